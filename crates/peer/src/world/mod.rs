//! The world role: steps episodes and shows what agents see.
//!
//! A world is a type that implements [`Simulator`], or, where it keeps its lanes and pictures itself, [`World`];
//! [`serve_generation`] takes its part in a run. The loop receives commands and requests for
//! views, keeps track of which views are resident, has missing ones rendered straight into the frame store, and sends each observation once its view is there. What moves, and what is seen, is the world's.

mod acting;
mod book;
pub mod program;
mod render_pool;
mod serving;
mod simulated;
mod simulator;
mod stage;
mod views;
mod wakeups;

use std::fmt::Debug;
use std::hash::Hash;

pub use case_book::{FailureKind, TaskFacts};
use domain::{ActionCode, FeedbackCode, State};
use shm_types::FrameSlot;
use shm_types::message::{EpisodeEnd, StepCommand, ViewRequest, WorldEpisodeConfig};

pub use program::serve_world;
pub use render_pool::GREY;
pub use serving::serve_generation;
pub use simulated::{EnvironmentView, SimulatedWorld};
pub use simulator::{
    CaseDeclaration, Environment, EpisodeBegin, Observed, Simulator, TrajectoryName,
};

use crate::error::ServeError;

/// Why something of a world cannot go on.
pub type WorldFailure = Box<dyn std::error::Error + Send + Sync>;

/// Why a message to a world has no answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Refusal {
    /// The message is invalid: it is reported and dropped, and nothing else changes.
    Message(String),
    /// The episode cannot go on: it ends without a result.
    Episode(String),
}

impl Refusal {
    fn of(failure: WorldFailure) -> Self {
        Self::Episode(failure.to_string())
    }
}

impl From<String> for Refusal {
    fn from(problem: String) -> Self {
        Self::Message(problem)
    }
}

/// A simulator and its tasks.
pub trait World {
    /// Names a picture: equal views have equal pixels, in whatever lane and episode.
    type View: Copy + Eq + Hash + Debug + Send + 'static;

    /// What a renderer needs to know of a view.
    type Picture: Send + 'static;

    /// Begins an episode, in place of the one that the lane may be in.
    ///
    /// # Errors
    /// What is wrong with it. The lane is unchanged then.
    fn begin(&mut self, config: &WorldEpisodeConfig) -> Result<Moment<Self::View>, Refusal>;

    /// Executes a command. `None` if it is about an earlier episode of the lane.
    ///
    /// # Errors
    /// What is wrong, if the command is invalid or out of order. The lane is unchanged then.
    fn apply(&mut self, command: &StepCommand) -> Result<Option<Moment<Self::View>>, Refusal>;

    /// The view that memory asks for: of a step of a demonstration, or of an episode that a memory has learned from.
    ///
    /// # Errors
    /// When there is no such step.
    fn remembered(&mut self, request: &ViewRequest) -> Result<Self::View, String>;

    /// What `view` shows.
    fn picture(&self, view: Self::View) -> Self::Picture;

    /// Called after each failure, and a few times a second.
    ///
    /// # Errors
    /// When serving has to end: the failure is not reported then.
    fn check(&self) -> Result<(), ServeError> {
        Ok(())
    }

    /// The views to render before the first step, for a run that asks for that: those that most episodes show.
    fn first_views(&self) -> Vec<Self::View> {
        Vec::new()
    }
}

/// What follows from the beginning of an episode, or from a command.
#[derive(Debug, Clone, PartialEq)]
pub struct Moment<V> {
    /// The state of the agent.
    pub state: State,
    /// The action that led here; `None` at the beginning, and if the policy's answer could not be read.
    pub action: Option<ActionCode>,
    /// The response to it.
    pub feedback: FeedbackCode,
    /// What the agent sees. It is not shown where the episode has ended.
    pub view: V,
    /// Sub-goals completed so far.
    pub sub_goals: u32,
    /// All sub-goals of the task.
    pub required: u32,
    /// Whether the agent ran in this step into what the variant has changed.
    pub conflict: bool,
    /// Whether the episode has ended, and how.
    pub ended: EpisodeEnd,
    /// The facts of the episode, one JSON object, if it has ended.
    pub facts: Option<String>,
    /// A hash of the state of the world, at the begin and at the end; otherwise 0.
    pub state_hash: u64,
}

/// A picture and the slot of the frame store that it is rendered into.
#[derive(Debug)]
pub struct RenderTask<'a, P> {
    /// What it shows.
    pub picture: &'a P,
    /// Where the pixels go.
    pub slot: &'a mut FrameSlot,
    /// The first 16 bytes of the BLAKE3 hash of the pixels, if the renderer knows it already.
    pub content_hash: Option<[u8; 16]>,
}

/// Renders pictures into slots of the frame store. The pixels of a picture must not depend on the renderer or on the other
/// pictures of the batch.
pub trait RenderWorker<P> {
    /// Renders all `tasks`. Returns how many bytes of pixels the program itself has copied.
    ///
    /// # Errors
    /// When the world cannot go on without the pictures.
    fn render_into(&mut self, tasks: &mut [RenderTask<'_, P>]) -> Result<u64, WorldFailure>;
}

/// Who renders.
pub enum Renderers<P> {
    /// Each on a thread of its own, at least one.
    Threads {
        /// The renderers.
        workers: Vec<Box<dyn RenderWorker<P> + Send>>,
        /// Most pictures in a batch of one of them: several where a device renders them faster together.
        batch: usize,
    },
    /// One on the thread of the world: where the simulator cannot be used from another thread.
    Caller(Box<dyn RenderWorker<P>>),
}

/// What a world renders with.
pub struct RenderSetup<P> {
    /// Who renders.
    pub renderers: Renderers<P>,
    /// Facts for the run's manifest, as names and values.
    pub facts: Vec<(&'static str, String)>,
}
