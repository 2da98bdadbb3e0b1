//! Why an episode failed, as a pure function of its record.
//!
//! One kind for each failure: the first whose rule applies, in the order of [`Failure`]. First comes *how* an
//! episode went wrong, where that shows (answers, barricade, loops), because an agent that is stuck says nothing
//! about what it knew; then *what* was missing. The bounds are conventions, the same for every memory and policy.

use std::collections::{BTreeMap, BTreeSet};

use domain::names::named;
use domain::{Pose, TaskType};
use serde::Serialize;

use crate::events::Requirement;
use crate::log::EpisodeRecord;

named! {
    /// Why an episode failed: the first of these that applies, in this order.
    Failure, "kind of failure" {
        /// In at least half of the answers no action could be read.
        Unreadable = "unreadable",
        /// The agent tried to enter a closed cell, and after that met no requirement and entered fewer than
        /// [`NEW_CELLS`] cells where it had not been before: it did not look for a way round.
        Blocked = "blocked",
        /// Within the last [`LOOP_STEPS`] steps the agent was at least [`LOOP_VISITS`] times in the same pose.
        Looped = "looped",
        /// The task has an order, and the agent stood before a B ahead of its first A and not again after it.
        WrongOrder = "wrong-order",
        /// Everything is done except the return to the origin.
        NoReturn = "no-return",
        /// Everything is done except the visit to the same instance again.
        NoRevisit = "no-revisit",
        /// The task is exhaustive, and some instances were visited and others were not.
        MissedInstance = "missed-instance",
        /// No item of the requirement that is next was ever in view.
        NeverSaw = "never-saw",
        /// One was in view, and the agent never stood before it.
        SawAndLeft = "saw-and-left",
        /// None of these.
        Other = "other",
    }
}

/// Number of new cells after a barricade that count as looking for a way round it.
pub const NEW_CELLS: usize = 10;
/// Number of steps at the end of an episode in which a loop is looked for.
pub const LOOP_STEPS: usize = 60;
/// Number of times in one pose that count as a loop.
pub const LOOP_VISITS: usize = 5;

impl Failure {
    /// Returns the kind of failure of `record`; `None` for a success.
    pub fn of(record: &EpisodeRecord) -> Option<Self> {
        let rule = |kind: &&Self| kind.applies(record);
        (!record.is_success()).then(|| Self::ALL.iter().find(rule).copied().unwrap_or(Self::Other))
    }

    /// The number of steps after which this failure of `record` was decided: that of the try to enter the closed cell,
    /// of the last visit to the pose of a loop, of the arrival or sight after which the agent came no further. The end of
    /// the episode where only the steps ran out.
    pub fn decided_at(self, record: &EpisodeRecord) -> u32 {
        let last_met = record.sub_goals.last().copied();
        let found = match self {
            Self::Unreadable => {
                let unread = (1..).zip(record.actions.chars()).filter(|(_, letter)| *letter == '?');
                let half = record.requests.unwrap_or(record.steps).div_ceil(2).max(1);
                unread.map(|(step, _)| step).nth(half as usize - 1)
            }
            Self::Blocked => record.tried_closed_at,
            Self::Looped => looped_at(record),
            Self::WrongOrder => {
                let early = record.visits.iter().find(|visit| visit.requirement == Requirement::B);
                early.map(|visit| visit.step)
            }
            Self::NoReturn | Self::NoRevisit | Self::MissedInstance => last_met,
            Self::SawAndLeft => {
                let open = next(record).unwrap_or_default();
                let seen = open.iter().filter_map(|one| record.first_seen.get(one).copied());
                seen.min().max(last_met)
            }
            Self::NeverSaw | Self::Other => None,
        };
        found.unwrap_or(record.steps)
    }

    /// A short description for a legend.
    pub const fn meaning(self) -> &'static str {
        match self {
            Self::Unreadable => "in at least half of the answers no action could be read",
            Self::Blocked => {
                "tried to enter a closed cell, then met no requirement and hardly went anywhere new"
            }
            Self::Looped => "at least 5 times in the same pose within the last 60 steps",
            Self::WrongOrder => "stood before B ahead of A, and not again after it",
            Self::NoReturn => "everything done except the return to the origin",
            Self::NoRevisit => "everything done except visiting the same instance again",
            Self::MissedInstance => "visited some of the instances and not all",
            Self::NeverSaw => "the target that was next was never in view",
            Self::SawAndLeft => "the target that was next was in view and was never reached",
            Self::Other => "none of the other kinds",
        }
    }

    fn applies(self, record: &EpisodeRecord) -> bool {
        use TaskType::{
            EveryAndReturn, EveryOfCategory, EveryOfType, FindAndReturn, InOrder, InOrderAndReturn,
            Revisit,
        };
        let left = record.required.saturating_sub(record.sub_goals.len() as u32);
        let task = record.task_type();
        match self {
            Self::Unreadable => {
                record.requests.is_some_and(|asked| asked > 0 && record.unread.total() * 2 >= asked)
            }
            Self::Blocked => record.tried_closed_at.is_some_and(|step| gave_up(record, step)),
            Self::Looped => looped_at(record).is_some(),
            Self::WrongOrder => {
                matches!(task, Some(InOrder | Revisit | InOrderAndReturn))
                    && record.sub_goals.len() == 1
                    && has_visited(record, Requirement::B)
            }
            Self::NoReturn => {
                matches!(task, Some(FindAndReturn | EveryAndReturn | InOrderAndReturn)) && left == 1
            }
            Self::NoRevisit => task == Some(Revisit) && left == 1,
            Self::MissedInstance => {
                matches!(task, Some(EveryOfType | EveryOfCategory | EveryAndReturn))
                    && !record.sub_goals.is_empty()
            }
            Self::NeverSaw => next(record).is_some_and(|open| !has_seen(record, &open)),
            Self::SawAndLeft => next(record).is_some_and(|open| has_seen(record, &open)),
            Self::Other => true,
        }
    }
}

/// The requirements that could be met next; `None` when none is left.
fn next(record: &EpisodeRecord) -> Option<Vec<Requirement>> {
    use Requirement::{A, B, C};
    let open = match (record.task_type(), record.sub_goals.len()) {
        (Some(TaskType::FindCategory | TaskType::EveryOfCategory), _) => vec![C],
        (Some(TaskType::BothTypes), _) => {
            [A, B].into_iter().filter(|one| !has_visited(record, *one)).collect()
        }
        (Some(TaskType::InOrder | TaskType::Revisit | TaskType::InOrderAndReturn), 1) => vec![B],
        _ => vec![A],
    };
    let left = record.sub_goals.len() < record.required as usize;
    (left && !open.is_empty()).then_some(open)
}

fn has_visited(record: &EpisodeRecord, requirement: Requirement) -> bool {
    record.visits.iter().any(|visit| visit.requirement == requirement)
}

/// Whether one of the requirements was ever in view.
fn has_seen(record: &EpisodeRecord, open: &[Requirement]) -> bool {
    open.iter().any(|requirement| record.first_seen.contains_key(requirement))
}

fn gave_up(record: &EpisodeRecord, tried_at: u32) -> bool {
    let poses = record.poses();
    let (before, after) = poses.split_at(poses.len().min(tried_at as usize));
    let known: BTreeSet<_> = before.iter().map(|pose| pose.cell).collect();
    let entered: BTreeSet<_> = after.iter().map(|pose| pose.cell).collect();
    let met = record.sub_goals.iter().any(|&step| step >= tried_at);
    !met && entered.difference(&known).count() < NEW_CELLS
}

/// The step of the [`LOOP_VISITS`]th visit to a pose within the last [`LOOP_STEPS`] steps, the first such.
fn looped_at(record: &EpisodeRecord) -> Option<u32> {
    let poses = record.poses();
    let first = poses.len().saturating_sub(LOOP_STEPS);
    let mut visits = BTreeMap::new();
    let again = |pose: &Pose| {
        let count = visits.entry(*pose).or_insert(0);
        *count += 1;
        *count == LOOP_VISITS
    };
    let last = poses[first..].iter().position(again)?;
    u32::try_from(first + last).ok()
}

/// Counts of failures by kind.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Failures(Vec<(Failure, usize)>);

impl Failures {
    /// Counts the failures of `records`.
    pub fn of<'a>(records: impl Iterator<Item = &'a EpisodeRecord>) -> Self {
        let mut counts: Vec<(Failure, usize)> =
            Failure::ALL.iter().map(|&failure| (failure, 0)).collect();
        for failure in records.filter_map(Failure::of) {
            counts[failure as usize].1 += 1;
        }
        Self(counts)
    }

    /// Each kind with its count, in the order of the kinds.
    pub fn iter(&self) -> impl Iterator<Item = (Failure, usize)> {
        self.0.iter().copied()
    }

    /// The number of failures.
    pub fn total(&self) -> usize {
        self.0.iter().map(|(_, count)| count).sum()
    }
}

#[cfg(test)]
mod tests {
    use domain::{Cell, Heading};

    use super::*;
    use crate::events::Visit;
    use crate::log::Unread;
    use crate::log::testing::record;

    /// A failure of `task` whose agent never visits a pose twice: north up column 3, and so on.
    fn failed(task: u8, required: u32, met: &[u32]) -> EpisodeRecord {
        let mut record = record("a", false);
        (record.task, record.required, record.sub_goals) = (task, required, met.to_vec());
        record.start_pose = Pose::new(0, 0, Heading::N);
        record.actions = format!("{}R{}", "f".repeat(99), "f".repeat(100));
        record
    }

    fn sees(mut record: EpisodeRecord, seen: &[Requirement]) -> EpisodeRecord {
        record.first_seen =
            seen.iter().map(|&requirement| (requirement, 1)).collect::<BTreeMap<_, _>>();
        record
    }

    fn visits(mut record: EpisodeRecord, visits: &[(u32, Requirement)]) -> EpisodeRecord {
        let visit = |&(step, requirement)| Visit { step, requirement, cell: Cell::new(3, 7) };
        record.visits = visits.iter().map(visit).collect();
        record
    }

    /// On a blocked route: walks north, runs into the barricade at step 5, then does `actions`.
    fn at_barricade(actions: &str) -> EpisodeRecord {
        let mut record = failed(1, 1, &[]);
        (record.tried_closed, record.tried_closed_at) = (Some(true), Some(5));
        record.actions = format!("fffff{actions}");
        record.steps = record.actions.len() as u32;
        record.blocked_moves = vec![5];
        record
    }

    #[test]
    fn one_record_of_each_kind() {
        use Requirement::{A, B, C};
        let mut unread = failed(1, 1, &[]);
        unread.unread = Unread { unreadable: 60, empty: 30, refused: 10, cut_off: 0 };
        let mut half = unread.clone();
        half.unread.refused = 9;
        // Turns on the spot for the last 20 steps: each of four poses five times.
        let mut spins = failed(1, 1, &[]);
        spins.actions = format!("{}{}", "f".repeat(180), "L".repeat(20));
        let mut turns = spins.clone();
        turns.actions = format!("{}{}", "f".repeat(180), "L".repeat(15));
        for (expected, record) in [
            // 100 of 200 answers; then 99.
            (Failure::Unreadable, unread),
            (Failure::NeverSaw, half),
            // Nine new cells after the barricade, then ten.
            (Failure::Blocked, at_barricade("Lfffffffff")),
            (Failure::NeverSaw, at_barricade("Rffffffffff")),
            (Failure::Looped, spins),
            (Failure::NeverSaw, turns),
            (Failure::WrongOrder, visits(failed(6, 2, &[50]), &[(20, B), (50, A)])),
            (Failure::WrongOrder, visits(failed(10, 3, &[50]), &[(20, B), (50, A)])),
            (Failure::NeverSaw, visits(failed(6, 2, &[50]), &[(50, A)])),
            (Failure::NoReturn, failed(7, 2, &[50])),
            (Failure::NoReturn, failed(8, 4, &[50, 60, 70])),
            (Failure::NoReturn, visits(failed(10, 3, &[50, 60]), &[(20, B), (50, A), (60, B)])),
            (Failure::NoRevisit, failed(9, 3, &[50, 60])),
            (Failure::MissedInstance, failed(3, 3, &[50])),
            (Failure::MissedInstance, failed(4, 3, &[50, 60])),
            (Failure::MissedInstance, failed(8, 4, &[50, 60])),
            (Failure::NeverSaw, sees(failed(1, 1, &[]), &[])),
            (Failure::NeverSaw, sees(failed(6, 2, &[]), &[B])),
            (Failure::NeverSaw, visits(sees(failed(5, 2, &[50]), &[A]), &[(50, A)])),
            (Failure::SawAndLeft, sees(failed(1, 1, &[]), &[A])),
            (Failure::SawAndLeft, sees(failed(4, 3, &[]), &[C])),
            (Failure::SawAndLeft, visits(sees(failed(5, 2, &[50]), &[A, B]), &[(50, A)])),
            (Failure::Other, failed(1, 0, &[])),
        ] {
            assert_eq!(Failure::of(&record), Some(expected), "{record:?}");
        }
        assert_eq!(Failure::of(&record("a", true)), None);
    }

    #[test]
    fn a_failure_says_after_which_step_it_was_decided() {
        use Requirement::{A, B};
        let mut unread = failed(1, 1, &[]);
        unread.unread = Unread { unreadable: 3, empty: 0, refused: 0, cut_off: 0 };
        (unread.actions, unread.steps, unread.requests) = ("f?f??".to_owned(), 5, Some(5));
        let mut spins = failed(1, 1, &[]);
        (spins.actions, spins.steps) = (format!("{}{}", "f".repeat(180), "L".repeat(20)), 200);
        for (expected, record) in [
            (5, unread),
            (5, at_barricade("Lfffffffff")),
            // The first pose is left once and met again after 4, 8, 12 and 16 turns.
            (196, spins),
            (20, visits(failed(6, 2, &[50]), &[(20, B), (50, A)])),
            (50, failed(7, 2, &[50])),
            (60, failed(9, 3, &[50, 60])),
            (50, failed(3, 3, &[50])),
            (1, sees(failed(1, 1, &[]), &[A])),
            (50, visits(sees(failed(5, 2, &[50]), &[A, B]), &[(50, A)])),
        ] {
            assert_eq!(Failure::of(&record).unwrap().decided_at(&record), expected, "{record:?}");
        }
        let never = failed(1, 1, &[]);
        assert_eq!(Failure::of(&never).unwrap().decided_at(&never), never.steps);
    }

    #[test]
    fn every_failure_is_counted_once() {
        let records =
            [failed(7, 2, &[50]), failed(7, 2, &[50]), failed(1, 1, &[]), record("a", true)];
        let failures = Failures::of(records.iter());
        let some: Vec<_> = failures.iter().filter(|(_, count)| *count > 0).collect();
        assert_eq!(some, [(Failure::NoReturn, 2), (Failure::NeverSaw, 1)]);
        assert_eq!(failures.total(), 3);
    }
}
