//! A step with everything that its request shows: pixels stay in shared memory, texts in their documents.

use std::ops::Deref;
use std::sync::Arc;

use domain::{Action, DocumentKind};
use shm_types::Frame;
use shm_types::documents::{Content, Document};
use shm_types::message::{FrameId, NO_FRAME, RequestId, TrajectoryStep};

use super::join::Ready;
use super::request::{
    DocumentView, FrameView, PastView, Request, Segment, SegmentView, Trajectory, TrajectoryView,
};

/// The requests that wait at this moment, each of another lane. Dereferences to the requests.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    steps: &'a [Arc<PinnedStep>],
    requests: &'a [Request<'a>],
}

impl<'a> Batch<'a> {
    /// The same requests, each as an owned step that can be kept until it is answered.
    pub fn steps(&self) -> &'a [Arc<PinnedStep>] {
        self.steps
    }
}

impl<'a> Deref for Batch<'a> {
    type Target = [Request<'a>];

    fn deref(&self) -> &Self::Target {
        self.requests
    }
}

/// Calls `f` with the batch of `steps`.
pub(super) fn with_batch<R>(steps: &[Arc<PinnedStep>], f: impl FnOnce(&Batch<'_>) -> R) -> R {
    let views: Vec<StepViews<'_>> = steps.iter().map(|step| step.views()).collect();
    let trajectories: Vec<_> = views.iter().map(StepViews::trajectories).collect();
    let requests: Vec<Request<'_>> = steps
        .iter()
        .zip(views.iter().zip(&trajectories))
        .map(|(step, (views, trajectories))| step.request(views, trajectories))
        .collect();
    f(&Batch { steps, requests: &requests })
}

/// A request that owns what it shows. Its frames and documents stay readable while it lives.
#[derive(Debug)]
pub struct PinnedStep {
    step: Ready,
    documents: Vec<Arc<Document>>,
    frames: Vec<Arc<Frame>>,
}

impl PinnedStep {
    pub(super) fn new(step: Ready, documents: Vec<Arc<Document>>) -> Self {
        Self { step, documents, frames: Vec::new() }
    }

    /// Identifies the request in its answer.
    pub fn id(&self) -> RequestId {
        RequestId {
            lane: self.step.lane,
            episode: self.step.episode.id,
            step: self.step.observed.step,
        }
    }

    /// All frames of the request, in order: the current view, the window, the segment, the keyframes.
    pub fn frames(&self) -> &[Arc<Frame>] {
        &self.frames
    }

    /// Calls `f` with the request.
    pub fn with_request<R>(&self, f: impl FnOnce(&Request<'_>) -> R) -> R {
        let views = self.views();
        let trajectories = views.trajectories();
        f(&self.request(&views, &trajectories))
    }

    /// The ids of [`Self::frames`].
    pub(super) fn frame_ids(&self) -> Vec<FrameId> {
        let window = self.step.window.iter().map(|past| past.frame);
        let segment = self.step.recalled.segment.iter().map(|&(frame, _)| frame);
        let keyframes = self.demonstrations().flatten().map(|step| step.frame);
        std::iter::once(self.step.observed.frame)
            .chain(window)
            .chain(segment)
            .chain(keyframes.filter(|&frame| frame != NO_FRAME))
            .collect()
    }

    /// Sets the frames of [`Self::frame_ids`].
    pub(super) fn pin(&mut self, frames: Vec<Arc<Frame>>) {
        self.frames = frames;
    }

    /// The demonstrations in the documents, each from its start to its end.
    fn demonstrations(&self) -> impl Iterator<Item = &[TrajectoryStep]> {
        let steps = self.documents.iter().filter_map(|document| match &document.content {
            Content::Trajectories(steps) => Some(steps),
            Content::Summary(_) | Content::Semantic(_) => None,
        });
        steps.flat_map(|steps| steps.chunk_by(|a, b| a.trajectory == b.trajectory))
    }

    fn views(&self) -> StepViews<'_> {
        // In the order of `frame_ids`.
        let mut frames = self.frames.iter().map(|frame| FrameView::of(frame));
        let mut next = || frames.next().unwrap_or(FrameView::NONE);
        let frame = next();
        let window = self.step.window.iter();
        let window = window
            .map(|past| PastView { frame: next(), action: past.action, feedback: past.feedback })
            .collect();
        let segment = self.step.recalled.segment.iter();
        let segment = segment.map(|&(_, action)| SegmentView { frame: next(), action }).collect();
        let mut view = |step: &TrajectoryStep| TrajectoryView {
            frame: (step.frame != NO_FRAME).then(&mut next),
            action: Action::try_from(step.action).ok(),
        };
        let demonstrations =
            self.demonstrations().map(|steps| steps.iter().map(&mut view).collect()).collect();
        let documents = self.documents.iter().filter_map(|document| {
            let (kind, text) = match &document.content {
                Content::Summary(text) => (DocumentKind::Summary, text),
                Content::Semantic(text) => (DocumentKind::Semantic, text),
                Content::Trajectories(_) => return None,
            };
            Some(DocumentView { id: document.id, kind, text })
        });
        StepViews { frame, window, segment, documents: documents.collect(), demonstrations }
    }

    fn request<'a>(
        &'a self,
        views: &'a StepViews<'a>,
        trajectories: &'a [Trajectory<'a>],
    ) -> Request<'a> {
        let Ready { lane, episode, observed, recalled, .. } = &self.step;
        let segment = Segment { distance: recalled.distance, steps: &views.segment };
        Request {
            lane: *lane,
            step: observed.step,
            episode: episode.id,
            episode_seed: episode.seed,
            repeat: episode.repeat,
            instruction: &episode.instruction,
            pose: observed.pose,
            feedback: observed.feedback,
            frame: views.frame,
            window: &views.window,
            segment: (!views.segment.is_empty()).then_some(segment),
            documents: &views.documents,
            trajectories,
            starts_as_demonstrated: episode.starts_as_demonstrated,
        }
    }
}

/// The lists that a [`Request`] borrows.
struct StepViews<'a> {
    frame: FrameView<'a>,
    window: Vec<PastView<'a>>,
    segment: Vec<SegmentView<'a>>,
    documents: Vec<DocumentView<'a>>,
    demonstrations: Vec<Vec<TrajectoryView<'a>>>,
}

impl StepViews<'_> {
    fn trajectories(&self) -> Vec<Trajectory<'_>> {
        self.demonstrations.iter().map(|steps| Trajectory { steps }).collect()
    }
}
