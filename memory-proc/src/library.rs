//! The documents of a run: published once each, and named from then on.
//!
//! Those that are consolidated over the demonstrations of all cases are read from their folder when a memory
//! first needs them. A run never goes on without one that it needs: an empty memory would be measured as if it
//! were the representation.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Context;
use domain::DocumentKind;
use shm_types::DocumentPublisher;
use shm_types::documents::Content;
use shm_types::message::DocumentId;
use warehouse::Demonstrations;

use crate::documents::DocumentFile;
use crate::representation::Documents;

/// A folder of documents and the way to the policy.
#[derive(Debug)]
pub struct Library {
    folder: Option<PathBuf>,
    publisher: DocumentPublisher,
    published: BTreeMap<(DocumentKind, Demonstrations), DocumentId>,
}

impl Library {
    /// Of the documents in `folder`. Nothing is read yet.
    pub fn new(folder: Option<PathBuf>, publisher: DocumentPublisher) -> Self {
        Self { folder, publisher, published: BTreeMap::new() }
    }
}

impl Documents for Library {
    fn publish(&mut self, episode: (u32, u64), content: &Content) -> anyhow::Result<DocumentId> {
        Ok(self.publisher.publish(Some(episode), content)?)
    }

    fn consolidated(
        &mut self,
        kind: DocumentKind,
        set: Demonstrations,
    ) -> anyhow::Result<DocumentId> {
        if let Some(&id) = self.published.get(&(kind, set)) {
            return Ok(id);
        }
        let folder = self.folder.as_deref().context(
            "it supplies a document, and this process was started without --documents DIR",
        )?;
        let document = DocumentFile::load(folder, kind, set)?;
        let id = self.publisher.publish(None, &document.content())?;
        self.published.insert((kind, set), id);
        Ok(id)
    }
}
