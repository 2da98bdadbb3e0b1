//! Which episodes of a run to take, where all of them would be too many.

use std::collections::{BTreeMap, BTreeSet};
use std::str::FromStr;

use conditions::Condition;
use run_log::{EpisodeRecord, RunLog};

/// Episodes of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Selection {
    /// So many: failures first, the conditions in turn.
    First(usize),
    /// All of them.
    All,
}

impl FromStr for Selection {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "all" => Ok(Self::All),
            count => count.parse().map(Self::First).map_err(|_| "expected a number, or `all`"),
        }
    }
}

impl Selection {
    /// The numbers of the selected episodes of `log`: those with one of `keys` first, then failures, the conditions in
    /// turn.
    pub fn choose(self, log: &RunLog, keys: &BTreeSet<String>) -> BTreeSet<usize> {
        let Self::First(most) = self else { return (0..log.episodes.len()).collect() };
        let mut first = FirstEpisodes::new(most);
        for record in &log.episodes {
            first.add(record, keys.contains(&record.key));
        }
        first.numbers()
    }
}

/// Selects episodes one after the other: preferred ones first, then failures, the conditions in turn.
#[derive(Debug)]
pub struct FirstEpisodes {
    most: usize,
    /// The number of episodes.
    seen: usize,
    /// Of each outcome and condition, the number of episodes.
    turns: BTreeMap<(bool, Condition), usize>,
    ranked: BTreeSet<Rank>,
}

/// Whether it is not preferred, whether it is a success, its turn among those of its condition, its number.
type Rank = (bool, bool, usize, usize);

impl FirstEpisodes {
    /// Selects `most` episodes.
    pub fn new(most: usize) -> Self {
        Self { most, seen: 0, turns: BTreeMap::new(), ranked: BTreeSet::new() }
    }

    /// Adds the next episode.
    pub fn add(&mut self, record: &EpisodeRecord, is_preferred: bool) {
        let turn = self.turns.entry((record.is_success(), record.condition())).or_default();
        *turn += 1;
        self.ranked.insert((!is_preferred, record.is_success(), *turn, self.seen));
        self.seen += 1;
        if self.ranked.len() > self.most {
            self.ranked.pop_last();
        }
    }

    /// The numbers of the selected episodes, from 0, in the order in which they were added.
    pub fn numbers(self) -> BTreeSet<usize> {
        self.ranked.into_iter().map(|(.., number)| number).collect()
    }
}

#[cfg(test)]
mod tests {
    use rigs::records::{log, record};

    use super::*;

    #[test]
    fn failures_are_chosen_first_and_the_conditions_take_turns() {
        let mut records = Vec::new();
        for (case, success) in [("a", true), ("b", false), ("c", false), ("d", false)] {
            records.push(record(case, success));
        }
        let log = log(records);
        let none = BTreeSet::new();
        assert_eq!(Selection::First(2).choose(&log, &none), BTreeSet::from([1, 2]));
        assert_eq!(Selection::First(9).choose(&log, &none), BTreeSet::from([0, 1, 2, 3]));
        assert_eq!(Selection::All.choose(&log, &none).len(), 4);
        let known = BTreeSet::from([log.episodes[0].key.clone()]);
        assert_eq!(Selection::First(2).choose(&log, &known), BTreeSet::from([0, 1]));
        assert_eq!("all".parse(), Ok(Selection::All));
        assert_eq!("7".parse(), Ok(Selection::First(7)));
        assert!("some".parse::<Selection>().is_err());
    }
}
