//! The files of the case book.

use std::collections::HashSet;
use std::io;
use std::path::{Path, PathBuf};

use domain::limits::MAX_INSTRUCTION;
use domain::{ActionCode, Mismatch, State};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::case_variant::MAX_VARIANTS;
use crate::{CaseBook, CaseFacts, DemonstrationBook, HARNESS_FAILURES, WorldFacts};

/// The file of the [`CaseBook`] in a run folder.
pub const CASE_BOOK_FILE: &str = "case-book.json";

/// The file of the [`DemonstrationBook`] in a run folder.
pub const DEMONSTRATIONS_FILE: &str = "demonstrations.json";

/// The file of the [`WorldDeclaration`](crate::WorldDeclaration) in the folder to which the processes of a run attach.
pub const WORLD_FILE: &str = "world.json";

/// A book with its text and what identifies it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BookFile<T> {
    /// The book.
    pub book: T,
    /// Its text, one line of JSON.
    pub text: String,
    /// BLAKE3 of the text, in hexadecimal digits.
    pub hash: String,
}

/// Why a book cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BookError {
    /// Its file cannot be read.
    #[error("cannot read {}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// Its text is not a case book.
    #[error("{origin} is not part of a case book: {problem}")]
    Invalid {
        /// The file.
        origin: String,
        /// What is wrong with it.
        problem: String,
    },
}

impl WorldFacts {
    /// What is wrong with its words.
    fn problem(&self) -> Option<String> {
        let Self { groups, tasks, failures, .. } = self;
        let mut names = HashSet::new();
        if let Some(kind) = failures.iter().find(|kind| !names.insert(&kind.name)) {
            return Some(format!("it has the kind of failure {} twice", kind.name));
        }
        let lacks = |(name, _): &&(&str, &str)| self.failure_index(name).is_none();
        if let Some((name, _)) = HARNESS_FAILURES.iter().find(lacks) {
            return Some(format!("it lacks the kind of failure {name}"));
        }
        let homeless =
            tasks.iter().find(|task| !groups.iter().any(|group| group.name == task.group));
        homeless.map(|task| format!("task {} is in no group", task.number))
    }
}

/// What the parts of a book have to fulfil.
pub(crate) trait Check {
    fn problem(&self) -> Option<String>;
}

impl Check for CaseBook {
    fn problem(&self) -> Option<String> {
        if let Some(problem) = self.world.declaration.problem() {
            return Some(problem);
        }
        let mut ids = HashSet::new();
        if let Some(case) = self.cases.iter().find(|case| !ids.insert(&case.id)) {
            return Some(format!("it has case {} twice", case.id));
        }
        for case in &self.cases {
            let texts = [Some(&case.instruction), case.paraphrase.as_ref()].into_iter().flatten();
            if let Some(bytes) = texts.map(String::len).find(|bytes| *bytes > MAX_INSTRUCTION) {
                return Some(format!(
                    "the instruction of case {} has {bytes} bytes, and at most {MAX_INSTRUCTION} fit",
                    case.id,
                ));
            }
        }
        let has_paraphrases = self.world.mismatches.contains(&Mismatch::Wording);
        let lacks = |case: &&CaseFacts| has_paraphrases && case.paraphrase.is_none();
        if let Some(case) = self.cases.iter().find(lacks) {
            return Some(format!(
                "it offers the mismatch wording, and case {} has no paraphrase",
                case.id
            ));
        }
        if let Some(problem) = self.world.problem() {
            return Some(problem);
        }
        let references = self.cases.iter().flat_map(|case| &case.references);
        let references = references.map(|of| (of.begin, &of.actions));
        let in_states = self.streams.iter().flat_map(|streams| &streams.states);
        let in_states = in_states.flat_map(|cases| cases.values());
        let in_states = in_states.map(|case| (case.begin, &case.actions));
        let problem = |(begin, actions): (State, &Vec<ActionCode>)| {
            self.world.declaration.trajectory_problem(&[begin], actions, &[])
        };
        if let Some(problem) = references.chain(in_states).find_map(problem) {
            return Some(format!("the expert's trajectory of a case: {problem}"));
        }
        let count = self.cases.len() as u32;
        let streams = self.streams.iter().flat_map(|streams| &streams.streams);
        let blocks = streams.flat_map(|stream| &stream.blocks);
        let states = self.streams.as_ref().map_or(0, |streams| streams.states.len()) as u32;
        if self.cases.len() + states as usize >= MAX_VARIANTS {
            return Some(format!("cases and world states are {MAX_VARIANTS} or more"));
        }
        for block in blocks {
            if block.world >= states || block.cases.iter().any(|case| *case >= count) {
                return Some(
                    "a block names a case or a world state that it does not have".to_owned(),
                );
            }
        }
        None
    }
}

impl Check for DemonstrationBook {
    fn problem(&self) -> Option<String> {
        if let Some(problem) = self.world.problem() {
            return Some(problem);
        }
        let count = self.demonstrations.len() as u32;
        let named = self.cases.iter().flat_map(|case| {
            let lists = [&case.own, &case.irrelevant, &case.confusable];
            let single = [case.after, case.elsewhere, case.new, case.blocked];
            let single = single.into_iter().flatten();
            lists.into_iter().flatten().copied().chain(single)
        });
        let planned = self.streams.iter().flat_map(|stream| stream.planned.iter().flatten());
        let mut named = named.chain(planned.copied()).chain(self.bank_order.iter().copied());
        if named.any(|index| index >= count) {
            return Some(format!("a set names a demonstration that is not among {count}"));
        }
        let cases = self.cases.len() as u32;
        if self.demonstrations.iter().any(|of| of.case >= cases) {
            return Some(format!("a demonstration is of a case that is not among {cases}"));
        }
        self.demonstrations.iter().find_map(|of| {
            let foreign = || self.world.trajectory_problem(&of.states, &of.actions, &of.feedback);
            of.problem().or_else(|| foreign().map(|problem| format!("a demonstration: {problem}")))
        })
    }
}

impl<T: Serialize> BookFile<T> {
    /// The file of `book`.
    ///
    /// # Errors
    /// When it cannot be written as JSON.
    pub fn new(book: T) -> Result<Self, serde_json::Error> {
        let mut text = serde_json::to_string(&book)?;
        text.push('\n');
        let hash = blake3::hash(text.as_bytes()).to_hex().to_string();
        Ok(Self { book, text, hash })
    }
}

#[expect(private_bounds, reason = "these files are all that there is")]
impl<T: DeserializeOwned + Check> BookFile<T> {
    /// Reads the file at `path`.
    ///
    /// # Errors
    /// When it cannot be read, or is not such a book.
    pub fn read(path: &Path) -> Result<Self, BookError> {
        let text = durable::input::read_text(path)
            .map_err(|source| BookError::Unreadable { path: path.to_owned(), source })?;
        Self::parse(text, &path.display().to_string())
    }

    /// Reads `text`, which comes from `origin`.
    ///
    /// # Errors
    /// When it is not such a book.
    pub fn parse(text: String, origin: &str) -> Result<Self, BookError> {
        let invalid = |problem: String| BookError::Invalid { origin: origin.to_owned(), problem };
        let book: T = serde_json::from_str(&text).map_err(|error| invalid(error.to_string()))?;
        if let Some(problem) = book.problem() {
            return Err(invalid(problem));
        }
        let hash = blake3::hash(text.as_bytes()).to_hex().to_string();
        Ok(Self { book, text, hash })
    }
}
