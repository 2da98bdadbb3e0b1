//! The case book: everything that a run knows about the cases of its world and that does not change while it runs.
//!
//! The world writes it as data, once for the settings of a run; no other process knows the world's rules. It consists of two
//! files, because what a process must not know is not in its file:
//!
//! - [`CaseBook`], for the orchestrator, scores and pages: instructions, references, streams, and which demonstrations are
//!   stale in which variant;
//! - [`DemonstrationBook`], for memory: demonstrations only. No rule of a variant, no goal, and no test reference, except in a run
//!   with the arm `oracle`, whose memories hold them.
//!
//! Both are identified by their content ([`BookFile`]).
//!
//! A part of the first is for every process: [`WorldDeclaration`], what agents do, see and are told, in words.
//!
//! What the world tells and is told about single episodes is data as well: [`EpisodeFacts`], of which every world has
//! [`SharedFacts`], [`LearnedEpisode`], and for those
//! who show episodes [`act`].

pub mod act;
mod case_variant;
mod cases;
mod declaration;
mod demonstrations;
mod episodes;
mod file;
mod keyframes;
mod request;
#[cfg(test)]
mod tests;

pub use case_variant::CaseVariant;
pub use cases::{
    CaseBook, CaseFacts, CaseInState, FailureKind, HARNESS_FAILURES, LOOPED, OUT_OF_STEPS,
    Reference, StreamBlock, StreamFacts, StreamsFacts, TaskFacts, TaskGroupFacts, UNREADABLE,
    WorldFacts,
};
pub use declaration::{
    ActionDeclaration, ForeignState, NO_LETTER, StateField, WAREHOUSE, WorldDeclaration, fill,
};
pub use demonstrations::{
    CaseDemonstrations, Demonstration, DemonstrationBook, StreamDemonstrations, ViewPlace,
};
pub use episodes::{
    EpisodeFacts, FailureFact, LEARNED_FILE, LOOP_LEAST, LOOP_STEPS, LOOP_VISITS, LearnedEpisode,
    LoopFact, PathFact, SharedFacts, looped_at, loops,
};
pub use file::{BookError, BookFile, CASE_BOOK_FILE, DEMONSTRATIONS_FILE, WORLD_FILE};
pub use keyframes::{Moment, keyframes};
pub use request::{BookRequest, ElsewhereRequest, StreamsRequest};

/// The number on the wire of the world variant that is the other warehouse.
pub const ELSEWHERE_VARIANT: u32 = u32::MAX;

/// The number in place of a world variant's for a view that shows no world: uniform grey.
pub const GREY_VARIANT: u32 = u32::MAX - 1;
