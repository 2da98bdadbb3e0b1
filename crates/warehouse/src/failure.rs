//! Why an episode failed, in the words of this world.
//!
//! One kind for each failure: the first whose rule applies, in the order of [`Failure`]. What the harness finds out by itself,
//! from answers and [loops](case_book::looped_at), is not among them; [`failure_kinds`] says where its kinds stand. First
//! comes *how* an episode went wrong, where that shows (answers, barricade, loops), because an agent that is stuck says nothing
//! about what it knew; then *what* was missing. The bounds are conventions, the same for every memory and policy.

use std::collections::{BTreeMap, BTreeSet};

use case_book::{FailureFact, FailureKind, HARNESS_FAILURES};
use domain::Pose;
use domain::events::{Requirement, Visit};
use domain::names::named;

use crate::task_type::TaskType;

named! {
    /// Why an episode failed: the first of these that applies, in this order.
    Failure, "kind of failure" {
        /// The agent tried to enter a closed cell, and after that met no requirement and entered fewer than
        /// [`NEW_CELLS`] cells where it had not been before: it did not look for a way round.
        Blocked = "blocked",
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
    }
}

/// Number of new cells after a barricade that count as looking for a way round it.
const NEW_CELLS: usize = 10;

/// Every kind of failure of an episode in this world, in the order in which they apply.
pub(crate) fn failure_kinds() -> Vec<FailureKind> {
    let [unreadable, looped, other] = HARNESS_FAILURES;
    let (blocked, missing) = Failure::ALL.split_at(1);
    let of_world = |kinds: &[Failure]| -> Vec<FailureKind> {
        kinds.iter().map(|kind| FailureKind::new((kind.name(), kind.meaning()))).collect()
    };
    let harness = |kind| vec![FailureKind::new(kind)];
    [harness(unreadable), of_world(blocked), harness(looped), of_world(missing), harness(other)]
        .concat()
}

/// What the kind of a failure follows from.
#[derive(Debug)]
pub(crate) struct FailedEpisode<'a> {
    /// The type of its task.
    pub task: TaskType,
    /// The poses, the begin first.
    pub poses: &'a [Pose],
    /// The steps at which sub-goals were completed, in order.
    pub sub_goals: &'a [u32],
    /// Sub-goals of the whole task.
    pub required: u32,
    /// Every arrival before an item that the task is about.
    pub visits: &'a [Visit],
    /// The first step whose view showed an item of a requirement.
    pub first_seen: &'a BTreeMap<Requirement, u32>,
    /// On a blocked route: the first step that tried to enter a closed cell.
    pub conflict_at: Option<u32>,
}

impl Failure {
    /// A short description for a legend.
    const fn meaning(self) -> &'static str {
        match self {
            Self::Blocked => {
                "tried to enter a closed cell, then met no requirement and hardly went anywhere new"
            }
            Self::WrongOrder => "stood before B ahead of A, and not again after it",
            Self::NoReturn => "everything done except the return to the origin",
            Self::NoRevisit => "everything done except visiting the same instance again",
            Self::MissedInstance => "visited some of the instances and not all",
            Self::NeverSaw => "the target that was next was never in view",
            Self::SawAndLeft => "the target that was next was in view and was never reached",
        }
    }
}

impl FailedEpisode<'_> {
    /// The kind of its failure, and the step of the event that its rule is about: the try to enter the closed cell, the arrival or
    /// sight after which the agent came no further, or the end of the episode. `None` where no rule applies.
    pub(crate) fn failure(&self) -> Option<FailureFact> {
        let mut steps = Failure::ALL.iter().map(|kind| (kind, self.step_of(*kind)));
        steps.find_map(|(kind, step)| {
            Some(FailureFact { kind: kind.name().to_owned(), step: step? })
        })
    }

    /// The step of the event that the rule of this kind is about; `None` where the rule does not apply.
    fn step_of(&self, kind: Failure) -> Option<u32> {
        let done = self.sub_goals.len();
        let lacks_one = self.required.saturating_sub(done as u32) == 1;
        let last_progress = self.sub_goals.last().copied();
        let after_last_progress =
            |applies: bool| applies.then(|| last_progress.unwrap_or(self.steps()));
        match kind {
            Failure::Blocked => self.conflict_at.filter(|&step| self.gave_up_after(step)),
            Failure::WrongOrder => {
                let is_out_of_order = self.task.is_ordered() && done == 1;
                self.first_visit(Requirement::B).filter(|_| is_out_of_order)
            }
            Failure::NoReturn => after_last_progress(self.task.ends_at_origin() && lacks_one),
            Failure::NoRevisit => after_last_progress(self.task == TaskType::Revisit && lacks_one),
            Failure::MissedInstance => after_last_progress(self.task.is_exhaustive() && done > 0),
            Failure::NeverSaw => {
                let open = self.open_requirements();
                (!open.is_empty() && self.first_sight(&open).is_none()).then_some(self.steps())
            }
            Failure::SawAndLeft => {
                let seen_at = self.first_sight(&self.open_requirements())?;
                Some(seen_at).max(last_progress)
            }
        }
    }

    fn steps(&self) -> u32 {
        self.poses.len().saturating_sub(1) as u32
    }

    /// The requirements that could be met next; none when all are met.
    fn open_requirements(&self) -> Vec<Requirement> {
        use Requirement::{A, B, C};
        let done = self.sub_goals.len();
        if done >= self.required as usize {
            return Vec::new();
        }
        match self.task {
            TaskType::FindCategory | TaskType::EveryOfCategory => vec![C],
            TaskType::BothTypes => {
                let is_open = |requirement: &Requirement| self.first_visit(*requirement).is_none();
                [A, B].into_iter().filter(is_open).collect()
            }
            task if task.is_ordered() && done == 1 => vec![B],
            _ => vec![A],
        }
    }

    /// The step at which the agent first stood before an item that counts for `requirement`.
    fn first_visit(&self, requirement: Requirement) -> Option<u32> {
        let visit = self.visits.iter().find(|visit| visit.requirement == requirement);
        visit.map(|visit| visit.step)
    }

    /// The step at which an item for one of `requirements` was first in view.
    fn first_sight(&self, requirements: &[Requirement]) -> Option<u32> {
        let seen = requirements.iter().filter_map(|requirement| self.first_seen.get(requirement));
        seen.min().copied()
    }

    /// Whether the agent, after it tried to enter a closed cell at step `tried_at`, met no requirement and hardly went anywhere
    /// new.
    fn gave_up_after(&self, tried_at: u32) -> bool {
        let (before, after) = self.poses.split_at(self.poses.len().min(tried_at as usize));
        let known_cells: BTreeSet<_> = before.iter().map(|pose| pose.cell).collect();
        let entered_cells: BTreeSet<_> = after.iter().map(|pose| pose.cell).collect();
        let made_progress = self.sub_goals.iter().any(|&step| step >= tried_at);
        !made_progress && entered_cells.difference(&known_cells).count() < NEW_CELLS
    }
}

#[cfg(test)]
mod tests {
    use domain::{Cell, Heading};

    use super::*;

    /// A failed episode of 200 steps, whose agent goes north up a column, and then east.
    struct Failed {
        task: u8,
        required: u32,
        met: Vec<u32>,
        poses: Vec<Pose>,
        visits: Vec<Visit>,
        first_seen: BTreeMap<Requirement, u32>,
        conflict_at: Option<u32>,
    }

    fn failed(task: u8, required: u32, met: &[u32]) -> Failed {
        let north = (0..100).map(|y| Pose::new(0, y, Heading::N));
        let east = (0..=100).map(|x| Pose::new(x, 99, Heading::E));
        Failed {
            task,
            required,
            met: met.to_vec(),
            poses: north.chain(east).collect(),
            visits: Vec::new(),
            first_seen: BTreeMap::new(),
            conflict_at: None,
        }
    }

    impl Failed {
        fn seeing(mut self, seen: &[Requirement]) -> Self {
            self.first_seen = seen.iter().map(|&requirement| (requirement, 1)).collect();
            self
        }

        fn visiting(mut self, visits: &[(u32, Requirement)]) -> Self {
            let visit = |&(step, requirement)| Visit { step, requirement, cell: Cell::new(3, 7) };
            self.visits = visits.iter().map(visit).collect();
            self
        }

        fn failure(&self) -> Option<(Failure, u32)> {
            let episode = FailedEpisode {
                task: TaskType::try_from(self.task).unwrap(),
                poses: &self.poses,
                sub_goals: &self.met,
                required: self.required,
                visits: &self.visits,
                first_seen: &self.first_seen,
                conflict_at: self.conflict_at,
            };
            episode.failure().map(|failure| (failure.kind.parse().unwrap(), failure.step))
        }
    }

    /// On a blocked route: goes north, runs into the barricade at step 5, and then enters so many new cells in the east.
    fn at_barricade(new_cells: u8) -> Failed {
        let mut episode = failed(1, 1, &[]);
        episode.poses = (0..5).map(|y| Pose::new(0, y, Heading::N)).collect();
        episode.poses.push(Pose::new(0, 4, Heading::N));
        episode.poses.extend((0..=new_cells).map(|x| Pose::new(x, 4, Heading::E)));
        episode.conflict_at = Some(5);
        episode
    }

    #[test]
    fn one_episode_of_each_kind_has_the_step_of_its_event() {
        use Requirement::{A, B, C};
        for (number, (expected, episode)) in [
            ((Failure::Blocked, 5), at_barricade(9)),
            ((Failure::NeverSaw, 16), at_barricade(10)),
            ((Failure::WrongOrder, 20), failed(6, 2, &[50]).visiting(&[(20, B), (50, A)])),
            ((Failure::WrongOrder, 20), failed(10, 3, &[50]).visiting(&[(20, B), (50, A)])),
            ((Failure::NeverSaw, 200), failed(6, 2, &[50]).visiting(&[(50, A)])),
            ((Failure::NoReturn, 50), failed(7, 2, &[50])),
            ((Failure::NoReturn, 70), failed(8, 4, &[50, 60, 70])),
            (
                (Failure::NoReturn, 60),
                failed(10, 3, &[50, 60]).visiting(&[(20, B), (50, A), (60, B)]),
            ),
            ((Failure::NoRevisit, 60), failed(9, 3, &[50, 60])),
            ((Failure::MissedInstance, 50), failed(3, 3, &[50])),
            ((Failure::MissedInstance, 60), failed(4, 3, &[50, 60])),
            ((Failure::MissedInstance, 60), failed(8, 4, &[50, 60])),
            ((Failure::NeverSaw, 200), failed(1, 1, &[])),
            ((Failure::NeverSaw, 200), failed(6, 2, &[]).seeing(&[B])),
            ((Failure::NeverSaw, 200), failed(5, 2, &[50]).seeing(&[A]).visiting(&[(50, A)])),
            ((Failure::SawAndLeft, 1), failed(1, 1, &[]).seeing(&[A])),
            ((Failure::SawAndLeft, 1), failed(4, 3, &[]).seeing(&[C])),
            ((Failure::SawAndLeft, 50), failed(5, 2, &[50]).seeing(&[A, B]).visiting(&[(50, A)])),
        ]
        .into_iter()
        .enumerate()
        {
            assert_eq!(episode.failure(), Some(expected), "episode {number}");
        }
        assert_eq!(failed(1, 0, &[]).failure(), None);
    }

    #[test]
    fn the_kinds_of_the_harness_stand_among_those_of_the_world() {
        let names: Vec<String> = failure_kinds().into_iter().map(|kind| kind.name).collect();
        insta::assert_snapshot!(names.join(" "), @"unreadable blocked looped wrong-order no-return no-revisit missed-instance never-saw saw-and-left out-of-steps");
    }
}
