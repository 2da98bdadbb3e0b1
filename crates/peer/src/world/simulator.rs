//! What the author of a world writes: cases, and environments that run one episode at a time.

use std::collections::BTreeMap;

use case_book::{FailureKind, TaskFacts, WorldDeclaration};
use domain::names::named;
use domain::{ActionCode, DemonstrationKind, FeedbackCode, Mismatch, Route, Start, State};
use serde::Deserialize;
use serde_json::{Map, Value};

use super::WorldFailure;
use crate::error::ServeError;

/// A world for which the SDK does the rest: it writes the case book by acting out the expert's trajectories, runs an
/// environment for each lane, checks the order of steps, and renders into shared memory.
pub trait Simulator {
    /// What the world says of itself.
    fn declaration(&self) -> WorldDeclaration;

    /// What kinds of tasks there are, numbered from 1, and the groups that they are in.
    fn tasks(&self) -> Vec<TaskFacts>;

    /// Kinds of failure that the world has words for, beside those of the harness; [facts](Environment::facts) of an episode can
    /// name one.
    fn failures(&self) -> Vec<FailureKind> {
        Vec::new()
    }

    /// In what its episodes can differ from the demonstrations, beside start and route: a mismatch that
    /// [changes the world](Mismatch::changes_world) is told to environments, for wording all cases have a paraphrase.
    fn mismatches(&self) -> Vec<Mismatch> {
        Vec::new()
    }

    /// The cases, always the same in the same order.
    ///
    /// # Errors
    /// When they cannot be read.
    fn cases(&self) -> Result<Vec<CaseDeclaration>, WorldFailure>;

    /// An environment.
    ///
    /// # Errors
    /// When it cannot be made.
    fn environment(&self) -> Result<Box<dyn Environment>, WorldFailure>;

    /// Called in a run after each failure of an environment, and a few times a second.
    ///
    /// # Errors
    /// When serving has to end, for example with [`ServeError::Interrupted`]: the failure is not reported then.
    fn check(&self) -> Result<(), ServeError> {
        Ok(())
    }
}

/// A simulator of one episode at a time.
pub trait Environment {
    /// Begins an episode: the same `begin` leads to the same state, if the world is deterministic.
    ///
    /// # Errors
    /// When the episode cannot take place. It has no result then.
    fn reset(&mut self, begin: &EpisodeBegin<'_>) -> Result<Observed, WorldFailure>;

    /// Takes an action. Not called after the episode has ended.
    ///
    /// # Errors
    /// When the episode cannot go on. It has no result then.
    fn step(&mut self, action: ActionCode) -> Result<Observed, WorldFailure>;

    /// Draws what the agent sees now: red, green, blue and alpha of each pixel, row by row from the top left corner.
    ///
    /// # Errors
    /// When the world cannot be drawn. Its process ends then.
    fn render(&mut self, width: u32, height: u32, pixels: &mut [u8]) -> Result<(), WorldFailure>;

    /// Facts of the episode that has ended, for its record: whatever helps to understand it. `failure`, an object with `kind` and
    /// `step`, says in one of the world's [words](Simulator::failures) why it failed.
    ///
    /// # Errors
    /// When there are none. The episode has no result then.
    fn facts(&mut self) -> Result<Map<String, Value>, WorldFailure> {
        Ok(Map::new())
    }
}

named! {
    /// A trajectory of a case's expert.
    TrajectoryName, "trajectory" {
        /// The demonstration from the case's original start.
        Original = "original",
        /// A demonstration from another start.
        Opposite = "opposite",
        /// A demonstration from a start near the original one.
        Nearby = "nearby",
        /// A demonstration from a start far from the original one.
        Distant = "distant",
        /// The reference from the start at which the case is tested.
        New = "new",
        /// The reference from that start where the way is blocked.
        Blocked = "blocked",
        /// The demonstration from the original start where the way is blocked.
        After = "after",
    }
}

impl TrajectoryName {
    /// Whether it takes place where the way is blocked.
    pub const fn is_blocked(self) -> bool {
        matches!(self, Self::Blocked | Self::After)
    }

    /// What it is as a demonstration. The two references from the new start are such in the arm `oracle` only.
    pub const fn demonstration(self) -> DemonstrationKind {
        match self {
            Self::Original => DemonstrationKind::Original,
            Self::Opposite => DemonstrationKind::Opposite,
            Self::Nearby => DemonstrationKind::Nearby,
            Self::Distant => DemonstrationKind::Distant,
            Self::After => DemonstrationKind::After,
            Self::New => DemonstrationKind::New,
            Self::Blocked => DemonstrationKind::Blocked,
        }
    }

    /// That of a demonstration; `None` for one in another world.
    pub const fn of(kind: DemonstrationKind) -> Option<Self> {
        match kind {
            DemonstrationKind::Original => Some(Self::Original),
            DemonstrationKind::Opposite => Some(Self::Opposite),
            DemonstrationKind::Nearby => Some(Self::Nearby),
            DemonstrationKind::Distant => Some(Self::Distant),
            DemonstrationKind::After => Some(Self::After),
            DemonstrationKind::New => Some(Self::New),
            DemonstrationKind::Blocked => Some(Self::Blocked),
            DemonstrationKind::Elsewhere => None,
        }
    }

    /// The reference of an episode from `start` on `route`. On a blocked route, episodes begin at the new start.
    pub const fn reference(start: Start, route: Route) -> Self {
        match (start, route) {
            (_, Route::Blocked) => Self::Blocked,
            (Start::Original, Route::Unchanged) => Self::Original,
            (Start::New, Route::Unchanged) => Self::New,
        }
    }

    /// Where it begins: [`Original`](Self::Original), [`Opposite`](Self::Opposite), [`Nearby`](Self::Nearby),
    /// [`Distant`](Self::Distant) or [`New`](Self::New).
    pub const fn start(self) -> Self {
        match self {
            Self::After => Self::Original,
            Self::Blocked => Self::New,
            Self::Original | Self::Opposite | Self::Nearby | Self::Distant | Self::New => self,
        }
    }
}

/// A case: a task with its starts, and what the expert does from them.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaseDeclaration {
    /// The id; no two cases have the same.
    pub id: String,
    /// The number of its task among those that the world declares, from 1.
    pub task: u8,
    /// The instruction for the policy.
    pub instruction: String,
    /// The same in other words.
    #[serde(default)]
    pub paraphrase: Option<String>,
    /// The expert's trajectories. `original` and `new` have to be there.
    pub trajectories: BTreeMap<TrajectoryName, Vec<ActionCode>>,
    /// Demonstrations of other cases that have nothing to do with this one, two of them: the ids of their cases, and which.
    pub irrelevant: Vec<(String, DemonstrationKind)>,
    /// Demonstrations of other cases that are like this one and lead elsewhere, two of them.
    pub confusable: Vec<(String, DemonstrationKind)>,
}

/// How an episode begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EpisodeBegin<'a> {
    /// The case.
    pub case: &'a CaseDeclaration,
    /// Where: `original`, `opposite`, `nearby`, `distant` or `new`.
    pub start: TrajectoryName,
    /// Whether the way is blocked.
    pub is_blocked: bool,
    /// In what the world differs from the demonstrations, beside that.
    pub mismatch: Mismatch,
    /// For random choices of a world that is not deterministic.
    pub seed: u64,
}

/// What an environment says after its begin and after each step.
#[derive(Debug, Clone, PartialEq)]
pub struct Observed {
    /// The state of the agent.
    pub state: State,
    /// The response to the action; [`FeedbackCode::START`] at the begin.
    pub feedback: FeedbackCode,
    /// Sub-goals completed so far.
    pub sub_goals: u32,
    /// All sub-goals of the task: at least 1. The task is complete when all are.
    pub required: u32,
    /// Whether the task can no longer be completed: the episode ends.
    pub has_failed: bool,
    /// Whether the agent ran in this step into what blocks the way.
    pub conflict: bool,
    /// A hash of everything that determines what is seen and what follows, if the world can tell: equal hashes, equal
    /// pictures, which are rendered once.
    pub state_hash: Option<u64>,
}
