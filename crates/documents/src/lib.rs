//! Documents: texts that are built from the demonstrations of all cases before a run, and supplied by summary, semantic
//! and hybrid memory.
//!
//! A document is addressed by everything that it depends on: its [name](DocumentName), the [recipe](Recipe) that it was
//! built with (builder, model, prompts, limits) and its [sources](Sources) (the world in words, demonstrations, frame
//! size, version of this program). Documents with different addresses lie side by side in a [folder](DocumentFolder);
//! building one never replaces another.
//!
//! What a model is asked for a document is here as well ([`asking`]), because an estimate needs it before anything is asked.
//!
//! What is not here: asking, scripted texts (memory-proc), and when documents are built (orchestrator).

pub mod asking;
mod file;
mod folder;
mod name;
mod recipe;
mod sources;

pub use file::{BuildAccount, DocumentFile, DocumentFileError, MAX_TEXT_BYTES, Provenance};
pub use folder::{DocumentFolder, DocumentSelection, DocumentState, StoredDocument};
pub use name::{DocumentName, UnknownDocument, kind};
pub use recipe::{EXTRACTIVE_VERSION, ModelRecipe, PROMPT_VERSION, Recipe};
pub use sources::Sources;

use domain::hex;
use sha2::{Digest, Sha256};

/// The SHA-256 of a text, in hexadecimal digits.
fn sha256_of(text: &str) -> String {
    hex(&Sha256::digest(text))
}

/// The SHA-256 of several parts, each preceded by its length, in hexadecimal digits.
fn sha256_of_parts<'a>(parts: impl IntoIterator<Item = &'a str>) -> String {
    let mut hasher = Sha256::new();
    for part in parts {
        hasher.update((part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    hex(&hasher.finalize())
}
