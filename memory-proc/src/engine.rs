//! All lanes of a run: who waits for what, and who can be answered.
//!
//! The engine is told of messages and finished embeddings, in whatever order they come, and says what is to be
//! sent and what is to be embedded next. It never waits: a lane whose views or embeddings are not there
//! yet stays open while others are answered. What it answers depends on the messages alone, not on
//! their timing or on other lanes.
//!
//! It does no input or output but the embedding cache's file; [`crate::serve`] connects it to the bus, to the
//! encoder and to the documents.

use std::collections::{BTreeSet, HashSet, VecDeque};

use domain::Pose;
use shm_types::message::{
    FrameId, MemoryEpisodeConfig, Observation, Recall, RecallTrace, ViewRequest,
};
use warehouse::{CaseSet, Warehouse};

use crate::embedding::{ContentHash, Embedding};
use crate::embedding_cache::{CacheError, EmbeddingCache};
use crate::episode::{Episode, Question, Unusable, unusable};
use crate::representation::{Documents, View};
use crate::views::{Arrival, HeldViews, Resident};

/// The lanes of a run. `P` is what gives a frame's pixels; the engine only hands it on.
pub struct Engine<P> {
    warehouse: Warehouse,
    cases: CaseSet,
    lanes: Vec<Lane>,
    /// Lanes with an open question.
    open: BTreeSet<u32>,
    views: HeldViews<P>,
    /// Episodes whose views are still to be asked for, by lane and ticket, first come first served.
    admission: VecDeque<(u32, u64)>,
    embeddings: EmbeddingCache,
    /// Current views to embed: somebody waits for each.
    urgent: VecDeque<(ContentHash, P)>,
    /// Poses of demonstration views to embed.
    background: VecDeque<Pose>,
    in_flight: HashSet<ContentHash>,
}

#[derive(Default)]
struct Lane {
    /// The episode whose steps are observed.
    running: Option<Episode>,
    /// The one that was announced and has not begun.
    next: Option<Episode>,
}

impl<P: Clone> Engine<P> {
    /// For `lanes` lanes, with room for `views` demonstration views.
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
            lanes: (0..lanes).map(|_| Lane::default()).collect(),
            open: BTreeSet::new(),
            views: HeldViews::new(views),
            admission: VecDeque::new(),
            embeddings,
            urgent: VecDeque::new(),
            background: VecDeque::new(),
            in_flight: HashSet::new(),
        }
    }

    /// An episode is announced: its views are asked for.
    ///
    /// # Errors
    /// When the brief asks for what cannot be.
    pub fn config(&mut self, config: &MemoryEpisodeConfig) -> Result<(), Unusable> {
        let episode = Episode::announced(config, &self.warehouse, &self.cases)?;
        let (needed, room) = (episode.blueprint.poses().len(), self.views.room());
        if needed > room {
            return Err(unusable!(
                "brief of episode {}: its memory needs {needed} views and there is room for {room}: raise \
                 --frame-budget or lower --lanes",
                config.episode
            ));
        }
        let lanes = self.lanes.len();
        let lane = self.lanes.get_mut(config.lane as usize).ok_or_else(|| {
            unusable!("brief of episode {}: lane {} of {lanes}", config.episode, config.lane)
        })?;
        if let Some(dropped) = lane.next.replace(episode) {
            self.close(dropped);
        }
        self.admission.push_back((config.lane, config.episode));
        self.admit();
        Ok(())
    }

    /// A step was observed. Returns the frame that [`Self::show`] is then to be told of, when the lane's
    /// memory looks at the current view.
    ///
    /// # Errors
    /// When the observation does not continue an episode, or says what cannot be.
    pub fn observe(
        &mut self,
        seen: &Observation,
        received_ns: u64,
    ) -> Result<Option<FrameId>, Unusable> {
        let unknown =
            || unusable!("observation of unknown episode {} in lane {}", seen.episode, seen.lane);
        let lane = self.lanes.get_mut(seen.lane as usize).ok_or_else(unknown)?;
        if let Some(next) = lane.next.take_if(|next| next.ticket == seen.episode)
            && let Some(abandoned) = lane.running.replace(next)
        {
            self.close(abandoned);
        }
        let running = &mut self.lanes[seen.lane as usize].running;
        if seen.last == 1 {
            let done = running.take_if(|running| running.ticket == seen.episode);
            self.close(done.ok_or_else(unknown)?);
            return Ok(None);
        }
        let running = running.as_mut().filter(|running| running.ticket == seen.episode);
        let running = running.ok_or_else(unknown)?;
        running.observe(seen, &self.warehouse, &self.cases)?;
        running.question = Some(Question { received_ns, content: None });
        if running.representation.matches_views() {
            return Ok(Some(seen.frame));
        }
        self.open.insert(seen.lane);
        Ok(None)
    }

    /// What the current view of a lane is, as [`Self::observe`] asked.
    pub fn show(&mut self, lane: u32, content: ContentHash, picture: P) {
        let running = self.lanes.get_mut(lane as usize).and_then(|lane| lane.running.as_mut());
        let Some(question) = running.and_then(|running| running.question.as_mut()) else { return };
        question.content = Some(content);
        self.open.insert(lane);
        if self.embeddings.get(&content).is_none() && !self.in_flight.contains(&content) {
            self.urgent.push_back((content, picture));
        }
    }

    /// A view that was asked for is resident.
    ///
    /// # Errors
    /// When nobody had asked for it.
    pub fn view(
        &mut self,
        pose: Pose,
        frame: FrameId,
        content: ContentHash,
        picture: P,
    ) -> Result<(), Unusable> {
        match self.views.arrived(pose, Resident { frame, content, picture }) {
            Arrival::Needed { embedded: true } if self.embeddings.get(&content).is_none() => {
                self.background.push_back(pose);
            }
            Arrival::Needed { .. } => {}
            // Its room is free again.
            Arrival::Dismissed => self.admit(),
            Arrival::Unexpected => {
                return Err(unusable!("view of {pose} as frame {frame}, which nobody waits for"));
            }
        }
        Ok(())
    }

    /// The next picture to embed: current views first.
    pub fn next_picture(&mut self) -> Option<(ContentHash, P)> {
        while let Some((content, picture)) = self.urgent.pop_front() {
            if self.start_embedding(content) {
                return Some((content, picture));
            }
        }
        while let Some(pose) = self.background.pop_front() {
            let view = self.views.resident(pose).map(|view| (view.content, view.picture.clone()));
            if let Some((content, picture)) = view
                && self.start_embedding(content)
            {
                return Some((content, picture));
            }
        }
        None
    }

    /// How many pictures are known to wait for their embeddings, those in work included.
    pub fn waiting(&self) -> usize {
        self.urgent.len() + self.background.len() + self.in_flight.len()
    }

    /// How many demonstration views are held, and how many may be.
    pub fn views_held(&self) -> (usize, usize) {
        (self.views.len(), self.views.room())
    }

    fn start_embedding(&mut self, content: ContentHash) -> bool {
        self.embeddings.get(&content).is_none() && self.in_flight.insert(content)
    }

    /// A picture from [`Self::next_picture`] is embedded.
    ///
    /// # Errors
    /// When the cache's file cannot be written; nothing but the next run's speed depends on that.
    pub fn embedded(
        &mut self,
        content: ContentHash,
        embedding: Embedding,
    ) -> Result<(), CacheError> {
        self.in_flight.remove(&content);
        self.embeddings.insert(content, embedding)
    }

    /// Answers every lane that can be answered, in the order of lanes. What they name of `documents` is
    /// published by then.
    ///
    /// # Errors
    /// When a document that a memory supplies cannot be had.
    pub fn answers(
        &mut self,
        clock: impl Fn() -> u64,
        documents: &mut dyn Documents,
    ) -> anyhow::Result<Vec<(Recall, RecallTrace)>> {
        let mut answers = Vec::new();
        for lane in std::mem::take(&mut self.open) {
            let Self { lanes, views, embeddings, .. } = self;
            // The episode may have ended without an answer.
            let Some(episode) = &mut lanes[lane as usize].running else { continue };
            let Some(Question { content, .. }) = episode.question else { continue };
            let embedding = content.and_then(|content| embeddings.get(&content));
            let compares = episode.representation.matches_views();
            let view = |pose| {
                let Resident { frame, content, .. } = views.resident(pose)?;
                let embedding = embeddings.get(content).filter(|_| compares).cloned();
                let is_ready = embedding.is_some() || !compares;
                is_ready.then_some(View { frame: *frame, content: *content, embedding })
            };
            let is_seen = embedding.is_some() || content.is_none();
            if is_seen && episode.admitted && episode.is_built(view, documents)? {
                answers.extend(episode.answer(embedding, &clock));
            } else {
                self.open.insert(lane);
            }
        }
        Ok(answers)
    }

    /// What is to be asked of the simulator since the last call.
    pub fn take_view_requests(&mut self) -> Vec<ViewRequest> {
        self.views.take_requests()
    }

    /// Asks for the views of episodes in the order of their briefs, as far as there is room.
    fn admit(&mut self) {
        while let Some(&(lane, ticket)) = self.admission.front() {
            let lane = &mut self.lanes[lane as usize];
            let mut episodes = [&mut lane.running, &mut lane.next].into_iter().flatten();
            if let Some(episode) = episodes.find(|episode| episode.ticket == ticket) {
                let (poses, embedded) =
                    (episode.blueprint.poses(), episode.representation.matches_views());
                if !self.views.try_hold(poses, embedded) {
                    return;
                }
                episode.admitted = true;
                if embedded {
                    // Those that are there, and were of no interest to the encoder so far.
                    for &pose in poses {
                        if let Some(view) = self.views.resident(pose)
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

    /// Forgets an episode that is in no lane any more.
    fn close(&mut self, episode: Episode) {
        if episode.admitted {
            self.views.release(episode.blueprint.poses());
            self.admit();
        }
    }
}

#[cfg(test)]
mod tests;
