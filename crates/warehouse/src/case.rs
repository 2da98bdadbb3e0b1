//! A case: one task with its six reference trajectories and the barricade of its blocked variant.

use domain::{Cell, DemonstrationKind, Mixture, Route, Start};

use crate::dynamics::Variant;
use crate::elsewhere::Elsewhere;
use crate::task::Task;
use crate::trajectory::{Replay, Trajectory};
use crate::world::Warehouse;

/// One of a case's six trajectories (specification, section 4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum TrajectoryKind {
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
}

impl TrajectoryKind {
    /// All six, demonstrations first.
    pub const ALL: [Self; 6] =
        [Self::Original, Self::Opposite, Self::Nearby, Self::Distant, Self::Test, Self::Blocked];

    /// The four demonstrations.
    pub const DEMONSTRATIONS: [Self; 4] =
        [Self::Original, Self::Opposite, Self::Nearby, Self::Distant];

    /// The one whose length is the reference l_i for an episode from `start` on `route`.
    ///
    /// A blocked route is defined from the new start only (specification, section 4).
    pub const fn reference(start: Start, route: Route) -> Self {
        match (start, route) {
            (_, Route::Blocked) => Self::Blocked,
            (Start::Original, Route::Unchanged) => Self::Original,
            (Start::New, Route::Unchanged) => Self::Test,
        }
    }

    /// The case's own demonstration of this kind; `None` for one that is not among its six trajectories.
    pub const fn demonstration(kind: DemonstrationKind) -> Option<Self> {
        match kind {
            DemonstrationKind::Original => Some(Self::Original),
            DemonstrationKind::Opposite => Some(Self::Opposite),
            DemonstrationKind::Nearby => Some(Self::Nearby),
            DemonstrationKind::Distant => Some(Self::Distant),
            DemonstrationKind::After
            | DemonstrationKind::Elsewhere
            | DemonstrationKind::New
            | DemonstrationKind::Blocked => None,
        }
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
        }
    }
}

/// A demonstration of a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct History {
    /// Index of the case in its set.
    pub case: usize,
    /// Which of its demonstrations.
    pub kind: DemonstrationKind,
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
}

impl Case {
    /// The trajectory from `start`.
    pub fn trajectory(&self, start: TrajectoryKind) -> &Trajectory {
        match start {
            TrajectoryKind::Original => &self.original,
            TrajectoryKind::Opposite => &self.opposite,
            TrajectoryKind::Nearby => &self.nearby,
            TrajectoryKind::Distant => &self.distant,
            TrajectoryKind::Test => &self.test,
            TrajectoryKind::Blocked => &self.blocked,
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
    pub fn variant(&self, start: TrajectoryKind) -> Variant {
        match start {
            TrajectoryKind::Blocked => Variant::closing(self.barricade.iter().copied()),
            _ => Variant::UNCHANGED,
        }
    }

    /// Replays the trajectory from `start` in its world variant.
    pub fn replay(&self, warehouse: &Warehouse, start: TrajectoryKind) -> Replay {
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
