//! Documents: what is told of the demonstrations of all cases in words, written once, before a run.
//!
//! Inside out:
//!
//! - [`sources`]: which demonstrations a document is made of;
//! - [`transcript`]: a demonstration as a builder may see it;
//! - [`Builder`]: makes a text of many of them;
//! - [`Extractive`]: the builder that needs no model; [`model`]: the one that asks one;
//! - [`file`](mod@file): a text with where it comes from, as it is kept; [`holdings`]: which of them there are;
//! - [`build`](mod@build): everything together, in a run of the simulator and this process.
//!
//! A builder is handed transcripts and nothing else. A [`Transcript`] has no room for the map, the catalogue,
//! a test reference or a case's name, so none of them can get into a document (SPEC sections 2 and 4).

pub mod build;
mod extractive;
pub mod file;
mod floor;
pub mod holdings;
pub mod model;
mod names;
pub mod sources;
mod survey;
pub mod transcript;

use std::path::Path;

use domain::DocumentKind;
use serde::{Deserialize, Serialize};

pub use extractive::Extractive;
pub use file::{DocumentError, DocumentFile, Provenance};
pub use transcript::{Seen, Step, Transcript};

/// Makes documents of demonstrations.
pub trait Builder {
    /// The word for it: `extractive`, `model`.
    fn name(&self) -> &str;

    /// What else decides the outcome when the demonstrations are the same: a version, a model, its prompts.
    fn version(&self) -> String;

    /// Writes the document of kind `kind`, a text, from `transcripts`, in their order.
    ///
    /// `progress` is told how many of how many parts are done, and while nothing is done that work goes on.
    /// `steps` is a folder that the builder may make, beside the document, to go on there after it was stopped.
    ///
    /// # Errors
    /// When it cannot be written. What a person should do is in the message.
    fn build(
        &mut self,
        kind: DocumentKind,
        transcripts: &[Transcript],
        steps: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<Built>;
}

/// A document as a [`Builder`] hands it over.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Built {
    /// The text.
    pub text: String,
    /// What the builder has to say about how it came to it.
    pub account: Account,
}

/// How a builder came to its text, as far as it asked a model. What was not measured is absent.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Account {
    /// The model that answered, as it calls itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Version of the prompts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt_version: Option<u32>,
    /// Requests that were answered, those of earlier attempts that this one could use included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub requests: Option<u64>,
    /// Answers among them that were cut off at their bound, and used up to their last whole line or sentence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut_off: Option<u64>,
    /// Tokens of all prompts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt_tokens: Option<u64>,
    /// Tokens of all answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub completion_tokens: Option<u64>,
}

impl Account {
    fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}
