//! The documents of a run: which it needs, and building missing ones before it begins.

use std::collections::BTreeMap;

use anyhow::Result;
use conditions::settings::{DocumentSource, RunSettings};
use documents::{
    DocumentFolder, DocumentName, DocumentSelection, DocumentState, Recipe, Sources, StoredDocument,
};
use run_log::{DOCUMENTS_FOLDER, DocumentFacts, RunFolder};

use crate::books::Books;
use crate::documents::{DocumentRequest, ModelServer, OwnWorld, ReadyDocuments, facts, needed};
use crate::invocation::Invocation;
use crate::progress::{BuildProgress, Verbosity, say};

/// The documents that a run needs, and where they come from.
#[derive(Debug)]
pub struct RunDocuments {
    needed: Vec<DocumentName>,
    request: DocumentRequest,
    /// The run's own copies; none before it has episodes.
    own: Option<DocumentFolder>,
}

impl RunDocuments {
    /// The documents of a run with `settings` and `books`, which starts over if `fresh`.
    pub fn of(settings: &RunSettings, books: &Books, fresh: bool) -> Self {
        let (folder, selection) = match &settings.documents {
            DocumentSource::Extractive => (None, DocumentSelection::Recipe(Recipe::Extractive)),
            DocumentSource::Model(name) => (None, DocumentSelection::Model(name.clone())),
            DocumentSource::Folder(path) => (Some(path.clone()), DocumentSelection::Any),
        };
        let request = DocumentRequest {
            folder,
            sources: Sources::new(
                books.demonstrations.book.clone(),
                settings.frame_size,
                settings.appearance(),
            ),
            assets: settings.assets.clone(),
            elsewhere: books.elsewhere.clone(),
            own_world: settings
                .own_world()
                .map(|_| OwnWorld::of(settings.world_cmd.clone(), &books.cases.book)),
            selection,
            server: ModelServer::default(),
        };
        let uses_memory = settings.policy.has_process();
        let own = (!fresh && RunFolder::has_episodes(&settings.out))
            .then(|| DocumentFolder::new(settings.out.join(DOCUMENTS_FOLDER)));
        Self {
            needed: if uses_memory { needed(&settings.conditions()) } else { Vec::new() },
            request,
            own,
        }
    }

    /// Returns the documents: the run's own copies, and the others as requested, built if they are missing. `None` when
    /// asked to stop.
    ///
    /// # Errors
    /// When a document is broken, missing without a recipe for it, or cannot be built.
    pub fn supply(&self, invocation: &Invocation<'_>) -> Result<Option<ReadyDocuments>> {
        let mut documents = self.own_copies();
        let others: Vec<DocumentName> = self.without(&documents);
        if others.is_empty() {
            return Ok(Some(ReadyDocuments::unlocked(documents)));
        }
        let mut progress = BuildProgress::new(invocation.verbosity);
        let report = &mut |stage| progress.show(stage);
        let ready = self.request.ensure(&others, false, invocation.stop, report);
        progress.close(matches!(ready, Ok(Some(_))));
        let Some(mut ready) = ready? else { return Ok(None) };
        if !ready.built.is_empty() && invocation.verbosity == Verbosity::Progress {
            let folder = self.request.folder()?;
            say(&format!("built {} in {}", listed(&ready.built), folder.path().display()));
        }
        documents.append(&mut ready.documents);
        ready.documents = documents;
        Ok(Some(ready))
    }

    /// The manifest's entries as they would be now: of the run's own copies, and of the others that can be used.
    pub fn facts_now(&self) -> BTreeMap<String, DocumentFacts> {
        facts(&self.usable())
    }

    /// Sizes of the texts that are ready, in bytes.
    pub fn sizes(&self) -> BTreeMap<DocumentName, u64> {
        let usable = self.usable().into_iter();
        usable
            .filter_map(|stored| Some((stored.name, stored.document?.text.len() as u64)))
            .collect()
    }

    /// The documents that can be used as they are.
    pub fn ready(&self) -> Vec<DocumentName> {
        self.usable().iter().map(|stored| stored.name).collect()
    }

    /// The documents that cannot be used yet.
    pub fn missing(&self) -> Vec<DocumentName> {
        self.without(&self.usable())
    }

    /// Whether the run builds those that are missing.
    pub fn builds_missing(&self) -> bool {
        matches!(self.request.selection, DocumentSelection::Recipe(_))
    }

    /// The run's own copies of needed documents.
    fn own_copies(&self) -> Vec<StoredDocument> {
        let Some(own) = &self.own else { return Vec::new() };
        let load = |&name: &DocumentName| {
            let document = own.load_run_copy(name).ok()?;
            Some(StoredDocument::current(own.run_copy(name), document))
        };
        self.needed.iter().filter_map(load).collect()
    }

    /// The run's own copies, and the other documents that can be used as they are. A request that cannot be read has none:
    /// [`Self::supply`] reports why.
    fn usable(&self) -> Vec<StoredDocument> {
        let mut documents = self.own_copies();
        let others = self.request.find(&self.without(&documents)).unwrap_or_default().into_iter();
        documents.extend(others.filter(|stored| stored.state == DocumentState::Current));
        documents
    }

    /// The needed documents that are not among `documents`.
    fn without(&self, documents: &[StoredDocument]) -> Vec<DocumentName> {
        let is_missing =
            |name: &&DocumentName| documents.iter().all(|stored| stored.name != **name);
        self.needed.iter().filter(is_missing).copied().collect()
    }
}

/// Documents for a message: their names, or of many the number.
pub fn listed(names: &[DocumentName]) -> String {
    const MOST_NAMED: usize = 4;
    if names.len() > MOST_NAMED {
        return format!("{} documents", names.len());
    }
    names.iter().map(DocumentName::to_string).collect::<Vec<_>>().join(", ")
}
