//! A document's file: JSON with the text and its provenance.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use domain::{Demonstrations, DocumentKind};
use serde::{Deserialize, Serialize};

use crate::recipe::address;
use crate::{DocumentName, sha256_of};

/// The version of the file format.
const FORMAT: u32 = 2;

/// Maximum size of a text in bytes: the wire carries no longer documents.
pub const MAX_TEXT_BYTES: usize = 16 << 20;

/// Where a document comes from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// `summary` or `semantic`.
    pub kind: DocumentKind,
    /// The demonstrations of every case that it is built from.
    pub demonstrations: Demonstrations,
    /// The builder: `extractive` or `model`.
    pub builder: String,
    /// Everything else about the builder that determines the text: its version, model, prompts, limits.
    pub builder_version: String,
    /// SHA-256 of what it is built from ([`Sources::sha256`](crate::Sources::sha256)), known without rendering.
    pub sources_sha256: String,
    /// SHA-256 of the text.
    pub text_sha256: String,
    /// Number of demonstrations.
    pub trajectories: u64,
    /// Number of distinct views in them.
    pub views: u64,
    /// The requests to a model that the text took.
    #[serde(default, skip_serializing_if = "BuildAccount::is_empty")]
    pub account: BuildAccount,
}

/// The requests to a model that a document took. What was not measured is absent.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BuildAccount {
    /// The model, as the server reports it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Version of the prompts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt_version: Option<u32>,
    /// Answered requests, including reused ones of an earlier attempt.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub requests: Option<u64>,
    /// Images in all prompts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub images: Option<u64>,
    /// Tokens of all prompts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt_tokens: Option<u64>,
    /// Tokens of all answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub completion_tokens: Option<u64>,
}

impl BuildAccount {
    /// Tokens of prompts and answers, if both were reported.
    pub fn tokens(&self) -> Option<u64> {
        self.prompt_tokens?.checked_add(self.completion_tokens?)
    }

    fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

impl Provenance {
    /// The document's name.
    pub fn name(&self) -> DocumentName {
        DocumentName { kind: self.kind, demonstrations: self.demonstrations }
    }

    /// The model that wrote it, by the name under which it was asked; `None` for another builder.
    pub fn model(&self) -> Option<String> {
        if self.builder != "model" {
            return None;
        }
        // As `ModelRecipe` writes it.
        let asked = || {
            let (_, after) = self.builder_version.split_once(", model ")?;
            let (before, _) = after.split_once(" characters to ")?;
            Some(before.rsplit_once(", ")?.0.to_owned())
        };
        asked().or_else(|| self.account.model.clone())
    }

    /// The document's address.
    pub fn address(&self) -> String {
        address(self.name(), &self.builder, &self.builder_version, &self.sources_sha256)
    }
}

/// A document and its provenance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DocumentFile {
    format: u32,
    /// Where it comes from.
    pub provenance: Provenance,
    /// The text.
    pub text: String,
}

/// Why a document cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum DocumentFileError {
    /// There is no such file.
    #[error("{} is missing", .0.display())]
    Missing(PathBuf),
    /// A file cannot be read or written.
    #[error("cannot {action} {}: {cause}", path.display())]
    Io {
        /// `read` or `write`.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The cause.
        cause: io::Error,
    },
    /// The file is not a usable document.
    #[error(
        "{}: {problem}; delete the file, or rebuild it with `memtransfer memory build --force`",
        path.display()
    )]
    Broken {
        /// The file.
        path: PathBuf,
        /// The problem.
        problem: String,
    },
}

impl DocumentFile {
    /// A document with the text `text`, whose hash is put into `provenance`.
    pub fn new(provenance: Provenance, text: String) -> Self {
        let provenance = Provenance { text_sha256: sha256_of(&text), ..provenance };
        Self { format: FORMAT, provenance, text }
    }

    /// Number of words in the text.
    pub fn words(&self) -> u64 {
        self.text.split_whitespace().count() as u64
    }

    /// Reads a document and checks it.
    ///
    /// # Errors
    /// When there is none, it cannot be read, or it is not usable.
    pub fn load(path: &Path) -> Result<Self, DocumentFileError> {
        let path = path.to_owned();
        let text = match durable::input::read_text(&path) {
            Ok(text) => text,
            Err(cause) => {
                return Err(match cause.kind() {
                    io::ErrorKind::NotFound => DocumentFileError::Missing(path),
                    io::ErrorKind::InvalidData => {
                        DocumentFileError::Broken { path, problem: cause.to_string() }
                    }
                    _ => DocumentFileError::Io { action: "read", path, cause },
                });
            }
        };
        Self::parse(&text).map_err(|problem| DocumentFileError::Broken { path, problem })
    }

    /// The document in the text of a file.
    ///
    /// # Errors
    /// Why it is not usable.
    pub fn parse(json: &str) -> Result<Self, String> {
        let value: serde_json::Value = serde_json::from_str(json).map_err(|e| e.to_string())?;
        // The format comes first: another format may have other fields.
        match value.get("format").and_then(serde_json::Value::as_u64) {
            Some(format) if format == u64::from(FORMAT) => {}
            Some(format) => {
                return Err(format!("it has format {format}; this program reads format {FORMAT}"));
            }
            None => return Err("it has no `format`".to_owned()),
        }
        let file: Self = serde_json::from_value(value).map_err(|e| e.to_string())?;
        if !DocumentKind::TEXTS.contains(&file.provenance.kind) {
            return Err(format!("{} are not a text", file.provenance.kind.word()));
        }
        if file.text.trim().is_empty() || file.text.len() > MAX_TEXT_BYTES {
            let bytes = file.text.len();
            return Err(format!("its text has {bytes} bytes; 1 to {MAX_TEXT_BYTES} are allowed"));
        }
        if file.provenance.text_sha256 != sha256_of(&file.text) {
            return Err("its text has been changed".to_owned());
        }
        Ok(file)
    }

    /// Writes the document to `path`: all of it or nothing, and durably. Creates the folder if it is missing.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), DocumentFileError> {
        let folder = path.parent().unwrap_or(Path::new("."));
        let draft = path.with_extension("json.new");
        let write = || {
            fs::create_dir_all(folder)?;
            let mut text = serde_json::to_vec_pretty(self)?;
            text.push(b'\n');
            let mut file = durable::output::create(&draft)?;
            file.write_all(&text)?;
            file.sync_all()?;
            fs::rename(&draft, path)?;
            File::open(folder)?.sync_all()
        };
        write().map_err(|cause| DocumentFileError::Io { action: "write", path: path.into(), cause })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn provenance() -> Provenance {
        Provenance {
            kind: DocumentKind::Summary,
            demonstrations: Demonstrations::ALL,
            builder: "extractive".to_owned(),
            builder_version: "1".to_owned(),
            sources_sha256: "11".to_owned(),
            text_sha256: String::new(),
            trajectories: 400,
            views: 900,
            account: BuildAccount::default(),
        }
    }

    #[test]
    fn a_saved_document_is_loaded_again_and_nothing_else_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("new");
        let path = folder.join("summary-4.json");
        let file = DocumentFile::new(provenance(), "# A summary\n".to_owned());
        file.save(&path).unwrap();
        assert_eq!(DocumentFile::load(&path).unwrap(), file);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        let account =
            BuildAccount { model: Some("m".into()), requests: Some(7), ..BuildAccount::default() };
        let asked = DocumentFile::new(Provenance { account, ..provenance() }, "text".to_owned());
        asked.save(&path).unwrap();
        assert_eq!(DocumentFile::load(&path).unwrap(), asked);
    }

    #[test]
    fn a_broken_document_is_named_with_its_problem() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("summary-4.json");
        let missing = DocumentFile::load(&path).unwrap_err();
        assert!(matches!(missing, DocumentFileError::Missing(_)), "{missing}");
        DocumentFile::new(provenance(), "# A summary".to_owned()).save(&path).unwrap();
        let json = fs::read_to_string(&path).unwrap();
        for (from, to, problem) in [
            ("{", "", "trailing characters"),
            ("\"format\": 2", "\"format\": 1", "format 1; this program reads format 2"),
            ("\"format\"", "\"fromat\"", "no `format`"),
            ("A summary", "A sumary", "its text has been changed"),
            ("# A summary", " ", "1 bytes"),
            ("\"views\"", "\"vews\"", "vews"),
            ("\"summary\"", "\"sumary\"", "sumary"),
        ] {
            assert!(json.contains(from), "{from}");
            fs::write(&path, json.replacen(from, to, 1)).unwrap();
            let error = DocumentFile::load(&path).unwrap_err().to_string();
            assert!(error.contains(problem) && error.contains("summary-4.json"), "{error}");
        }
        fs::write(&path, [0xff, 0xfe]).unwrap();
        let error = DocumentFile::load(&path).unwrap_err();
        assert!(matches!(error, DocumentFileError::Broken { .. }), "{error}");
        let error = DocumentFile::load(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(error.ends_with("not a regular file"), "{error}");
    }
}
