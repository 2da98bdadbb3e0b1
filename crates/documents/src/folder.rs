//! A folder of documents: where each lies, and which of them fits.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Serialize, Serializer};

use crate::{DocumentFile, DocumentFileError, DocumentName, Provenance, Recipe, Sources};

/// A folder of documents.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DocumentFolder(PathBuf);

/// Which documents are acceptable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DocumentSelection {
    /// Those of one recipe.
    Recipe(Recipe),
    /// Those of the model builder, for any model or for the one named.
    Model(Option<String>),
    /// All.
    Any,
}

/// A document as it is found in a folder, or is missing there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct StoredDocument {
    /// Its name.
    #[serde(flatten)]
    pub name: DocumentName,
    /// The file, or where it would be.
    pub file: PathBuf,
    /// Its address; absent when the file is not readable.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub address: Option<String>,
    /// Whether it can be used.
    pub state: DocumentState,
    /// Why it cannot be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
    /// Its content, when it is readable.
    #[serde(flatten, serialize_with = "summarized", skip_serializing_if = "Option::is_none")]
    pub document: Option<DocumentFile>,
}

/// Whether a document can be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DocumentState {
    /// It fits.
    Current,
    /// There is none.
    Missing,
    /// It was made for other assets, frames or another version of this program.
    Outdated,
    /// The file is not a usable document.
    Broken,
}

impl DocumentState {
    /// The word in tables.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Current => "current",
            Self::Missing => "missing",
            Self::Outdated => "outdated",
            Self::Broken => "broken",
        }
    }
}

impl StoredDocument {
    /// A document that was loaded from `file` and can be used.
    pub fn current(file: PathBuf, document: DocumentFile) -> Self {
        Self {
            name: document.provenance.name(),
            file,
            address: Some(document.provenance.address()),
            state: DocumentState::Current,
            problem: None,
            document: Some(document),
        }
    }

    /// A document that cannot be used.
    fn unusable(
        name: DocumentName,
        file: PathBuf,
        state: DocumentState,
        problem: impl Into<String>,
    ) -> Self {
        Self { name, file, address: None, state, problem: Some(problem.into()), document: None }
    }
}

impl DocumentSelection {
    fn accepts(&self, made: &Provenance) -> bool {
        match self {
            Self::Recipe(recipe) => {
                (&*made.builder, &made.builder_version) == (recipe.builder(), &recipe.version())
            }
            Self::Model(None) => made.builder == "model",
            Self::Model(Some(model)) => made.model().as_ref() == Some(model),
            Self::Any => true,
        }
    }
}

impl DocumentFolder {
    /// The folder at `path`, which may be missing.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(path.into())
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The file of the document with this name and address: `summary-4-0123456789ab.json`.
    pub fn file(&self, name: DocumentName, address: &str) -> PathBuf {
        let DocumentName { kind, demonstrations } = name;
        self.0.join(format!("{}-{demonstrations}-{address}.json", kind.word()))
    }

    /// The file of a run's own copy, of which there is one for each name: `summary-4.json`.
    pub fn run_copy(&self, name: DocumentName) -> PathBuf {
        let DocumentName { kind, demonstrations } = name;
        self.0.join(format!("{}-{demonstrations}.json", kind.word()))
    }

    /// All documents in the folder, by name; none when there is no such folder. Those that were not made from `sources` are
    /// outdated.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn list(&self, sources: &Sources) -> io::Result<Vec<StoredDocument>> {
        let files = self.files()?.into_iter();
        let mut found: Vec<StoredDocument> = files
            .map(|(name, file)| load(name, file, &sources.sha256(name.demonstrations)))
            .collect();
        found.sort_by(|a, b| (a.name, &a.file).cmp(&(b.name, &b.file)));
        Ok(found)
    }

    /// The document of this name that is acceptable and was made from `sources`.
    ///
    /// When several are, the result is broken and its problem names them. When none is, the result is missing, and its
    /// file is where the recipe's document would be.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn find(
        &self,
        name: DocumentName,
        selection: &DocumentSelection,
        sources: &Sources,
    ) -> io::Result<StoredDocument> {
        let sources_sha256 = sources.sha256(name.demonstrations);
        if let DocumentSelection::Recipe(recipe) = selection {
            let file = self.file(name, &recipe.address(name, &sources_sha256));
            return Ok(load(name, file, &sources_sha256));
        }
        let files = self.files()?.into_iter().filter(|(other, _)| *other == name);
        let loaded = files.map(|(name, file)| load(name, file, &sources_sha256));
        let (usable, others): (Vec<_>, Vec<_>) = loaded
            .filter(|stored| {
                stored.document.as_ref().is_none_or(|file| selection.accepts(&file.provenance))
            })
            .partition(|stored| stored.state == DocumentState::Current);
        let mut usable = distinct(usable);
        match usable.len() {
            1 => Ok(usable.remove(0)),
            0 => Ok(others.into_iter().next().unwrap_or_else(|| {
                let problem = format!("{} has no document {name}", self.0.display());
                let file = self.run_copy(name);
                StoredDocument::unusable(name, file, DocumentState::Missing, problem)
            })),
            _ => {
                let versions = usable.iter().filter_map(|stored| {
                    let made = &stored.document.as_ref()?.provenance;
                    Some(format!(
                        "\n  {}: {} {}",
                        stored.file.display(),
                        made.builder,
                        made.builder_version
                    ))
                });
                let problem = format!(
                    "several documents {name} fit; name the model with --documents model:NAME, or move the other \
                     files to another folder:{}",
                    versions.collect::<String>()
                );
                let file = usable.remove(0).file;
                Ok(StoredDocument::unusable(name, file, DocumentState::Broken, problem))
            }
        }
    }

    /// Loads the run's own copy of a document.
    ///
    /// # Errors
    /// When there is none, or it is not usable.
    pub fn load_run_copy(&self, name: DocumentName) -> Result<DocumentFile, DocumentFileError> {
        let path = self.run_copy(name);
        let file = DocumentFile::load(&path)?;
        match file.provenance.name() {
            own if own == name => Ok(file),
            own => {
                Err(DocumentFileError::Broken { path, problem: format!("it is document {own}") })
            }
        }
    }

    /// Names and files of everything that is named like a document; none when there is no such folder.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn files(&self) -> io::Result<Vec<(DocumentName, PathBuf)>> {
        let entries = match fs::read_dir(&self.0) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries?,
        };
        let mut found = Vec::new();
        for entry in entries {
            let path = entry?.path();
            let name = path.file_name().and_then(|name| name.to_str()).and_then(name_of);
            found.extend(name.map(|name| (name, path)));
        }
        found.sort();
        Ok(found)
    }
}

/// The document name in a file name, with or without an address.
fn name_of(file: &str) -> Option<DocumentName> {
    let mut words = file.strip_suffix(".json")?.splitn(3, '-');
    let (kind, demonstrations) = (words.next()?, words.next()?);
    format!("{kind}/{demonstrations}").parse().ok()
}

/// Loads a document that should have this name, and determines whether it was made from these sources.
fn load(name: DocumentName, file: PathBuf, sources_sha256: &str) -> StoredDocument {
    let document = match DocumentFile::load(&file) {
        Ok(document) => document,
        Err(error) => {
            let is_missing = matches!(error, DocumentFileError::Missing(_));
            let state = if is_missing { DocumentState::Missing } else { DocumentState::Broken };
            return StoredDocument::unusable(name, file, state, error.to_string());
        }
    };
    let (own, is_current) =
        (document.provenance.name(), document.provenance.sources_sha256 == sources_sha256);
    if own != name {
        let problem = format!("{} holds document {own}", file.display());
        return StoredDocument::unusable(name, file, DocumentState::Broken, problem);
    }
    let mut stored = StoredDocument::current(file, document);
    if !is_current {
        let problem = "made from other demonstrations, layout, catalogue or frame size, or by another version of this \
                       program";
        (stored.state, stored.problem) = (DocumentState::Outdated, Some(problem.to_owned()));
    }
    stored
}

/// Keeps one of several files with the same address.
fn distinct(mut stored: Vec<StoredDocument>) -> Vec<StoredDocument> {
    stored.sort_by(|a, b| (&a.address, &a.file).cmp(&(&b.address, &b.file)));
    stored.dedup_by(|a, b| a.address == b.address);
    stored
}

/// A document in JSON: its provenance and the size of its text.
fn summarized<S: Serializer>(document: &Option<DocumentFile>, to: S) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    struct StoredSummary<'a> {
        provenance: &'a Provenance,
        bytes: u64,
        words: u64,
    }
    let summary = document.as_ref().map(|document| StoredSummary {
        provenance: &document.provenance,
        bytes: document.text.len() as u64,
        words: document.words(),
    });
    summary.serialize(to)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use domain::Demonstrations;

    use super::*;
    use crate::ModelRecipe;
    use crate::file::tests::provenance;
    use crate::sources::tests::sources;

    const FRAME: u32 = 448;
    const SMALL: u32 = 224;

    struct Bench {
        folder: tempfile::TempDir,
        /// By frame size.
        sources: BTreeMap<u32, Sources>,
    }

    impl Bench {
        fn new() -> Self {
            let sources = [FRAME, SMALL].map(|size| (size, sources(size)));
            Self { folder: tempfile::tempdir().unwrap(), sources: sources.into() }
        }

        fn folder(&self) -> DocumentFolder {
            DocumentFolder::new(self.folder.path())
        }

        /// Builds `summary/4` by a recipe for frames of one size.
        fn build(&self, recipe: &Recipe, frame: u32, text: &str) -> PathBuf {
            let made = Provenance {
                builder: recipe.builder().to_owned(),
                builder_version: recipe.version(),
                sources_sha256: self.sources[&frame].sha256(Demonstrations::ALL),
                ..provenance()
            };
            let path = self.folder().file(made.name(), &made.address());
            DocumentFile::new(made, text.to_owned()).save(&path).unwrap();
            path
        }

        fn find(&self, selection: &DocumentSelection, frame: u32) -> StoredDocument {
            self.folder().find(provenance().name(), selection, &self.sources[&frame]).unwrap()
        }
    }

    fn model(name: &str) -> Recipe {
        Recipe::Model(ModelRecipe::new(name))
    }

    #[test]
    fn building_by_another_model_or_frame_size_keeps_every_document() {
        let bench = Bench::new();
        bench.build(&model("A"), FRAME, "by A");
        bench.build(&model("B"), FRAME, "by B");
        bench.build(&model("A"), SMALL, "by A, small");
        bench.build(&Recipe::Extractive, FRAME, "extractive");
        bench.build(&Recipe::Extractive, SMALL, "extractive, small");
        for (recipe, frame, expected) in [
            (model("A"), FRAME, "by A"),
            (model("B"), FRAME, "by B"),
            (model("A"), SMALL, "by A, small"),
            (Recipe::Extractive, FRAME, "extractive"),
            (Recipe::Extractive, SMALL, "extractive, small"),
        ] {
            let found = bench.find(&DocumentSelection::Recipe(recipe), frame);
            assert_eq!(found.state, DocumentState::Current);
            let document = found.document.unwrap();
            assert_eq!(document.text, expected);
            let author = expected.strip_prefix("by ").and_then(|by| by.get(..1));
            assert_eq!(document.provenance.model().as_deref(), author);
        }
        let listed = bench.folder().list(&bench.sources[&FRAME]).unwrap();
        let outdated = listed.iter().filter(|stored| stored.state == DocumentState::Outdated);
        assert_eq!((listed.len(), outdated.count()), (5, 2));
    }

    #[test]
    fn documents_by_two_models_are_distinguished_by_the_model() {
        let bench = Bench::new();
        let any = DocumentSelection::Model(None);
        assert_eq!(bench.find(&any, FRAME).state, DocumentState::Missing);
        bench.build(&Recipe::Extractive, FRAME, "extractive");
        assert_eq!(bench.find(&any, FRAME).state, DocumentState::Missing);
        bench.build(&model("A"), FRAME, "by A");
        assert_eq!(bench.find(&any, FRAME).document.unwrap().text, "by A");
        bench.build(&model("B"), FRAME, "by B");
        let both = bench.find(&any, FRAME);
        let problem = both.problem.unwrap();
        assert!(both.state == DocumentState::Broken && problem.contains("model:NAME"), "{problem}");
        assert!(problem.contains("model A,") && problem.contains("model B,"), "{problem}");
        let named = DocumentSelection::Model(Some("B".into()));
        assert_eq!(bench.find(&named, FRAME).document.unwrap().text, "by B");
    }

    #[test]
    fn a_document_is_missing_outdated_or_broken() {
        let bench = Bench::new();
        let selection = DocumentSelection::Recipe(Recipe::Extractive);
        assert_eq!(bench.find(&selection, FRAME).state, DocumentState::Missing);
        let path = bench.build(&Recipe::Extractive, SMALL, "small");
        assert_eq!(bench.find(&selection, FRAME).state, DocumentState::Missing);
        assert_eq!(bench.find(&DocumentSelection::Any, FRAME).state, DocumentState::Outdated);
        fs::write(bench.folder.path().join("notes.json"), "mine").unwrap();
        fs::write(path, "{").unwrap();
        let found = bench.find(&DocumentSelection::Any, FRAME);
        assert_eq!(found.state, DocumentState::Broken);
        assert!(found.problem.unwrap().contains("summary-4-"));
    }

    #[test]
    fn a_run_has_one_copy_of_each_name() {
        let bench = Bench::new();
        let name = provenance().name();
        let path = bench.build(&model("A"), FRAME, "by A");
        assert!(bench.folder().load_run_copy(name).is_err());
        fs::copy(path, bench.folder().run_copy(name)).unwrap();
        assert_eq!(bench.folder().load_run_copy(name).unwrap().text, "by A");
        // The copy and the original are the same document.
        assert_eq!(bench.find(&DocumentSelection::Any, FRAME).state, DocumentState::Current);
        let other = DocumentName { demonstrations: Demonstrations::ORIGINAL, ..name };
        fs::rename(bench.folder().run_copy(name), bench.folder().run_copy(other)).unwrap();
        let error = bench.folder().load_run_copy(other).unwrap_err().to_string();
        assert!(error.contains("it is document summary/4"), "{error}");
    }
}
