//! What is left to walk, how often each episode was walked in vain, and which one makes the policy fail.
//!
//! A policy that crashes or hangs takes with it whatever was under way. If one episode is to blame, the same
//! ones walked together again would end the same way. So those that were under way are suspects then: they are
//! walked before all others and fewer at a time, half as many after each such failure, until one that fails
//! alone is the culprit. It is given up after [`SPOILT_WALKS`] such walks; suspects that are finished are cleared,
//! and when nobody is suspected any more, all lanes are used again. What is walked when never changes what is
//! logged of it.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use crate::plan::Episode;
use results::key::EpisodeKey;

/// How often an episode is walked before it is left unfinished, when others may be to blame for it.
const WALKS: u32 = 12;

/// How often an episode is walked before it is left unfinished, when the policy failed on it alone.
const SPOILT_WALKS: u32 = 3;

/// Culprits that may be found one after the other without an episode being finished in between. A policy that
/// fails on more of them fails on everything.
pub(super) const CULPRITS_IN_A_ROW: u32 = 2;

/// What is left to walk.
#[derive(Debug, Default)]
pub(super) struct Work {
    queue: VecDeque<Episode>,
    tries: BTreeMap<EpisodeKey, Tries>,
    search: Option<Search>,
    unfinished: Vec<(Episode, String)>,
    finished: u64,
    /// Culprits found since an episode was finished.
    culprits: u32,
}

/// How often an episode was walked in vain.
#[derive(Debug, Default, Clone, Copy)]
struct Tries {
    /// For whatever reason.
    all: u32,
    /// Because a process other than the policy failed.
    failed: u32,
    /// Because the policy failed on it and on nothing else.
    spoilt: u32,
}

/// The search for the episode that makes the policy fail.
#[derive(Debug)]
struct Search {
    suspects: BTreeSet<EpisodeKey>,
    /// How many are walked at once.
    width: usize,
}

impl Work {
    pub(super) fn new(episodes: impl IntoIterator<Item = Episode>) -> Self {
        Self { queue: episodes.into_iter().collect(), ..Self::default() }
    }

    /// Whether nothing waits to be begun.
    pub(super) fn is_done(&self) -> bool {
        self.queue.is_empty()
    }

    /// Episodes finished so far.
    pub(super) fn count_finished(&self) -> u64 {
        self.finished
    }

    /// Culprits found since an episode was finished.
    pub(super) fn culprits_in_a_row(&self) -> u32 {
        self.culprits
    }

    /// How many episodes are walked at once while a culprit is looked for.
    pub(super) fn width(&self) -> Option<usize> {
        self.search.as_ref().map(|search| search.width)
    }

    /// Episodes that are given up, and why.
    pub(super) fn into_unfinished(self) -> Vec<(Episode, String)> {
        self.unfinished
    }

    /// Which time of walking `episode` this is, from 1.
    pub(super) fn attempt(&self, episode: &Episode) -> u32 {
        1 + self.tries.get(&episode.key).map_or(0, |tries| tries.all)
    }

    /// The episode to begin while `busy` are under way, if another one may be.
    pub(super) fn next(&mut self, busy: usize) -> Option<Episode> {
        let Some(Search { suspects, width }) = &self.search else { return self.queue.pop_front() };
        if busy >= *width {
            return None;
        }
        let suspect = self.queue.iter().position(|episode| suspects.contains(&episode.key))?;
        self.queue.remove(suspect)
    }

    /// `episode` is in the log.
    pub(super) fn finish(&mut self, episode: &Episode) {
        self.finished += 1;
        self.culprits = 0;
        self.clear(&episode.key);
    }

    /// `episode` is not to be walked again.
    pub(super) fn give_up(&mut self, episode: Episode, why: String) {
        self.clear(&episode.key);
        self.unfinished.push((episode, why));
    }

    /// The policy has spoilt `episode` and nothing else. Returns whether it is given up.
    pub(super) fn spoilt(&mut self, episode: Episode, why: &str) -> bool {
        let tries = self.tries.entry(episode.key.clone()).or_default();
        tries.all += 1;
        tries.spoilt += 1;
        if tries.spoilt < SPOILT_WALKS {
            self.queue.push_front(episode);
            return false;
        }
        self.give_up(episode, why.to_owned());
        true
    }

    /// A generation has failed with `under_way`, and not because of the policy.
    pub(super) fn failed(&mut self, under_way: Vec<Episode>) {
        for episode in under_way {
            let tries = self.tries.entry(episode.key.clone()).or_default();
            tries.all += 1;
            tries.failed += 1;
            if tries.failed < WALKS {
                self.queue.push_front(episode);
            } else {
                self.give_up(episode, "its processes failed again and again".to_owned());
            }
        }
    }

    /// A generation has failed with `under_way` because of the policy, and `why`. Returns the episode that is
    /// found to be the culprit, if it is given up.
    pub(super) fn failed_by_policy(
        &mut self,
        mut under_way: Vec<Episode>,
        why: &str,
    ) -> Option<EpisodeKey> {
        if under_way.len() != 1 {
            let width = (under_way.len() / 2).max(1);
            let suspects: BTreeSet<_> =
                under_way.iter().map(|episode| episode.key.clone()).collect();
            for episode in under_way {
                self.tries.entry(episode.key.clone()).or_default().all += 1;
                self.queue.push_front(episode);
            }
            if !suspects.is_empty() {
                self.search = Some(Search { suspects, width });
            }
            return None;
        }
        let culprit = under_way.pop()?;
        let key = culprit.key.clone();
        // Alone from now on, as it was this time.
        let alone = || Search { suspects: BTreeSet::from([key.clone()]), width: 1 };
        self.search.get_or_insert_with(alone).width = 1;
        let why = format!("the policy fails whenever this episode is walked, alone too: {why}");
        self.spoilt(culprit, &why).then(|| {
            self.culprits += 1;
            key
        })
    }

    /// `key` is suspected no longer.
    fn clear(&mut self, key: &EpisodeKey) {
        if let Some(search) = &mut self.search {
            search.suspects.remove(key);
            if search.suspects.is_empty() {
                self.search = None;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use domain::Representation;

    use super::*;
    use results::conditions::{Condition, Demonstrations, Route, Start, Variation};

    const LANES: usize = 16;

    fn episodes(count: usize) -> Vec<Episode> {
        let condition = Condition {
            memory: Representation::Working,
            start: Start::Original,
            route: Route::Unchanged,
            demonstrations: Demonstrations::NONE,
            variation: Variation::STANDARD,
        };
        let of = |case_index| {
            let key = EpisodeKey { condition, run: 1, case: format!("c{case_index:03}") };
            Episode { key, case_index, seed: 1 }
        };
        (0..count).map(of).collect()
    }

    /// How walking ended.
    struct Outcome {
        finished: Vec<usize>,
        given_up: Vec<usize>,
        generations: u32,
        /// Whether it was stopped because the policy fails on everything.
        hopeless: bool,
    }

    /// Walks `count` episodes with a policy that fails whenever one of `poisonous` has been under way for a turn.
    /// In each turn, the episode that was begun first is finished.
    fn walk(count: usize, poisonous: impl Fn(usize) -> bool) -> Outcome {
        let mut work = Work::new(episodes(count));
        let mut outcome =
            Outcome { finished: vec![], given_up: vec![], generations: 0, hopeless: false };
        while !work.is_done() && !outcome.hopeless {
            outcome.generations += 1;
            assert!(outcome.generations < 1000, "it does not end");
            let mut under_way: VecDeque<Episode> = VecDeque::new();
            loop {
                while under_way.len() < LANES
                    && let Some(episode) = work.next(under_way.len())
                {
                    under_way.push_back(episode);
                }
                if under_way.iter().any(|episode| poisonous(episode.case_index)) {
                    work.failed_by_policy(under_way.into_iter().collect(), "it crashed");
                    outcome.hopeless = work.culprits_in_a_row() >= CULPRITS_IN_A_ROW;
                    break;
                }
                let Some(done) = under_way.pop_front() else { break };
                work.finish(&done);
                outcome.finished.push(done.case_index);
            }
        }
        outcome.finished.sort_unstable();
        outcome.given_up = work.unfinished.iter().map(|(episode, _)| episode.case_index).collect();
        outcome.given_up.sort_unstable();
        outcome
    }

    #[test]
    fn one_poisonous_episode_is_found_and_everything_else_is_walked() {
        for poison in 0..40 {
            let Outcome { finished, given_up, generations, hopeless } = walk(40, |n| n == poison);
            assert!(!hopeless && generations <= 8, "{poison}: {generations} generations");
            assert_eq!(given_up, [poison]);
            assert_eq!(finished, (0..40).filter(|&n| n != poison).collect::<Vec<_>>());
        }
    }

    #[test]
    fn several_poisonous_episodes_are_found_as_well() {
        let outcome = walk(100, |n| n % 20 == 7);
        assert_eq!(outcome.given_up, [7, 27, 47, 67, 87]);
        assert_eq!(outcome.finished.len(), 95);
    }

    #[test]
    fn a_policy_that_fails_on_everything_is_not_tried_for_ever() {
        let outcome = walk(100, |_| true);
        assert!(
            outcome.hopeless && outcome.generations <= 16,
            "{} generations",
            outcome.generations
        );
    }

    #[test]
    fn what_others_spoil_is_walked_more_often_and_a_failure_by_chance_costs_nothing() {
        let mut work = Work::new(episodes(3));
        for _ in 0..WALKS - 1 {
            let under_way: Vec<_> = std::iter::from_fn(|| work.next(0)).collect();
            assert_eq!(under_way.len(), 3);
            work.failed(under_way);
        }
        let under_way: Vec<_> = std::iter::from_fn(|| work.next(0)).collect();
        assert_eq!(work.attempt(&under_way[0]), WALKS);
        work.failed_by_policy(under_way, "killed by somebody");
        assert_eq!((work.width(), work.unfinished.len()), (Some(1), 0));
        while let Some(episode) = work.next(0) {
            assert!(work.next(1).is_none(), "one at a time");
            work.finish(&episode);
        }
        assert_eq!((work.width(), work.count_finished(), work.is_done()), (None, 3, true));
    }
}
