//! Demonstration views in the frame store together with their embeddings.

use std::collections::{HashMap, VecDeque};

use search::ContentHash;
use shm_types::message::NO_FRAME;

use crate::bank::{Collecting, KnownView};
use crate::demonstrations::ViewId;
use crate::embedding_cache::EmbeddingCache;
use crate::views::{PinnedView, PinnedViews};

/// Demonstration views in the frame store, and embeddings.
pub(crate) struct EmbeddedViews<I> {
    pub(crate) pinned: PinnedViews<I>,
    pub(crate) embeddings: EmbeddingCache,
    /// The content of the views of banks that are not pinned as a whole.
    pub(crate) contents: HashMap<ViewId, ContentHash>,
    /// Demonstration views to embed.
    pub(crate) background: VecDeque<ViewId>,
}

impl<I: Clone> EmbeddedViews<I> {
    /// Room for `room` pinned views, and the embeddings known so far.
    pub(crate) fn new(room: usize, embeddings: EmbeddingCache) -> Self {
        Self {
            pinned: PinnedViews::new(room),
            embeddings,
            contents: HashMap::new(),
            background: VecDeque::new(),
        }
    }

    /// A view, once it is in the frame store, and embedded if `embeds`.
    pub(crate) fn known(&self, view_id: ViewId, embeds: bool) -> Option<KnownView> {
        let &PinnedView { frame, content, .. } = self.pinned.get(view_id)?;
        let embedding = embeds.then(|| self.embeddings.get(&content).cloned());
        match embedding {
            Some(None) => None,
            embedding => Some(KnownView { frame, content, embedding: embedding.flatten() }),
        }
    }

    /// Whether all of `view_ids` are [known](Self::known); `ready` counts those that are, the first ones.
    pub(crate) fn are_known(&self, view_ids: &[ViewId], ready: &mut usize, embeds: bool) -> bool {
        let is_known = |&view_id: &ViewId| {
            let view = self.pinned.get(view_id);
            view.is_some_and(|view| !embeds || self.embeddings.get(&view.content).is_some())
        };
        *ready += view_ids[*ready..].iter().take_while(|view_id| is_known(view_id)).count();
        *ready == view_ids.len()
    }

    /// Pins all of these views, or none; returns whether there was room. `embeds`: they have to be embedded.
    pub(crate) fn try_pin(&mut self, view_ids: &[ViewId], embeds: bool) -> bool {
        if !self.pinned.try_pin(view_ids, embeds) {
            return false;
        }
        if embeds {
            // Views that are there already and have not been embedded for others.
            let known = |view_id: &ViewId| self.pinned.get(*view_id);
            let is_new = |view_id: &&ViewId| {
                known(view_id).is_some_and(|view| self.embeddings.get(&view.content).is_none())
            };
            self.background.extend(view_ids.iter().filter(is_new));
        }
        true
    }

    /// Pins further views of a bank if it is `wanted`, and takes those that are embedded.
    pub(crate) fn collect(&mut self, collecting: &mut Collecting, wanted: bool) {
        let mut still = Vec::new();
        for view_id in std::mem::take(&mut collecting.pinned) {
            match self.known(view_id, true) {
                None => still.push(view_id),
                Some(view) => {
                    self.contents.insert(view_id, view.content);
                    collecting.found.insert(view_id, view);
                    self.pinned.release(&[view_id]);
                }
            }
        }
        collecting.pinned = still;
        while wanted && let Some(&view_id) = collecting.waiting.front() {
            if let Some(view) = self.collected(view_id) {
                collecting.found.insert(view_id, view);
            } else if collecting.has_room() && self.try_pin(&[view_id], true) {
                collecting.pinned.push(view_id);
            } else {
                return;
            }
            collecting.waiting.pop_front();
        }
    }

    /// A view that has been collected before, without its frame.
    pub(crate) fn collected(&self, view_id: ViewId) -> Option<KnownView> {
        let content = *self.contents.get(&view_id)?;
        let embedding = Some(self.embeddings.get(&content)?.clone());
        Some(KnownView { frame: NO_FRAME, content, embedding })
    }
}
