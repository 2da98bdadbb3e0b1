//! The extractive builder: deterministic, offline, and made of nothing but what demonstrations contain.
//!
//! What it writes is meant to be read by people and models, and follows a grammar that a program can read,
//! too: `docs/documents.md` states it.

mod semantic;
mod summary;

use std::path::Path;

use anyhow::bail;
use domain::DocumentKind;
use plates::Plate;

use super::{Account, Builder, Built, Transcript};

/// Changes whenever the same demonstrations give another text.
const VERSION: u32 = 1;

/// Writes down what it finds in demonstrations.
#[derive(Debug, Clone, Copy, Default)]
pub struct Extractive;

impl Builder for Extractive {
    fn name(&self) -> &str {
        "extractive"
    }

    fn version(&self) -> String {
        VERSION.to_string()
    }

    fn build(
        &mut self,
        kind: DocumentKind,
        transcripts: &[Transcript],
        _steps: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> anyhow::Result<Built> {
        let text = match kind {
            DocumentKind::Summary => {
                let mut summary = summary::Summary::default();
                for (done, transcript) in transcripts.iter().enumerate() {
                    progress(done, transcripts.len());
                    summary.add(transcript);
                }
                summary.to_string()
            }
            DocumentKind::Semantic => {
                let mut facts = semantic::Facts::default();
                for (done, transcript) in transcripts.iter().enumerate() {
                    progress(done, transcripts.len());
                    facts.extract(transcript);
                }
                facts.consolidate().to_string()
            }
            DocumentKind::Trajectories => bail!("{} are no text to be written", kind.word()),
        };
        progress(transcripts.len(), transcripts.len());
        Ok(Built { text, account: Account::default() })
    }
}

/// The digits of a plate's category, as documents spell them: `061`.
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
