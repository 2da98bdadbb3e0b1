//! Requests and decisions.
//!
//! A request borrows everything: pixels stay where the simulator wrote them. Equal requests may come at any time, in any
//! batch and any order, so a policy whose runs are to be reproducible decides from the request alone.

use std::sync::Arc;

use case_book::WorldDeclaration;
use domain::{ActionCode, DocumentKind, FeedbackCode, Outcome, State};
use shm_types::message::{FrameId, NO_FRAME, RequestId};
use shm_types::{Frame, FrameSize};

/// An image in shared memory. It does not change while the request lives.
#[derive(Clone, Copy)]
pub struct FrameView<'a> {
    /// Identifies the frame within the run; never reused.
    pub id: FrameId,
    /// First 16 bytes of the BLAKE3 hash of the pixels: equal pixels, equal hash, whatever the run.
    pub content_hash: [u8; 16],
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// RGBA, 8 bits each, rows top to bottom: `4 * width * height` bytes.
    pub pixels: &'a [u8],
}

impl<'a> FrameView<'a> {
    pub(crate) fn of(frame: &'a Frame) -> Self {
        let FrameSize { width, height } = frame.size();
        let (id, content_hash) = (frame.id(), frame.content_hash());
        Self { id, content_hash, width, height, pixels: frame.pixels() }
    }

    /// No image.
    pub const NONE: Self =
        Self { id: NO_FRAME, content_hash: [0; 16], width: 0, height: 0, pixels: &[] };

    /// The colour of the pixel in column `x` and row `y`; black outside the image.
    pub fn rgb(&self, x: u32, y: u32) -> [u8; 3] {
        if x >= self.width {
            return [0; 3];
        }
        let at = 4 * (y as usize * self.width as usize + x as usize);
        match self.pixels.get(at..at + 3) {
            Some(&[red, green, blue]) => [red, green, blue],
            _ => [0; 3],
        }
    }
}

impl std::fmt::Debug for FrameView<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "FrameView({} of {} x {})", self.id, self.width, self.height)
    }
}

/// One past step of the running episode.
#[derive(Debug, Clone, Copy)]
pub struct PastView<'a> {
    /// The view before the action.
    pub frame: FrameView<'a>,
    /// The action taken there; `None` if the answer could not be read.
    pub action: Option<ActionCode>,
    /// The feedback to it.
    pub feedback: FeedbackCode,
}

/// What memory supplies for a step is a list of items, the most important first.
#[derive(Debug, Clone, Copy)]
pub enum Item<'a> {
    /// A text.
    Text(TextView<'a>),
    /// Steps of a demonstration.
    Steps(StepsView<'a>),
    /// A remembered view with a caption.
    Frame(CaptionedView<'a>),
    /// Actions to take from this step on.
    Plan(PlanView<'a>),
}

/// A text that memory supplies.
#[derive(Debug, Clone, Copy)]
pub struct TextView<'a> {
    /// Identifies the text within the run: equal ids, equal texts.
    pub id: u128,
    /// The kind: summary, semantic or note.
    pub kind: DocumentKind,
    /// The text.
    pub text: &'a str,
}

/// Consecutive steps of one demonstration.
#[derive(Debug, Clone, Copy)]
pub struct StepsView<'a> {
    /// Distance between what was retrieved and the query; `None` if memory tells none. For episodic memory, the cosine
    /// distance between the embeddings of the first view and the current one.
    pub distance: Option<f32>,
    /// Whether these are all steps of the demonstration.
    pub is_whole: bool,
    /// The task of the demonstration, in English: that of this episode, or another.
    pub instruction: &'a str,
    /// The steps, in order. Never empty.
    pub steps: &'a [StepView<'a>],
}

/// One step of a demonstration.
#[derive(Debug, Clone, Copy)]
pub struct StepView<'a> {
    /// The view before the action, if it is supplied: all views of a retrieved segment, the keyframes of a
    /// demonstration.
    pub frame: Option<FrameView<'a>>,
    /// The expert's action there; `None` at the end of the item, and where actions are not supplied.
    pub action: Option<ActionCode>,
}

/// A remembered view with a caption.
#[derive(Debug, Clone, Copy)]
pub struct CaptionedView<'a> {
    /// The view.
    pub frame: FrameView<'a>,
    /// The caption; may be empty.
    pub caption: &'a str,
    /// The task of the demonstration that shows the view, in English.
    pub instruction: &'a str,
}

/// Actions that memory proposes to take one after the other, from this step on.
#[derive(Debug, Clone, Copy)]
pub struct PlanView<'a> {
    /// Its parts, in order. Never empty.
    pub parts: &'a [PlannedActions<'a>],
}

/// A part of a plan: actions that come from the same place.
#[derive(Debug, Clone, Copy)]
pub struct PlannedActions<'a> {
    /// The task of the demonstration in which an expert took these actions, in English; `None` if memory chose them itself.
    pub instruction: Option<&'a str>,
    /// The actions, in order. Never empty.
    pub actions: &'a [ActionCode],
}

impl<'a> PlanView<'a> {
    /// The actions of all parts.
    pub fn actions(&self) -> impl Iterator<Item = ActionCode> + use<'a> {
        self.parts.iter().flat_map(|part| part.actions).copied()
    }
}

impl<'a> Item<'a> {
    /// The text, if it is one.
    pub const fn text(&self) -> Option<TextView<'a>> {
        if let Self::Text(text) = *self { Some(text) } else { None }
    }

    /// Steps that were retrieved: those with a distance, or of a part of a demonstration. Episodic memory supplies these.
    pub fn segment(&self) -> Option<StepsView<'a>> {
        self.steps().filter(|steps| !steps.is_trajectory())
    }

    /// A whole demonstration. Full-context memory supplies these.
    pub fn trajectory(&self) -> Option<StepsView<'a>> {
        self.steps().filter(StepsView::is_trajectory)
    }

    /// The plan, if it is one.
    pub const fn plan(&self) -> Option<PlanView<'a>> {
        if let Self::Plan(plan) = *self { Some(plan) } else { None }
    }

    const fn steps(&self) -> Option<StepsView<'a>> {
        if let Self::Steps(steps) = *self { Some(steps) } else { None }
    }

    /// The number of images.
    pub fn images(&self) -> usize {
        match self {
            Self::Text(_) | Self::Plan(_) => 0,
            Self::Steps(steps) => steps.steps.iter().filter(|step| step.frame.is_some()).count(),
            Self::Frame(_) => 1,
        }
    }
}

impl StepsView<'_> {
    /// Whether this is a demonstration that is supplied whole, and was not retrieved by its distance.
    pub const fn is_trajectory(&self) -> bool {
        self.is_whole && self.distance.is_none()
    }
}

/// All that a policy may use to decide a step: `x_t`, `W_t` and `m_t` (specification, section 1).
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// The lane that the episode runs in. It has no meaning beyond telling simultaneous episodes apart.
    pub lane: u32,
    /// Steps taken so far.
    pub step: u32,
    /// Identifies the episode within the run; never reused.
    pub episode: u64,
    /// Seed for random choices.
    pub episode_seed: u64,
    /// The repetition of the run, from 1. Equal requests of one repetition are the same request and may get the same
    /// answer.
    pub repeat: u32,
    /// The task, in English.
    pub instruction: &'a str,
    /// The agent's state.
    pub state: State,
    /// The feedback to the last action.
    pub feedback: FeedbackCode,
    /// The agent's view.
    pub frame: FrameView<'a>,
    /// The last steps, oldest first.
    pub window: &'a [PastView<'a>],
    /// What memory supplies, the most important first.
    pub items: &'a [Item<'a>],
    /// Whether the prompt says that a demonstration started in this episode's start pose (paper, Design Choices).
    pub starts_as_demonstrated: bool,
    /// Whether the prompt says that the demonstrations took place in another warehouse.
    pub demonstrated_elsewhere: bool,
    /// What the world says of itself: what states, actions and feedback mean.
    pub world: &'a Arc<WorldDeclaration>,
}

impl<'a> Request<'a> {
    /// Identifies the request in its answer.
    pub const fn id(&self) -> RequestId {
        RequestId { lane: self.lane, episode: self.episode, step: self.step }
    }

    /// The texts that memory supplies.
    pub fn texts(&self) -> impl Iterator<Item = TextView<'a>> + use<'a> {
        self.items.iter().filter_map(Item::text)
    }

    /// The retrieved segments that memory supplies ([`Item::segment`]).
    pub fn segments(&self) -> impl Iterator<Item = StepsView<'a>> + use<'a> {
        self.items.iter().filter_map(Item::segment)
    }

    /// The demonstrations that memory supplies whole ([`Item::trajectory`]).
    pub fn trajectories(&self) -> impl Iterator<Item = StepsView<'a>> + use<'a> {
        self.items.iter().filter_map(Item::trajectory)
    }

    /// The plans that memory supplies.
    pub fn plans(&self) -> impl Iterator<Item = PlanView<'a>> + use<'a> {
        self.items.iter().filter_map(Item::plan)
    }

    /// The number of images: the current view, the window and the items.
    pub fn images(&self) -> u32 {
        let supplied: usize = self.items.iter().map(Item::images).sum();
        (1 + self.window.len() + supplied) as u32
    }
}

/// The outcome of a request. Anything but an action costs a step and leaves the agent where it is. A failure of a
/// server is not an answer: see [`Answers::fail`](super::Answers::fail).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Take this action.
    Act(ActionCode),
    /// No action could be read from the answer.
    Unreadable,
    /// The answer was empty.
    Empty,
    /// The model refused.
    Refused,
    /// The answer was cut off at the bound on its tokens, before it named an action.
    CutOff,
}

impl Answer {
    /// The outcome on the wire and in the log.
    pub const fn outcome(self) -> Outcome {
        match self {
            Self::Act(_) => Outcome::Acted,
            Self::Unreadable => Outcome::Unreadable,
            Self::Empty => Outcome::Empty,
            Self::Refused => Outcome::Refused,
            Self::CutOff => Outcome::CutOff,
        }
    }

    /// The action, if there is one.
    pub const fn action(self) -> Option<ActionCode> {
        match self {
            Self::Act(action) => Some(action),
            Self::Unreadable | Self::Empty | Self::Refused | Self::CutOff => None,
        }
    }
}

/// The cost of asking a language model. A count that is not known is `None`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Usage {
    /// Tokens of the prompt.
    pub prompt_tokens: Option<u32>,
    /// Tokens of the answer.
    pub completion_tokens: Option<u32>,
    /// Tokens of the prompt that the server took from its cache.
    pub cached_tokens: Option<u32>,
    /// Tokens of the prompt's images.
    pub image_tokens: Option<u32>,
    /// Tokens of the prompt that are memory; an estimate.
    pub memory_tokens: Option<u32>,
    /// Tokens of the prompt that a server can reuse: the previous prompt of the episode began with them too. 0 for the first
    /// one; an estimate.
    pub reusable_tokens: Option<u32>,
    /// Requests sent, including failed ones.
    pub attempts: u32,
    /// Whether the reply came from the response cache.
    pub replayed: bool,
    /// When the prompt was built, CLOCK_MONOTONIC.
    pub prompted_ns: u64,
    /// When the last request was sent; 0 without one.
    pub sent_ns: u64,
    /// Why the reply ended, in the server's terms. The log keeps the first 46 bytes.
    pub finish_reason: Option<String>,
    /// Whether the model reasoned before it answered.
    pub reasoned: Option<bool>,
    /// The model that the reply names. The log keeps the first 128 bytes.
    pub model: Option<String>,
}

/// A policy's answer to one request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Decision {
    /// The answer.
    pub answer: Answer,
    /// Images that the policy used.
    pub images: u32,
    /// The cost of asking a model; `None` if none was asked.
    pub usage: Option<Usage>,
}

impl Decision {
    /// `action`, decided from all images of `request` without a model.
    pub fn act(request: &Request<'_>, action: impl Into<ActionCode>) -> Self {
        Self { answer: Answer::Act(action.into()), images: request.images(), usage: None }
    }
}
