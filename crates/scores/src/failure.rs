//! Why an episode failed, as a pure function of its record.
//!
//! One kind for each failure: the first whose rule applies, in the order of [`Failure`]. First comes *how* an
//! episode went wrong, where that shows (answers, barricade, loops), because an agent that is stuck says nothing
//! about what it knew; then *what* was missing. The bounds are conventions, the same for every memory and policy.

use std::collections::{BTreeMap, BTreeSet};

use domain::names::named;
use domain::{Pose, TaskType};
use serde::Serialize;

use domain::events::Requirement;
use run_log::EpisodeRecord;

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
        if record.is_success() {
            return None;
        }
        Self::ALL.iter().copied().find(|failure| failure.decision(record).is_some())
    }

    /// The number of steps after which this failure of `record` was decided: that of the try to enter the closed cell,
    /// of the last visit to the pose of a loop, of the arrival or sight after which the agent came no further. The end of
    /// the episode where only the steps ran out.
    pub fn decided_at(self, record: &EpisodeRecord) -> u32 {
        self.decision(record).unwrap_or(record.steps)
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

    /// The number of steps after which `record` failed in this way; `None` where the rule of this kind does not apply.
    fn decision(self, record: &EpisodeRecord) -> Option<u32> {
        let has_task = |property: fn(TaskType) -> bool| record.task_type().is_some_and(property);
        let done = record.sub_goals.len();
        let lacks_one = record.required.saturating_sub(done as u32) == 1;
        let last_progress = record.sub_goals.last().copied();
        let after_last_progress =
            |applies: bool| applies.then(|| last_progress.unwrap_or(record.steps));
        match self {
            Self::Unreadable => became_unreadable_at(record),
            Self::Blocked => record.tried_closed_at.filter(|&step| gave_up_after(record, step)),
            Self::Looped => looped_at(record),
            Self::WrongOrder => {
                let is_out_of_order = has_task(TaskType::is_ordered) && done == 1;
                first_visit(record, Requirement::B).filter(|_| is_out_of_order)
            }
            Self::NoReturn => after_last_progress(has_task(TaskType::ends_at_origin) && lacks_one),
            Self::NoRevisit => {
                after_last_progress(has_task(|task| task == TaskType::Revisit) && lacks_one)
            }
            Self::MissedInstance => {
                after_last_progress(has_task(TaskType::is_exhaustive) && done > 0)
            }
            Self::NeverSaw => {
                let open = open_requirements(record);
                (!open.is_empty() && first_sight(record, &open).is_none()).then_some(record.steps)
            }
            Self::SawAndLeft => {
                let seen_at = first_sight(record, &open_requirements(record))?;
                Some(seen_at).max(last_progress)
            }
            Self::Other => Some(record.steps),
        }
    }
}

/// The requirements that could be met next; none when all are met.
fn open_requirements(record: &EpisodeRecord) -> Vec<Requirement> {
    use Requirement::{A, B, C};
    let done = record.sub_goals.len();
    if done >= record.required as usize {
        return Vec::new();
    }
    match record.task_type() {
        Some(TaskType::FindCategory | TaskType::EveryOfCategory) => vec![C],
        Some(TaskType::BothTypes) => {
            let is_open = |requirement: &Requirement| first_visit(record, *requirement).is_none();
            [A, B].into_iter().filter(is_open).collect()
        }
        Some(task) if task.is_ordered() && done == 1 => vec![B],
        _ => vec![A],
    }
}

/// The step at which the agent first stood before an item that counts for `requirement`.
fn first_visit(record: &EpisodeRecord, requirement: Requirement) -> Option<u32> {
    let visit = record.visits.iter().find(|visit| visit.requirement == requirement);
    visit.map(|visit| visit.step)
}

/// The step at which an item for one of `requirements` was first in view.
fn first_sight(record: &EpisodeRecord, requirements: &[Requirement]) -> Option<u32> {
    requirements.iter().filter_map(|requirement| record.first_seen.get(requirement)).min().copied()
}

/// The step at which half of all answers had no action, if so many had none.
fn became_unreadable_at(record: &EpisodeRecord) -> Option<u32> {
    let answers = record.requests.filter(|&answers| answers > 0)?;
    if record.unread.total() * 2 < answers {
        return None;
    }
    let unread_steps = (1..).zip(record.actions.chars()).filter(|(_, letter)| *letter == '?');
    let step = unread_steps.map(|(step, _)| step).nth(answers.div_ceil(2) as usize - 1);
    Some(step.unwrap_or(record.steps))
}

/// Whether the agent, after it tried to enter a closed cell at step `tried_at`, met no requirement and hardly went anywhere
/// new.
fn gave_up_after(record: &EpisodeRecord, tried_at: u32) -> bool {
    let poses = record.poses();
    let (before, after) = poses.split_at(poses.len().min(tried_at as usize));
    let known_cells: BTreeSet<_> = before.iter().map(|pose| pose.cell).collect();
    let entered_cells: BTreeSet<_> = after.iter().map(|pose| pose.cell).collect();
    let made_progress = record.sub_goals.iter().any(|&step| step >= tried_at);
    !made_progress && entered_cells.difference(&known_cells).count() < NEW_CELLS
}

/// The step of the [`LOOP_VISITS`]th visit to a pose within the last [`LOOP_STEPS`] steps, the first such.
fn looped_at(record: &EpisodeRecord) -> Option<u32> {
    let poses = record.poses();
    let first = poses.len().saturating_sub(LOOP_STEPS);
    let mut visits: BTreeMap<Pose, usize> = BTreeMap::new();
    for (step, pose) in (0..).zip(&poses).skip(first) {
        let count = visits.entry(*pose).or_default();
        *count += 1;
        if *count == LOOP_VISITS {
            return Some(step);
        }
    }
    None
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
    use domain::events::Visit;
    use rigs::records::record;
    use run_log::Unread;

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
