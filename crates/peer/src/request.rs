//! What a policy is given for one step of one episode, and what it answers.
//!
//! A request borrows everything: pixels stay where the simulator wrote them. Two equal requests may
//! be answered at any time, in any batch and any order, so a policy that wants its runs repeatable
//! answers from the request alone.

use domain::{Action, DocumentKind, Feedback, Outcome, Pose};
use shm_types::message::{DocumentId, FrameId, NO_FRAME};

/// A view: pixels in shared memory, which never change while the view can be named.
#[derive(Clone, Copy)]
pub struct FrameView<'a> {
    /// Names the pixels. Good for caching what was seen in them, since it is never reused; which
    /// number it is means nothing.
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

impl FrameView<'_> {
    /// No picture.
    pub const NONE: Self =
        Self { id: NO_FRAME, content_hash: [0; 16], width: 0, height: 0, pixels: &[] };

    /// The red, green and blue of the pixel in column `x` and row `y`; black outside the picture.
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
    /// What was done there; `None` when the answer could not be read.
    pub action: Option<Action>,
    /// What the world said to it.
    pub feedback: Feedback,
}

/// One view of a remembered segment.
#[derive(Debug, Clone, Copy)]
pub struct SegmentView<'a> {
    /// The remembered view.
    pub frame: FrameView<'a>,
    /// What the expert did there; `None` at the end of the segment, and everywhere in one of images
    /// alone.
    pub action: Option<Action>,
}

/// What memory found for this step: the stored view nearest to the current one, and what followed.
#[derive(Debug, Clone, Copy)]
pub struct Segment<'a> {
    /// Cosine distance between the embeddings of the first remembered view and the current one.
    pub distance: f32,
    /// The matched view, then the views that the expert's actions led to. Never empty.
    pub steps: &'a [SegmentView<'a>],
}

/// A document that memory supplies as it stands.
#[derive(Debug, Clone, Copy)]
pub struct DocumentView<'a> {
    /// Names the text. Good for caching what was read in it, since it is never reused; which number it
    /// is means nothing.
    pub id: DocumentId,
    /// Summary or semantic.
    pub kind: DocumentKind,
    /// The text.
    pub text: &'a str,
}

/// One step of a demonstration that memory supplies whole.
#[derive(Debug, Clone, Copy)]
pub struct TrajectoryView<'a> {
    /// The view before the action, where it is a keyframe.
    pub frame: Option<FrameView<'a>>,
    /// What the expert did there; `None` at the end of the demonstration.
    pub action: Option<Action>,
}

/// A demonstration: every action, and keyframes.
#[derive(Debug, Clone, Copy)]
pub struct Trajectory<'a> {
    /// From its start to its end. Never empty.
    pub steps: &'a [TrajectoryView<'a>],
}

/// Names a request, for its answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct RequestId {
    /// The lane the episode runs in.
    pub lane: u32,
    /// Steps taken so far.
    pub step: u32,
    /// The episode; never used again within a run.
    pub episode: u64,
}

/// All that a policy may use to decide one step (SPEC section 1: `x_t`, `W_t` and `m_t`).
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// The lane the episode runs in. For a policy's own book-keeping; it means nothing.
    pub lane: u32,
    /// Steps taken so far.
    pub step: u32,
    /// Names the episode: never used again within a run, and which number it is means nothing.
    pub episode: u64,
    /// A policy that draws at random draws from this.
    pub episode_seed: u64,
    /// Which repetition of the run this is, from 1. Equal requests of one repetition are the same request, and
    /// may be given the same answer.
    pub repeat: u32,
    /// What is asked for, in English.
    pub instruction: &'a str,
    /// Where the agent is.
    pub pose: Pose,
    /// What the world said to the last action.
    pub feedback: Feedback,
    /// What the agent sees.
    pub frame: FrameView<'a>,
    /// The last steps, oldest first.
    pub window: &'a [PastView<'a>],
    /// What memory retrieved for this step, if it retrieves.
    pub segment: Option<Segment<'a>>,
    /// Documents that memory supplies, in order.
    pub documents: &'a [DocumentView<'a>],
    /// Demonstrations that memory supplies whole.
    pub trajectories: &'a [Trajectory<'a>],
    /// Whether a demonstration is known to have started in the pose this episode started in: the hint
    /// of the original start (paper, Design Choices).
    pub starts_as_demonstrated: bool,
}

impl Request<'_> {
    /// What names the request in its answer.
    pub const fn id(&self) -> RequestId {
        RequestId { lane: self.lane, step: self.step, episode: self.episode }
    }

    /// Images in the request: the current view, the window's, the segment's and the keyframes.
    pub fn images(&self) -> u32 {
        let retrieved = self.segment.map_or(0, |segment| segment.steps.len());
        let steps = self.trajectories.iter().flat_map(|trajectory| trajectory.steps);
        let keyframes = steps.filter(|step| step.frame.is_some()).count();
        (1 + self.window.len() + retrieved + keyframes) as u32
    }
}

/// What came of asking a policy. Anything but an action leaves the agent where it is, costs a step
/// and is reported as such; it is never an accident of the machinery.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Do this.
    Act(Action),
    /// There was an answer, and no action could be read from it.
    Unreadable,
    /// The answer was empty.
    Empty,
    /// The model refused.
    Refused,
}

impl Answer {
    /// The word for this on the wire and in the log.
    pub const fn outcome(self) -> Outcome {
        match self {
            Self::Act(_) => Outcome::Acted,
            Self::Unreadable => Outcome::Unreadable,
            Self::Empty => Outcome::Empty,
            Self::Refused => Outcome::Refused,
        }
    }

    /// The action, if one was chosen.
    pub const fn action(self) -> Option<Action> {
        match self {
            Self::Act(action) => Some(action),
            Self::Unreadable | Self::Empty | Self::Refused => None,
        }
    }
}

/// What asking a language model took. `None`: nobody told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Usage {
    /// Tokens of the prompt.
    pub prompt_tokens: Option<u32>,
    /// Tokens of the answer.
    pub completion_tokens: Option<u32>,
    /// Tokens of the prompt that the server had computed before and took from its own cache.
    pub cached_tokens: Option<u32>,
    /// Tokens of the prompt's images.
    pub image_tokens: Option<u32>,
    /// Tokens of the prompt that are injected memory, an estimate.
    pub memory_tokens: Option<u32>,
    /// Requests that were sent, failed ones included.
    pub attempts: u32,
    /// The reply is one that was kept from an earlier request: it cost nothing this time.
    pub replayed: bool,
    /// When the prompt was built, CLOCK_MONOTONIC.
    pub prompted_ns: u64,
    /// When the request was sent, the last time if several times; 0 where none was.
    pub sent_ns: u64,
}

/// A policy's answer to one request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decision {
    /// The answer.
    pub answer: Answer,
    /// Images the policy was shown for it.
    pub images: u32,
    /// What asking a model took; `None` where none was asked.
    pub usage: Option<Usage>,
}

impl Decision {
    /// `action`, after being shown every image of `request`, without asking a model.
    pub fn act(request: &Request<'_>, action: Action) -> Self {
        Self { answer: Answer::Act(action), images: request.images(), usage: None }
    }
}
