//! Small demonstrations and a folder of documents, for the tests of memories and of the engine.

use std::sync::Arc;

use anyhow::bail;
use domain::{
    Action, ActionCode, Demonstrations, DocumentKind, Feedback, Heading, Pose, SegmentContent,
};
use peer::memory::{Memory, MemoryError, MemoryItem, Query, Step};
use shm_types::documents::Content;
use shm_types::message::DocumentId;

use super::MemorySettings;
use crate::bank::{BankSteps, KnownView, MemoryBank};
use crate::demonstrations::{RememberedDemonstration, ViewId};
use crate::items::DocumentSupplier;

/// A demonstration of case 8: north from (3, `from`) for `steps` steps; sub-goal 1 is completed at step 2.
pub(crate) fn demonstration(number: u16, from: u8, steps: u8) -> RememberedDemonstration {
    let all = 0..=steps;
    RememberedDemonstration {
        case: 8,
        number,
        instruction: "Find a cone.".to_owned(),
        states: all.clone().map(|t| Pose::new(3, from + t, Heading::N).into()).collect(),
        // Named by the row.
        views: all
            .clone()
            .map(|t| ViewId { sequence: 0, number: 0, step: (from + t).into() })
            .collect(),
        feedback: all
            .clone()
            .map(|t| if t == 0 { Feedback::Start } else { Feedback::Moved }.into())
            .collect(),
        stages: all.map(|t| u32::from(t >= 2)).collect(),
        actions: vec![Some(Action::Forward.into()); usize::from(steps)],
    }
}

/// The actions of the warehouse that are turns.
pub(crate) fn turns() -> Vec<ActionCode> {
    [Action::TurnLeft, Action::TurnRight, Action::TurnAround].map(ActionCode::from).to_vec()
}

/// The standard settings.
pub(crate) fn settings() -> MemorySettings {
    MemorySettings {
        horizon: 6,
        segment: SegmentContent::Actions,
        hits: 1,
        keyframes: 40,
        turns: turns(),
        embeddings: Arc::default(),
        documents: Vec::new(),
    }
}

/// Builds a memory without views.
pub(crate) fn build(
    memory: &mut dyn Memory,
    demonstrations: &[RememberedDemonstration],
) -> Result<(), MemoryError> {
    let bank = MemoryBank::new(demonstrations.to_vec());
    memory.build(&BankSteps::without_views(&bank).demonstrations())
}

/// Builds the memory that `new` makes, whose views are those of `view`.
pub(crate) fn build_with_views<M: Memory>(
    new: impl FnOnce(&MemorySettings) -> M,
    settings: &MemorySettings,
    demonstrations: &[RememberedDemonstration],
    view: impl Fn(Pose) -> KnownView,
) -> M {
    let bank = MemoryBank::new(demonstrations.to_vec());
    let steps = bank.with_views(|of| Some(view(Pose::new(3, of.step as u8, Heading::N)))).unwrap();
    let mut memory = new(&MemorySettings { embeddings: steps.embeddings(), ..settings.clone() });
    memory.build(&steps.demonstrations()).unwrap();
    memory
}

/// What a memory supplies for a view and steps taken.
pub(crate) fn recall(
    memory: &mut dyn Memory,
    embedding: Option<&[f32]>,
    step: u32,
) -> Result<Vec<MemoryItem>, MemoryError> {
    let now = Step {
        lane: 1,
        episode: 7,
        step,
        state: Pose::new(0, 0, Heading::N).into(),
        last_action: None,
        feedback: Feedback::Start.into(),
        frame: None,
        embedding,
        pinned: None,
    };
    memory.recall(&Query {
        now,
        instruction: "Find a cone.",
        window: &[],
        image_budget: 1000,
        text_budget: 1000,
    })
}

/// Stores what is published: document `i + 1` is entry `i`, with the episode it belongs to. The text of a consolidated
/// document names its kind and set.
#[derive(Debug, Default)]
pub(crate) struct TestDocuments {
    pub(crate) published: Vec<(Option<(u32, u64)>, Content)>,
    consolidated: Vec<(Arc<str>, DocumentId)>,
    /// Whether consolidated documents are missing.
    pub(crate) is_empty: bool,
}

impl TestDocuments {
    fn add(&mut self, episode: Option<(u32, u64)>, content: Content) -> DocumentId {
        self.published.push((episode, content));
        self.published.len() as DocumentId
    }

    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        self.published.clear();
        self.consolidated.clear();
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
    ) -> anyhow::Result<Arc<str>> {
        let content: fn(String) -> Content = match kind {
            _ if self.is_empty => bail!("there is no {kind:?} of {set}"),
            DocumentKind::Summary => Content::Summary,
            DocumentKind::Semantic => Content::Semantic,
            DocumentKind::Trajectories | DocumentKind::Note => bail!("{kind:?} of {set}"),
        };
        let text: Arc<str> = format!("{} of {set}", kind.word()).into();
        if let Some((known, _)) = self.consolidated.iter().find(|(known, _)| *known == text) {
            return Ok(known.clone());
        }
        let id = self.add(None, content(text.to_string()));
        self.consolidated.push((text.clone(), id));
        Ok(text)
    }

    fn published(&self, text: &Arc<str>) -> Option<DocumentId> {
        let same = |(known, id): &(Arc<str>, DocumentId)| Arc::ptr_eq(known, text).then_some(*id);
        self.consolidated.iter().find_map(same)
    }
}
