//! Which documents a folder holds, and whether they are still what would be built: as JSON, for the
//! orchestrator.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use domain::DocumentKind;
use serde::Serialize;
use shm_types::FrameSize;
use warehouse::Demonstrations;

use super::build::Wanted;
use super::file::{DocumentError, DocumentFile, Provenance};
use super::sources::Sources;

/// What is asked.
#[derive(Debug, Clone)]
pub struct Question {
    /// The folder of documents.
    pub folder: PathBuf,
    /// Which ones; `None`: all that are there.
    pub wanted: Option<Vec<Wanted>>,
    /// Size of the frames that they should be made of.
    pub frame: FrameSize,
    /// Name and version of the builder that they should be by; `None`: any.
    pub builder: Option<(String, String)>,
    /// Whether the texts are part of the answer.
    pub with_text: bool,
}

/// The answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Holdings {
    /// The folder.
    pub folder: PathBuf,
    /// Its documents, as asked.
    pub documents: Vec<Holding>,
}

/// One document.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Holding {
    /// Its kind.
    pub kind: DocumentKind,
    /// Its demonstrations.
    pub demonstrations: Demonstrations,
    /// Where it is, or would be.
    pub file: PathBuf,
    /// Whether it can be used.
    pub state: State,
    /// What is wrong with it, when it cannot be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
    /// Where it comes from, when it could be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub provenance: Option<Provenance>,
    /// Bytes of its text.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// Words of its text.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub words: Option<u64>,
    /// Its text.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
}

/// Whether a document can be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// It is what would be built.
    Current,
    /// There is none.
    Missing,
    /// It is made of other demonstrations or frames, or by another builder.
    Outdated,
    /// Its file is not what it should be.
    Broken,
}

impl Question {
    /// Looks into the folder.
    ///
    /// # Errors
    /// When the folder cannot be read. A document that cannot is part of the answer.
    pub fn answer(&self, sources: &Sources) -> Result<Holdings> {
        let wanted = match &self.wanted {
            Some(wanted) => wanted.clone(),
            None => documents_in(&self.folder)
                .with_context(|| format!("cannot list {}", self.folder.display()))?,
        };
        let documents = wanted.into_iter().map(|wanted| self.look(wanted, sources)).collect();
        Ok(Holdings { folder: self.folder.clone(), documents })
    }

    fn look(&self, (kind, demonstrations): Wanted, sources: &Sources) -> Holding {
        let mut holding = Holding {
            kind,
            demonstrations,
            file: self.folder.join(DocumentFile::name(kind, demonstrations)),
            state: State::Current,
            problem: None,
            provenance: None,
            bytes: None,
            words: None,
            text: None,
        };
        let document = match DocumentFile::load(&self.folder, kind, demonstrations) {
            Ok(document) => document,
            Err(error) => {
                let is_missing = matches!(error, DocumentError::Missing { .. });
                holding.state = if is_missing { State::Missing } else { State::Broken };
                holding.problem = Some(error.to_string());
                return holding;
            }
        };
        if let Some(problem) = self.outdated(&document.provenance, sources) {
            holding.state = State::Outdated;
            holding.problem = Some(problem);
        }
        let DocumentFile { provenance, text, .. } = document;
        holding.provenance = Some(provenance);
        holding.bytes = Some(text.len() as u64);
        holding.words = Some(text.split_whitespace().count() as u64);
        holding.text = self.with_text.then_some(text);
        holding
    }

    /// Why a document is not what would be built now, if it is not.
    fn outdated(&self, made: &Provenance, sources: &Sources) -> Option<String> {
        if made.sources_sha256 != sources.sha256(made.demonstrations, self.frame) {
            return Some(format!(
                "made of other demonstrations, another layout or catalogue, frames that are not {} x {}, or \
                 by another version of this program",
                self.frame.width, self.frame.height
            ));
        }
        let (name, version) = self.builder.as_ref()?;
        let is_by = (&made.builder, &made.builder_version) == (name, version);
        let by = || format!("{} {}", made.builder, made.builder_version);
        (!is_by).then(|| format!("by {} and not by {name} {version}", by()))
    }
}

/// The documents whose files lie in `folder`, by kind; none when there is no such folder.
fn documents_in(folder: &Path) -> io::Result<Vec<Wanted>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let name = entry?.file_name();
        found.extend(name.to_str().and_then(document_called));
    }
    found.sort_unstable();
    Ok(found)
}

fn document_called(name: &str) -> Option<Wanted> {
    let (kind, demonstrations) = name.strip_suffix(".json")?.split_once('-')?;
    let kind = DocumentKind::TEXTS.into_iter().find(|text| text.word() == kind)?;
    Some((kind, demonstrations.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::super::Account;
    use super::*;

    const KIND: DocumentKind = DocumentKind::Semantic;
    const ALL: Demonstrations = Demonstrations::ALL;

    #[test]
    fn a_document_is_current_outdated_broken_or_missing() {
        let folder = tempfile::tempdir().unwrap();
        let sources = Sources::load(None).unwrap();
        let question = Question {
            folder: folder.path().to_owned(),
            wanted: None,
            frame: FrameSize::DEFAULT,
            builder: None,
            with_text: false,
        };
        let ask = |question: &Question| question.answer(&sources).unwrap().documents;
        assert_eq!(ask(&question), []);
        let asked = Question { wanted: Some(vec![(KIND, ALL)]), ..question.clone() };
        assert_eq!(ask(&asked)[0].state, State::Missing);

        let provenance = Provenance {
            kind: KIND,
            demonstrations: ALL,
            builder: "extractive".to_owned(),
            builder_version: "1".to_owned(),
            inputs_sha256: "00".to_owned(),
            sources_sha256: sources.sha256(ALL, FrameSize::DEFAULT),
            text_sha256: String::new(),
            trajectories: 400,
            views: 900,
            account: Account::default(),
        };
        let document = DocumentFile::new(provenance, "# What is known\nlittle".to_owned());
        let path = document.save(folder.path()).unwrap();
        fs::write(folder.path().join("notes.json"), "mine").unwrap();
        let found = ask(&question);
        assert_eq!((found.len(), found[0].state, found[0].words), (1, State::Current, Some(5)));
        assert_eq!((found[0].text.as_ref(), found[0].bytes), (None, Some(22)));
        let told = ask(&Question { with_text: true, ..question.clone() });
        assert_eq!(told[0].text.as_deref(), Some("# What is known\nlittle"));

        let small = FrameSize { width: 64, height: 64 };
        let by = |version: &str| Some(("extractive".to_owned(), version.to_owned()));
        for (question, state) in [
            (Question { frame: small, ..question.clone() }, State::Outdated),
            (Question { builder: by("1"), ..question.clone() }, State::Current),
            (Question { builder: by("2"), ..question.clone() }, State::Outdated),
        ] {
            let found = ask(&question);
            assert_eq!(found[0].state, state, "{:?}", found[0].problem);
        }
        fs::write(path, "{").unwrap();
        let found = ask(&question);
        assert_eq!(found[0].state, State::Broken);
        assert!(found[0].problem.as_ref().unwrap().contains("semantic-4.json"));
    }
}
