//! Memory representations (specification, section 5): what is stored, and what a step is supplied with.
//!
//! Equations (1) and (2) of the paper: a [`MemoryBuilder`] is what is known before any view is rendered. From it and the
//! views a [`Memory`] `M_r = B_r(D_r)` is built once, and at each step it recalls `m_{r,t} = A_r(M_r, x_t)`, in addition
//! to the window of the last steps. [`Representation::describe`] says in words what each representation stores and
//! supplies.
//!
//! To add one: a file with a builder and a memory, and its line in [`memory_builder`], which the compiler asks for.
//!
//! What is not here: where views, embeddings and documents come from, and when they are ready.

use std::collections::BTreeMap;

use anyhow::Context;
use domain::{DocumentKind, Pose, Representation, SegmentContent};
use search::{ContentHash, Embedding};
use shm_types::documents::Content;
use shm_types::message::{DocumentId, FrameId, SegmentStep};
use warehouse::Demonstrations;

use crate::demonstrations::Demonstration;

mod consolidated;
mod episodic;
mod full_context;
#[cfg(test)]
pub(crate) mod testing;

/// The builder of a memory.
pub fn memory_builder(representation: Representation, spec: MemorySpec) -> Box<dyn MemoryBuilder> {
    match representation {
        Representation::FullContext => Box::new(full_context::FullContext::new(spec)),
        Representation::Episodic => Box::new(episodic::Episodic::new(spec)),
        Representation::Working
        | Representation::Summary
        | Representation::Semantic
        | Representation::Hybrid => Box::new(consolidated::Consolidated {
            kinds: representation.describe().documents,
            set: spec.set,
        }),
    }
}

/// What an episode's memory is built from, and how.
#[derive(Debug, Clone)]
pub struct MemorySpec {
    /// The episode: lane and number.
    pub episode: (u32, u64),
    /// The set of demonstrations.
    pub set: Demonstrations,
    /// The demonstrations of that set for the episode's case.
    pub demonstrations: Vec<Demonstration>,
    /// H_epi: expert actions in a retrieved segment.
    pub horizon: usize,
    /// What a retrieved segment contains.
    pub segment: SegmentContent,
    /// Keyframes of all demonstrations together, at most.
    pub keyframes: usize,
}

/// A memory before it is built.
pub trait MemoryBuilder {
    /// The poses, each once, whose views must be in the frame store before the memory can be built. They stay there until
    /// the episode ends, and are embedded if the representation [matches views](Representation::matches_views).
    fn poses(&self) -> &[Pose] {
        &[]
    }

    /// Builds the memory from the views of [`Self::poses`], and publishes the documents that it will supply.
    ///
    /// # Errors
    /// When a document is missing or cannot be published; the run cannot continue then.
    fn build(
        &self,
        views: &StoredViews,
        documents: &mut dyn DocumentSupplier,
    ) -> anyhow::Result<Box<dyn Memory>>;
}

/// A memory, which no longer changes.
pub trait Memory {
    /// What a step is supplied with, in addition to the window.
    fn recall(&self, query: &RecallQuery<'_>) -> RecalledItems;
}

/// The current step, as far as a memory may use it.
#[derive(Debug, Clone, Copy)]
pub struct RecallQuery<'a> {
    /// The current view's embedding, if the representation [matches views](Representation::matches_views).
    pub embedding: Option<&'a Embedding>,
    /// Sub-goals completed so far.
    pub stage: u32,
    /// Steps taken so far.
    pub elapsed: u32,
}

/// What a step is supplied with, in addition to the window.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RecalledItems {
    /// A segment of a demonstration.
    pub segment: Option<RetrievedSegment>,
    /// Published documents, in order; at most [`MAX_DOCUMENTS`](shm_types::message::MAX_DOCUMENTS).
    pub documents: Vec<DocumentId>,
}

/// A segment of a demonstration, and its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct RetrievedSegment {
    /// The matched view, then the views that the expert's actions led to. Each step holds the action that the expert took
    /// *at* that view. The last step holds none, and a segment of images alone holds none at all. At most
    /// [`MAX_SEGMENT`](shm_types::message::MAX_SEGMENT) steps.
    pub segment: Vec<SegmentStep>,
    /// The demonstration's case.
    pub case: u32,
    /// The demonstration's number in that case.
    pub demonstration: u16,
    /// The matched view's step in it.
    pub step: u16,
    /// Cosine distance of the matched view from the current one.
    pub distance: f32,
}

/// A remembered view in the frame store.
#[derive(Debug, Clone)]
pub struct StoredView {
    /// Its frame.
    pub frame: FrameId,
    /// Its content.
    pub content: ContentHash,
    /// Its embedding, if the representation matches views.
    pub embedding: Option<Embedding>,
}

/// The views of a memory, by pose.
#[derive(Debug, Clone, Default)]
pub struct StoredViews(BTreeMap<Pose, StoredView>);

impl StoredViews {
    /// Number of views.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are no views.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Adds the view from `pose`.
    pub fn insert(&mut self, pose: Pose, view: StoredView) {
        self.0.insert(pose, view);
    }

    /// The view from `pose`.
    ///
    /// # Errors
    /// When [`MemoryBuilder::poses`] does not name the pose.
    pub fn of(&self, pose: Pose) -> anyhow::Result<&StoredView> {
        self.0.get(&pose).with_context(|| format!("the memory did not request the view of {pose}"))
    }
}

/// Publishes the documents that memories supply.
pub trait DocumentSupplier {
    /// Publishes a document for one episode (lane and number).
    ///
    /// # Errors
    /// When it cannot be published.
    fn publish(&mut self, episode: (u32, u64), content: &Content) -> anyhow::Result<DocumentId>;

    /// Publishes the document of one kind over the demonstrations `set` of all cases, for the whole run.
    ///
    /// # Errors
    /// When it is missing, not usable, or cannot be published.
    fn consolidated(
        &mut self,
        kind: DocumentKind,
        set: Demonstrations,
    ) -> anyhow::Result<DocumentId>;
}
