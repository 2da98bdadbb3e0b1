//! Small demonstrations and a supplier of documents, for the tests of representations and of the engine.

use anyhow::bail;
use domain::{Action, Heading, Pose};
use domain::{DocumentKind, SegmentContent};
use shm_types::documents::Content;
use shm_types::message::DocumentId;
use warehouse::Demonstrations;

use super::{DocumentSupplier, MemorySpec};
use crate::demonstrations::Demonstration;

/// A demonstration of case 8: north from (3, `from`) for `steps` steps; sub-goal 1 is completed at step 2.
pub(crate) fn demonstration(number: u16, from: u8, steps: u8) -> Demonstration {
    Demonstration {
        case: 8,
        number,
        poses: (0..=steps).map(|t| Pose::new(3, from + t, Heading::N)).collect(),
        stages: (0..=steps).map(|t| u32::from(t >= 2)).collect(),
        actions: vec![Action::Forward; usize::from(steps)],
    }
}

/// The standard settings.
pub(crate) fn spec(demonstrations: Vec<Demonstration>) -> MemorySpec {
    MemorySpec {
        episode: (1, 7),
        set: Demonstrations::ORIGINAL,
        demonstrations,
        horizon: 6,
        segment: SegmentContent::Actions,
        keyframes: 40,
    }
}

/// Stores what is published: document `i + 1` is entry `i`, with the episode it belongs to. The text of a consolidated
/// document names its kind and set.
#[derive(Debug, Default)]
pub(crate) struct TestDocuments {
    pub(crate) published: Vec<(Option<(u32, u64)>, Content)>,
    /// Whether consolidated documents are missing.
    pub(crate) is_empty: bool,
}

impl TestDocuments {
    fn add(&mut self, episode: Option<(u32, u64)>, content: Content) -> DocumentId {
        self.published.push((episode, content));
        self.published.len() as DocumentId
    }

    pub(crate) fn content(&self, id: DocumentId) -> &Content {
        &self.published[id as usize - 1].1
    }
}

impl DocumentSupplier for TestDocuments {
    fn publish(&mut self, episode: (u32, u64), content: &Content) -> anyhow::Result<DocumentId> {
        Ok(self.add(Some(episode), content.clone()))
    }

    fn consolidated(
        &mut self,
        kind: DocumentKind,
        set: Demonstrations,
    ) -> anyhow::Result<DocumentId> {
        let content = match kind {
            _ if self.is_empty => bail!("there is no {kind:?} of {set}"),
            DocumentKind::Summary => Content::Summary(format!("summary of {set}")),
            DocumentKind::Semantic => Content::Semantic(format!("knowledge of {set}")),
            DocumentKind::Trajectories => bail!("trajectories are never consolidated"),
        };
        let known = self.published.iter().position(|entry| entry == &(None, content.clone()));
        Ok(match known {
            Some(at) => at as DocumentId + 1,
            None => self.add(None, content),
        })
    }
}
