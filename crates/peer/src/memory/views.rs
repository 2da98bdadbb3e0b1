//! What a memory is given.

use std::sync::Arc;

use domain::{ActionCode, FeedbackCode, State};
use shm_types::{Bank, Frame};

use crate::policy::FrameView;

/// One demonstration of a bank. Demonstrations are numbered from 0, in the order of [`Memory::build`](super::Memory::build).
#[derive(Debug, Clone, Copy)]
pub struct Demonstration<'a> {
    /// The task that it demonstrates.
    pub instruction: &'a str,
    /// Its steps, from the start to the end; the last has no action.
    pub steps: &'a [DemonstrationStep],
    /// The embeddings of the steps' views, one after the other, each of [`Self::dimension`] numbers and length 1; empty
    /// unless the memory asked for them.
    pub embeddings: &'a [f32],
    /// The views of the steps; empty unless the memory asked for them.
    pub frames: &'a [Arc<Frame>],
    /// Sub-goals that the expert had completed at each step; empty for an external memory.
    pub stages: &'a [u32],
    /// What keeps the embeddings readable: a binding of another language holds it as long as it holds them.
    pub bank: Option<&'a Arc<Bank>>,
}

/// One step of a demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DemonstrationStep {
    /// The expert's state.
    pub state: State,
    /// The expert's action there.
    pub action: Option<ActionCode>,
    /// The feedback to the action before.
    pub feedback: FeedbackCode,
    /// First 16 bytes of the BLAKE3 hash of the view's pixels: equal views, equal hash. Zeros if the view was not rendered.
    pub content_hash: [u8; 16],
}

impl<'a> Demonstration<'a> {
    /// Numbers in an embedding; 0 without embeddings.
    pub fn dimension(&self) -> usize {
        self.embeddings.len().checked_div(self.steps.len()).unwrap_or(0)
    }

    /// The embedding of a step's view.
    pub fn embedding(&self, step: usize) -> Option<&'a [f32]> {
        let dimension = self.dimension();
        let embedding = self.embeddings.get(step * dimension..(step + 1) * dimension)?;
        (!embedding.is_empty()).then_some(embedding)
    }

    /// A step's view.
    pub fn frame(&self, step: usize) -> Option<FrameView<'a>> {
        self.frames.get(step).map(|frame| FrameView::of(frame))
    }
}

/// An episode that begins.
#[derive(Debug, Clone, Copy)]
pub struct Episode<'a> {
    /// Its lane. A lane has one episode at a time.
    pub lane: u32,
    /// Its id.
    pub episode: u64,
    /// The agent's task.
    pub instruction: &'a str,
    /// Seed for random choices.
    pub seed: u64,
    /// The repetition of the run, from 1.
    pub repeat: u32,
    /// Most images in one answer.
    pub image_budget: u32,
    /// Most bytes of text in one answer.
    pub text_budget: u32,
    /// Whether the memory learns from the episode. If not, the episode must not change what it answers in later ones.
    pub learns: bool,
}

/// The end of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EpisodeEnd<'a> {
    /// The lane.
    pub lane: u32,
    /// The episode.
    pub episode: u64,
    /// The number under which items can name the episode's steps from now on, as those of a demonstration; `None` unless
    /// the memory learns from the episode. Episodes are numbered after the demonstrations, in order.
    pub demonstration: Option<u32>,
    /// Whether the task was completed; `None` if the memory is not told.
    pub success: Option<bool>,
    /// The steps at which sub-goals were completed, in order; `None` if the memory is not told.
    pub sub_goals: Option<&'a [u32]>,
}

impl EpisodeEnd<'_> {
    /// The end of an episode that the memory does not learn from.
    pub const fn unlearned(lane: u32, episode: u64) -> Self {
        Self { lane, episode, demonstration: None, success: None, sub_goals: None }
    }
}

/// The agent's state after a step.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// The lane.
    pub lane: u32,
    /// The episode.
    pub episode: u64,
    /// Steps taken so far.
    pub step: u32,
    /// The agent's state.
    pub state: State,
    /// The action that led here; `None` at the start, and if the policy's answer could not be read.
    pub last_action: Option<ActionCode>,
    /// The feedback to it.
    pub feedback: FeedbackCode,
    /// The agent's view; `None` at the end of the episode, and for a memory in the host's process.
    pub frame: Option<FrameView<'a>>,
    /// The view's embedding, of length 1; `None` unless the memory asked for embeddings.
    pub embedding: Option<&'a [f32]>,
    /// The view itself, for who keeps it; `None` where `frame` is.
    pub pinned: Option<&'a Arc<Frame>>,
}

/// A step for which the memory is asked.
#[derive(Debug, Clone, Copy)]
pub struct Query<'a> {
    /// The agent's state.
    pub now: Step<'a>,
    /// The agent's task.
    pub instruction: &'a str,
    /// The last steps before this one, oldest first.
    pub window: &'a [PastStep],
    /// Most images in the answer.
    pub image_budget: u32,
    /// Most bytes of text in the answer.
    pub text_budget: u32,
}

/// A past step of the running episode.
#[derive(Debug, Clone)]
pub struct PastStep {
    /// The state before the action.
    pub state: State,
    /// The action taken there; `None` if the policy's answer could not be read.
    pub action: Option<ActionCode>,
    /// The feedback to it.
    pub feedback: FeedbackCode,
    /// The view before the action.
    pub frame: Arc<Frame>,
}
