//! All lanes of a run: which of them can be answered, and what the others wait for.
//!
//! The engine takes messages and finished embeddings in any order and returns what to send and what to embed next. It
//! never waits: a lane whose views, embeddings or memory are not ready stays pending while others are answered.
//! Its answers depend on the messages only, not on their timing or on other lanes.
//!
//! Its only input and output are the embedding cache's file and the snapshots of memories that learn; [`crate::serve`]
//! connects it to the bus, the encoder and the documents.

mod external;

use std::collections::{BTreeMap, BTreeSet, HashSet, VecDeque};
use std::sync::Arc;

use anyhow::Context;

use crate::bank::BankSteps;
use crate::demonstrations::{DemonstrationLibrary, ViewId};
use crate::embedded_views::EmbeddedViews;
use crate::embedding_cache::{CacheError, EmbeddingCache};
use crate::episode::{MemoryEpisode, PendingObservation, PendingStage, Reason, Unready};
use crate::external::{ExternalMemories, ToExternal};
use crate::hosted::{HostedMemory, MemoryHost};
use crate::items::{Assembler, DocumentSupplier};
use crate::sequences::SequenceMemories;
use crate::snapshots::SnapshotFolder;
use crate::views::{Arrival, PinnedView};
use search::{ContentHash, Embedding};
use shm_types::message::{
    FrameId, MemoryEpisodeConfig, Observation, Recall, RecallTrace, SnapshotReport, StepReport,
    ViewRequest,
};

/// The lanes of a run. `I` is a source of a frame's pixels, which the engine passes on to the encoder.
pub struct Engine<I> {
    library: DemonstrationLibrary,
    lanes: Vec<EngineLane>,
    /// Lanes with a pending observation.
    pending: BTreeSet<u32>,
    views: EmbeddedViews<I>,
    /// Episodes whose views have not been requested, by lane and number, in order of arrival.
    admission: VecDeque<(u32, u64)>,
    /// Current views to embed, which observations wait for.
    urgent: VecDeque<(ContentHash, I)>,
    in_flight: HashSet<ContentHash>,
    externals: ExternalMemories,
    sequences: SequenceMemories,
    /// Reports of memories that have learned.
    learned: Vec<SnapshotReport>,
    /// Episodes that cannot go on.
    failures: Vec<EpisodeFailure>,
}

#[derive(Default)]
struct EngineLane {
    /// The reports of steps whose observations have not been taken, in order.
    reports: VecDeque<StepReport>,
    /// The episode whose steps are observed.
    running: Option<MemoryEpisode>,
    /// Its memory, once there is one. `None` for that of a sequence.
    memory: Option<HostedMemory>,
    /// The announced episode that has not begun.
    next: Option<MemoryEpisode>,
}

/// What an episode cannot go on for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EpisodeFailure {
    /// Its lane.
    pub lane: u32,
    /// The episode.
    pub episode: u64,
    /// The reason.
    pub why: String,
    /// Whether its external memory has exceeded a time limit.
    pub is_overdue: bool,
}

/// What a lane sends.
enum LaneMessage {
    /// The answer to its pending observation.
    Answer(Box<(Recall, RecallTrace)>),
    /// Its episode is over, and its memory has learned from it.
    Learned(SnapshotReport),
}

impl<I: Clone> Engine<I> {
    /// Creates an engine for `lanes` lanes, with room for `views` demonstration views. Without a folder for `snapshots`, no
    /// memory can learn.
    pub fn new(
        library: DemonstrationLibrary,
        lanes: u32,
        views: usize,
        embeddings: EmbeddingCache,
        externals: ExternalMemories,
        snapshots: Option<SnapshotFolder>,
    ) -> Self {
        Self {
            library,
            lanes: (0..lanes).map(|_| EngineLane::default()).collect(),
            pending: BTreeSet::new(),
            views: EmbeddedViews::new(views, embeddings),
            admission: VecDeque::new(),
            urgent: VecDeque::new(),
            in_flight: HashSet::new(),
            externals,
            sequences: SequenceMemories::new(snapshots, lanes),
            learned: Vec::new(),
            failures: Vec::new(),
        }
    }

    /// Takes an announced episode, and requests its views.
    ///
    /// # Errors
    /// When a value in the message is invalid, or its views do not fit.
    pub fn config(&mut self, config: &MemoryEpisodeConfig) -> Result<(), String> {
        let Self { externals, library, .. } = self;
        let external = |set| match config.sequence {
            0 => externals.of_bank(config, set, library),
            _ => externals.of_sequence(config),
        };
        let refused = |what: String| format!("config of episode {}: {what}", config.episode);
        let episode = MemoryEpisode::announced(config, library, external).map_err(refused)?;
        if episode.learns() && !self.sequences.can_save() {
            let what = "its memory learns, and memory-proc was started without --snapshots";
            return Err(refused(what.to_owned()));
        }
        let (needed, room) = (episode.view_ids().len(), self.views.pinned.room());
        if needed > room {
            return Err(refused(format!(
                "its memory needs {needed} views and there is room for {room}: raise --frame-budget or lower --lanes"
            )));
        }
        let lanes = self.lanes.len();
        let lane = self.lanes.get_mut(config.lane as usize);
        let lane = lane.ok_or_else(|| refused(format!("lane {} of {lanes}", config.lane)))?;
        if let Some(bank) = episode.own_bank() {
            self.externals.retain(bank);
        }
        if let Some(dropped) = lane.next.replace(episode) {
            self.close(dropped, None);
        }
        self.admission.push_back((config.lane, config.episode));
        self.admit();
        Ok(())
    }

    /// Takes the report of a step, before its observation.
    ///
    /// # Errors
    /// When there is no such lane.
    pub fn step_report(&mut self, report: &StepReport) -> Result<(), String> {
        let StepReport { lane, episode, .. } = *report;
        let known = self.lanes.get_mut(lane as usize);
        let known =
            known.ok_or_else(|| format!("step report of episode {episode} in lane {lane}"))?;
        known.reports.push_back(*report);
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
    ) -> Result<Option<FrameId>, String> {
        let unknown =
            || format!("observation of unknown episode {} in lane {}", seen.episode, seen.lane);
        let lane = self.lanes.get_mut(seen.lane as usize).ok_or_else(unknown)?;
        let is_of_step =
            |report: &StepReport| (report.episode, report.step) == (seen.episode, seen.step);
        // Those before it belong to observations that could not be used.
        let report = lane.reports.iter().position(is_of_step);
        let report = report.and_then(|at| lane.reports.drain(..=at).next_back());
        let report = report.ok_or_else(|| {
            format!(
                "observation of episode {}, step {}, without a step report",
                seen.episode, seen.step
            )
        })?;
        if let Some(next) = lane.next.take_if(|next| next.id == seen.episode)
            && let (Some(abandoned), memory) = (lane.running.replace(next), lane.memory.take())
        {
            self.close(abandoned, memory);
        }
        let EngineLane { running, memory, .. } = &mut self.lanes[seen.lane as usize];
        let is_last = seen.last == 1;
        let done = running.take_if(|own| own.id == seen.episode && is_last && !own.learns());
        if let Some(mut done) = done {
            let memory = memory.take();
            // What is wrong with the message changes nothing any more.
            let _ = done.observe(self.library.world(), seen, &report);
            self.close(done, memory);
            return Ok(None);
        }
        let running = running.as_mut().filter(|running| running.id == seen.episode);
        let running = running.ok_or_else(unknown)?;
        running.observe(self.library.world(), seen, &report)?;
        let stage = if is_last { PendingStage::Ended } else { PendingStage::New };
        running.pending = Some(PendingObservation { received_ns, content: None, stage });
        if running.embeds && !is_last {
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
        if self.views.embeddings.get(&content).is_none() && !self.in_flight.contains(&content) {
            self.urgent.push_back((content, image));
        }
    }

    /// Takes a requested view, which is in the frame store now.
    ///
    /// # Errors
    /// When it was not requested.
    pub fn view(
        &mut self,
        view_id: ViewId,
        frame: FrameId,
        content: ContentHash,
        image: I,
    ) -> Result<(), String> {
        match self.views.pinned.arrived(view_id, PinnedView { frame, content, image }) {
            Arrival::Needed { embedded: true } if self.views.embeddings.get(&content).is_none() => {
                self.views.background.push_back(view_id);
            }
            Arrival::Needed { .. } => {}
            // That leaves room for another.
            Arrival::Dismissed => self.admit(),
            Arrival::Unexpected => {
                let ViewId { sequence, number, step } = view_id;
                return Err(format!(
                    "view of step {step} of demonstration {number} of sequence {sequence} as frame {frame}, which was \
                     not requested"
                ));
            }
        }
        Ok(())
    }

    /// The running episode of a lane gets no answer.
    fn fail(&mut self, lane: u32, why: impl Into<Reason>) {
        self.pending.remove(&lane);
        let running = self.lanes.get_mut(lane as usize).and_then(|lane| lane.running.as_mut());
        if let Some(running) = running
            && running.pending.take().is_some()
        {
            let Reason { text: why, is_overdue } = why.into();
            self.failures.push(EpisodeFailure { lane, episode: running.id, why, is_overdue });
        }
    }

    /// The episodes that cannot go on, since the last call.
    pub fn take_failures(&mut self) -> Vec<EpisodeFailure> {
        std::mem::take(&mut self.failures)
    }

    /// The reports of memories that have learned from an episode, since the last call.
    pub fn take_snapshot_reports(&mut self) -> Vec<SnapshotReport> {
        std::mem::take(&mut self.learned)
    }

    /// The messages to external memories that have arisen since the last call, in order.
    pub fn take_external_messages(&mut self) -> Vec<(u8, ToExternal)> {
        self.externals.take_messages()
    }

    /// The next image to embed: current views first. One that another process has embedded is left out.
    pub fn next_image(&mut self) -> Option<(ContentHash, I)> {
        while let Some((content, image)) = self.urgent.pop_front() {
            if self.start_embedding(content) {
                return Some((content, image));
            }
        }
        while let Some(view_id) = self.views.background.pop_front() {
            let view =
                self.views.pinned.get(view_id).map(|view| (view.content, view.image.clone()));
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
        self.urgent.len() + self.views.background.len() + self.in_flight.len()
    }

    /// Number of demonstration views that are pinned, and that may be.
    pub fn pinned_views(&self) -> (usize, usize) {
        (self.views.pinned.len(), self.views.pinned.room())
    }

    fn start_embedding(&mut self, content: ContentHash) -> bool {
        let embeddings = &mut self.views.embeddings;
        embeddings.get(&content).is_none()
            && !self.in_flight.contains(&content)
            && !embeddings.find_stored(&content)
            && self.in_flight.insert(content)
    }

    /// Number of known embeddings.
    pub fn known_embeddings(&self) -> usize {
        self.views.embeddings.len()
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
        self.views.embeddings.insert(content, embedding)
    }

    /// Writes new embeddings to the cache's file if a batch is due.
    ///
    /// # Errors
    /// As [`Self::add_embedding`].
    pub fn write_embeddings(&mut self) -> Result<(), CacheError> {
        self.views.embeddings.write_if_due()
    }

    /// Answers every lane that can be answered, in the order of lanes. The documents that answers name have been published.
    ///
    /// # Errors
    /// When a document is missing or cannot be published, or a built-in memory fails.
    pub fn answers(
        &mut self,
        clock: impl Fn() -> u64,
        documents: &mut dyn DocumentSupplier,
    ) -> anyhow::Result<Vec<Box<(Recall, RecallTrace)>>> {
        self.fail_deserted(clock());
        let asked_ns = self.oldest_questions();
        self.externals.build_banks(&mut self.views, &asked_ns, clock());
        for collecting in self.sequences.unfinished_banks() {
            self.views.collect(collecting, true);
        }
        let mut answers = Vec::new();
        for lane in std::mem::take(&mut self.pending) {
            match self.advance(lane, &clock, documents) {
                Ok(Some(LaneMessage::Answer(messages))) => answers.push(messages),
                Ok(Some(LaneMessage::Learned(report))) => {
                    self.learned.push(report);
                    if let Some(done) = self.lanes[lane as usize].running.take() {
                        self.close(done, None);
                    }
                }
                // The episode may have ended without an answer.
                Ok(None) => {}
                Err(Unready::Waiting) => drop(self.pending.insert(lane)),
                Err(Unready::Refused(why)) => self.fail(lane, why),
                Err(Unready::Broken(error)) => return Err(error),
            }
        }
        self.admit();
        Ok(answers)
    }

    /// Gets the pending observation of a lane as far as it can get now. `None` if there is none.
    fn advance(
        &mut self,
        lane: u32,
        clock: &dyn Fn() -> u64,
        documents: &mut dyn DocumentSupplier,
    ) -> Result<Option<LaneMessage>, Unready> {
        let Self { lanes, library, views, externals, sequences, .. } = self;
        let EngineLane { running, memory, .. } = &mut lanes[lane as usize];
        let Some(episode) = running.as_mut().filter(|running| running.pending.is_some()) else {
            return Ok(None);
        };
        let mut host = MemoryHost { library, views, externals, documents, clock };
        if !episode.begun {
            match episode.stream {
                Some(_) => sequences.bind(episode, &mut host)?,
                None => begin_own(episode, memory, &mut host)?,
            }
            episode.begun = true;
        }
        match episode.pending.as_ref().map(|pending| &pending.stage) {
            Some(PendingStage::Ended) => {
                let report = sequences.learn(episode, host.externals, clock())?;
                return Ok(Some(LaneMessage::Learned(report)));
            }
            Some(PendingStage::New | PendingStage::Asked { .. }) => {
                let memory = match &episode.stream {
                    Some(part) => sequences.of(part.sequence).map(|known| &mut known.memory),
                    None => memory.as_mut(),
                };
                let answer = memory.ok_or("its memory is gone")?.ask(episode, &mut host)?;
                if let Some(pending) = &mut episode.pending {
                    pending.stage = PendingStage::Answered(Box::new(answer));
                }
            }
            Some(PendingStage::Answered(_)) | None => {}
        }
        supply(episode, &mut host)
    }

    /// When the oldest question that is open was asked, by external memory.
    fn oldest_questions(&self) -> BTreeMap<u8, u64> {
        let mut asked_ns = BTreeMap::new();
        for running in self.lanes.iter().filter_map(|lane| lane.running.as_ref()) {
            let stage = running.pending.as_ref().map(|pending| &pending.stage);
            if let (Some(index), Some(&PendingStage::Asked { since_ns, .. })) =
                (running.external(), stage)
            {
                let oldest = asked_ns.entry(index).or_insert(since_ns);
                *oldest = since_ns.min(*oldest);
            }
        }
        asked_ns
    }

    /// Ends the building of a bank.
    fn finish_bank(&mut self, id: u64, outcome: Result<u64, Reason>) {
        self.externals.finish(id, outcome, &mut self.views);
        self.admit();
    }

    /// The view requests that have arisen since the last call.
    pub fn take_view_requests(&mut self) -> Vec<ViewRequest> {
        self.views.pinned.take_requests()
    }

    /// Requests the views of announced episodes, in order, as long as there is room.
    fn admit(&mut self) {
        while let Some(&(lane, id)) = self.admission.front() {
            let lane = &mut self.lanes[lane as usize];
            let mut episodes = [&mut lane.running, &mut lane.next].into_iter().flatten();
            if let Some(episode) = episodes.find(|episode| episode.id == id) {
                if !self.views.try_pin(episode.view_ids(), episode.embeds) {
                    return;
                }
                episode.admitted = true;
            }
            self.admission.pop_front();
        }
    }

    /// Drops an episode that has left its lane, with its own memory.
    fn close(&mut self, episode: MemoryEpisode, memory: Option<HostedMemory>) {
        if episode.admitted {
            self.views.pinned.release(episode.view_ids());
        }
        self.views.pinned.release(&episode.recalled);
        self.sequences.release(&episode, &mut self.externals);
        if let Some(mut memory) = memory {
            // It was not told anything that it could fail at.
            let _ = memory.end(&episode, None, &mut self.externals);
        }
        if let Some(bank) = episode.own_bank() {
            self.externals.release(bank);
        }
        self.admit();
    }
}

/// Builds the memory of an episode that is not part of a sequence, and tells it that the episode begins.
fn begin_own<I: Clone>(
    episode: &mut MemoryEpisode,
    memory: &mut Option<HostedMemory>,
    host: &mut MemoryHost<'_, I>,
) -> Result<(), Unready> {
    let MemoryHost { views, externals, documents, clock, .. } = host;
    let mut built = match episode.own_bank() {
        Some(bank) => HostedMemory::External { bank, to_load: None },
        None => {
            let MemoryEpisode { bank, embeds, ready, pins_bank, admitted, .. } = episode;
            let is_known = |ready| views.are_known(&bank.view_ids, ready, *embeds);
            if !*admitted || *pins_bank && !is_known(ready) {
                return Err(Unready::Waiting);
            }
            let view = |view_id| views.known(view_id, *embeds);
            let steps = match pins_bank {
                true => bank.with_views(view).context("a view of the bank is missing")?,
                false => BankSteps::without_views(bank),
            };
            HostedMemory::build(&episode.kind, steps, externals, *documents, clock())?
        }
    };
    built.begin(episode, externals, clock())?;
    *memory = Some(built);
    Ok(())
}

/// Puts the recall for the answer to an episode's pending observation together, once the views that it names are resident.
///
/// # Errors
/// When a document cannot be published.
fn supply<I: Clone>(
    episode: &mut MemoryEpisode,
    host: &mut MemoryHost<'_, I>,
) -> Result<Option<LaneMessage>, Unready> {
    let views = &mut *host.views;
    let stage = episode.pending.as_mut().map(|pending| &mut pending.stage);
    let Some(PendingStage::Answered(answer)) = stage else { return Ok(None) };
    let is_known = episode.last.as_ref().is_some_and(|last| Arc::ptr_eq(&last.0, &answer.checked));
    if !is_known {
        let view_ids = &answer.checked.view_ids;
        if !episode.pins_bank && !answer.pinned {
            let (needed, room) = (view_ids.len(), views.pinned.room());
            if needed > room {
                let why = format!(
                    "its memory names {needed} views and there is room for {room}: raise --frame-budget or lower \
                     --memory-images"
                );
                return Err(why.into());
            }
            let mut is_pinned = views.try_pin(view_ids, false);
            let earlier = std::mem::take(&mut episode.recalled);
            views.pinned.release(&earlier);
            if !is_pinned {
                episode.last = None;
                is_pinned = views.try_pin(view_ids, false);
            }
            if is_pinned {
                episode.recalled.clone_from(view_ids);
                answer.pinned = true;
            }
        }
        let is_resident = (episode.pins_bank || answer.pinned)
            && view_ids.iter().all(|&view_id| views.pinned.get(view_id).is_some());
        if !is_resident {
            return Err(Unready::Waiting);
        }
        let mut assembler = Assembler {
            bank: &episode.bank,
            episode: (episode.lane, episode.id),
            texts: &mut episode.texts,
            documents: &mut *host.documents,
        };
        let frame = |view_id| views.pinned.get(view_id).map(|view| view.frame);
        let assembled = assembler.assemble(&answer.checked, frame)?;
        episode.last = Some((answer.checked.clone(), assembled));
    }
    let messages = episode.take_messages((host.clock)());
    Ok(messages.map(|messages| LaneMessage::Answer(Box::new(messages))))
}

#[cfg(test)]
mod tests;
