//! The finished episodes of one condition, by run or by case, as the formulas need them.
//!
//! An episode that was given up because of a fault is not here: infrastructure is never scored.

use std::collections::{BTreeMap, BTreeSet};

use super::spread::Spread;
use conditions::Condition;
use run_log::{EpisodeRecord, RunLog};

/// All finished episodes of one condition outside of streams, ordered by case and run.
#[derive(Debug, Clone, Default)]
pub(super) struct Trials<'a> {
    list: Vec<&'a EpisodeRecord>,
}

impl<'a> Trials<'a> {
    /// The episodes of each condition that has one in `log`.
    pub(super) fn by_condition(log: &'a RunLog) -> BTreeMap<Condition, Self> {
        let mut trials: BTreeMap<Condition, Self> = BTreeMap::new();
        for record in log.episodes.iter().filter(|record| record.stream.is_none()) {
            trials.entry(record.condition()).or_default().list.push(record);
        }
        for Self { list } in trials.values_mut() {
            list.sort_by_key(|record| (&record.case, record.run));
        }
        trials
    }

    /// The episodes of `condition` in `log`, of the cases that are selected.
    pub(super) fn of(
        log: &'a RunLog,
        condition: &Condition,
        is_selected: impl Fn(&str) -> bool,
    ) -> Self {
        let is_own = |record: &&EpisodeRecord| {
            record.stream.is_none() && record.condition() == *condition && is_selected(&record.case)
        };
        let mut list: Vec<&EpisodeRecord> = log.episodes.iter().filter(is_own).collect();
        list.sort_by_key(|record| (&record.case, record.run));
        Self { list }
    }

    /// The episodes of these cases.
    pub(super) fn of_cases(&self, cases: &BTreeSet<&str>) -> Self {
        let is_of = |record: &&EpisodeRecord| cases.contains(record.case.as_str());
        Self { list: self.iter().filter(is_of).collect() }
    }

    /// All episodes, by case and run.
    pub(super) fn iter(&self) -> impl Iterator<Item = &'a EpisodeRecord> + Clone {
        self.list.iter().copied()
    }

    /// The number of episodes.
    pub(super) fn count(&self) -> usize {
        self.list.len()
    }

    /// The episodes of each run.
    pub(super) fn runs(&self) -> BTreeMap<u32, Vec<&'a EpisodeRecord>> {
        let mut runs: BTreeMap<u32, Vec<&EpisodeRecord>> = BTreeMap::new();
        for record in &self.list {
            runs.entry(record.run).or_default().push(record);
        }
        runs
    }

    /// The repetitions of each case.
    pub(super) fn cases(&self) -> BTreeMap<&'a str, Vec<&'a EpisodeRecord>> {
        let mut cases: BTreeMap<&str, Vec<&EpisodeRecord>> = BTreeMap::new();
        for record in &self.list {
            cases.entry(&record.case).or_default().push(record);
        }
        cases
    }

    /// A figure computed for each run by itself, over the runs in which it is defined; `None` when it is in none.
    pub(super) fn over_runs(
        &self,
        figure: impl Fn(&[&EpisodeRecord]) -> Option<f64>,
    ) -> Option<Spread> {
        let values: Vec<f64> = self.runs().values().filter_map(|records| figure(records)).collect();
        Spread::of(&values)
    }
}

/// The contribution of an episode to SPL: `s_i * l_i / max(p_i, l_i)`, with 0 / 0 taken as 1 (an episode that
/// begins complete).
pub fn path_weight(record: &EpisodeRecord) -> f64 {
    if !record.is_success() {
        return 0.0;
    }
    match record.steps.max(record.reference) {
        0 => 1.0,
        longest => f64::from(record.reference) / f64::from(longest),
    }
}
