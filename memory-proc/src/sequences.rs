//! Memories that persist from episode to episode of a stream, and those that episodes share because their bank is large.
//!
//! A sequence is one stream in one order with one condition. Its episodes run one after the other and share one memory,
//! which is built from the bank of the stream and then continues from snapshot to snapshot: an episode that the memory
//! learns from begins with the snapshot that its config names and ends with a new one. What a memory knows therefore
//! depends on the log only, and not on crashes. A memory in another state than the one that is asked for is dropped, and
//! built or loaded again.
//!
//! Outside of streams, the episodes with one bank and one kind of memory share it as they would in the arm `frozen`.
//!
//! What is not here: which episodes are learned from, and in which order (the orchestrator).

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::task::Poll;

use anyhow::Context;
use bytemuck::Zeroable;
use domain::{Action, Feedback, FeedbackLevel, Pose};
use peer::memory::{Episode, EpisodeEnd, Memory};
use serde::{Deserialize, Serialize};
use shm_types::message::{EXPERIENCE, SnapshotId, SnapshotReport};

use crate::bank::{BankSteps, Collecting, MemoryBank};
use crate::demonstrations::{BankOrigin, DemonstrationLibrary, RememberedDemonstration};
use crate::episode::{EpisodeMemory, MemoryEpisode, PendingStage, Reason, build_built_in};
use crate::external::ExternalMemories;
use crate::items::DocumentSupplier;
use crate::snapshots::SnapshotFolder;

/// Banks that are kept when no memory waits for them.
const KEPT_BANKS: usize = 16;

/// Bytes of the memories that are kept without an episode.
const KEPT_BYTES: u64 = 256 << 20;

/// The host's part of a snapshot, and the folder of the memory's own files.
const EXPERIENCE_FILE: &str = "experience.json";
const MEMORY_FOLDER: &str = "memory";

/// What an episode of a stream has beside what every episode has.
pub(crate) struct SequenceEpisode {
    pub(crate) sequence: u64,
    /// The snapshot that it begins with; zero: the memory as it was built.
    pub(crate) snapshot: SnapshotId,
    pub(crate) origin: BankOrigin,
    pub(crate) feedback: FeedbackLevel,
    /// What has happened so far, if the memory learns from it.
    pub(crate) recording: Option<Recording>,
    /// Whether the memory has been told that the episode begins.
    pub(crate) begun: bool,
}

/// An episode so far, as the demonstration that it becomes.
#[derive(Debug)]
pub(crate) struct Recording {
    pub(crate) lived: RememberedDemonstration,
    pub(crate) is_complete: bool,
}

/// An episode that a memory has learned from, as it is stored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct StoredExperience {
    position: u32,
    instruction: String,
    poses: Vec<Pose>,
    /// The codes of the feedback.
    feedback: Vec<u8>,
    /// The steps at which sub-goals were completed.
    sub_goals: Vec<u32>,
    /// The letters of the actions; [`NO_LETTER`] where there was none.
    actions: String,
}

/// Stands for an action that could not be read.
const NO_LETTER: char = '-';

impl StoredExperience {
    /// An episode, as it was lived.
    fn new(lived: &RememberedDemonstration) -> Self {
        let letter = |action: &Option<Action>| action.map_or(NO_LETTER, Action::letter);
        Self {
            position: lived.case,
            instruction: lived.instruction.clone(),
            poses: lived.poses.clone(),
            feedback: lived.feedback.iter().map(|feedback| *feedback as u8).collect(),
            sub_goals: lived.sub_goals(),
            actions: lived.actions.iter().map(letter).collect(),
        }
    }

    /// The episode, of this sequence; `None` if its parts do not belong together.
    pub(crate) fn lived(self, sequence: u64) -> Option<RememberedDemonstration> {
        let action = |letter| match letter {
            NO_LETTER => Some(None),
            letter => Action::from_letter(letter).map(Some),
        };
        let feedback = self.feedback.iter().map(|code| Feedback::try_from(*code).ok());
        let stage = |step: u32| self.sub_goals.iter().filter(|at| **at <= step).count() as u32;
        let lived = RememberedDemonstration {
            case: self.position,
            number: EXPERIENCE,
            views: RememberedDemonstration::lived_views(sequence, self.position, &self.poses),
            stages: (0..self.poses.len() as u32).map(stage).collect(),
            feedback: feedback.collect::<Option<_>>()?,
            actions: self.actions.chars().map(action).collect::<Option<_>>()?,
            instruction: self.instruction,
            poses: self.poses,
        };
        let states = lived.poses.len();
        ((lived.feedback.len(), lived.actions.len() + 1) == (states, states)).then_some(lived)
    }
}

/// The bank of a stream, and the embeddings of its views.
#[derive(Debug)]
pub(crate) struct StreamBank {
    bank: Arc<MemoryBank>,
    pub(crate) collecting: Collecting,
}

impl StreamBank {
    /// Its steps, with the views that have been collected if they are `embedded`. `None` while one is missing.
    fn steps(&self, embedded: bool) -> Option<BankSteps<'_>> {
        match embedded {
            true => self.bank.with_views(|at| self.collecting.found.get(&at).cloned()),
            false => Some(BankSteps::without_views(&self.bank)),
        }
    }
}

/// The memory of a sequence.
pub(crate) struct SequenceMemory {
    origin: BankOrigin,
    /// The demonstrations that it was built from, then the episodes that it has learned from.
    pub(crate) bank: Arc<MemoryBank>,
    snapshot: SnapshotId,
    /// The episode that it learns from now: until that ends it is in no state that a snapshot has.
    learning: Option<u64>,
    /// The episodes that use it.
    users: BTreeSet<u64>,
    pub(crate) memory: KeptMemory,
}

/// A memory that persists.
pub(crate) enum KeptMemory {
    BuiltIn(Box<dyn Memory>),
    /// The external memory that was built from the host's bank with this id.
    External {
        bank: u64,
        /// The folder that it has yet to load from, and whether it has been asked to.
        to_load: Option<(PathBuf, bool)>,
    },
}

impl KeptMemory {
    /// Bytes of its store in this process, as far as it tells them.
    fn store_bytes(&self) -> u64 {
        match self {
            Self::BuiltIn(memory) => memory.store_bytes().unwrap_or(0),
            Self::External { .. } => 0,
        }
    }
}

/// Whether an episode has its memory.
pub(crate) enum Binding {
    /// It has.
    Ready,
    /// Views of the bank are not known yet, or an external memory is being built.
    Waiting,
    /// It cannot have it.
    Refused(Reason),
}

/// The memories of the sequences that run, and the banks of their streams.
pub(crate) struct SequenceMemories {
    snapshots: Option<SnapshotFolder>,
    memories: BTreeMap<u64, SequenceMemory>,
    /// Memories without an episode that are kept.
    kept: usize,
    /// Sequences, the last used last.
    recent: Vec<u64>,
    /// Banks, the last used last. The flag: with embeddings.
    banks: Vec<((BankOrigin, bool), StreamBank)>,
    /// Banks of external memories that are not needed any more.
    dropped: Vec<u64>,
}

impl SequenceMemories {
    pub(crate) fn new(snapshots: Option<SnapshotFolder>, lanes: u32) -> Self {
        let kept = lanes as usize;
        Self {
            snapshots,
            memories: BTreeMap::new(),
            kept,
            recent: Vec::new(),
            banks: Vec::new(),
            dropped: Vec::new(),
        }
    }

    /// The banks of external memories that have been dropped since the last call.
    pub(crate) fn take_dropped(&mut self) -> Vec<u64> {
        std::mem::take(&mut self.dropped)
    }

    fn drop_memory(&mut self, sequence: u64) {
        if let Some(SequenceMemory { memory: KeptMemory::External { bank, .. }, .. }) =
            self.memories.remove(&sequence)
        {
            self.dropped.push(bank);
        }
    }

    /// Whether memories can learn.
    pub(crate) fn can_save(&self) -> bool {
        self.snapshots.is_some()
    }

    /// The banks whose views are not known.
    pub(crate) fn unfinished_banks(&mut self) -> impl Iterator<Item = &mut Collecting> {
        let collecting = self.banks.iter_mut().map(|(_, bank)| &mut bank.collecting);
        collecting.filter(|collecting| !collecting.is_complete())
    }

    /// Gives an episode the memory of its sequence, in the state that the episode's config names.
    ///
    /// # Errors
    /// When a document is missing or a built-in memory cannot be built.
    pub(crate) fn bind(
        &mut self,
        episode: &mut MemoryEpisode,
        library: &DemonstrationLibrary,
        documents: &mut dyn DocumentSupplier,
        (externals, now_ns): (&mut ExternalMemories, u64),
    ) -> anyhow::Result<Binding> {
        let Some(part) = &mut episode.stream else {
            return Ok(Binding::Refused("it is no part of a stream".into()));
        };
        let sequence = part.sequence;
        let is_usable = |memory: &SequenceMemory| {
            memory.origin == part.origin
                && memory.snapshot == part.snapshot
                && memory.learning.is_none()
        };
        if !self.memories.get(&sequence).is_some_and(is_usable) {
            self.drop_memory(sequence);
            let of = (&episode.memory, episode.embeds);
            match self.create(part, of, library, documents, (&mut *externals, now_ns))? {
                Poll::Ready(Ok(memory)) => {
                    drop(self.memories.insert(sequence, memory));
                    // Its episode may be given up before it begins: it can be dropped from now on.
                    self.note_use(sequence);
                }
                Poll::Ready(Err(reason)) => return Ok(Binding::Refused(reason.into())),
                Poll::Pending => return Ok(Binding::Waiting),
            }
        }
        let Some(known) = self.memories.get_mut(&sequence) else { return Ok(Binding::Waiting) };
        let learns = part.recording.is_some();
        match (&mut known.memory, &mut episode.memory) {
            (KeptMemory::BuiltIn(memory), _) => memory.begin_episode(&Episode {
                lane: episode.lane,
                episode: episode.id,
                instruction: &episode.instruction,
                seed: episode.seed,
                repeat: episode.repeat,
                image_budget: episode.budgets.images,
                text_budget: episode.budgets.text,
                learns,
            })?,
            (KeptMemory::External { bank: id, to_load }, EpisodeMemory::External { bank, .. }) => {
                match is_loaded(*id, to_load, externals, now_ns) {
                    Ok(true) => *bank = *id,
                    Ok(false) => return Ok(Binding::Waiting),
                    Err(why) => {
                        self.drop_memory(sequence);
                        return Ok(Binding::Refused(why));
                    }
                }
            }
            _ => return Ok(Binding::Refused("its sequence has another memory".into())),
        }
        known.users.insert(episode.id);
        known.learning = learns.then_some(episode.id);
        part.begun = true;
        episode.bank = known.bank.clone();
        self.note_use(sequence);
        self.drop_unused();
        Ok(Binding::Ready)
    }

    /// Makes the memory of `sequence` the one that was used last.
    fn note_use(&mut self, sequence: u64) {
        self.recent.retain(|other| *other != sequence);
        self.recent.push(sequence);
    }

    /// Drops the memories that no episode has used for longest.
    fn drop_unused(&mut self) {
        let memories = &mut self.memories;
        self.recent.retain(|sequence| memories.contains_key(sequence));
        let is_unused = |sequence: &u64| memories[sequence].users.is_empty();
        let unused: Vec<u64> = self.recent.iter().copied().filter(is_unused).rev().collect();
        let (mut kept, mut bytes) = (0, 0);
        for sequence in unused {
            kept += 1;
            bytes = self.memories[&sequence].memory.store_bytes().saturating_add(bytes);
            if kept > self.kept || bytes > KEPT_BYTES {
                self.drop_memory(sequence);
            }
        }
    }

    /// The memory of a sequence as its snapshot has it, or why there is none; an external one is built and loads on its own.
    /// Pending while views of its bank are not known.
    fn create(
        &mut self,
        part: &SequenceEpisode,
        (memory, embeds): (&EpisodeMemory, bool),
        library: &DemonstrationLibrary,
        documents: &mut dyn DocumentSupplier,
        (externals, now_ns): (&mut ExternalMemories, u64),
    ) -> anyhow::Result<Poll<Result<SequenceMemory, String>>> {
        let known = match self.bank(part.origin, embeds, library) {
            Ok(known) => known,
            Err(reason) => return Ok(Poll::Ready(Err(reason))),
        };
        if !known.collecting.is_complete() {
            return Ok(Poll::Pending);
        }
        let steps = known.steps(embeds).context("a view of the bank is missing")?;
        let memory = match memory {
            EpisodeMemory::BuiltIn { representation, settings, set, .. } => KeptMemory::BuiltIn(
                build_built_in(*representation, settings, *set, &steps, documents)?,
            ),
            EpisodeMemory::External { index, .. } => {
                let bank = externals.publish_for_sequence(*index, &known.bank, steps, now_ns);
                KeptMemory::External { bank, to_load: None }
            }
        };
        let mut made = SequenceMemory {
            origin: part.origin,
            bank: known.bank.clone(),
            snapshot: SnapshotId::default(),
            learning: None,
            users: BTreeSet::new(),
            memory,
        };
        let loaded = made.load(self.snapshots.as_ref(), part);
        if let (Err(_), KeptMemory::External { bank, .. }) = (&loaded, &made.memory) {
            self.dropped.push(*bank);
        }
        Ok(Poll::Ready(loaded.map(|()| made)))
    }

    /// The bank of a stream.
    fn bank(
        &mut self,
        origin: BankOrigin,
        embeds: bool,
        library: &DemonstrationLibrary,
    ) -> Result<&StreamBank, String> {
        let key = (origin, embeds);
        let made = match self.banks.iter().position(|(known, _)| *known == key) {
            Some(at) => self.banks.remove(at),
            None => {
                let bank = Arc::new(MemoryBank::new(library.of_bank(origin)?));
                let collecting =
                    if embeds { Collecting::new(&bank) } else { Collecting::default() };
                (key, StreamBank { bank, collecting })
            }
        };
        while self.banks.len() >= KEPT_BANKS
            && let Some(oldest) =
                self.banks.iter().position(|(_, bank)| bank.collecting.is_complete())
        {
            self.banks.remove(oldest);
        }
        self.banks.push(made);
        self.banks.last().map(|(_, bank)| bank).ok_or_else(|| "no bank".to_owned())
    }

    /// The memory that an episode has been given.
    pub(crate) fn of(&mut self, sequence: u64) -> Option<&mut SequenceMemory> {
        self.memories.get_mut(&sequence)
    }

    /// Ends an episode that its memory learns from, after its last observation: the memory learns, and is saved. If that
    /// fails, the memory is dropped.
    /// `Ok(None)` while an external memory saves.
    pub(crate) fn learn(
        &mut self,
        episode: &MemoryEpisode,
        externals: (&mut ExternalMemories, u64),
    ) -> Result<Option<SnapshotReport>, Reason> {
        let (Some(part), Some(folder)) = (&episode.stream, &self.snapshots) else {
            return Err("it is not part of a stream, or there is no folder for snapshots".into());
        };
        let memory = self.memories.get_mut(&part.sequence);
        let memory = memory.filter(|memory| memory.learning == Some(episode.id));
        let memory = memory.ok_or("its memory has gone on with another episode")?;
        let learned = memory.learn(episode, part, folder, externals);
        if learned.is_err() {
            self.drop_memory(part.sequence);
        }
        learned
    }

    /// An episode has left its lane. A memory that was learning from it is dropped.
    pub(crate) fn release(&mut self, episode: &MemoryEpisode) {
        let Some(part) = episode.stream.as_ref().filter(|part| part.begun) else { return };
        let Some(memory) = self.memories.get_mut(&part.sequence) else { return };
        if memory.learning == Some(episode.id) {
            self.drop_memory(part.sequence);
        } else if memory.users.remove(&episode.id)
            && part.recording.is_none()
            && let KeptMemory::BuiltIn(memory) = &mut memory.memory
        {
            // It was not told anything that it could fail at.
            let _ = memory.end_episode(&EpisodeEnd::unlearned(episode.lane, episode.id));
        }
    }
}

/// Whether an external memory is built and has loaded what it has to; asks it to load once it is built.
fn is_loaded(
    bank: u64,
    to_load: &mut Option<(PathBuf, bool)>,
    externals: &mut ExternalMemories,
    now_ns: u64,
) -> Result<bool, Reason> {
    if !externals.is_built(bank)? {
        return Ok(false);
    }
    let Some((folder, is_asked)) = to_load else { return Ok(true) };
    if !*is_asked {
        externals.store(bank, folder, true, now_ns)?;
        *is_asked = true;
        return Ok(false);
    }
    let Some(outcome) = externals.take_stored(bank, now_ns) else { return Ok(false) };
    outcome?;
    *to_load = None;
    Ok(true)
}

impl SequenceMemory {
    fn learn(
        &mut self,
        episode: &MemoryEpisode,
        part: &SequenceEpisode,
        folder: &SnapshotFolder,
        (externals, now_ns): (&mut ExternalMemories, u64),
    ) -> Result<Option<SnapshotReport>, Reason> {
        let recording = part.recording.as_ref().ok_or("nothing is learned from it")?;
        let is_saving = episode
            .pending
            .as_ref()
            .is_some_and(|pending| matches!(pending.stage, PendingStage::Saving));
        let store_bytes = match &mut self.memory {
            KeptMemory::External { bank, .. } if is_saving => {
                match externals.take_stored(*bank, now_ns) {
                    None => return Ok(None),
                    Some(outcome) => outcome?,
                }
            }
            _ => {
                let sub_goals = recording.lived.sub_goals();
                let end = EpisodeEnd {
                    lane: episode.lane,
                    episode: episode.id,
                    demonstration: Some(self.bank.demonstrations.len() as u32),
                    success: (part.feedback != FeedbackLevel::None)
                        .then_some(recording.is_complete),
                    sub_goals: (part.feedback == FeedbackLevel::SubGoals).then_some(&sub_goals),
                };
                let lived = &recording.lived;
                let views =
                    RememberedDemonstration::lived_views(part.sequence, lived.case, &lived.poses);
                let lived = RememberedDemonstration { views, ..lived.clone() };
                Arc::make_mut(&mut self.bank).demonstrations.push(Arc::new(lived));
                let own = self.begin_snapshot(folder, part.sequence)?;
                match &mut self.memory {
                    KeptMemory::BuiltIn(memory) => {
                        let now = episode.last_step().ok_or("it has not begun")?;
                        let told = memory.observe(&now).and_then(|()| memory.end_episode(&end));
                        told.and_then(|()| memory.save(&own)).map_err(|error| error.to_string())?;
                        memory.store_bytes().unwrap_or(0)
                    }
                    KeptMemory::External { bank, .. } => {
                        externals.end(episode, *bank, &end);
                        externals.store(*bank, &own, false, now_ns)?;
                        return Ok(None);
                    }
                }
            }
        };
        self.snapshot = folder.finish(part.sequence, self.snapshot)?;
        self.learning = None;
        Ok(Some(SnapshotReport {
            episode: episode.id,
            snapshot: self.snapshot,
            store_bytes,
            lane: episode.lane,
            ..Zeroable::zeroed()
        }))
    }

    /// Writes the host's part of a snapshot. Returns the folder for the memory's own.
    fn begin_snapshot(&self, folder: &SnapshotFolder, sequence: u64) -> Result<PathBuf, String> {
        let unfinished = folder.begin(sequence)?;
        let path = unfinished.join(EXPERIENCE_FILE);
        let all = self.bank.demonstrations.iter();
        let experiences = all.filter(|of| of.number == EXPERIENCE);
        let stored: Vec<_> = experiences.map(|of| StoredExperience::new(of)).collect();
        let written = serde_json::to_vec(&stored).map_err(|error| error.to_string())?;
        durable::write_file(&path, &written)
            .map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        let own = unfinished.join(MEMORY_FOLDER);
        fs::create_dir(&own)
            .map_err(|error| format!("cannot create {}: {error}", own.display()))?;
        Ok(own)
    }

    /// Brings a memory that is built, or is being built, into the state that an episode begins with.
    fn load(
        &mut self,
        folder: Option<&SnapshotFolder>,
        part: &SequenceEpisode,
    ) -> Result<(), String> {
        if part.snapshot == SnapshotId::default() {
            return Ok(());
        }
        let folder = folder.ok_or(
            "it continues from a snapshot, and memory-proc was started without --snapshots",
        )?;
        let found = folder.find(part.sequence, part.snapshot)?;
        let failed = |what: String| format!("snapshot {}: {what}", found.display());
        for (number, stored) in read_experiences(&found).map_err(&failed)?.into_iter().enumerate() {
            let lived = stored.lived(part.sequence).ok_or_else(|| {
                failed(format!("episode {number} of {EXPERIENCE_FILE} has parts that do not fit"))
            })?;
            Arc::make_mut(&mut self.bank).demonstrations.push(Arc::new(lived));
        }
        let own = found.join(MEMORY_FOLDER);
        match &mut self.memory {
            KeptMemory::BuiltIn(memory) => {
                memory.load(&own).map_err(|error| failed(error.to_string()))?;
            }
            KeptMemory::External { to_load, .. } => *to_load = Some((own, false)),
        }
        self.snapshot = part.snapshot;
        Ok(())
    }
}

fn read_experiences(snapshot: &Path) -> Result<Vec<StoredExperience>, String> {
    let text = durable::read(&snapshot.join(EXPERIENCE_FILE)).map_err(|error| error.to_string())?;
    serde_json::from_slice(&text).map_err(|error| error.to_string())
}
