//! All lanes of a run: which of them can be answered, and what the others wait for.
//!
//! The engine takes messages and finished embeddings in any order and returns what to send and what to embed next. It
//! never waits: a lane whose views or embeddings are missing stays pending while others are answered. Its answers depend
//! on the messages only, not on their timing or on other lanes.
//!
//! Its only input and output is the embedding cache's file; [`crate::serve`] connects it to the bus, the encoder and the
//! documents.

use std::collections::{BTreeSet, HashSet, VecDeque};

use domain::Pose;
use shm_types::message::{
    FrameId, MemoryEpisodeConfig, Observation, Recall, RecallTrace, ViewRequest,
};
use warehouse::{CaseSet, Warehouse};

use crate::embedding_cache::{CacheError, EmbeddingCache};
use crate::episode::{MemoryEpisode, PendingObservation, Unusable, unusable};
use crate::representation::{DocumentSupplier, StoredView};
use crate::views::{Arrival, PinnedView, PinnedViews};
use search::{ContentHash, Embedding};

/// The lanes of a run. `I` is a source of a frame's pixels, which the engine passes on to the encoder.
pub struct Engine<I> {
    warehouse: Warehouse,
    cases: CaseSet,
    lanes: Vec<EngineLane>,
    /// Lanes with a pending observation.
    pending: BTreeSet<u32>,
    views: PinnedViews<I>,
    /// Episodes whose views have not been requested, by lane and number, in order of arrival.
    admission: VecDeque<(u32, u64)>,
    embeddings: EmbeddingCache,
    /// Current views to embed, which observations wait for.
    urgent: VecDeque<(ContentHash, I)>,
    /// Poses of demonstration views to embed.
    background: VecDeque<Pose>,
    in_flight: HashSet<ContentHash>,
}

#[derive(Default)]
struct EngineLane {
    /// The episode whose steps are observed.
    running: Option<MemoryEpisode>,
    /// The announced episode that has not begun.
    next: Option<MemoryEpisode>,
}

impl<I: Clone> Engine<I> {
    /// Creates an engine for `lanes` lanes, with room for `views` demonstration views.
    pub fn new(
        warehouse: Warehouse,
        cases: CaseSet,
        lanes: u32,
        views: usize,
        embeddings: EmbeddingCache,
    ) -> Self {
        Self {
            warehouse,
            cases,
            lanes: (0..lanes).map(|_| EngineLane::default()).collect(),
            pending: BTreeSet::new(),
            views: PinnedViews::new(views),
            admission: VecDeque::new(),
            embeddings,
            urgent: VecDeque::new(),
            background: VecDeque::new(),
            in_flight: HashSet::new(),
        }
    }

    /// Takes an announced episode, and requests its views.
    ///
    /// # Errors
    /// When a value in the message is invalid, or its views do not fit.
    pub fn config(&mut self, config: &MemoryEpisodeConfig) -> Result<(), Unusable> {
        let episode = MemoryEpisode::announced(config, &self.warehouse, &self.cases)?;
        let (needed, room) = (episode.builder.poses().len(), self.views.room());
        if needed > room {
            return Err(unusable!(
                "config of episode {}: its memory needs {needed} views and there is room for {room}: raise \
                 --frame-budget or lower --lanes",
                config.episode
            ));
        }
        let lanes = self.lanes.len();
        let lane = self.lanes.get_mut(config.lane as usize).ok_or_else(|| {
            unusable!("config of episode {}: lane {} of {lanes}", config.episode, config.lane)
        })?;
        if let Some(dropped) = lane.next.replace(episode) {
            self.close(dropped);
        }
        self.admission.push_back((config.lane, config.episode));
        self.admit();
        Ok(())
    }

    /// Takes an observation. Returns its frame if the lane's memory uses the current view, which then has to be passed to
    /// [`Self::current_view`].
    ///
    /// # Errors
    /// When the observation does not continue an episode, or a value in it is invalid.
    pub fn observe(
        &mut self,
        seen: &Observation,
        received_ns: u64,
    ) -> Result<Option<FrameId>, Unusable> {
        let unknown =
            || unusable!("observation of unknown episode {} in lane {}", seen.episode, seen.lane);
        let lane = self.lanes.get_mut(seen.lane as usize).ok_or_else(unknown)?;
        if let Some(next) = lane.next.take_if(|next| next.id == seen.episode)
            && let Some(abandoned) = lane.running.replace(next)
        {
            self.close(abandoned);
        }
        let running = &mut self.lanes[seen.lane as usize].running;
        if seen.last == 1 {
            let done = running.take_if(|running| running.id == seen.episode);
            self.close(done.ok_or_else(unknown)?);
            return Ok(None);
        }
        let running = running.as_mut().filter(|running| running.id == seen.episode);
        let running = running.ok_or_else(unknown)?;
        running.observe(seen, &self.warehouse, &self.cases)?;
        running.pending = Some(PendingObservation { received_ns, content: None });
        if running.representation.matches_views() {
            return Ok(Some(seen.frame));
        }
        self.pending.insert(seen.lane);
        Ok(None)
    }

    /// Takes the current view of a lane.
    pub fn current_view(&mut self, lane: u32, content: ContentHash, image: I) {
        let running = self.lanes.get_mut(lane as usize).and_then(|lane| lane.running.as_mut());
        let Some(pending) = running.and_then(|running| running.pending.as_mut()) else { return };
        pending.content = Some(content);
        self.pending.insert(lane);
        if self.embeddings.get(&content).is_none() && !self.in_flight.contains(&content) {
            self.urgent.push_back((content, image));
        }
    }

    /// Takes a requested view, which is in the frame store now.
    ///
    /// # Errors
    /// When it was not requested.
    pub fn view(
        &mut self,
        pose: Pose,
        frame: FrameId,
        content: ContentHash,
        image: I,
    ) -> Result<(), Unusable> {
        match self.views.arrived(pose, PinnedView { frame, content, image }) {
            Arrival::Needed { embedded: true } if self.embeddings.get(&content).is_none() => {
                self.background.push_back(pose);
            }
            Arrival::Needed { .. } => {}
            // That leaves room for another.
            Arrival::Dismissed => self.admit(),
            Arrival::Unexpected => {
                return Err(unusable!("view of {pose} as frame {frame}, which was not requested"));
            }
        }
        Ok(())
    }

    /// The next image to embed: current views first.
    pub fn next_image(&mut self) -> Option<(ContentHash, I)> {
        while let Some((content, image)) = self.urgent.pop_front() {
            if self.start_embedding(content) {
                return Some((content, image));
            }
        }
        while let Some(pose) = self.background.pop_front() {
            let view = self.views.get(pose).map(|view| (view.content, view.image.clone()));
            if let Some((content, image)) = view
                && self.start_embedding(content)
            {
                return Some((content, image));
            }
        }
        None
    }

    /// Number of images that wait for their embeddings, including those in progress.
    pub fn waiting(&self) -> usize {
        self.urgent.len() + self.background.len() + self.in_flight.len()
    }

    /// Number of demonstration views that are pinned, and that may be.
    pub fn pinned_views(&self) -> (usize, usize) {
        (self.views.len(), self.views.room())
    }

    fn start_embedding(&mut self, content: ContentHash) -> bool {
        self.embeddings.get(&content).is_none() && self.in_flight.insert(content)
    }

    /// Takes the embedding of an image from [`Self::next_image`].
    ///
    /// # Errors
    /// When the cache's file cannot be written. Only the next run's speed depends on that.
    pub fn add_embedding(
        &mut self,
        content: ContentHash,
        embedding: Embedding,
    ) -> Result<(), CacheError> {
        self.in_flight.remove(&content);
        self.embeddings.insert(content, embedding)
    }

    /// Writes new embeddings to the cache's file if a batch is due.
    ///
    /// # Errors
    /// As [`Self::add_embedding`].
    pub fn write_embeddings(&mut self) -> Result<(), CacheError> {
        self.embeddings.write_if_due()
    }

    /// Answers every lane that can be answered, in the order of lanes. The documents that answers name have been published.
    ///
    /// # Errors
    /// When a document is missing or cannot be published.
    pub fn answers(
        &mut self,
        clock: impl Fn() -> u64,
        documents: &mut dyn DocumentSupplier,
    ) -> anyhow::Result<Vec<(Recall, RecallTrace)>> {
        let mut answers = Vec::new();
        for lane in std::mem::take(&mut self.pending) {
            let Self { lanes, views, embeddings, .. } = self;
            // The episode may have ended without an answer.
            let Some(episode) = &mut lanes[lane as usize].running else { continue };
            let Some(PendingObservation { content, .. }) = episode.pending else { continue };
            let embedding = content.and_then(|content| embeddings.get(&content));
            let compares = episode.representation.matches_views();
            let view = |pose| {
                let PinnedView { frame, content, .. } = views.get(pose)?;
                let embedding = embeddings.get(content).filter(|_| compares).cloned();
                let is_ready = embedding.is_some() || !compares;
                is_ready.then_some(StoredView { frame: *frame, content: *content, embedding })
            };
            let is_seen = embedding.is_some() || content.is_none();
            if is_seen && episode.admitted && episode.is_built(view, documents)? {
                answers.extend(episode.answer(embedding, &clock));
            } else {
                self.pending.insert(lane);
            }
        }
        Ok(answers)
    }

    /// The view requests that have arisen since the last call.
    pub fn take_view_requests(&mut self) -> Vec<ViewRequest> {
        self.views.take_requests()
    }

    /// Requests the views of announced episodes, in order, as long as there is room.
    fn admit(&mut self) {
        while let Some(&(lane, id)) = self.admission.front() {
            let lane = &mut self.lanes[lane as usize];
            let mut episodes = [&mut lane.running, &mut lane.next].into_iter().flatten();
            if let Some(episode) = episodes.find(|episode| episode.id == id) {
                let (poses, embedded) =
                    (episode.builder.poses(), episode.representation.matches_views());
                if !self.views.try_pin(poses, embedded) {
                    return;
                }
                episode.admitted = true;
                if embedded {
                    // Views that are there already and have not been embedded for other lanes.
                    for &pose in poses {
                        if let Some(view) = self.views.get(pose)
                            && self.embeddings.get(&view.content).is_none()
                        {
                            self.background.push_back(pose);
                        }
                    }
                }
            }
            self.admission.pop_front();
        }
    }

    /// Drops an episode that has left its lane.
    fn close(&mut self, episode: MemoryEpisode) {
        if episode.admitted {
            self.views.release(episode.builder.poses());
            self.admit();
        }
    }
}

#[cfg(test)]
mod tests;
