//! Lanes: N episodes at once, each a small state machine. Pure: messages in, messages out.
//!
//! A lane waits for at most one answer. A [`WorldEpisodeConfig`] or a [`StepCommand`] asks the simulator, which shows
//! memory and policy the state and tells the orchestrator how far the episode is ([`StepReport`]). When memory's
//! [`RecallTrace`] and the policy's [`Decision`] are here, the next command goes out. The world knows the task and
//! the step limit: it says when an episode has ended, and sends its facts.
//!
//! Every answer names its episode by an id that is used once. An answer to an earlier episode of the lane is
//! late, and ignored.

use std::collections::{BTreeMap, HashSet};

use case_book::{CaseBook, LearnedEpisode, WorldDeclaration};
use domain::{ExternalName, MemoryKind};
use run_log::{EpisodeRecord, RecallTotals, Stages};
use shm_types::message::{
    Decision, EpisodeId, MAX_EXTERNAL_MEMORIES, MemoryEpisodeConfig, PolicyEpisodeConfig,
    RecallTrace, Role, SnapshotReport, StepCommand, StepReport, WorldEpisodeConfig,
};
use shm_types::notes::Note;

use crate::books::Books;
use crate::plan::PlannedEpisode;
use crate::streams::Experience;

mod answer_error;
mod episode;
mod retrieved;
mod stamps;

pub use answer_error::AnswerError;
use episode::ActiveEpisode;
pub use stamps::Stamps;

/// What all episodes of a run have in common.
#[derive(Debug, Clone, Copy)]
pub struct Rules {
    /// Expert actions that a retrieved segment covers, H_epi.
    pub horizon: u8,
    /// Segments that episodic memory supplies, k.
    pub hits: u8,
    /// Keyframes of full-context memory.
    pub keyframes: u8,
    /// Most images that memory supplies at a step.
    pub memory_images: u16,
    /// Most bytes of text that memory supplies at a step.
    pub memory_text_bytes: u32,
    /// T_max.
    pub max_steps: u32,
    /// Whether the orchestrator itself decides, by replaying the reference.
    pub expert: bool,
    /// The external memories of the run, in the order of their indices.
    pub external_memories: ExternalNames,
}

/// The names of a run's external memories: the position is the index on the wire.
pub type ExternalNames = [Option<ExternalName>; MAX_EXTERNAL_MEMORIES];

impl Rules {
    /// The index of the external memory called `name`.
    fn external_index(&self, name: ExternalName) -> Option<u8> {
        let at = self.external_memories.iter().position(|known| *known == Some(name))?;
        u8::try_from(at).ok()
    }
}

/// A finished episode: its record and its times.
#[derive(Debug, Clone, PartialEq)]
pub struct FinishedEpisode {
    /// Which episode.
    pub episode: PlannedEpisode,
    /// What follows from settings, seed and frames alone.
    pub record: EpisodeRecord,
    /// Nanoseconds in each stage of its steps.
    pub stages: Stages,
    /// What memory supplied.
    pub recalls: RecallTotals,
    /// The lane it ran in.
    pub lane: u32,
    /// Its id on the wire.
    pub id: u64,
    /// When it began, CLOCK_MONOTONIC.
    pub started_ns: u64,
    /// When it ended, CLOCK_MONOTONIC.
    pub ended_ns: u64,
    /// Messages about it that could not be used.
    pub unusable: u32,
}

/// A request to a model that was answered.
#[derive(Debug, Clone, PartialEq)]
pub struct AnsweredRequest {
    /// Key of the episode.
    pub key: String,
    /// The answer, with what it cost.
    pub decision: Decision,
}

/// The messages that begin an episode, in the order in which they are sent.
#[derive(Debug)]
pub struct EpisodeOpening {
    /// For the memory.
    pub memory: MemoryEpisodeConfig,
    /// For the policy.
    pub policy: PolicyEpisodeConfig,
    /// For the simulator.
    pub world: WorldEpisodeConfig,
}

/// What follows from a message.
#[derive(Debug)]
pub enum Turn {
    /// Nothing.
    Wait,
    /// This command is to be sent.
    Command(StepCommand),
    /// The episode is finished and its lane free.
    Finished(Box<FinishedEpisode>),
}

/// An answer that a lane waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PendingAnswer {
    /// The process that owes it.
    pub role: Role,
    /// The lane.
    pub lane: u32,
    /// The memory of its episode.
    pub memory: MemoryKind,
    /// Since when, CLOCK_MONOTONIC.
    pub since_ns: u64,
    /// Messages about the lane's episode that could not be used; the answer may have been among them.
    pub unusable: u32,
}

/// What the steps of all episodes use.
#[derive(Debug)]
struct Context<'w> {
    books: &'w Books,
    rules: Rules,
    now_ns: u64,
    /// By sequence and position: the episodes that a memory has learned from.
    experience: BTreeMap<u64, BTreeMap<u32, Experience>>,
}

impl Context<'_> {
    fn book(&self) -> &CaseBook {
        &self.books.cases.book
    }

    /// What the world says of itself.
    fn declaration(&self) -> &WorldDeclaration {
        &self.book().world.declaration
    }
}

/// The lanes of a run and the episodes in them.
#[derive(Debug)]
pub struct Lanes<'w> {
    context: Context<'w>,
    lanes: Vec<Option<ActiveEpisode>>,
    /// The ids of the episodes that have begun.
    used_ids: HashSet<EpisodeId>,
    answered: Vec<AnsweredRequest>,
    stepped: Vec<Stamps>,
}

impl<'w> Lanes<'w> {
    /// `count` free lanes.
    pub fn new(books: &'w Books, rules: Rules, count: usize) -> Self {
        Self {
            context: Context { books, rules, now_ns: 0, experience: BTreeMap::new() },
            lanes: std::iter::repeat_with(|| None).take(count).collect(),
            used_ids: HashSet::new(),
            answered: Vec::new(),
            stepped: Vec::new(),
        }
    }

    /// Adds an episode that is in the log and that the memory of its sequence has learned from.
    pub fn remember(&mut self, sequence: u64, position: u32, experience: Experience) {
        self.context.experience.entry(sequence).or_default().insert(position, experience);
    }

    /// What the world says of itself.
    pub fn declaration(&self) -> &WorldDeclaration {
        self.context.declaration()
    }

    /// The episodes that memories have learned from, for a simulator that starts now.
    pub fn learned_episodes(&self) -> Vec<LearnedEpisode> {
        let sequences = self.context.experience.iter();
        let all = sequences.flat_map(|(&sequence, of)| {
            of.iter().map(move |(&position, of)| {
                of.as_learned(self.context.declaration(), sequence, position)
            })
        });
        all.collect()
    }

    /// Sets the time, CLOCK_MONOTONIC, that holds until the next call: reading the clock for every message would
    /// cost as much as handling it.
    pub fn set_time(&mut self, now_ns: u64) {
        self.context.now_ns = now_ns;
    }

    /// The time that was set last.
    pub fn time(&self) -> u64 {
        self.context.now_ns
    }

    /// A free lane.
    pub fn free(&self) -> Option<usize> {
        self.lanes.iter().position(Option::is_none)
    }

    /// Number of episodes under way.
    pub fn busy(&self) -> usize {
        self.lanes.iter().flatten().count()
    }

    /// Begins `episode` in the free lane `lane`.
    pub fn begin(&mut self, lane: usize, episode: PlannedEpisode) -> EpisodeOpening {
        // Episodes that differ in their mismatch alone have the same seed.
        let mismatch = episode.key.condition.mismatch as u64;
        let id = self.unused_id(episode.seed.wrapping_add(mismatch));
        let mut active = ActiveEpisode::new(&self.context, id, lane as u32, episode);
        let opening = active.opening(&self.context);
        self.lanes[lane] = Some(active);
        opening
    }

    /// The id of the next attempt at the episode with this seed and mismatch. No other attempt of the session has it.
    fn unused_id(&mut self, seed: u64) -> EpisodeId {
        let mut attempt = 1;
        loop {
            let id = episode_id(seed, attempt);
            if id != 0 && self.used_ids.insert(id) {
                return id;
            }
            attempt += 1;
        }
    }

    /// Takes the simulator's answer. The facts of episodes that have ended are among `notes`.
    ///
    /// # Errors
    /// When it cannot be used. After [`AnswerError::Invalid`] the episode cannot go on: [`Lanes::give_up`].
    pub fn reported(&mut self, report: &StepReport, notes: &[Note]) -> Result<Turn, AnswerError> {
        let &StepReport { lane, episode, .. } = report;
        let (context, stepped) = (&self.context, &mut self.stepped);
        let Some(active) = find(&mut self.lanes, Role::Sim, lane, episode)? else {
            return Ok(Turn::Wait);
        };
        if active.reported(context, report, notes)? {
            // A memory that learns from it reports when it has.
            return if active.learns() { Ok(Turn::Wait) } else { self.finish(lane) };
        }
        let turn = if context.rules.expert {
            Some(active.expert_step(context)?)
        } else {
            active.settle(context, &mut self.answered)?
        };
        Ok(taken(turn, stepped))
    }

    /// Takes memory's trace of a recall.
    ///
    /// # Errors
    /// When it cannot be used. After [`AnswerError::Invalid`] the episode cannot go on: [`Lanes::give_up`].
    pub fn recalled(&mut self, trace: &RecallTrace) -> Result<Turn, AnswerError> {
        let &RecallTrace { lane, episode, .. } = trace;
        let Some(active) = find(&mut self.lanes, Role::Memory, lane, episode)? else {
            return Ok(Turn::Wait);
        };
        active.recalled(&self.context, trace)?;
        Ok(taken(active.settle(&self.context, &mut self.answered)?, &mut self.stepped))
    }

    /// Takes the policy's answer.
    ///
    /// # Errors
    /// When it cannot be used. After [`AnswerError::Invalid`] the episode cannot go on: [`Lanes::give_up`].
    pub fn decided(&mut self, decision: &Decision) -> Result<Turn, AnswerError> {
        let &Decision { lane, episode, .. } = decision;
        let Some(active) = find(&mut self.lanes, Role::Policy, lane, episode)? else {
            return Ok(Turn::Wait);
        };
        active.decided(&self.context, decision)?;
        Ok(taken(active.settle(&self.context, &mut self.answered)?, &mut self.stepped))
    }

    /// Takes memory's report that it has learned from an episode.
    ///
    /// # Errors
    /// When it cannot be used.
    pub fn learned(&mut self, report: &SnapshotReport) -> Result<Turn, AnswerError> {
        let &SnapshotReport { lane, episode, .. } = report;
        let Some(active) = find(&mut self.lanes, Role::Memory, lane, episode)? else {
            return Ok(Turn::Wait);
        };
        active.learned(report)?;
        self.finish(lane)
    }

    /// Ends the episode of a lane.
    ///
    /// # Errors
    /// When what the simulator has told contradicts itself.
    fn finish(&mut self, lane: u32) -> Result<Turn, AnswerError> {
        let Some(active) = &self.lanes[lane as usize] else { return Ok(Turn::Wait) };
        let finished = active.clone().finish(&self.context);
        let step = finished.record.steps;
        let checked = finished.record.check(self.context.rules.max_steps);
        checked.map_err(|problem| AnswerError::Invalid { role: Role::Sim, lane, step, problem })?;
        self.lanes[lane as usize] = None;
        let FinishedEpisode { episode, record, .. } = &finished;
        if let (true, Some(part), Some(place)) = (episode.learns(), episode.part, episode.key.place)
        {
            let variant = episode.variant(self.context.book());
            if let Some(experience) = Experience::of(episode.case_index, variant, record) {
                self.remember(part.sequence, place.position, experience);
            }
        }
        Ok(Turn::Finished(Box::new(finished)))
    }

    /// Whether a decision arrived before what it is based on, which is on its way.
    pub fn has_early_decision(&self) -> bool {
        self.lanes.iter().flatten().any(ActiveEpisode::has_early_decision)
    }

    /// The requests to a model that were answered since the last call.
    pub fn take_answered(&mut self) -> Vec<AnsweredRequest> {
        std::mem::take(&mut self.answered)
    }

    /// The steps that were taken since the last call.
    pub fn take_stepped(&mut self) -> std::vec::Drain<'_, Stamps> {
        self.stepped.drain(..)
    }

    /// The memory of the episode `id`, if that runs in the lane.
    pub fn memory_of(&self, lane: u32, id: u64) -> Option<MemoryKind> {
        let active = self.lanes.get(lane as usize)?.as_ref()?;
        (active.id() == id).then(|| active.memory())
    }

    /// Frees the lane if the episode `id` runs in it, and returns that episode.
    pub fn give_up_episode(&mut self, lane: u32, id: u64) -> Option<PlannedEpisode> {
        let active = self.lanes.get_mut(lane as usize)?.take_if(|active| active.id() == id)?;
        Some(active.into_episode())
    }

    /// Frees the lane and returns its episode.
    pub fn give_up(&mut self, lane: u32) -> Option<PlannedEpisode> {
        self.lanes.get_mut(lane as usize)?.take().map(ActiveEpisode::into_episode)
    }

    /// Frees all lanes and returns their episodes.
    pub fn give_up_all(&mut self) -> Vec<PlannedEpisode> {
        let active = self.lanes.iter_mut().filter_map(Option::take);
        active.map(ActiveEpisode::into_episode).collect()
    }

    /// The answers that lanes wait for. The wait for memory begins at `memory_busy_ns`, when memory was last known to
    /// make progress, if that is later.
    pub fn pending(&self, memory_busy_ns: u64) -> Vec<PendingAnswer> {
        let active =
            (0..).zip(&self.lanes).filter_map(|(lane, active)| Some((lane, active.as_ref()?)));
        active.map(|(lane, active)| active.pending(lane, memory_busy_ns)).collect()
    }
}

/// The id on the wire of an attempt at an episode: the first 8 bytes, as a little-endian number, of the BLAKE3 hash of
/// `memtransfer episode id v1`, a zero byte, the [seed](conditions::key::EpisodeKey::seed) of the episode plus the code of its
/// mismatch, and the number of the attempt, both as 8 little-endian bytes.
///
/// So ids are the same whatever the lanes and whatever was executed before, and tell no more than the seed.
fn episode_id(seed: u64, attempt: u64) -> EpisodeId {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"memtransfer episode id v1\0");
    hasher.update(&seed.to_le_bytes());
    hasher.update(&attempt.to_le_bytes());
    let first = hasher.finalize();
    let first = first.as_bytes().first_chunk::<8>();
    first.copied().map_or(0, u64::from_le_bytes)
}

/// The episode that a message is about; `None` when the message is late.
fn find(
    lanes: &mut [Option<ActiveEpisode>],
    role: Role,
    lane: u32,
    id: u64,
) -> Result<Option<&mut ActiveEpisode>, AnswerError> {
    let count = lanes.len();
    let active = lanes.get_mut(lane as usize);
    let active = active.ok_or(AnswerError::NoSuchLane { role, lane, lanes: count })?;
    Ok(active.as_mut().filter(|active| active.id() == id))
}

/// Notes that a step was taken, if one was.
fn taken(step: Option<(StepCommand, Stamps)>, stepped: &mut Vec<Stamps>) -> Turn {
    let Some((command, stamps)) = step else { return Turn::Wait };
    stepped.push(stamps);
    Turn::Command(command)
}
