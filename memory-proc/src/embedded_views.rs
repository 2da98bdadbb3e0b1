//! Demonstration views in the frame store together with their embeddings.

use std::collections::{HashMap, VecDeque};

use search::ContentHash;
use shm_types::message::NO_FRAME;

use crate::bank::{Collecting, KnownView, Viewpoint};
use crate::embedding_cache::EmbeddingCache;
use crate::views::{PinnedView, PinnedViews};

/// Demonstration views in the frame store, and embeddings.
pub(crate) struct EmbeddedViews<I> {
    pub(crate) pinned: PinnedViews<I>,
    pub(crate) embeddings: EmbeddingCache,
    /// The content of the views of banks that are not pinned as a whole.
    pub(crate) contents: HashMap<Viewpoint, ContentHash>,
    /// Demonstration views to embed.
    pub(crate) background: VecDeque<Viewpoint>,
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
    pub(crate) fn known(&self, viewpoint: Viewpoint, embeds: bool) -> Option<KnownView> {
        let &PinnedView { frame, content, .. } = self.pinned.get(viewpoint)?;
        let embedding = embeds.then(|| self.embeddings.get(&content).cloned());
        match embedding {
            Some(None) => None,
            embedding => Some(KnownView { frame, content, embedding: embedding.flatten() }),
        }
    }

    /// Whether all of `viewpoints` are [known](Self::known); `ready` counts those that are, the first ones.
    pub(crate) fn are_known(
        &self,
        viewpoints: &[Viewpoint],
        ready: &mut usize,
        embeds: bool,
    ) -> bool {
        let is_known = |&viewpoint: &Viewpoint| {
            let view = self.pinned.get(viewpoint);
            view.is_some_and(|view| !embeds || self.embeddings.get(&view.content).is_some())
        };
        *ready += viewpoints[*ready..].iter().take_while(|viewpoint| is_known(viewpoint)).count();
        *ready == viewpoints.len()
    }

    /// Pins all of these views, or none; returns whether there was room. `embeds`: they have to be embedded.
    pub(crate) fn try_pin(&mut self, viewpoints: &[Viewpoint], embeds: bool) -> bool {
        if !self.pinned.try_pin(viewpoints, embeds) {
            return false;
        }
        if embeds {
            // Views that are there already and have not been embedded for others.
            let known = |viewpoint: &Viewpoint| self.pinned.get(*viewpoint);
            let is_new = |viewpoint: &&Viewpoint| {
                known(viewpoint).is_some_and(|view| self.embeddings.get(&view.content).is_none())
            };
            self.background.extend(viewpoints.iter().filter(is_new));
        }
        true
    }

    /// Pins further views of a bank if it is `wanted`, and takes those that are embedded.
    pub(crate) fn collect(&mut self, collecting: &mut Collecting, wanted: bool) {
        let mut still = Vec::new();
        for viewpoint in std::mem::take(&mut collecting.pinned) {
            match self.known(viewpoint, true) {
                None => still.push(viewpoint),
                Some(view) => {
                    self.contents.insert(viewpoint, view.content);
                    collecting.found.insert(viewpoint, view);
                    self.pinned.release(&[viewpoint]);
                }
            }
        }
        collecting.pinned = still;
        while wanted && let Some(&viewpoint) = collecting.waiting.front() {
            if let Some(view) = self.collected(viewpoint) {
                collecting.found.insert(viewpoint, view);
            } else if collecting.has_room() && self.try_pin(&[viewpoint], true) {
                collecting.pinned.push(viewpoint);
            } else {
                return;
            }
            collecting.waiting.pop_front();
        }
    }

    /// A view that has been collected before, without its frame.
    pub(crate) fn collected(&self, viewpoint: Viewpoint) -> Option<KnownView> {
        let content = *self.contents.get(&viewpoint)?;
        let embedding = Some(self.embeddings.get(&content)?.clone());
        Some(KnownView { frame: NO_FRAME, content, embedding })
    }
}
