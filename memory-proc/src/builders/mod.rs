//! Builders of documents.
//!
//! - [`Transcript`]: a demonstration as a builder sees it;
//! - [`DocumentBuilder`]: writes a text from transcripts; [`Extractive`] needs no model, [`ModelBuilder`] asks one;
//! - [`build`](mod@build): has views rendered, reads them and has documents written.
//!
//! A builder gets transcripts only. A [`Transcript`] holds no map, catalogue, test reference or case name, so none of
//! them can get into a document (specification, sections 2 and 4).

pub mod build;
mod extractive;
mod floor;
pub mod model;
mod names;
mod survey;
mod transcript;

use std::path::Path;

use case_book::{Demonstration, WorldDeclaration};
use documents::BuildAccount;
use domain::DocumentKind;

pub use extractive::Extractive;
pub use model::ModelBuilder;
pub use transcript::{FrameReading, Transcript, TranscriptStep, transcripts};

/// Writes documents.
pub trait DocumentBuilder {
    /// Writes a document from transcripts, in their order.
    ///
    /// `progress` is called with the number of finished parts and of all parts, also while a part takes long. `steps` is
    /// a folder beside the document, which the builder may create to continue there after an interruption.
    ///
    /// # Errors
    /// When the document cannot be written. The message says what to do.
    fn build(
        &mut self,
        kind: DocumentKind,
        transcripts: &[Transcript],
        steps: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<BuiltText>;

    /// Writes a document from demonstrations in a world other than the warehouse, in their order.
    ///
    /// # Errors
    /// When the builder writes documents of the warehouse only.
    fn build_of_any_world(
        &mut self,
        kind: DocumentKind,
        world: &WorldDeclaration,
        demonstrations: &[&Demonstration],
    ) -> anyhow::Result<BuiltText>;
}

/// A text and what it took.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct BuiltText {
    /// The text.
    pub text: String,
    /// The requests to a model that it took.
    pub account: BuildAccount,
}
