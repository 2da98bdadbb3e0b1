//! Memory representations (SPEC section 5): what is stored, and what a step is supplied with.
//!
//! Equations (1) and (2) of the paper: a [`Blueprint`] is what is known before any view is there, from it
//! and the views `M_r = B_r(D_r)` is built once ([`Blueprint::build`]), and each step is supplied with
//! `m_{r,t} = A_r(M_r, x_t)` ([`Memory::access`]). Every representation is in addition to the
//! [`Window`](working::Window). What each of them stores and supplies, in words, is
//! [`Representation::describe`].
//!
//! One representation a file. To add one: its file, with a blueprint and a memory, and the line in
//! [`blueprint`] that names it, to which the compiler leads from a new [`Representation`].
//!
//! Not here: where views, embeddings and documents come from, and when they are there.

use std::collections::BTreeMap;

use anyhow::Context;
use domain::{DocumentKind, Pose, Representation, SegmentContent};
use shm_types::documents::Content;
use shm_types::message::{DocumentId, FrameId, SegmentStep};
use warehouse::Demonstrations;

use crate::demonstrations::Demonstration;
use crate::embedding::{ContentHash, Embedding};

mod episodic;
mod fixed;
mod full_context;
mod hybrid;
mod semantic;
mod summary;
#[cfg(test)]
pub(crate) mod testing;
pub mod working;

/// How `representation` makes its memory of `ingredients`.
pub fn blueprint(representation: Representation, ingredients: Ingredients) -> Box<dyn Blueprint> {
    match representation {
        Representation::Working => Box::new(working::Working),
        Representation::FullContext => Box::new(full_context::FullContext::new(ingredients)),
        Representation::Summary => Box::new(summary::Summary(ingredients.set)),
        Representation::Semantic => Box::new(semantic::Semantic(ingredients.set)),
        Representation::Hybrid => Box::new(hybrid::Hybrid(ingredients.set)),
        Representation::Episodic => Box::new(episodic::Episodic::new(ingredients)),
    }
}

/// What an episode's memory is to be made of.
#[derive(Debug, Clone)]
pub struct Ingredients {
    /// The episode: lane and ticket.
    pub episode: (u32, u64),
    /// Which demonstrations are remembered.
    pub set: Demonstrations,
    /// What that comes to for the episode's case, acted out.
    pub demonstrations: Vec<Demonstration>,
    /// H_epi: the expert actions that a retrieved segment follows.
    pub horizon: usize,
    /// What a retrieved segment holds.
    pub segment: SegmentContent,
    /// Most keyframes that all demonstrations together keep.
    pub keyframes: usize,
}

/// A memory before it is built.
pub trait Blueprint {
    /// The poses, in order and each once, whose views must be resident before the memory can be built.
    /// They stay so until the episode ends. Those of a representation that
    /// [matches views](Representation::matches_views) are embedded, too.
    fn poses(&self) -> &[Pose] {
        &[]
    }

    /// Builds the memory of the views of [`Self::poses`]. What it supplies as documents is published here:
    /// before the first recall that names it.
    ///
    /// # Errors
    /// When a document cannot be had or published; the run cannot go on then.
    fn build(
        &self,
        views: &Views,
        documents: &mut dyn Documents,
    ) -> anyhow::Result<Box<dyn Memory>>;
}

/// A memory that was built: fixed from then on.
pub trait Memory {
    /// What is supplied at a step, beside the window.
    fn access(&self, now: &Situation<'_>) -> Supply;
}

/// The current step, as far as a memory may look at it.
#[derive(Debug, Clone, Copy)]
pub struct Situation<'a> {
    /// The current view's embedding; there whenever the representation
    /// [matches views](Representation::matches_views).
    pub embedding: Option<&'a Embedding>,
    /// Sub-goals completed so far.
    pub stage: u32,
    /// Steps taken so far.
    pub elapsed: u32,
}

/// What a step is supplied with, beside the window.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Supply {
    /// A piece of a demonstration.
    pub segment: Option<Retrieved>,
    /// Published documents, in order; at most [`MAX_DOCUMENTS`](shm_types::message::MAX_DOCUMENTS).
    pub documents: Vec<DocumentId>,
}

/// A piece of a demonstration, and where it comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct Retrieved {
    /// The matched view, then the views that the expert's actions led to. Each step holds the action
    /// that the expert took *at* that view; the last one holds none, and none does in a segment of images
    /// alone. At most [`MAX_SEGMENT`](shm_types::message::MAX_SEGMENT) steps.
    pub segment: Vec<SegmentStep>,
    /// Index of the case that the demonstration belongs to.
    pub case: u32,
    /// Which of that case's demonstrations.
    pub demonstration: u16,
    /// Step of the matched view in it.
    pub step: u16,
    /// Cosine distance of the matched view to the current one.
    pub distance: f32,
}

/// A remembered view that is resident.
#[derive(Debug, Clone)]
pub struct View {
    /// Its frame.
    pub frame: FrameId,
    /// Its content.
    pub content: ContentHash,
    /// Its embedding, where the representation matches views.
    pub embedding: Option<Embedding>,
}

/// The views that a blueprint needs, by pose.
#[derive(Debug, Clone, Default)]
pub struct Views(BTreeMap<Pose, View>);

impl Views {
    /// How many are there.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether none is there.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The view from `pose` is there.
    pub fn insert(&mut self, pose: Pose, view: View) {
        self.0.insert(pose, view);
    }

    /// The view from `pose`.
    ///
    /// # Errors
    /// When it was not asked for.
    pub fn of(&self, pose: Pose) -> anyhow::Result<&View> {
        self.0.get(&pose).with_context(|| format!("a memory uses the view of {pose} unasked"))
    }
}

/// Where the documents that a memory supplies come from and go to.
pub trait Documents {
    /// Publishes a document that belongs to one episode (lane and ticket), and goes with it.
    ///
    /// # Errors
    /// When it cannot be published.
    fn publish(&mut self, episode: (u32, u64), content: &Content) -> anyhow::Result<DocumentId>;

    /// The document of one kind that was consolidated over the demonstrations `set` of all cases, published
    /// for the whole run.
    ///
    /// # Errors
    /// When there is none, it cannot be used or not be published.
    fn consolidated(
        &mut self,
        kind: DocumentKind,
        set: Demonstrations,
    ) -> anyhow::Result<DocumentId>;
}
