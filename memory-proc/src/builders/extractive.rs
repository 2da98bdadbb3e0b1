//! The extractive builder: deterministic and offline. It writes only what the demonstrations contain.
//! [`any_world`] is for worlds other than the warehouse.
//!
//! Its texts follow a grammar that people, models and programs can read; `docs/documents.md` states it.

pub(super) mod any_world;
mod semantic;
mod summary;

use std::path::Path;

use anyhow::bail;
use case_book::{Demonstration, WorldDeclaration};
use documents::BuildAccount;
use domain::DocumentKind;
use plates::Plate;

use super::{BuiltText, DocumentBuilder, Transcript};

/// Writes documents by rules. [`documents::EXTRACTIVE_VERSION`] changes whenever the same transcripts give another text.
#[derive(Debug, Clone, Copy, Default)]
pub struct Extractive;

impl DocumentBuilder for Extractive {
    fn build(
        &mut self,
        kind: DocumentKind,
        transcripts: &[Transcript],
        _steps: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<BuiltText> {
        let text = match kind {
            DocumentKind::Summary => {
                let mut summary = summary::SummaryDraft::default();
                for (done, transcript) in transcripts.iter().enumerate() {
                    progress(done, transcripts.len());
                    summary.add(transcript);
                }
                summary.to_string()
            }
            DocumentKind::Semantic => {
                let mut facts = semantic::FoundFacts::default();
                for (done, transcript) in transcripts.iter().enumerate() {
                    progress(done, transcripts.len());
                    facts.extract(transcript);
                }
                facts.consolidate().to_string()
            }
            DocumentKind::Trajectories | DocumentKind::Note => {
                bail!("a document of kind {} is not built", kind.word())
            }
        };
        progress(transcripts.len(), transcripts.len());
        Ok(BuiltText { text, account: BuildAccount::default() })
    }

    fn build_of_any_world(
        &mut self,
        kind: DocumentKind,
        world: &WorldDeclaration,
        demonstrations: &[&Demonstration],
    ) -> anyhow::Result<BuiltText> {
        let text = any_world::text(kind, world, demonstrations)?;
        Ok(BuiltText { text, account: BuildAccount::default() })
    }
}

/// The digits of a plate's category, as documents write them: `061`.
fn category_digits(plate: Plate) -> String {
    plate.0[..3].iter().map(|digit| char::from(b'0' + digit)).collect()
}

/// The digits of a plate's type.
fn type_digits(plate: Plate) -> String {
    plate.0[3..].iter().map(|digit| char::from(b'0' + digit)).collect()
}

#[cfg(test)]
#[path = "extractive/tests.rs"]
mod tests;
