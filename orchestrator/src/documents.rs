//! The documents that a run needs, and building missing ones before it begins.
//!
//! The crate `documents` knows what a document is, where it lies and whether it fits. Here missing documents are built by
//! a memory process (`building`). One build at a time runs in a folder; others wait for it.

mod building;

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use case_book::CaseBook;
use conditions::Condition;
use conditions::settings::RunSettings;
use documents::{
    BuildAccount, DocumentFolder, DocumentName, DocumentSelection, DocumentState, Recipe, Sources,
    StoredDocument,
};
use domain::{SecretHeader, cache_folder};
use run_log::{DocumentFacts, DocumentUsage};
use shm_types::FrameSize;

/// Locked while documents are built in a folder.
const LOCK_FILE: &str = "lock";

/// How often a lock is tried that another process holds.
const LOCK_INTERVAL: Duration = Duration::from_millis(200);

/// The documents that `conditions` of a run with `settings` supply, each once.
pub fn needed<'a>(
    settings: &RunSettings,
    conditions: impl IntoIterator<Item = &'a Condition>,
) -> Vec<DocumentName> {
    let mut names: Vec<DocumentName> = conditions
        .into_iter()
        .flat_map(|condition| {
            let demonstrations = settings.demonstrations_of(condition);
            let kinds = condition.memory.describe().map_or(&[][..], |info| info.documents).iter();
            kinds.map(move |&kind| DocumentName { kind, demonstrations })
        })
        .collect();
    names.sort_unstable();
    names.dedup();
    names
}

/// Where documents come from, and for which world.
#[derive(Debug, Clone)]
pub struct DocumentRequest {
    /// Their folder; `None`: `documents` in the cache folder.
    pub folder: Option<PathBuf>,
    /// The demonstrations that they are made from, and how the world looks.
    pub sources: Sources,
    /// Folder of the world's assets; `None`: the built-in ones.
    pub assets: Option<PathBuf>,
    /// The world's file of the other world in which tasks are demonstrated, if there is one.
    pub elsewhere: Option<String>,
    /// The world that takes the place of the warehouse, if one does.
    pub own_world: Option<OwnWorld>,
    /// Which documents are acceptable. Missing ones are built if this is a recipe.
    pub selection: DocumentSelection,
    /// How a model is asked.
    pub server: ModelServer,
}

/// How the views of a world other than the warehouse are drawn.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OwnWorld {
    /// The command that starts it; `None` if the user starts it, so that no views can be drawn before the run.
    pub command: Option<String>,
    /// The ids of its cases, in the order of the case book.
    pub case_ids: Vec<String>,
}

impl OwnWorld {
    /// The world that `command` starts, with the cases of `book`.
    pub fn of(command: Option<String>, book: &CaseBook) -> Self {
        Self { command, case_ids: book.ids().into_iter().map(str::to_owned).collect() }
    }
}

/// How a model is asked for documents. None of it changes the prompts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ModelServer {
    /// Its address; `None`: the one in the environment.
    pub base_url: Option<String>,
    /// Where the address was given, on which the key depends: a word of `memory-proc build --base-url-from`.
    pub base_url_from: Option<&'static str>,
    /// Further headers of the requests, which may go to the address.
    pub headers: Vec<SecretHeader>,
    /// Time limit of an attempt, in seconds.
    pub timeout: Option<u32>,
    /// Number of retries of a request.
    pub max_retries: Option<u32>,
}

/// Documents that are ready. If some of them were built now, no other process builds in their folder while this value exists.
#[derive(Debug)]
pub struct ReadyDocuments {
    /// The documents.
    pub documents: Vec<StoredDocument>,
    /// Those of them that were built now.
    pub built: Vec<DocumentName>,
    _lock: Option<File>,
}

/// Progress of a build.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BuildStage {
    /// Another process builds in the folder.
    Waiting,
    /// The process starts.
    Starting,
    /// A document is written: parts done, of all.
    Writing(u64, u64),
}

/// The folder of documents at `path`; `None`: `documents` in the cache folder.
///
/// # Errors
/// When none is given and the environment names no cache folder.
pub fn document_folder(path: Option<&Path>) -> Result<DocumentFolder> {
    let path =
        path.map_or_else(|| Ok(cache_folder()?.join("documents")), |path| Ok(path.to_owned()));
    path.map(DocumentFolder::new)
}

impl DocumentRequest {
    /// The folder of the documents.
    ///
    /// # Errors
    /// When none is given and the environment names no cache folder.
    pub fn folder(&self) -> Result<DocumentFolder> {
        document_folder(self.folder.as_deref())
    }

    /// The wanted documents, as they are in the folder.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn find(&self, wanted: &[DocumentName]) -> Result<Vec<StoredDocument>> {
        let folder = self.folder()?;
        let find = |&name: &DocumentName| folder.find(name, &self.selection, &self.sources);
        let found: std::io::Result<_> = wanted.iter().map(find).collect();
        found.with_context(|| format!("cannot list {}", folder.path().display()))
    }

    /// Those of the wanted documents that would be built: the ones that are not current, or all if `force`.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn missing(&self, wanted: &[DocumentName], force: bool) -> Result<Vec<DocumentName>> {
        let found = self.find(wanted)?.into_iter();
        let missing = found.filter(|document| force || document.state != DocumentState::Current);
        Ok(missing.map(|document| document.name).collect())
    }

    /// All documents in the folder.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn list(&self) -> Result<Vec<StoredDocument>> {
        let folder = self.folder()?;
        let listed = folder.list(&self.sources);
        listed.with_context(|| format!("cannot list {}", folder.path().display()))
    }

    /// Builds the wanted documents that are missing, or all of them if `force`. `None` when stopped. Where nothing is missing,
    /// nothing is written.
    ///
    /// # Errors
    /// When a document is broken, or missing without a recipe for it; when building fails.
    pub fn ensure(
        &self,
        wanted: &[DocumentName],
        force: bool,
        stop: &AtomicBool,
        report: &mut dyn FnMut(BuildStage),
    ) -> Result<Option<ReadyDocuments>> {
        let folder = self.folder()?;
        let is_missing =
            |document: &&StoredDocument| force || document.state != DocumentState::Current;
        let mut documents = self.find(wanted)?;
        let mut locked = None;
        // What is only read is not locked: this user may not be allowed to write in the folder.
        if matches!(self.selection, DocumentSelection::Recipe(_))
            && documents.iter().any(|document| is_missing(&document))
        {
            locked = lock(folder.path(), stop, report)?;
            if locked.is_none() {
                return Ok(None);
            }
            // Another process may have built them meanwhile.
            documents = self.find(wanted)?;
        }
        let missing: Vec<&StoredDocument> = documents.iter().filter(is_missing).collect();
        let names: Vec<DocumentName> = missing.iter().map(|document| document.name).collect();
        if names.is_empty() {
            return Ok(Some(ReadyDocuments { documents, built: names, _lock: locked }));
        }
        if let Some(broken) =
            missing.iter().find(|document| document.state == DocumentState::Broken && !force)
        {
            bail!("{}", broken.problem.clone().unwrap_or_default());
        }
        let DocumentSelection::Recipe(recipe) = &self.selection else {
            bail!("{}", self.how_to_build(missing[0], &folder));
        };
        if !building::build(self, recipe, &folder, &names, stop, report)? {
            return Ok(None);
        }
        let documents = self.find(wanted)?;
        if let Some(bad) =
            documents.iter().find(|document| document.state != DocumentState::Current)
        {
            let problem = bad.problem.clone().unwrap_or_default();
            bail!("document {} was built and is {}: {problem}", bad.name, bad.state.word());
        }
        Ok(Some(ReadyDocuments { documents, built: names, _lock: locked }))
    }

    /// The message for a document that a run does not build by itself.
    fn how_to_build(&self, document: &StoredDocument, folder: &DocumentFolder) -> String {
        let DocumentName { kind, demonstrations } = document.name;
        let builder = match &self.selection {
            DocumentSelection::Model(model) => {
                format!("model --model {}", model.as_deref().unwrap_or("NAME"))
            }
            DocumentSelection::Any | DocumentSelection::Recipe(_) => "extractive".to_owned(),
        };
        let why = match document.state {
            DocumentState::Missing => String::new(),
            _ => format!(" ({})", document.problem.clone().unwrap_or_default()),
        };
        let out = self.folder.iter().map(|path| ("--out", path.display().to_string()));
        let size = self.sources.frame_size();
        let size = (size != FrameSize::DEFAULT.width).then(|| ("--frame-size", size.to_string()));
        let look = self.sources.appearance().differing_flags();
        let flags = size.into_iter().chain(look).chain(out);
        format!(
            "document {} is {} in {}{why}, and a run builds documents by the script or by its own model only. To build \
             it:\n  \
             memtransfer memory build --builder {builder} --kind {} --demos {demonstrations}{}",
            document.name,
            document.state.word(),
            folder.path().display(),
            kind.word(),
            flags.map(|(flag, value)| format!(" {flag} {value}")).collect::<String>(),
        )
    }

    /// The flags of `memory-proc build` for a recipe.
    fn builder_flags(&self, recipe: &Recipe) -> Vec<(&'static str, Option<String>)> {
        let mut flags = vec![("--builder", Some(recipe.builder().into()))];
        if let Recipe::Model(recipe) = recipe {
            let ModelServer { base_url, base_url_from, timeout, max_retries, .. } = &self.server;
            flags.extend([
                ("--model", Some(recipe.model.clone())),
                ("--context-chars", Some(recipe.context_chars.to_string())),
                ("--max-tokens", Some(recipe.max_tokens.to_string())),
                ("--views", Some(recipe.views.to_string())),
                ("--image-budget", Some(recipe.image_budget.to_string())),
                ("--reasoning", Some(recipe.reasoning.to_string())),
                ("--system-role", Some(recipe.system_role.to_string())),
                ("--extra-body", recipe.extra_body.clone()),
                ("--image-format", Some(recipe.image_format.to_string())),
                ("--base-url", base_url.clone()),
                ("--base-url-from", base_url_from.map(str::to_owned)),
                ("--request-timeout", timeout.map(|seconds| seconds.to_string())),
                ("--max-retries", max_retries.map(|retries| retries.to_string())),
            ]);
        }
        flags
    }
}

impl ReadyDocuments {
    /// Documents in a folder in which no process builds.
    pub fn unlocked(documents: Vec<StoredDocument>) -> Self {
        Self { documents, built: Vec::new(), _lock: None }
    }

    /// Adds `others`, whose folder is not locked any more, so that more can be built in it.
    pub fn add(&mut self, others: Self) {
        self.documents.extend(others.documents);
        self.built.extend(others.built);
    }

    /// Their entries in the manifest, by name.
    pub fn facts(&self) -> BTreeMap<String, DocumentFacts> {
        let mut facts = facts(&self.documents);
        for name in &self.built {
            facts.entry(name.to_string()).and_modify(|document| document.built = true);
        }
        facts
    }

    /// Copies the documents into a run's folder, unless they are there: a run keeps what it supplied.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn copy_to(&self, folder: &Path) -> Result<()> {
        let folder = DocumentFolder::new(folder);
        for stored in &self.documents {
            let Some(document) = &stored.document else { continue };
            let path = folder.run_copy(stored.name);
            if path != stored.file {
                document.save(&path)?;
            }
        }
        Ok(())
    }
}

/// The manifest's entries about documents, by name. Documents that are not readable are left out.
pub fn facts(documents: &[StoredDocument]) -> BTreeMap<String, DocumentFacts> {
    let facts = |stored: &StoredDocument| {
        let document = stored.document.as_ref()?;
        let facts = DocumentFacts {
            sha256: document.provenance.text_sha256.clone(),
            builder: document.provenance.builder.clone(),
            model: document.provenance.model(),
            usage: usage(&document.provenance.account),
            built: false,
            address: stored.address.clone(),
            bytes: document.text.len() as u64,
            words: document.words(),
        };
        Some((stored.name.to_string(), facts))
    };
    documents.iter().filter_map(facts).collect()
}

/// What a document took of a model; `None` for one that no model has written.
fn usage(account: &BuildAccount) -> Option<DocumentUsage> {
    let &BuildAccount { requests, prompt_tokens, completion_tokens, .. } = account;
    Some(DocumentUsage { requests: requests?, prompt_tokens, completion_tokens })
}

/// Locks a folder, which is created if it is missing, against other builds. `None` when stopped.
fn lock(
    folder: &Path,
    stop: &AtomicBool,
    report: &mut dyn FnMut(BuildStage),
) -> Result<Option<File>> {
    let path = folder.join(LOCK_FILE);
    let failed = || format!("cannot lock {}", path.display());
    fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let file = durable::output::open_lock(&path).with_context(failed)?;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(Some(file)),
            Err(TryLockError::Error(error)) => return Err(error).with_context(failed),
            Err(TryLockError::WouldBlock) if stop.load(Ordering::Relaxed) => return Ok(None),
            Err(TryLockError::WouldBlock) => {
                report(BuildStage::Waiting);
                std::thread::sleep(LOCK_INTERVAL);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use case_book::BookRequest;
    use conditions::{Route, Start, Variation};
    use documents::{DocumentFile, Provenance};
    use domain::{Appearance, Demonstrations, Representation};
    use warehouse::case_book::write_books;

    use super::*;

    #[test]
    fn each_condition_s_documents_are_needed_once() {
        let flags = settings::Layer::flags([("policy", "grounded")]).unwrap();
        let settings = settings::resolve([flags]).unwrap().settings;
        let demonstrations = [Demonstrations::NONE, Demonstrations::ORIGINAL, Demonstrations::ALL];
        let needed_by = |memory: &[Representation]| {
            let conditions: Vec<Condition> = memory
                .iter()
                .flat_map(|&memory| demonstrations.map(|set| (memory, set)))
                .filter_map(|(memory, set)| {
                    Condition::new(memory, Start::New, Route::Unchanged, set, Variation::STANDARD)
                })
                .collect();
            needed(&settings, &conditions).iter().map(DocumentName::to_string).collect::<Vec<_>>()
        };
        use Representation::{Episodic, FullContext, Hybrid, Semantic, Summary, Working};
        assert_eq!(needed_by(&[Working, FullContext, Episodic]), Vec::<String>::new());
        assert_eq!(needed_by(&[Semantic]), ["semantic/original", "semantic/4"]);
        let all = ["summary/original", "summary/4", "semantic/original", "semantic/4"];
        assert_eq!(needed_by(&[Hybrid]), all);
        assert_eq!(needed_by(&[Summary, Hybrid, Semantic]), all);
        let of = |condition: &str| {
            let condition = condition.parse().unwrap();
            needed(&settings, [&condition]).iter().map(DocumentName::to_string).collect::<Vec<_>>()
        };
        assert_eq!(of("summary/new/unchanged/original/oracle"), ["summary/new-reference"]);
        assert_eq!(of("summary/new/blocked/original/oracle"), ["summary/blocked-reference"]);
        assert_eq!(of("semantic/new/unchanged/original/wrong"), ["semantic/elsewhere"]);
    }

    /// A request for documents of the shipped warehouse in `folder`.
    fn request(folder: &Path, selection: DocumentSelection) -> DocumentRequest {
        let demonstrations = write_books(&BookRequest::default()).unwrap().demonstrations;
        DocumentRequest {
            folder: Some(folder.to_owned()),
            sources: Sources::new(demonstrations, 448, Appearance::STANDARD),
            assets: None,
            elsewhere: None,
            own_world: None,
            selection,
            server: ModelServer::default(),
        }
    }

    #[test]
    fn a_run_does_not_build_documents_of_another_model_and_says_how() {
        let folder = tempfile::tempdir().unwrap();
        let request = request(folder.path(), DocumentSelection::Model(Some("m".into())));
        let error = |request: &DocumentRequest| {
            let wanted = ["summary/4".parse().unwrap()];
            let ready = request.ensure(&wanted, false, &AtomicBool::new(false), &mut |_| ());
            ready.unwrap_err().to_string()
        };
        let (command, out) = ("--builder model --model m --kind summary --demos 4", folder.path());
        let standard = format!("{command} --out {}", out.display());
        assert!(error(&request).ends_with(&standard), "{}", error(&request));
        // The command builds what the run looks for.
        let book = request.sources.book().clone();
        let sources = Sources::new(book, 224, Appearance::WITH_PLATES);
        let request = DocumentRequest { sources, ..request };
        let other = format!("{command} --frame-size 224 --plates on --out {}", out.display());
        assert!(error(&request).ends_with(&other), "{}", error(&request));
    }

    /// The folder may be one that this user can only read.
    #[test]
    fn where_nothing_is_missing_nothing_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let request = request(folder.path(), DocumentSelection::Recipe(Recipe::Extractive));
        let name: DocumentName = "summary/4".parse().unwrap();
        let provenance = Provenance {
            kind: name.kind,
            demonstrations: name.demonstrations,
            builder: Recipe::Extractive.builder().to_owned(),
            builder_version: Recipe::Extractive.version(),
            sources_sha256: request.sources.sha256(name.demonstrations),
            text_sha256: String::new(),
            trajectories: 1,
            views: 1,
            account: BuildAccount::default(),
        };
        let file = request.folder().unwrap().file(name, &provenance.address());
        DocumentFile::new(provenance, "text".to_owned()).save(&file).unwrap();
        let ready = request.ensure(&[name], false, &AtomicBool::new(false), &mut |_| ());
        assert!(ready.unwrap().unwrap().built.is_empty());
        let there: Vec<_> =
            fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert_eq!(there, [file]);
    }

    #[test]
    fn one_process_at_a_time_builds_in_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let stop = AtomicBool::new(false);
        let mut stages = Vec::new();
        let first = lock(folder.path(), &stop, &mut |stage| stages.push(stage)).unwrap();
        assert!(first.is_some() && stages.is_empty());
        // The second one is stopped as soon as it waits.
        let mut report = |stage| {
            stop.store(true, Ordering::Relaxed);
            stages.push(stage);
        };
        assert!(lock(folder.path(), &stop, &mut report).unwrap().is_none());
        assert_eq!(stages, [BuildStage::Waiting]);
        drop(first);
        // Waits: a process that another test starts has this one's files for a moment, and with them the lock.
        let locked = lock(folder.path(), &AtomicBool::new(false), &mut |_| ()).unwrap();
        assert!(locked.is_some());
        // Documents that were added to others do not keep the next ones from being built.
        let added = ReadyDocuments { _lock: locked, ..ReadyDocuments::unlocked(Vec::new()) };
        let mut ready = ReadyDocuments::unlocked(Vec::new());
        ready.add(added);
        assert!(lock(folder.path(), &AtomicBool::new(false), &mut |_| ()).unwrap().is_some());
        // A pipe in its place is not waited for.
        let path = folder.path().join(LOCK_FILE);
        fs::remove_file(&path).unwrap();
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mkfifoat(rustix::fs::CWD, &path, mode).unwrap();
        let error = format!("{:#}", lock(folder.path(), &stop, &mut |_| ()).unwrap_err());
        assert!(error.contains("cannot lock") && error.contains("a pipe"), "{error}");
    }
}
