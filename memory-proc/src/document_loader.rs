//! The documents of a run, published once each.
//!
//! Consolidated documents are read from their folder when a memory first needs them. A missing document ends the run: a
//! memory without it would be measured as if it were the representation.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context;
use documents::{DocumentFolder, DocumentName};
use domain::{Demonstrations, DocumentKind};
use shm_types::DocumentPublisher;
use shm_types::documents::Content;
use shm_types::message::DocumentId;

use crate::items::DocumentSupplier;

/// Reads documents from a run's folder and publishes them.
#[derive(Debug)]
pub struct DocumentLoader {
    folder: Option<DocumentFolder>,
    publisher: DocumentPublisher,
    published: BTreeMap<DocumentName, (Arc<str>, DocumentId)>,
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
    ) -> anyhow::Result<Arc<str>> {
        let name = DocumentName { kind, demonstrations };
        if let Some((text, _)) = self.published.get(&name) {
            return Ok(text.clone());
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
        let (kept, text): (Arc<str>, _) = (document.text.as_str().into(), document.text);
        let content = match kind {
            DocumentKind::Semantic => Content::Semantic(text),
            // No file holds anything else.
            DocumentKind::Summary | DocumentKind::Trajectories | DocumentKind::Note => {
                Content::Summary(text)
            }
        };
        let id = self.publisher.publish(None, &content)?;
        self.published.insert(name, (kept.clone(), id));
        Ok(kept)
    }

    fn published(&self, text: &Arc<str>) -> Option<DocumentId> {
        let same = |(known, id): &(Arc<str>, DocumentId)| Arc::ptr_eq(known, text).then_some(*id);
        self.published.values().find_map(same)
    }
}
