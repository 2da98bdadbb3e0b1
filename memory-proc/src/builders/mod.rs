//! Builders of documents.
//!
//! - [`DocumentBuilder`]: writes a text from demonstrations; [`Extractive`] needs no model, [`ModelBuilder`] asks one;
//! - [`build`](mod@build): has documents written;
//! - [`ViewRenderer`](views::ViewRenderer): draws the views that a model is shown.
//!
//! A builder gets the world's declaration and demonstrations only. They hold no map, catalogue, test reference or case name,
//! so none of them can get into a document (specification, sections 2 and 4).

pub mod build;
mod extractive;
pub mod model;
#[cfg(test)]
mod testing;
pub mod views;

use std::path::Path;

use case_book::{Demonstration, WorldDeclaration};
use documents::BuildAccount;
use domain::DocumentKind;

pub use extractive::Extractive;
pub use model::ModelBuilder;

/// Writes documents.
pub trait DocumentBuilder {
    /// Writes a document from demonstrations in `world`, in their order.
    ///
    /// `progress` is called with the number of finished parts and of all parts, also while a part takes long. `steps` is
    /// a folder beside the document, which the builder may create to continue there after an interruption.
    ///
    /// # Errors
    /// When the document cannot be written. The message says what to do.
    fn build(
        &mut self,
        kind: DocumentKind,
        world: &WorldDeclaration,
        demonstrations: &[&Demonstration],
        steps: &Path,
        progress: &mut dyn FnMut(usize, usize),
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
