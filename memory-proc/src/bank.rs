//! A bank: the demonstrations that a memory is built from, in the form in which it is given them.

use std::collections::{HashMap, VecDeque};
use std::ops::Range;
use std::sync::Arc;

use peer::memory::{self, DemonstrationStep};
use search::{ContentHash, Embedding};
use shm_types::BankContent;
use shm_types::banks::{BankDemonstration, BankStep};
use shm_types::message::{FrameId, NO_FRAME, action_code};

use crate::demonstrations::{RememberedDemonstration, ViewId};

/// Demonstrations, and their views.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct MemoryBank {
    /// The demonstrations, numbered from 0.
    pub demonstrations: Vec<Arc<RememberedDemonstration>>,
    /// The views of those that the bank was made of, each once, sorted.
    pub view_ids: Vec<ViewId>,
}

/// What is known about a remembered view.
#[derive(Debug, Clone, Default)]
pub struct KnownView {
    /// Its frame, if it is in the frame store.
    pub frame: FrameId,
    /// Its content.
    pub content: ContentHash,
    /// Its embedding, if the memory asked for embeddings.
    pub embedding: Option<Embedding>,
}

impl MemoryBank {
    /// A bank of these demonstrations.
    pub fn new(
        demonstrations: impl IntoIterator<Item: Into<Arc<RememberedDemonstration>>>,
    ) -> Self {
        let demonstrations: Vec<Arc<RememberedDemonstration>> =
            demonstrations.into_iter().map(Into::into).collect();
        let mut view_ids: Vec<ViewId> =
            demonstrations.iter().flat_map(|demonstration| demonstration.views.clone()).collect();
        view_ids.sort_unstable();
        view_ids.dedup();
        Self { demonstrations, view_ids }
    }

    /// The steps of all demonstrations with what is known about their views. `None` while a view is not known.
    pub fn with_views(&self, view: impl Fn(ViewId) -> Option<KnownView>) -> Option<BankSteps<'_>> {
        let mut found = BankSteps::without_views(self);
        let mut embeddings = Embeddings::new();
        let views = self.demonstrations.iter().flat_map(|demonstration| &demonstration.views);
        for (at, &view_id) in views.enumerate() {
            let KnownView { frame, content, embedding } = view(view_id)?;
            found.frames.push(frame);
            found.steps[at].content_hash = content;
            if let Some(embedding) = embedding {
                embeddings.entry(content).or_insert(embedding);
            }
        }
        found.embeddings = Arc::new(embeddings);
        Some(found)
    }
}

/// Views that are pinned at the same time to embed a bank that is too large to be pinned as a whole.
const PINNED_AT_ONCE: usize = 64;

/// The views of a bank that is too large to be pinned as a whole.
#[derive(Debug, Default)]
pub(crate) struct Collecting {
    pub(crate) found: HashMap<ViewId, KnownView>,
    pub(crate) waiting: VecDeque<ViewId>,
    pub(crate) pinned: Vec<ViewId>,
}

impl Collecting {
    pub(crate) fn new(bank: &MemoryBank) -> Self {
        let waiting = bank.view_ids.iter().copied().collect();
        Self { found: HashMap::new(), waiting, pinned: Vec::new() }
    }

    /// Whether further views may be pinned.
    pub(crate) fn has_room(&self) -> bool {
        self.pinned.len() < PINNED_AT_ONCE
    }

    pub(crate) fn is_complete(&self) -> bool {
        self.waiting.is_empty() && self.pinned.is_empty()
    }
}

/// The steps of a bank's demonstrations, one demonstration after the other, with their views.
#[derive(Debug)]
pub struct BankSteps<'a> {
    bank: &'a MemoryBank,
    steps: Vec<DemonstrationStep>,
    embeddings: Arc<Embeddings>,
    frames: Vec<FrameId>,
}

/// Embeddings of views by content, each once.
pub type Embeddings = HashMap<ContentHash, Embedding>;

impl<'a> BankSteps<'a> {
    /// The steps without views.
    pub fn without_views(bank: &'a MemoryBank) -> Self {
        let steps = bank.demonstrations.iter().flat_map(|demonstration| {
            let states = demonstration.states.iter().zip(&demonstration.feedback).enumerate();
            states.map(|(at, (&state, &feedback))| DemonstrationStep {
                state,
                action: demonstration.actions.get(at).copied().flatten(),
                feedback,
                content_hash: [0; 16],
            })
        });
        Self { bank, steps: steps.collect(), embeddings: Arc::default(), frames: Vec::new() }
    }

    /// Each demonstration with its place in the lists.
    fn places(&self) -> impl Iterator<Item = (&'a RememberedDemonstration, Range<usize>)> {
        let mut first = 0;
        self.bank.demonstrations.iter().map(move |demonstration| {
            let place = first..first + demonstration.states.len();
            first = place.end;
            (&**demonstration, place)
        })
    }

    /// The embeddings of the views, which a built-in memory is given apart from the demonstrations: many steps share a view.
    pub fn embeddings(&self) -> Arc<Embeddings> {
        self.embeddings.clone()
    }

    /// As a built-in memory is given them.
    pub fn demonstrations(&self) -> Vec<memory::Demonstration<'_>> {
        let given = self.places().map(|(demonstration, place)| memory::Demonstration {
            instruction: &demonstration.instruction,
            embeddings: &[],
            steps: &self.steps[place],
            frames: &[],
            stages: &demonstration.stages,
            bank: None,
        });
        given.collect()
    }

    /// As an external memory is given them, with or without frames.
    pub fn content(self, with_frames: bool) -> BankContent {
        let mut content = BankContent::default();
        for (demonstration, place) in self.places() {
            content.demonstrations.push(BankDemonstration {
                first_step: place.start as u32,
                steps: place.len() as u32,
                first_byte: content.text.len() as u32,
                bytes: demonstration.instruction.len() as u32,
            });
            content.text.push_str(&demonstration.instruction);
        }
        let frame = |at: usize| self.frames.get(at).copied().filter(|_| with_frames);
        let steps = self.steps.iter().enumerate().map(|(at, step)| BankStep {
            frame: frame(at).unwrap_or(NO_FRAME),
            content_hash: step.content_hash,
            state: step.state.padded(),
            action: action_code(step.action),
            feedback: step.feedback.0,
            reserved: [0; 6],
        });
        content.steps = steps.collect();
        let views = self.steps.iter().filter_map(|step| self.embeddings.get(&step.content_hash));
        content.embeddings = views.flat_map(|view| view.as_slice()).copied().collect();
        content
    }
}
