//! What a step shows, laid out so that a [`Request`] can borrow it: pixels stay in shared memory, text in
//! the document it came in.

use std::sync::Arc;

use domain::{Action, DocumentKind};
use shm_types::Frame;
use shm_types::documents::{Content, Document};
use shm_types::message::{FrameId, NO_FRAME, TrajectoryStep};

use super::join::{Join, Ready};
use crate::{
    DocumentView, FrameView, PastView, Request, Segment, SegmentView, Trajectory, TrajectoryView,
};

/// A step, with what keeps its pixels and texts where they are.
pub(super) struct Held<'a> {
    pub(super) step: &'a Ready,
    /// Those that the recall names, in order.
    pub(super) documents: Vec<Arc<Document>>,
    /// Those of [`Self::frame_ids`], in order.
    pub(super) frames: Vec<Arc<Frame>>,
}

impl Held<'_> {
    /// Every frame that the step shows: the current one, the window's, the segment's, the keyframes.
    pub(super) fn frame_ids(&self) -> Vec<FrameId> {
        let recalled = &self.step.recalled;
        let window = recalled.window.iter().map(|&(frame, ..)| frame);
        let segment = recalled.segment.iter().map(|&(frame, _)| frame);
        let keyframes = self.demonstrations().flatten().map(|step| step.frame);
        std::iter::once(self.step.observed.frame)
            .chain(window)
            .chain(segment)
            .chain(keyframes.filter(|&frame| frame != NO_FRAME))
            .collect()
    }

    /// The demonstrations in the documents, each from its start to its end.
    fn demonstrations(&self) -> impl Iterator<Item = &[TrajectoryStep]> {
        let steps = self.documents.iter().filter_map(|document| match &document.content {
            Content::Trajectories(steps) => Some(steps),
            Content::Summary(_) | Content::Semantic(_) => None,
        });
        steps.flat_map(|steps| steps.chunk_by(|a, b| a.trajectory == b.trajectory))
    }
}

/// The views and texts of a step.
pub(super) struct Shown<'a> {
    step: &'a Ready,
    frame: FrameView<'a>,
    window: Vec<PastView<'a>>,
    segment: Vec<SegmentView<'a>>,
    documents: Vec<DocumentView<'a>>,
    demonstrations: Vec<Vec<TrajectoryView<'a>>>,
}

impl<'a> Shown<'a> {
    pub(super) fn new(held: &'a Held<'a>) -> Self {
        let mut views = held.frames.iter().map(|frame| {
            let size = frame.size();
            let (width, height) = (size.width, size.height);
            let (id, content_hash) = (frame.id(), frame.content_hash());
            FrameView { id, content_hash, width, height, pixels: frame.pixels() }
        });
        // What is held was held in this very order.
        let mut next = || views.next().unwrap_or(FrameView::NONE);
        let recalled = &held.step.recalled;
        let frame = next();
        let window = recalled.window.iter();
        let window = window
            .map(|&(_, action, feedback)| PastView { frame: next(), action, feedback })
            .collect();
        let segment = recalled.segment.iter();
        let segment = segment.map(|&(_, action)| SegmentView { frame: next(), action }).collect();
        let mut shown = |step: &TrajectoryStep| TrajectoryView {
            frame: (step.frame != NO_FRAME).then(&mut next),
            action: Action::try_from(step.action).ok(),
        };
        let demonstrations =
            held.demonstrations().map(|steps| steps.iter().map(&mut shown).collect()).collect();
        let documents = held.documents.iter().filter_map(|document| {
            let (kind, text) = match &document.content {
                Content::Summary(text) => (DocumentKind::Summary, text),
                Content::Semantic(text) => (DocumentKind::Semantic, text),
                Content::Trajectories(_) => return None,
            };
            Some(DocumentView { id: document.id, kind, text })
        });
        let documents = documents.collect();
        Self { step: held.step, frame, window, segment, documents, demonstrations }
    }

    /// The demonstrations, for [`Self::request`] to borrow.
    pub(super) fn trajectories(&self) -> Vec<Trajectory<'_>> {
        self.demonstrations.iter().map(|steps| Trajectory { steps }).collect()
    }

    pub(super) fn request<'b>(
        &'b self,
        join: &'b Join,
        trajectories: &'b [Trajectory<'b>],
    ) -> Request<'b> {
        let (step, lane) = (self.step, join.lane(self.step.lane));
        Request {
            lane: step.lane,
            step: step.observed.step,
            episode: lane.episode,
            episode_seed: lane.seed,
            repeat: lane.repeat,
            instruction: &lane.instruction,
            pose: step.observed.pose,
            feedback: step.observed.feedback,
            frame: self.frame,
            window: &self.window,
            segment: (!self.segment.is_empty())
                .then_some(Segment { distance: step.recalled.distance, steps: &self.segment }),
            documents: &self.documents,
            trajectories,
            starts_as_demonstrated: lane.starts_as_demonstrated,
        }
    }
}
