//! A document as it is kept: a JSON file `<kind>-<demonstrations>.json` of a text and where it comes from.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use domain::DocumentKind;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use shm_types::documents::{Content, MAX_DOCUMENT_BYTES};
use warehouse::Demonstrations;

use super::Account;
use super::transcript::hex;

/// Changes when a reader of the old files could not read the new ones.
pub const FORMAT: u32 = 1;

/// Where a document comes from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// `summary` or `semantic`.
    pub kind: DocumentKind,
    /// Which demonstrations of every case it is made of.
    pub demonstrations: Demonstrations,
    /// Who wrote it: `extractive`, `model`.
    pub builder: String,
    /// What else decides the outcome: the builder's version, a model, its prompts.
    pub builder_version: String,
    /// SHA-256 of what the builder was shown, [`sha256`](super::transcript::sha256) of the transcripts.
    pub inputs_sha256: String,
    /// SHA-256 of what those are made from, [`sha256`](super::sources::Sources::sha256): known without
    /// rendering, so that a document can be told to be out of date.
    pub sources_sha256: String,
    /// SHA-256 of the text.
    pub text_sha256: String,
    /// Demonstrations it is made of.
    pub trajectories: u64,
    /// Different views in them.
    pub views: u64,
    /// What the builder says about how it came to the text.
    #[serde(default, skip_serializing_if = "Account::is_empty")]
    pub account: Account,
}

/// A document and where it comes from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DocumentFile {
    /// [`FORMAT`].
    pub format: u32,
    /// Where it comes from.
    pub provenance: Provenance,
    /// The text.
    pub text: String,
}

/// Why a document cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum DocumentError {
    /// There is none.
    #[error(
        "{} is missing: `memtransfer memory build --kind {kind} --demos {demonstrations}` makes it",
        path.display(), kind = kind.word()
    )]
    Missing {
        /// The file.
        path: PathBuf,
        /// Its kind.
        kind: DocumentKind,
        /// Its demonstrations.
        demonstrations: Demonstrations,
    },
    /// The system refused.
    #[error("cannot {doing} {}: {cause}", path.display())]
    System {
        /// What was tried.
        doing: &'static str,
        /// With what.
        path: PathBuf,
        /// What it said.
        cause: io::Error,
    },
    /// The file is not what it should be.
    #[error(
        "{}: {problem}; remove it, or build it anew with `memtransfer memory build --force`",
        path.display()
    )]
    Broken {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
}

impl DocumentFile {
    /// The document `text`, whose hash is put into `provenance`.
    pub fn new(provenance: Provenance, text: String) -> Self {
        let provenance = Provenance { text_sha256: sha256_of(&text), ..provenance };
        Self { format: FORMAT, provenance, text }
    }

    /// The file's name in a folder of documents: `summary-4.json`.
    pub fn name(kind: DocumentKind, demonstrations: Demonstrations) -> String {
        format!("{}-{demonstrations}.json", kind.word())
    }

    /// Reads the document of `kind` over `demonstrations` in `folder`, and checks that it is that.
    ///
    /// # Errors
    /// When there is none, it cannot be read, or it is broken.
    pub fn load(
        folder: &Path,
        kind: DocumentKind,
        demonstrations: Demonstrations,
    ) -> Result<Self, DocumentError> {
        let path = folder.join(Self::name(kind, demonstrations));
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => {
                return Err(DocumentError::Missing { path, kind, demonstrations });
            }
            Err(cause) if cause.kind() == io::ErrorKind::InvalidData => {
                return Err(DocumentError::Broken { path, problem: cause.to_string() });
            }
            Err(cause) => return Err(DocumentError::System { doing: "read", path, cause }),
        };
        Self::parse(&text, kind, demonstrations)
            .map_err(|problem| DocumentError::Broken { path, problem })
    }

    fn parse(
        json: &str,
        kind: DocumentKind,
        demonstrations: Demonstrations,
    ) -> Result<Self, String> {
        let value: serde_json::Value = serde_json::from_str(json).map_err(|e| e.to_string())?;
        // The format comes first: a file of another one may well have other fields.
        match value.get("format").and_then(serde_json::Value::as_u64) {
            Some(format) if format == u64::from(FORMAT) => {}
            Some(format) => {
                return Err(format!("format {format}, and this program reads {FORMAT}"));
            }
            None => return Err("it says no format".to_owned()),
        }
        let file: Self = serde_json::from_value(value).map_err(|e| e.to_string())?;
        let Provenance { kind: own_kind, demonstrations: own, text_sha256, .. } = &file.provenance;
        if (*own_kind, *own) != (kind, demonstrations) {
            return Err(format!("it is a {} document over {own}", own_kind.word()));
        }
        if !DocumentKind::TEXTS.contains(own_kind) {
            return Err(format!("{} are no text", own_kind.word()));
        }
        if file.text.trim().is_empty() || file.text.len() > MAX_DOCUMENT_BYTES {
            let bytes = file.text.len();
            return Err(format!("a text of {bytes} bytes; 1 to {MAX_DOCUMENT_BYTES} can be used"));
        }
        if *text_sha256 != sha256_of(&file.text) {
            return Err("its text is not the one that was built".to_owned());
        }
        Ok(file)
    }

    /// Writes it into `folder`, which is made if it is missing: all of it or nothing, and durably.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn save(&self, folder: &Path) -> Result<PathBuf, DocumentError> {
        let Provenance { kind, demonstrations, .. } = self.provenance;
        let path = folder.join(Self::name(kind, demonstrations));
        let draft = path.with_extension("json.new");
        let write = || {
            fs::create_dir_all(folder)?;
            let mut file = File::create(&draft)?;
            serde_json::to_writer_pretty(&mut file, self)?;
            file.write_all(b"\n")?;
            file.sync_all()?;
            fs::rename(&draft, &path)?;
            File::open(folder)?.sync_all()
        };
        match write() {
            Ok(()) => Ok(path),
            Err(cause) => Err(DocumentError::System { doing: "write", path, cause }),
        }
    }

    /// What is published.
    pub fn content(&self) -> Content {
        match self.provenance.kind {
            DocumentKind::Semantic => Content::Semantic(self.text.clone()),
            // Trajectories are no text, and a file of them is not read.
            DocumentKind::Summary | DocumentKind::Trajectories => {
                Content::Summary(self.text.clone())
            }
        }
    }
}

/// SHA-256 of a text, in hexadecimal digits.
fn sha256_of(text: &str) -> String {
    hex(&Sha256::digest(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    const KIND: DocumentKind = DocumentKind::Summary;

    fn provenance() -> Provenance {
        Provenance {
            kind: KIND,
            demonstrations: Demonstrations::ALL,
            builder: "extractive".to_owned(),
            builder_version: "1".to_owned(),
            inputs_sha256: "00".to_owned(),
            sources_sha256: "11".to_owned(),
            text_sha256: String::new(),
            trajectories: 400,
            views: 900,
            account: Account::default(),
        }
    }

    #[test]
    fn what_is_saved_is_loaded_and_nothing_else_lies_there() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("new");
        let file = DocumentFile::new(provenance(), "# A summary\n".to_owned());
        let path = file.save(&folder).unwrap();
        assert_eq!(path, folder.join("summary-4.json"));
        assert_eq!(DocumentFile::load(&folder, KIND, Demonstrations::ALL).unwrap(), file);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        let account = Account { model: Some("m".into()), requests: Some(7), ..Account::default() };
        let told = DocumentFile::new(Provenance { account, ..provenance() }, "text".to_owned());
        told.save(&folder).unwrap();
        assert_eq!(DocumentFile::load(&folder, KIND, Demonstrations::ALL).unwrap(), told);
    }

    #[test]
    fn a_missing_document_says_how_to_make_it() {
        let error = DocumentFile::load(Path::new("/nowhere"), KIND, Demonstrations::ALL);
        assert_eq!(
            error.unwrap_err().to_string(),
            "/nowhere/summary-4.json is missing: `memtransfer memory build --kind summary --demos 4` makes it"
        );
    }

    #[test]
    fn a_broken_document_is_named_with_what_is_wrong() {
        let folder = tempfile::tempdir().unwrap();
        let good = DocumentFile::new(provenance(), "# A summary".to_owned());
        let path = good.save(folder.path()).unwrap();
        let json = fs::read_to_string(&path).unwrap();
        for (from, to, problem) in [
            ("{", "", "trailing characters"),
            ("\"format\": 1", "\"format\": 2", "format 2, and this program reads 1"),
            ("\"format\"", "\"fromat\"", "it says no format"),
            ("A summary", "A sumary", "its text is not the one that was built"),
            ("# A summary", " ", "a text of 1 bytes"),
            ("\"summary\"", "\"semantic\"", "it is a semantic document over 4"),
            ("\"4\"", "\"original\"", "it is a summary document over original"),
            ("\"views\"", "\"vews\"", "vews"),
            ("\"summary\"", "\"sumary\"", "sumary"),
        ] {
            assert!(json.contains(from), "{from}");
            fs::write(&path, json.replacen(from, to, 1)).unwrap();
            let error = DocumentFile::load(folder.path(), KIND, Demonstrations::ALL).unwrap_err();
            let error = error.to_string();
            assert!(error.contains(problem) && error.contains("summary-4.json"), "{error}");
        }
        fs::write(&path, [0xff, 0xfe]).unwrap();
        let error = DocumentFile::load(folder.path(), KIND, Demonstrations::ALL).unwrap_err();
        assert!(matches!(error, DocumentError::Broken { .. }), "{error}");
    }
}
