//! The documents of summary, semantic and hybrid memory: which there are, and having them built before a run.
//!
//! What a document is and whether it is out of date the memory process knows; here it is asked
//! (`memory-proc documents`) and, where something is missing, started together with the simulator to build it
//! (`memory-proc build`). One build at a time goes on in a folder.

mod building;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fmt;
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use domain::DocumentKind;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use warehouse::Demonstrations;

use results::conditions::Condition;
use results::log::DocumentFacts;
use results::names::UnknownName;
use supervise::sibling;

/// Held while documents are built in a folder.
const LOCK_FILE: &str = "lock";

/// How often a folder is tried that somebody else builds in.
const LOCK_INTERVAL: Duration = Duration::from_millis(200);

/// Names a document: its kind, and the demonstrations of every case that it is made of. Written `summary/4`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct DocumentName {
    /// What it tells.
    pub kind: DocumentKind,
    /// Of what.
    pub demonstrations: Demonstrations,
}

impl fmt::Display for DocumentName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.kind.word(), self.demonstrations)
    }
}

/// The kind of document that a word names.
///
/// # Errors
/// When it names none.
pub fn kind(word: &str) -> Result<DocumentKind, UnknownName> {
    let words = DocumentKind::TEXTS.map(DocumentKind::word);
    let found = DocumentKind::TEXTS.into_iter().find(|kind| kind.word() == word);
    found.ok_or_else(|| UnknownName::new("kind of document", word, words))
}

/// The documents that `conditions` supply, each once.
pub fn needed<'a>(conditions: impl IntoIterator<Item = &'a Condition>) -> Vec<DocumentName> {
    let mut names: Vec<DocumentName> = conditions
        .into_iter()
        .flat_map(|&Condition { memory, demonstrations, .. }| {
            let kinds = memory.describe().documents.iter();
            kinds.map(move |&kind| DocumentName { kind, demonstrations })
        })
        .collect();
    names.sort_unstable();
    names.dedup();
    names
}

/// Who builds documents.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Builder {
    /// The deterministic one, which needs no model.
    Extractive,
    /// A model behind a chat endpoint.
    Model(Model),
    /// Somebody did: documents are taken as they are, whoever built them.
    Anyone {
        /// The builder in whose folder they lie, unless a folder is given.
        of: &'static str,
    },
}

/// Which model, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Model {
    /// As the server calls it.
    pub name: String,
    /// Where the server is; `None`: where the environment says.
    pub base_url: Option<String>,
    /// How it is asked: flags of `memory-proc build` with their values.
    pub flags: Vec<(&'static str, String)>,
}

impl Builder {
    fn arguments(&self) -> Vec<OsString> {
        let mut arguments: Vec<OsString> = vec!["--builder".into()];
        match self {
            Self::Extractive => arguments.push("extractive".into()),
            Self::Anyone { of } => arguments.push(of.into()),
            Self::Model(Model { name, base_url, flags }) => {
                arguments.extend(["model".into(), "--model".into(), name.into()]);
                let url = base_url.iter().map(|url| ("--base-url", url));
                let flags = flags.iter().map(|(flag, value)| (*flag, value)).chain(url);
                arguments.extend(flags.flat_map(|(flag, value)| [flag.into(), value.into()]));
            }
        }
        arguments
    }
}

/// Documents in one folder, made for one world.
#[derive(Debug, Clone)]
pub struct Library {
    /// Where they lie; `None`: where the memory process keeps those of the builder.
    pub folder: Option<PathBuf>,
    /// Folder of layout, catalogue and cases; `None`: those that are built in.
    pub assets: Option<PathBuf>,
    /// Width and height of the frames that they are made of.
    pub frame_size: u32,
    /// Who builds them.
    pub builder: Builder,
}

/// What a folder holds, as the memory process says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holdings {
    /// The folder.
    pub folder: PathBuf,
    /// Its documents.
    pub documents: Vec<Holding>,
}

/// One document.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holding {
    /// Its name.
    #[serde(flatten)]
    pub name: DocumentName,
    /// Where it is, or would be.
    pub file: PathBuf,
    /// Whether it can be used.
    pub state: State,
    /// Why not, when it cannot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
    /// Where it comes from, when it could be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub provenance: Option<BTreeMap<String, Value>>,
    /// Bytes of its text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// Words of its text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub words: Option<u64>,
    /// Its text, when asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
}

/// Whether a document can be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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

impl State {
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

impl Holding {
    /// What a manifest says of it; `None` when it could not be read.
    pub fn facts(&self) -> Option<DocumentFacts> {
        Some(DocumentFacts {
            sha256: self.said("text_sha256")?,
            builder: self.said("builder")?,
            bytes: self.bytes?,
            words: self.words?,
        })
    }

    /// A word of its provenance.
    pub fn said(&self, key: &str) -> Option<String> {
        Some(self.provenance.as_ref()?.get(key)?.as_str()?.to_owned())
    }
}

/// Documents that are there. Nobody builds others in their folder as long as this is held.
#[derive(Debug)]
pub struct Supply {
    /// Their folder.
    pub folder: PathBuf,
    /// What each is.
    pub documents: Vec<Holding>,
    /// Those of them that were built just now.
    pub built: Vec<DocumentName>,
    /// Held while somebody could build in the folder.
    _lock: Option<File>,
}

/// How far building is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Somebody else builds in the folder.
    Waiting,
    /// The processes are being started.
    Starting,
    /// Views of demonstrations are rendered and read: done, of all.
    Views(u64, u64),
    /// The documents are written: parts done, of all of the document at hand.
    Writing(u64, u64),
}

impl Library {
    /// What is there of `wanted`, or all there is; with the texts if `text`.
    ///
    /// # Errors
    /// When the memory process cannot be asked.
    pub fn ask(&self, wanted: Option<&[DocumentName]>, text: bool) -> Result<Holdings> {
        let program = sibling("memory-proc")?;
        let mut command = Command::new(&program);
        command.arg("documents").args(self.builder.arguments());
        command.arg("--frame-size").arg(self.frame_size.to_string());
        if let Builder::Anyone { .. } = self.builder {
            command.arg("--by-anyone");
        }
        if let Some(folder) = &self.folder {
            command.arg("--documents").arg(folder);
        }
        if let Some(assets) = &self.assets {
            command.arg("--assets").arg(assets);
        }
        if let Some(wanted) = wanted {
            command.arg("--wanted").arg(listed(wanted));
        }
        if text {
            command.arg("--text");
        }
        let output = command.output();
        let output = output.with_context(|| format!("cannot start {}", program.display()))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            bail!("{}", said.trim().trim_start_matches("memory-proc: "));
        }
        serde_json::from_slice(&output.stdout)
            .with_context(|| format!("{} said nothing that can be used", program.display()))
    }

    /// Has those of `wanted` built that are missing or out of date, and all of them if `force`. `None` when
    /// asked to stop meanwhile.
    ///
    /// # Errors
    /// When a document is broken, or missing and nobody is named who could build it; when building fails.
    pub fn ensure(
        &self,
        wanted: &[DocumentName],
        force: bool,
        stop: &AtomicBool,
        tell: &mut dyn FnMut(Stage),
    ) -> Result<Option<Supply>> {
        let folder = self.ask(Some(wanted), false)?.folder;
        let Some(lock) = lock(&folder, stop, tell)? else { return Ok(None) };
        let holdings = self.ask(Some(wanted), false)?;
        let missing: Vec<&Holding> =
            holdings.documents.iter().filter(|d| force || d.state != State::Current).collect();
        for document in &missing {
            let problem = || document.problem.clone().unwrap_or_default();
            match (document.state, &self.builder) {
                (State::Broken, _) if !force => bail!("{}", problem()),
                (_, Builder::Anyone { of }) => {
                    let DocumentName { kind, demonstrations } = document.name;
                    let why = match document.state {
                        State::Missing => String::new(),
                        _ => format!(" ({})", problem()),
                    };
                    let out = self.folder.iter().map(|dir| format!(" --out {}", dir.display()));
                    bail!(
                        "document {} is {} in {} and is not built in passing{why}. To build it:\n  \
                         memtransfer memory build --builder {of} --kind {} --demos {demonstrations}{}",
                        document.name,
                        document.state.word(),
                        folder.display(),
                        kind.word(),
                        out.collect::<String>(),
                    )
                }
                _ => {}
            }
        }
        let missing: Vec<DocumentName> = missing.iter().map(|document| document.name).collect();
        if missing.is_empty() {
            let documents = holdings.documents;
            return Ok(Some(Supply { folder, documents, built: missing, _lock: Some(lock) }));
        }
        if !building::build(self, &folder, &missing, stop, tell)? {
            return Ok(None);
        }
        let documents = self.ask(Some(wanted), false)?.documents;
        if let Some(bad) = documents.iter().find(|document| document.state != State::Current) {
            let problem = bad.problem.clone().unwrap_or_default();
            bail!("document {} was built and is {}: {problem}", bad.name, bad.state.word());
        }
        Ok(Some(Supply { folder, documents, built: missing, _lock: Some(lock) }))
    }
}

impl Supply {
    /// No documents.
    pub fn nothing() -> Self {
        Self { folder: PathBuf::new(), documents: Vec::new(), built: Vec::new(), _lock: None }
    }

    /// Documents that lie where nobody builds.
    pub fn kept(holdings: Holdings) -> Self {
        let Holdings { folder, documents } = holdings;
        Self { folder, documents, built: Vec::new(), _lock: None }
    }

    /// What a manifest says of them, by name.
    pub fn facts(&self) -> BTreeMap<String, DocumentFacts> {
        let facts = |document: &Holding| Some((document.name.to_string(), document.facts()?));
        self.documents.iter().filter_map(facts).collect()
    }

    /// Puts a copy of each into `folder`, unless they lie there: what was supplied stays with the run.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn copy_to(&self, folder: &Path) -> Result<()> {
        if self.folder == folder || self.documents.is_empty() {
            return Ok(());
        }
        let cannot = |path: &Path| format!("cannot write {}", path.display());
        fs::create_dir_all(folder).with_context(|| cannot(folder))?;
        for document in &self.documents {
            let Some(name) = document.file.file_name() else { continue };
            let (path, draft) = (folder.join(name), folder.join("draft.new"));
            fs::copy(&document.file, &draft)
                .and_then(|_| fs::rename(&draft, &path))
                .with_context(|| cannot(&path))?;
        }
        Ok(())
    }
}

/// Names as the memory process reads them.
fn listed(names: &[DocumentName]) -> String {
    names.iter().map(DocumentName::to_string).collect::<Vec<_>>().join(",")
}

/// Locks `folder`, which is made if it is missing, against other builds. `None` when asked to stop meanwhile.
fn lock(folder: &Path, stop: &AtomicBool, tell: &mut dyn FnMut(Stage)) -> Result<Option<File>> {
    let path = folder.join(LOCK_FILE);
    let cannot = || format!("cannot lock {}", path.display());
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let file = File::options().create(true).append(true).open(&path).with_context(cannot)?;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(Some(file)),
            Err(TryLockError::Error(error)) => return Err(error).with_context(cannot),
            Err(TryLockError::WouldBlock) if stop.load(Ordering::Relaxed) => return Ok(None),
            Err(TryLockError::WouldBlock) => {
                tell(Stage::Waiting);
                std::thread::sleep(LOCK_INTERVAL);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use domain::Representation;

    use super::*;
    use results::conditions::{Route, Start, Variation};

    #[test]
    fn each_condition_s_documents_are_needed_once() {
        let demonstrations = [Demonstrations::NONE, Demonstrations::ORIGINAL, Demonstrations::ALL];
        let needed_by = |memory: &[Representation]| {
            let conditions: Vec<Condition> = memory
                .iter()
                .flat_map(|&memory| demonstrations.map(|set| (memory, set)))
                .filter_map(|(memory, set)| {
                    Condition::new(memory, Start::New, Route::Unchanged, set, Variation::STANDARD)
                })
                .collect();
            needed(&conditions).iter().map(DocumentName::to_string).collect::<Vec<_>>()
        };
        use Representation::{Episodic, FullContext, Hybrid, Semantic, Summary, Working};
        assert_eq!(needed_by(&[Working, FullContext, Episodic]), Vec::<String>::new());
        assert_eq!(needed_by(&[Semantic]), ["semantic/original", "semantic/4"]);
        let all = ["summary/original", "summary/4", "semantic/original", "semantic/4"];
        assert_eq!(needed_by(&[Hybrid]), all);
        assert_eq!(needed_by(&[Summary, Hybrid, Semantic]), all);
    }

    #[test]
    fn what_the_memory_process_says_is_understood() {
        let json = r#"{
            "folder": "/d",
            "documents": [
                {"kind": "summary", "demonstrations": "4", "file": "/d/summary-4.json", "state": "missing",
                 "problem": "there is none"},
                {"kind": "semantic", "demonstrations": "original", "file": "/d/semantic-original.json",
                 "state": "current", "provenance": {"builder": "extractive", "text_sha256": "ab", "views": 9},
                 "bytes": 20, "words": 4}
            ]
        }"#;
        let holdings: Holdings = serde_json::from_str(json).unwrap();
        assert_eq!(holdings.documents[0].state, State::Missing);
        let facts = Supply::kept(holdings).facts();
        let expected = DocumentFacts {
            sha256: "ab".to_owned(),
            builder: "extractive".to_owned(),
            bytes: 20,
            words: 4,
        };
        assert_eq!(facts, BTreeMap::from([("semantic/original".to_owned(), expected)]));
    }

    #[test]
    fn a_folder_is_built_in_by_one_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let stop = AtomicBool::new(false);
        let mut stages = Vec::new();
        let first = lock(folder.path(), &stop, &mut |stage| stages.push(stage)).unwrap();
        assert!(first.is_some() && stages.is_empty());
        // The second one is asked to stop as soon as it waits.
        let mut said = |stage| {
            stop.store(true, Ordering::Relaxed);
            stages.push(stage);
        };
        assert!(lock(folder.path(), &stop, &mut said).unwrap().is_none());
        assert_eq!(stages, [Stage::Waiting]);
        drop(first);
        assert!(lock(folder.path(), &stop, &mut |_| ()).unwrap().is_some());
    }
}
