//! The built-in memories (specification, section 5): what each stores, and what it supplies for a step.
//!
//! Equations (1) and (2) of the paper: a memory `M_r = B_r(D_r)` is built once from demonstrations, and at each step it
//! recalls `m_{r,t} = A_r(M_r, x_t)`, in addition to the window of the last steps. [`Representation::describe`] says in
//! words what each representation stores and supplies.
//!
//! They implement [`Memory`], as external memories do. To add one: a file with such a type, and its line in [`built_in`],
//! which the compiler asks for.
//!
//! What is not here: where views, embeddings and documents come from, and how items reach the policy.

use std::collections::BTreeMap;
use std::sync::Arc;

use domain::{ActionCode, Representation, SegmentContent};
use peer::memory::{Memory, Step};

use crate::bank::Embeddings;

mod adaptive;
mod consolidated;
mod episodic;
mod full_context;
#[cfg(test)]
pub(crate) mod testing;

/// A built-in memory, which has to be built.
pub fn built_in(representation: Representation, settings: &MemorySettings) -> Box<dyn Memory> {
    match representation {
        Representation::FullContext => {
            Box::new(full_context::FullContext::new(settings.keyframes, settings.turns.clone()))
        }
        Representation::Episodic => Box::new(episodic::Episodic::new(settings)),
        Representation::Adaptive => Box::new(adaptive::Adaptive::new(settings)),
        Representation::Working
        | Representation::Summary
        | Representation::Semantic
        | Representation::Hybrid => {
            Box::new(consolidated::Consolidated { documents: settings.documents.clone() })
        }
    }
}

/// The task stage that a memory can know: how many sub-goals its demonstration had completed at the view that it last supplied in
/// the running episode or, if the agent has then done what the expert did there, at the next one. By lane, with the episode.
#[derive(Debug, Default)]
struct KnownStages(BTreeMap<u32, (u64, SuppliedStage)>);

/// The stage of a view that is supplied, the expert's action there, and the stage after it.
#[derive(Debug, Clone, Copy)]
struct SuppliedStage {
    stage: u32,
    action: Option<ActionCode>,
    next: u32,
}

impl KnownStages {
    /// The stage of the episode, 0 before anything was supplied.
    fn of(&self, now: &Step<'_>) -> u32 {
        let known = self.0.get(&now.lane).filter(|(episode, _)| *episode == now.episode);
        known.map_or(0, |(_, supplied)| match supplied.action {
            Some(action) if now.last_action == Some(action) => supplied.next,
            _ => supplied.stage,
        })
    }

    fn supplied(&mut self, now: &Step<'_>, supplied: SuppliedStage) {
        self.0.insert(now.lane, (now.episode, supplied));
    }
}

/// The numbers in each of the embeddings; 0 if there are none.
fn dimension(embeddings: &Embeddings) -> usize {
    embeddings.values().next().map_or(0, |embedding| embedding.as_slice().len())
}

/// The settings of built-in memories.
#[derive(Debug, Clone)]
pub struct MemorySettings {
    /// H_epi: expert actions in a retrieved segment.
    pub horizon: u32,
    /// What a retrieved segment contains.
    pub segment: SegmentContent,
    /// Segments that are retrieved, k.
    pub hits: usize,
    /// Keyframes of all demonstrations together, at most.
    pub keyframes: usize,
    /// The actions of the world that are turns.
    pub turns: Vec<ActionCode>,
    /// The embeddings of the demonstrations' views.
    pub embeddings: Arc<Embeddings>,
    /// The texts that [`RepresentationInfo::documents`](domain::representation::RepresentationInfo) names, in order.
    pub documents: Vec<Arc<str>>,
}
