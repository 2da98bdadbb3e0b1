//! A case: one task with its six reference trajectories and the barricade of its blocked variant.

use domain::{Action, Cell, Feedback, Pose};

use crate::demonstrated::PlannedAfter;
use crate::dynamics::{Variant, step};
use crate::elsewhere::Elsewhere;
use crate::progress::Progress;
use crate::task::Task;
use crate::world::Warehouse;

/// One of a case's six trajectories (specification, section 4), or a demonstration beside them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Start {
    /// The case's start.
    Original,
    /// The same cell, facing the other way.
    Opposite,
    /// 2 to 4 cells along the same aisle, same heading.
    Nearby,
    /// Another aisle, heading turned by 90 degrees.
    Distant,
    /// The new start that episodes are tested from. Never part of a memory.
    Test,
    /// The test start with a passage closed. Never part of a memory.
    Blocked,
    /// The case's start with that passage closed: a demonstration by an expert who knows.
    After,
    /// The same task in another warehouse.
    Elsewhere,
}

impl Start {
    /// The six that a case has, demonstrations first.
    pub const ALL: [Self; 6] =
        [Self::Original, Self::Opposite, Self::Nearby, Self::Distant, Self::Test, Self::Blocked];

    /// The four demonstrations that a case has.
    pub const DEMONSTRATIONS: [Self; 4] =
        [Self::Original, Self::Opposite, Self::Nearby, Self::Distant];

    /// All that a memory can be built from.
    pub const REMEMBERED: [Self; 6] =
        [Self::Original, Self::Opposite, Self::Nearby, Self::Distant, Self::After, Self::Elsewhere];

    /// The kind of demonstration with this number on the wire, if there is one.
    pub fn demonstration(number: u16) -> Option<Self> {
        Self::REMEMBERED.into_iter().find(|&start| start as u16 == number)
    }

    /// The name in files and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Original => "original",
            Self::Opposite => "opposite",
            Self::Nearby => "nearby",
            Self::Distant => "distant",
            Self::Test => "test",
            Self::Blocked => "blocked",
            Self::After => "after",
            Self::Elsewhere => "elsewhere",
        }
    }

    /// The letter in the log's provenance column.
    pub const fn letter(self) -> char {
        match self {
            Self::Original => 'o',
            Self::Opposite => 'p',
            Self::Nearby => 'n',
            Self::Distant => 'd',
            Self::Test => 't',
            Self::Blocked => 'b',
            Self::After => 'a',
            Self::Elsewhere => 'w',
        }
    }
}

/// The kind of histories of other tasks that a case is tested with (specification, section 6).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Mixture {
    /// They share no pose with the test reference.
    Irrelevant,
    /// They share poses with it and continue differently from there.
    Confusable,
}

impl Mixture {
    /// Both kinds.
    pub const ALL: [Self; 2] = [Self::Irrelevant, Self::Confusable];

    /// The name in files and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Irrelevant => "irrelevant",
            Self::Confusable => "confusable",
        }
    }
}

/// A start pose and a list of actions. Everything else follows by replay.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Trajectory {
    /// The first pose.
    pub start: Pose,
    /// The actions, in order.
    pub actions: Vec<Action>,
}

/// A replayed trajectory. Index 0 of each list is the start, index `t` the state after action `t`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Replay {
    /// Poses.
    pub poses: Vec<Pose>,
    /// Feedback; [`Feedback::Start`] first.
    pub feedback: Vec<Feedback>,
    /// Sub-goals completed so far.
    pub stages: Vec<u32>,
    /// The steps at which sub-goals were completed, in order.
    pub goal_steps: Vec<u32>,
    /// Steps until the task was complete, `l_i` of a reference; `None` if it never was. A final turn towards the rack comes
    /// after that and does not count.
    pub length: Option<u32>,
}

impl Trajectory {
    /// Replays the trajectory with the world's dynamics and scores it for `task`.
    pub fn replay(&self, warehouse: &Warehouse, task: &Task, variant: &Variant) -> Replay {
        let mut progress = Progress::new(warehouse, task, self.start.cell);
        let mut replay = Replay {
            poses: vec![self.start],
            feedback: vec![Feedback::Start],
            stages: vec![progress.stage()],
            goal_steps: vec![0; progress.stage() as usize],
            length: progress.is_complete().then_some(0),
        };
        let mut pose = self.start;
        for (taken, &action) in (1..).zip(&self.actions) {
            let feedback;
            (pose, feedback) = step(&warehouse.layout, variant, pose, action);
            let met = progress.visit(pose.cell);
            replay.poses.push(pose);
            replay.feedback.push(feedback);
            replay.stages.push(progress.stage());
            replay.goal_steps.extend((0..met).map(|_| taken));
            if met > 0 && progress.is_complete() {
                replay.length = Some(taken);
            }
        }
        replay
    }
}

/// A demonstration of a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct History {
    /// Index of the case in its set.
    pub case: usize,
    /// Which of its demonstrations.
    pub start: Start,
}

/// A task, its six trajectories, the passage that its blocked variant closes, and the demonstrations of other tasks that it
/// is tested with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Case {
    /// Identifies the case, for example `t03-07`: type 3, seventh case.
    pub id: String,
    /// The task.
    pub task: Task,
    /// Demonstration from the case's start.
    pub original: Trajectory,
    /// Demonstration from the same cell, facing the other way.
    pub opposite: Trajectory,
    /// Demonstration from a few cells along the aisle.
    pub nearby: Trajectory,
    /// Demonstration from another aisle.
    pub distant: Trajectory,
    /// Reference from the test start.
    pub test: Trajectory,
    /// Reference from the test start with `barricade` closed.
    pub blocked: Trajectory,
    /// The cells of the closed passage, sorted.
    pub barricade: Vec<Cell>,
    /// Two demonstrations of other tasks that share no pose with the test reference.
    pub irrelevant: [History; 2],
    /// Two demonstrations of other tasks that share poses with it and continue differently from there.
    pub confusable: [History; 2],
    /// The demonstration after the passage has closed. [`CaseSet::demonstrated`] plans it.
    pub after: PlannedAfter,
}

impl Case {
    /// The trajectory from `start`. Not for demonstrations beside the case's own ([`CaseSet::demonstrated`] has those): the
    /// original stands for them here.
    pub fn trajectory(&self, start: Start) -> &Trajectory {
        match start {
            Start::Original | Start::After | Start::Elsewhere => &self.original,
            Start::Opposite => &self.opposite,
            Start::Nearby => &self.nearby,
            Start::Distant => &self.distant,
            Start::Test => &self.test,
            Start::Blocked => &self.blocked,
        }
    }

    /// Its histories of other tasks of one kind.
    pub const fn mixed(&self, mixture: Mixture) -> [History; 2] {
        match mixture {
            Mixture::Irrelevant => self.irrelevant,
            Mixture::Confusable => self.confusable,
        }
    }

    /// The world variant of the trajectory from `start`.
    pub fn variant(&self, start: Start) -> Variant {
        match start {
            Start::Blocked => Variant::closing(self.barricade.iter().copied()),
            _ => Variant::UNCHANGED,
        }
    }

    /// Replays the trajectory from `start` in its world variant.
    pub fn replay(&self, warehouse: &Warehouse, start: Start) -> Replay {
        self.trajectory(start).replay(warehouse, &self.task, &self.variant(start))
    }
}

/// The cases of a benchmark, all generated from one seed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CaseSet {
    /// The seed.
    pub seed: u64,
    /// The cases, sorted by id.
    pub cases: Vec<Case>,
    /// Another warehouse in which their tasks are demonstrated, if there is one.
    pub elsewhere: Option<Elsewhere>,
}

impl CaseSet {
    /// The index of the case with this id.
    pub fn index(&self, id: &str) -> Option<usize> {
        self.cases.iter().position(|case| case.id == id)
    }

    /// The case with this id.
    pub fn case(&self, id: &str) -> Option<&Case> {
        self.cases.iter().find(|case| case.id == id)
    }
}

#[cfg(test)]
mod tests {
    use domain::Heading;

    use super::*;
    use crate::testing::{BLUE_BARREL, RED_BARREL, cells, tiny};

    #[test]
    fn a_replay_lists_poses_feedback_and_when_each_sub_goal_was_met() {
        let warehouse = tiny();
        let task = Task::InOrder { a: BLUE_BARREL, b: RED_BARREL };
        let actions = "fRUffrfL".chars().filter_map(Action::from_letter).collect();
        let trajectory = Trajectory { start: Pose::new(1, 3, Heading::W), actions };
        let replay = trajectory.replay(&warehouse, &task, &Variant::UNCHANGED);
        use Feedback::{Blocked, Moved, Start, Turned};
        assert_eq!(
            replay.feedback,
            [Start, Moved, Turned, Turned, Moved, Moved, Blocked, Blocked, Turned]
        );
        assert_eq!(replay.poses[5], Pose::new(0, 1, Heading::S));
        assert_eq!(replay.poses.last(), Some(&Pose::new(0, 1, Heading::E)));
        assert_eq!(replay.stages, [0, 1, 1, 1, 1, 1, 1, 1, 1]);
        assert_eq!((replay.goal_steps, replay.length), (vec![1], None));

        let there =
            Trajectory { start: Pose::new(1, 3, Heading::E), actions: vec![Action::Backward; 1] };
        let on =
            there.actions.iter().copied().chain([Action::Forward; 4]).chain([Action::TurnLeft]);
        let there = Trajectory { actions: on.collect(), ..there };
        let replay = there.replay(&warehouse, &task, &Variant::UNCHANGED);
        // The step beyond the last sub-goal and the last turn do not count.
        assert_eq!((replay.goal_steps, replay.length), (vec![1, 4], Some(4)));
        let closed = Variant::closing(cells(&[(2, 3)]));
        assert_eq!(there.replay(&warehouse, &task, &closed).length, None);
    }
}
