//! Episodes that are left to run, how often each failed, and which one makes a process fail.
//!
//! A policy, a world or an external memory that crashes or hangs takes every episode under way with it. If one of them is the
//! cause, the same ones together would end the same way. So those that the process worked on become suspects: they run before
//! all others and fewer at a time, half as many after each such failure, until one fails alone. That one is given up after
//! [`SPOILED_ATTEMPTS`]; suspects that are finished are cleared, and when none is left, all lanes are used again. Between two
//! attempts of an episode that fails alone others are tried alone, at the end also one that is no suspect: a process that fails
//! on [`MOST_FAILED_ALONE`] of them in a row fails on everything. The order of episodes never changes their records.
//!
//! The episodes of a sequence run strictly one after the other: the next one waits until the one before is in the log, and
//! is not run if that one has no result.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;

use conditions::key::EpisodeKey;
use domain::{ExternalName, MemoryKind};

use crate::plan::PlannedEpisode;

/// Attempts at an episode when something else may be the cause of its failures.
const ATTEMPTS: u32 = 12;

/// Attempts at an episode that alone makes a process fail.
const SPOILED_ATTEMPTS: u32 = 3;

/// Different episodes on which a process may fail, each alone and none finished in between. A process that fails on so many
/// fails on everything.
pub(super) const MOST_FAILED_ALONE: usize = 4;

/// What can fail because of an episode: what is the user's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Culpable {
    Policy,
    /// All processes of an external world.
    World,
    Memory(ExternalName),
}

impl fmt::Display for Culpable {
    /// As it is called in a sentence.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Policy => f.write_str("the policy"),
            Self::World => f.write_str("the world"),
            Self::Memory(name) => write!(f, "the external memory {name}"),
        }
    }
}

impl Culpable {
    /// Whether it takes part in `episode`.
    pub(super) fn serves(self, episode: &PlannedEpisode) -> bool {
        match self {
            Self::Policy | Self::World => true,
            Self::Memory(name) => episode.key.condition.memory == MemoryKind::External(name),
        }
    }
}

/// Episodes that are left to run.
#[derive(Debug, Default)]
pub(super) struct EpisodeQueue {
    waiting: VecDeque<PlannedEpisode>,
    /// Of each sequence, the episodes after the one that waits or is under way.
    later: BTreeMap<u64, VecDeque<PlannedEpisode>>,
    failures: BTreeMap<EpisodeKey, FailedAttempts>,
    search: Option<CulpritSearch>,
    unfinished: Vec<(PlannedEpisode, String)>,
    finished: u64,
}

/// Failed attempts at an episode.
#[derive(Debug, Default, Clone, Copy)]
struct FailedAttempts {
    /// Failures for any reason.
    all: u32,
    /// Failures for which the episode cannot be the reason.
    by_others: u32,
    /// Because a process failed on this episode and nothing else.
    spoiled: u32,
}

/// The search for the episode that makes a process fail.
#[derive(Debug)]
struct CulpritSearch {
    process: Culpable,
    suspects: BTreeSet<EpisodeKey>,
    /// Episodes that run at once.
    width: usize,
    /// The episodes on which the process failed alone since it has finished one.
    failed_alone: BTreeSet<EpisodeKey>,
}

impl CulpritSearch {
    /// The place in `waiting` of the episode to begin: a suspect; if all of them fail alone, another episode, far from them
    /// in the plan, to see whether the process fails on any.
    fn next(&self, waiting: &VecDeque<PlannedEpisode>) -> Option<usize> {
        let is_suspect = |episode: &PlannedEpisode| self.suspects.contains(&episode.key);
        let is_tried = |episode: &PlannedEpisode| self.failed_alone.contains(&episode.key);
        let is_other =
            |episode: &PlannedEpisode| self.process.serves(episode) && !is_tried(episode);
        let untried = waiting.iter().position(|episode| is_suspect(episode) && !is_tried(episode));
        if self.failed_alone.is_empty() {
            return untried;
        }
        untried
            .or_else(|| waiting.iter().rposition(is_other))
            .or_else(|| waiting.iter().position(is_suspect))
    }
}

impl EpisodeQueue {
    pub(super) fn new(episodes: impl IntoIterator<Item = PlannedEpisode>) -> Self {
        let mut queue = Self::default();
        for episode in episodes {
            match episode.sequence().and_then(|sequence| queue.later.get_mut(&sequence)) {
                Some(later) => later.push_back(episode),
                None => {
                    queue.later.extend(episode.sequence().map(|one| (one, VecDeque::new())));
                    queue.waiting.push_back(episode);
                }
            }
        }
        queue
    }

    /// Whether no episode waits.
    pub(super) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Number of finished episodes.
    pub(super) fn count_finished(&self) -> u64 {
        self.finished
    }

    /// Whether the process that is searched for a culprit fails on everything.
    pub(super) fn is_hopeless(&self) -> bool {
        self.search.as_ref().is_some_and(|search| search.failed_alone.len() >= MOST_FAILED_ALONE)
    }

    /// Episodes that run at once during a search for a culprit.
    pub(super) fn width(&self) -> Option<usize> {
        self.search.as_ref().map(|search| search.width)
    }

    /// The episodes that were given up, and why.
    pub(super) fn into_unfinished(self) -> Vec<(PlannedEpisode, String)> {
        self.unfinished
    }

    /// The number of the current attempt at `episode`, from 1.
    pub(super) fn attempt(&self, episode: &PlannedEpisode) -> u32 {
        1 + self.failures.get(&episode.key).map_or(0, |failures| failures.all)
    }

    /// The episode to begin while `busy` are under way, if another one may begin.
    pub(super) fn next(&mut self, busy: usize) -> Option<PlannedEpisode> {
        let Some(search) = &self.search else { return self.waiting.pop_front() };
        if busy >= search.width {
            return None;
        }
        let next = search.next(&self.waiting)?;
        self.waiting.remove(next)
    }

    /// `episode` is in the log. The next one of its sequence waits from now on, and continues from its snapshot.
    pub(super) fn finish(&mut self, episode: &PlannedEpisode) {
        self.finished += 1;
        if let Some(search) = &mut self.search
            && search.process.serves(episode)
        {
            search.failed_alone.clear();
        }
        self.clear(&episode.key);
        let Some(part) = episode.part else { return };
        let next = self.later.get_mut(&part.sequence).and_then(VecDeque::pop_front);
        if let Some(mut next) = next {
            if let Some(its) = &mut next.part {
                its.snapshot = part.snapshot;
            }
            // First, so that the sequence goes on while its memory is at hand.
            self.waiting.push_front(next);
        }
    }

    /// `episode` is not run again in this session, and neither are the later ones of its sequence.
    pub(super) fn give_up(&mut self, episode: PlannedEpisode, why: String) {
        self.clear(&episode.key);
        let later = episode.sequence().and_then(|sequence| self.later.remove(&sequence));
        let not_run = format!("not run, because {} of its sequence has no result", episode.key);
        self.unfinished.push((episode, why));
        let later = later.into_iter().flatten();
        self.unfinished.extend(later.map(|episode| (episode, not_run.clone())));
    }

    /// A process failed on `episode` and nothing else. Returns whether the episode is given up.
    pub(super) fn spoiled(&mut self, episode: PlannedEpisode, why: &str) -> bool {
        let failures = self.failures.entry(episode.key.clone()).or_default();
        failures.all += 1;
        failures.spoiled += 1;
        if failures.spoiled < SPOILED_ATTEMPTS {
            self.waiting.push_front(episode);
            return false;
        }
        self.give_up(episode, why.to_owned());
        true
    }

    /// A generation ended with `under_way`, and none of them is known to be the reason: they start over, however often.
    pub(super) fn interrupted(&mut self, under_way: Vec<PlannedEpisode>) {
        for episode in under_way {
            self.failures.entry(episode.key.clone()).or_default().all += 1;
            self.waiting.push_front(episode);
        }
    }

    /// Gives up all waiting episodes with `memory`, and what would follow in their sequences. Returns how many.
    pub(super) fn exclude(&mut self, memory: MemoryKind, why: &str) -> usize {
        let waiting = std::mem::take(&mut self.waiting);
        let is_its = |episode: &PlannedEpisode| episode.key.condition.memory == memory;
        let (excluded, waiting): (Vec<_>, Vec<_>) = waiting.into_iter().partition(is_its);
        self.waiting = waiting.into();
        let before = self.unfinished.len();
        excluded.into_iter().for_each(|episode| self.give_up(episode, why.to_owned()));
        self.unfinished.len() - before
    }

    /// A generation failed with `under_way`, and not because of one of them.
    pub(super) fn failed(&mut self, under_way: Vec<PlannedEpisode>) {
        for episode in under_way {
            let failures = self.failures.entry(episode.key.clone()).or_default();
            failures.all += 1;
            failures.by_others += 1;
            if failures.by_others < ATTEMPTS {
                self.waiting.push_front(episode);
            } else {
                let why = format!("its processes failed {ATTEMPTS} times");
                self.give_up(episode, why);
            }
        }
    }

    /// A generation failed because of `process`, which worked on the episodes `under_way`. Returns the culprit, if it was found
    /// and given up.
    pub(super) fn failed_by(
        &mut self,
        process: Culpable,
        mut under_way: Vec<PlannedEpisode>,
        why: &str,
    ) -> Option<EpisodeKey> {
        if under_way.len() != 1 {
            let width = (under_way.len() / 2).max(1);
            let suspects: BTreeSet<_> =
                under_way.iter().map(|episode| episode.key.clone()).collect();
            self.interrupted(under_way);
            if !suspects.is_empty() {
                let failed_alone = BTreeSet::new();
                self.search = Some(CulpritSearch { process, suspects, width, failed_alone });
            }
            return None;
        }
        let culprit = under_way.pop()?;
        let key = culprit.key.clone();
        let alone = CulpritSearch {
            process,
            suspects: BTreeSet::new(),
            width: 1,
            failed_alone: BTreeSet::new(),
        };
        let search = match &mut self.search {
            Some(search) if search.process == process => search,
            none_or_other => none_or_other.insert(alone),
        };
        // It keeps running alone, as it did this time.
        search.width = 1;
        search.suspects.insert(key.clone());
        search.failed_alone.insert(key.clone());
        let why = format!("{process} fails whenever this episode runs, even alone: {why}");
        self.spoiled(culprit, &why).then_some(key)
    }

    /// `key` is no longer a suspect.
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
    use domain::{Arm, FeedbackLevel, Representation};

    use super::*;
    use crate::plan::StreamPart;
    use conditions::{Condition, Demonstrations, Mismatch, Route, Start, Variation};

    const LANES: usize = 16;

    fn episodes(count: usize) -> Vec<PlannedEpisode> {
        let condition = Condition {
            memory: Representation::Working.into(),
            start: Start::Original,
            route: Route::Unchanged,
            demonstrations: Demonstrations::NONE,
            variation: Variation::STANDARD,
            mismatch: Mismatch::None,
            arm: Arm::Frozen,
        };
        let of = |case_index| {
            let key =
                EpisodeKey { condition, run: 1, place: None, case: format!("c{case_index:03}") };
            PlannedEpisode { key, case_index, seed: 1, part: None }
        };
        (0..count).map(of).collect()
    }

    /// How a run ended.
    struct Outcome {
        finished: Vec<usize>,
        given_up: Vec<usize>,
        generations: u32,
        /// Whether it was stopped because the policy fails on everything.
        hopeless: bool,
    }

    /// Runs `count` episodes with a policy that fails whenever one of `poisonous` has been under way for a turn.
    /// In each turn, the episode that was begun first is finished.
    fn run(count: usize, poisonous: impl Fn(usize) -> bool) -> Outcome {
        let mut queue = EpisodeQueue::new(episodes(count));
        let mut outcome =
            Outcome { finished: vec![], given_up: vec![], generations: 0, hopeless: false };
        while !queue.is_empty() && !outcome.hopeless {
            outcome.generations += 1;
            assert!(outcome.generations < 1000, "it does not end");
            let mut under_way: VecDeque<PlannedEpisode> = VecDeque::new();
            loop {
                while under_way.len() < LANES
                    && let Some(episode) = queue.next(under_way.len())
                {
                    under_way.push_back(episode);
                }
                if under_way.iter().any(|episode| poisonous(episode.case_index)) {
                    let under_way = under_way.into_iter().collect();
                    queue.failed_by(Culpable::Policy, under_way, "it crashed");
                    outcome.hopeless = queue.is_hopeless();
                    break;
                }
                let Some(done) = under_way.pop_front() else { break };
                queue.finish(&done);
                outcome.finished.push(done.case_index);
            }
        }
        outcome.finished.sort_unstable();
        outcome.given_up = queue.unfinished.iter().map(|(episode, _)| episode.case_index).collect();
        outcome.given_up.sort_unstable();
        outcome
    }

    #[test]
    fn one_poisonous_episode_is_found_and_everything_else_is_finished() {
        for poison in 0..40 {
            let Outcome { finished, given_up, generations, hopeless } = run(40, |n| n == poison);
            assert!(!hopeless && generations <= 8, "{poison}: {generations} generations");
            assert_eq!(given_up, [poison]);
            assert_eq!(finished, (0..40).filter(|&n| n != poison).collect::<Vec<_>>());
        }
    }

    #[test]
    fn several_poisonous_episodes_are_found_as_well() {
        let outcome = run(100, |n| n % 20 == 7);
        assert_eq!(outcome.given_up, [7, 27, 47, 67, 87]);
        assert_eq!(outcome.finished.len(), 95);
    }

    #[test]
    fn poisonous_episodes_in_a_row_do_not_look_like_a_policy_that_fails_on_everything() {
        for first in [0, 5, 20, 30] {
            let outcome = run(40, |n| (first..first + 5).contains(&n));
            assert_eq!(outcome.given_up, (first..first + 5).collect::<Vec<_>>());
            assert_eq!((outcome.finished.len(), outcome.hopeless), (35, false));
        }
        // Where nothing else is left, each has its three attempts.
        let outcome = run(3, |_| true);
        assert_eq!((outcome.given_up.len(), outcome.hopeless), (3, false));
    }

    #[test]
    fn a_policy_that_fails_on_everything_is_not_tried_for_ever() {
        let outcome = run(100, |_| true);
        assert!(
            outcome.hopeless && outcome.generations <= 9,
            "{} generations",
            outcome.generations
        );
    }

    #[test]
    fn an_excluded_memory_takes_its_waiting_episodes_with_it_and_no_others() {
        let memory: MemoryKind = "top-3".parse().unwrap();
        let mut all = episodes(6);
        for episode in all.iter_mut().step_by(2) {
            episode.key.condition.memory = memory;
        }
        let mut queue = EpisodeQueue::new(all);
        for _ in 0..2 * ATTEMPTS {
            let under_way = vec![queue.next(0).unwrap(), queue.next(1).unwrap()];
            queue.interrupted(under_way);
        }
        assert_eq!(queue.exclude(memory, "it crashes"), 3);
        let left: Vec<usize> =
            std::iter::from_fn(|| queue.next(0)).map(|episode| episode.case_index).collect();
        assert_eq!(left.len(), 3);
        assert!(left.iter().all(|index| index % 2 == 1), "{left:?}");
        let given_up = queue.into_unfinished();
        assert_eq!(given_up.len(), 3);
        assert!(given_up.iter().all(|(_, why)| why == "it crashes"));
    }

    #[test]
    fn a_search_for_the_culprit_of_a_memory_tries_no_episode_of_another_one() {
        let name: ExternalName = "top-3".parse().unwrap();
        let mut all = episodes(8);
        for episode in all.iter_mut().skip(4) {
            episode.key.condition.memory = MemoryKind::External(name);
        }
        let mut queue = EpisodeQueue::new(all);
        let under_way: Vec<_> = std::iter::from_fn(|| queue.next(0)).take(6).collect();
        let (own, others): (Vec<_>, Vec<_>) =
            under_way.into_iter().partition(|episode| Culpable::Memory(name).serves(episode));
        queue.interrupted(others);
        let mut tried = Vec::new();
        let mut next = own;
        while !next.is_empty() {
            queue.failed_by(Culpable::Memory(name), next, "it crashed");
            if queue.is_hopeless() {
                break;
            }
            next = queue.next(0).into_iter().collect();
            tried.extend(next.iter().map(|episode| episode.case_index));
        }
        // One after the other: the two that were under way, then those from the end.
        tried.sort_unstable();
        assert_eq!(tried, [4, 5, 6, 7]);
        assert_eq!(queue.exclude(MemoryKind::External(name), "it crashes"), 4);
        assert_eq!((queue.width(), queue.unfinished.len()), (None, 4));
        assert_eq!(std::iter::from_fn(|| queue.next(0)).count(), 4);
    }

    #[test]
    fn failures_of_others_allow_more_attempts_and_a_failure_by_chance_costs_nothing() {
        let mut queue = EpisodeQueue::new(episodes(3));
        for _ in 0..ATTEMPTS - 1 {
            let under_way: Vec<_> = std::iter::from_fn(|| queue.next(0)).collect();
            assert_eq!(under_way.len(), 3);
            queue.failed(under_way);
        }
        let under_way: Vec<_> = std::iter::from_fn(|| queue.next(0)).collect();
        assert_eq!(queue.attempt(&under_way[0]), ATTEMPTS);
        queue.failed_by(Culpable::Policy, under_way, "killed");
        assert_eq!((queue.width(), queue.unfinished.len()), (Some(1), 0));
        while let Some(episode) = queue.next(0) {
            assert!(queue.next(1).is_none(), "one at a time");
            queue.finish(&episode);
        }
        assert_eq!((queue.width(), queue.count_finished(), queue.is_empty()), (None, 3, true));
    }

    /// Two sequences of three episodes each: cases 0 to 2 and 10 to 12.
    fn sequences() -> Vec<PlannedEpisode> {
        let part = |sequence| StreamPart {
            sequence,
            block: 0,
            place: 0,
            after: 0,
            round: None,
            world: 0,
            feedback: FeedbackLevel::None,
            snapshot: [0; 16],
        };
        let all = episodes(13).into_iter().filter(|episode| !(3..10).contains(&episode.case_index));
        all.map(|episode| {
            let part = Some(part(1 + episode.case_index as u64 / 10));
            PlannedEpisode { part, ..episode }
        })
        .collect()
    }

    #[test]
    fn a_sequence_waits_for_its_episode_and_goes_on_from_its_snapshot() {
        let mut queue = EpisodeQueue::new(sequences());
        let (mut one, other) = (queue.next(0).unwrap(), queue.next(0).unwrap());
        assert_eq!((one.case_index, other.case_index), (0, 10));
        assert_eq!(queue.next(0), None, "the others wait for these");
        // What fails is repeated, and nothing else of its sequence.
        queue.failed(vec![other]);
        let other = queue.next(0).unwrap();
        assert_eq!((other.case_index, queue.next(0)), (10, None));
        one.part.as_mut().unwrap().snapshot = [7; 16];
        queue.finish(&one);
        let second = queue.next(0).unwrap();
        assert_eq!((second.case_index, second.part.unwrap().snapshot), (1, [7; 16]));
        queue.finish(&second);
        let third = queue.next(0).unwrap();
        assert_eq!((third.case_index, third.part.unwrap().snapshot), (2, [7; 16]));
        queue.finish(&third);
        queue.finish(&other);
        assert_eq!(queue.next(0).unwrap().case_index, 11);
    }

    #[test]
    fn an_episode_without_a_result_ends_its_sequence() {
        let mut queue = EpisodeQueue::new(sequences());
        let (one, other) = (queue.next(0).unwrap(), queue.next(0).unwrap());
        queue.give_up(one, "no answer".into());
        queue.finish(&other);
        let left: Vec<usize> = std::iter::from_fn(|| {
            let episode = queue.next(0)?;
            queue.finish(&episode);
            Some(episode.case_index)
        })
        .collect();
        assert_eq!(left, [11, 12]);
        let given_up = queue.into_unfinished();
        let given_up: Vec<(usize, &str)> =
            given_up.iter().map(|(episode, why)| (episode.case_index, why.as_str())).collect();
        let not_run = "not run, because working/original/unchanged/none/run1/c000 of its sequence has no result";
        assert_eq!(given_up, [(0, "no answer"), (1, not_run), (2, not_run)]);
    }
}
