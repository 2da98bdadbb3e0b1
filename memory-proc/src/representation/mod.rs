//! Memory representations (SPEC section 5): what is stored, and what a step is supplied with.
//!
//! Equations (1) and (2) of the paper: a [`Blueprint`] is what is known before any view is there, from it
//! and the views `M_r = B_r(D_r)` is built once ([`Blueprint::build`]), and each step is supplied with
//! `m_{r,t} = A_r(M_r, x_t)` ([`Memory::access`]). Every representation is in addition to the
//! [`Window`](working::Window). One representation a file.
//!
//! Not here: where views and embeddings come from, and when they are there.

use shm_types::message::{FrameId, SegmentStep};
use shm_types::{Pose, Representation};

use crate::demonstrations::Demonstration;
use crate::embedding::{ContentHash, Embedding};

pub mod episodic;
pub mod working;

/// The current step, as far as a memory may look at it.
#[derive(Debug, Clone, Copy)]
pub struct Situation<'a> {
    /// The current view's embedding; there whenever [`Blueprint::matches_views`].
    pub embedding: Option<&'a Embedding>,
    /// Sub-goals completed so far.
    pub stage: u32,
    /// Steps taken so far.
    pub elapsed: u32,
}

/// A remembered view that is resident and embedded.
#[derive(Debug, Clone)]
pub struct View {
    /// Its frame.
    pub frame: FrameId,
    /// Its content.
    pub content: ContentHash,
    /// Its embedding.
    pub embedding: Embedding,
}

/// A piece of a demonstration, and where it comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct Retrieved {
    /// The matched view, then the views that the expert's actions led to. Each step holds the action
    /// that the expert took *at* that view; the last one holds none.
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

/// A memory that was built: fixed from then on.
pub trait Memory {
    /// What is supplied at a step, beside the window.
    fn access(&self, now: &Situation<'_>) -> Option<Retrieved>;
}

/// What a memory will be made of.
#[derive(Debug, Clone)]
pub struct Blueprint {
    representation: Representation,
    demonstrations: Vec<Demonstration>,
    horizon: usize,
    poses: Vec<Pose>,
}

impl Blueprint {
    /// A memory of `demonstrations`. `horizon` is H_epi, the expert actions that a segment follows.
    pub fn new(
        representation: Representation,
        demonstrations: Vec<Demonstration>,
        horizon: usize,
    ) -> Self {
        let mut poses: Vec<Pose> = match representation {
            Representation::Working
            | Representation::FullContext
            | Representation::Summary
            | Representation::Semantic
            | Representation::Hybrid => Vec::new(),
            Representation::Episodic => demonstrations
                .iter()
                .flat_map(|demonstration| &demonstration.poses)
                .copied()
                .collect(),
        };
        poses.sort_unstable();
        poses.dedup();
        Self { representation, demonstrations, horizon, poses }
    }

    /// The poses, each once, whose views must be resident and embedded before the memory can be built.
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// Whether access compares views, so that the current view must be embedded.
    pub fn matches_views(&self) -> bool {
        match self.representation {
            Representation::Working
            | Representation::FullContext
            | Representation::Summary
            | Representation::Semantic
            | Representation::Hybrid => false,
            Representation::Episodic => true,
        }
    }

    /// Builds the memory. `view` gives the view of each of [`Self::poses`]; `None` as soon as it gives none.
    pub fn build(&self, view: impl Fn(Pose) -> Option<View>) -> Option<Box<dyn Memory>> {
        Some(match self.representation {
            Representation::Working
            | Representation::FullContext
            | Representation::Summary
            | Representation::Semantic
            | Representation::Hybrid => Box::new(working::Working),
            Representation::Episodic => {
                Box::new(episodic::Episodic::build(&self.demonstrations, self.horizon, view)?)
            }
        })
    }
}
