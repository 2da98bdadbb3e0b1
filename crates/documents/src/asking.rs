//! What a model is asked for a document: demonstrations in words and views, the prompts, and how much fits into one.
//!
//! - [`Narration`]: a demonstration in the words of its world;
//! - [`DocumentPrompt`], [`PromptStage`]: the prompts, whose texts are the files in `prompts/`;
//! - [`Room`]: how many texts fit into a prompt;
//! - [`BuildEstimate`]: what building a document would take.
//!
//! Nothing is asked here, and nothing is rendered: the builder in memory-proc does both.

mod estimate;
mod narration;
mod prompt;
mod room;
#[cfg(test)]
mod testing;

pub use estimate::BuildEstimate;
pub use narration::{Narration, NarrationPart, narrations};
pub use prompt::{DocumentPrompt, PromptPart, PromptStage, PromptTexts};
pub use room::{PartSize, Room};
