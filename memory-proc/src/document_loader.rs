//! The documents of a run, published once each.
//!
//! Consolidated documents are read from their folder when a memory first needs them. A missing document ends the run: a
//! memory without it would be measured as if it were the representation.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Context;
use documents::{DocumentFolder, DocumentName};
use domain::DocumentKind;
use shm_types::DocumentPublisher;
use shm_types::documents::Content;
use shm_types::message::DocumentId;
use warehouse::Demonstrations;

use crate::representation::DocumentSupplier;

/// Reads documents from a run's folder and publishes them.
#[derive(Debug)]
pub struct DocumentLoader {
    folder: Option<DocumentFolder>,
    publisher: DocumentPublisher,
    published: BTreeMap<DocumentName, DocumentId>,
}

impl DocumentLoader {
    /// Creates a loader of the documents in `folder`. Reads nothing yet.
    pub fn new(folder: Option<PathBuf>, publisher: DocumentPublisher) -> Self {
        Self { folder: folder.map(DocumentFolder::new), publisher, published: BTreeMap::new() }
    }
}

impl DocumentSupplier for DocumentLoader {
    fn publish(&mut self, episode: (u32, u64), content: &Content) -> anyhow::Result<DocumentId> {
        Ok(self.publisher.publish(Some(episode), content)?)
    }

    fn consolidated(
        &mut self,
        kind: DocumentKind,
        demonstrations: Demonstrations,
    ) -> anyhow::Result<DocumentId> {
        let name = DocumentName { kind, demonstrations };
        if let Some(&id) = self.published.get(&name) {
            return Ok(id);
        }
        let folder = self.folder.as_ref().with_context(|| {
            format!(
                "the memory supplies {name}, and memory-proc was started without --documents DIR"
            )
        })?;
        let document = folder.load_run_copy(name).with_context(|| {
            let kind = kind.word();
            format!("document {name} (`memtransfer memory build --kind {kind} --demos {demonstrations}` builds it)")
        })?;
        let text = document.text;
        let content = match kind {
            DocumentKind::Semantic => Content::Semantic(text),
            // A file of trajectories is not loaded.
            DocumentKind::Summary | DocumentKind::Trajectories => Content::Summary(text),
        };
        let id = self.publisher.publish(None, &content)?;
        self.published.insert(name, id);
        Ok(id)
    }
}
