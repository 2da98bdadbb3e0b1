//! The name of a document: what kind it is, and of which demonstrations.

use std::fmt;
use std::str::FromStr;

use domain::{Demonstrations, DocumentKind};
use serde::{Deserialize, Serialize};

/// Names a document by its kind and the demonstrations of every case that it is built from. Written `summary/4`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct DocumentName {
    /// Its kind.
    pub kind: DocumentKind,
    /// The demonstrations of every case.
    pub demonstrations: Demonstrations,
}

/// A word that names no document.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown document `{word}`: {expected}")]
pub struct UnknownDocument {
    word: String,
    expected: String,
}

/// The kind of document that a word names.
///
/// # Errors
/// When it names none.
pub fn kind(word: &str) -> Result<DocumentKind, UnknownDocument> {
    let found = DocumentKind::TEXTS.into_iter().find(|kind| kind.word() == word);
    found.ok_or_else(|| UnknownDocument {
        word: word.to_owned(),
        expected: format!("a kind is {}", DocumentKind::TEXTS.map(DocumentKind::word).join(" or ")),
    })
}

impl fmt::Display for DocumentName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.kind.word(), self.demonstrations)
    }
}

impl FromStr for DocumentName {
    type Err = UnknownDocument;

    fn from_str(text: &str) -> Result<Self, UnknownDocument> {
        let unknown = |expected: String| UnknownDocument { word: text.to_owned(), expected };
        let (word, demonstrations) = text.split_once('/').ok_or_else(|| {
            unknown("a document is written kind/demonstrations, as in summary/4".into())
        })?;
        let demonstrations = demonstrations.parse();
        let demonstrations = demonstrations
            .map_err(|error: domain::UnknownDemonstrations| unknown(error.to_string()))?;
        Ok(Self { kind: kind(word)?, demonstrations })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_written_as_they_are_read() {
        for text in ["summary/4", "semantic/original", "summary/nearby+distant"] {
            assert_eq!(text.parse::<DocumentName>().unwrap().to_string(), text);
        }
        for (text, expected) in [
            ("summary", "kind/demonstrations"),
            ("sumary/4", "summary or semantic"),
            ("summary/5", "5"),
        ] {
            let error = text.parse::<DocumentName>().unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
