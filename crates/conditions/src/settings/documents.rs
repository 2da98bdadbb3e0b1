//! Where the documents of summary, semantic and hybrid memory come from: `--documents`.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use domain::names::{UnknownName, serde_as_text};

/// Where documents come from. Written `extractive`, `model`, `model:NAME`, or as a path, which has a slash.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum DocumentSource {
    /// The script: deterministic, and needs no model.
    Extractive,
    /// A model. With a name, documents that this one has written before. Without, the run's own model, which writes those
    /// that are missing; in a run without a model, documents that any has written before.
    Model(Option<String>),
    /// A folder that holds them.
    Folder(PathBuf),
}

/// A word that is neither a builder nor a path.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}; a folder is named by its path, for example ./documents")]
pub struct UnknownDocuments(UnknownName);

impl FromStr for DocumentSource {
    type Err = UnknownDocuments;

    fn from_str(text: &str) -> Result<Self, UnknownDocuments> {
        match text {
            "extractive" => Ok(Self::Extractive),
            "model" => Ok(Self::Model(None)),
            named if named.len() > "model:".len() && named.starts_with("model:") => {
                Ok(Self::Model(Some(named["model:".len()..].to_owned())))
            }
            path if path.contains('/') => Ok(Self::Folder(path.into())),
            word => {
                let known = ["extractive", "model"];
                Err(UnknownDocuments(UnknownName::new("builder of documents", word, known)))
            }
        }
    }
}

impl fmt::Display for DocumentSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Extractive => f.pad("extractive"),
            Self::Model(None) => f.pad("model"),
            Self::Model(Some(name)) => f.pad(&format!("model:{name}")),
            Self::Folder(path) => f.pad(&path.display().to_string()),
        }
    }
}

serde_as_text!(DocumentSource);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_are_written_as_they_are_read() {
        for (text, expected) in [
            ("extractive", DocumentSource::Extractive),
            ("model", DocumentSource::Model(None)),
            ("model:org/name", DocumentSource::Model(Some("org/name".into()))),
            ("./mine", DocumentSource::Folder("./mine".into())),
        ] {
            assert_eq!(text.parse().as_ref(), Ok(&expected));
            assert_eq!(expected.to_string(), text);
        }
        insta::assert_snapshot!("modle".parse::<DocumentSource>().unwrap_err(), @"unknown builder of documents `modle`: did you mean `model`? (known: extractive, model); a folder is named by its path, for example ./documents");
    }
}
