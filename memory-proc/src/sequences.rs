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

use anyhow::Context;
use bytemuck::Zeroable;
use domain::{ActionCode, FeedbackCode, FeedbackLevel, State};
use peer::memory::EpisodeEnd;
use serde::{Deserialize, Serialize};
use shm_types::message::{EXPERIENCE, SnapshotId, SnapshotReport};

use crate::bank::{BankSteps, Collecting, MemoryBank};
use crate::demonstrations::{BankOrigin, DemonstrationLibrary, RememberedDemonstration};
use crate::episode::{MemoryEpisode, SequenceEpisode, Unready};
use crate::external::ExternalMemories;
use crate::hosted::{HostedMemory, MemoryHost};
use crate::snapshots::SnapshotFolder;

/// Banks that are kept when no memory waits for them.
const KEPT_BANKS: usize = 16;

/// Bytes of the memories that are kept without an episode.
const KEPT_BYTES: u64 = 256 << 20;

/// The host's part of a snapshot, and the folder of the memory's own files.
const EXPERIENCE_FILE: &str = "experience.json";
const MEMORY_FOLDER: &str = "memory";

/// An episode that a memory has learned from, as it is stored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct StoredExperience {
    position: u32,
    instruction: String,
    states: Vec<State>,
    feedback: Vec<FeedbackCode>,
    /// The steps at which sub-goals were completed.
    sub_goals: Vec<u32>,
    /// `None` where an answer could not be read.
    actions: Vec<Option<ActionCode>>,
}

impl StoredExperience {
    /// An episode, as it was lived.
    fn new(lived: &RememberedDemonstration) -> Self {
        Self {
            position: lived.case,
            instruction: lived.instruction.clone(),
            states: lived.states.clone(),
            feedback: lived.feedback.clone(),
            sub_goals: lived.sub_goals(),
            actions: lived.actions.clone(),
        }
    }

    /// The episode, of this sequence; `None` if its parts do not belong together.
    pub(crate) fn lived(self, sequence: u64) -> Option<RememberedDemonstration> {
        let stage = |step: u32| self.sub_goals.iter().filter(|at| **at <= step).count() as u32;
        let lived = RememberedDemonstration {
            case: self.position,
            number: EXPERIENCE,
            views: RememberedDemonstration::lived_views(sequence, self.position, &self.states),
            stages: (0..self.states.len() as u32).map(stage).collect(),
            feedback: self.feedback,
            actions: self.actions,
            instruction: self.instruction,
            states: self.states,
        };
        let states = lived.states.len();
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
    /// Once that episode is over: the folder in which the memory saves what it has learned.
    saving: Option<PathBuf>,
    /// The episodes that use it.
    users: BTreeSet<u64>,
    pub(crate) memory: HostedMemory,
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
}

impl SequenceMemories {
    pub(crate) fn new(snapshots: Option<SnapshotFolder>, lanes: u32) -> Self {
        let kept = lanes as usize;
        Self { snapshots, memories: BTreeMap::new(), kept, recent: Vec::new(), banks: Vec::new() }
    }

    fn drop_memory(&mut self, sequence: u64, externals: &mut ExternalMemories) {
        if let Some(dropped) = self.memories.remove(&sequence) {
            dropped.memory.discard(externals);
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
    pub(crate) fn bind<I: Clone>(
        &mut self,
        episode: &mut MemoryEpisode,
        host: &mut MemoryHost<'_, I>,
    ) -> Result<(), Unready> {
        let part = episode.stream.as_ref().ok_or("it is no part of a stream")?;
        let sequence = part.sequence;
        let is_usable = |memory: &SequenceMemory| {
            memory.origin == part.origin
                && memory.snapshot == part.snapshot
                && memory.learning.is_none()
        };
        if !self.memories.get(&sequence).is_some_and(is_usable) {
            self.drop_memory(sequence, host.externals);
            let created = self.create(episode, part, host)?;
            self.memories.insert(sequence, created);
            // Its episode may be given up before it begins: it can be dropped from now on.
            self.note_use(sequence);
        }
        let known = self.memories.get_mut(&sequence).ok_or("its memory is gone")?;
        if let Err(unready) = known.memory.begin(episode, host.externals, (host.clock)()) {
            if let Unready::Refused(_) = unready {
                self.drop_memory(sequence, host.externals);
            }
            return Err(unready);
        }
        known.users.insert(episode.id);
        known.learning = episode.learns().then_some(episode.id);
        episode.bank = known.bank.clone();
        self.note_use(sequence);
        self.drop_unused(host.externals);
        Ok(())
    }

    /// Makes the memory of `sequence` the one that was used last.
    fn note_use(&mut self, sequence: u64) {
        self.recent.retain(|other| *other != sequence);
        self.recent.push(sequence);
    }

    /// Drops the memories that no episode has used for longest.
    fn drop_unused(&mut self, externals: &mut ExternalMemories) {
        let memories = &mut self.memories;
        self.recent.retain(|sequence| memories.contains_key(sequence));
        let is_unused = |sequence: &u64| memories[sequence].users.is_empty();
        let unused: Vec<u64> = self.recent.iter().copied().filter(is_unused).rev().collect();
        let (mut kept, mut bytes) = (0, 0);
        for sequence in unused {
            kept += 1;
            bytes = self.memories[&sequence].memory.store_bytes().saturating_add(bytes);
            if kept > self.kept || bytes > KEPT_BYTES {
                self.drop_memory(sequence, externals);
            }
        }
    }

    /// The memory of a sequence as its snapshot has it. An external one is built and loads on its own.
    fn create<I: Clone>(
        &mut self,
        episode: &MemoryEpisode,
        part: &SequenceEpisode,
        host: &mut MemoryHost<'_, I>,
    ) -> Result<SequenceMemory, Unready> {
        let known = self.bank(part.origin, episode.embeds, host.library)?;
        host.views.collect(&mut known.collecting, true);
        if !known.collecting.is_complete() {
            return Err(Unready::Waiting);
        }
        let steps = known.steps(episode.embeds).context("a view of the bank is missing")?;
        let (externals, now_ns) = (&mut *host.externals, (host.clock)());
        let memory = HostedMemory::build(&episode.kind, steps, externals, host.documents, now_ns)?;
        let mut created = SequenceMemory {
            origin: part.origin,
            bank: known.bank.clone(),
            snapshot: SnapshotId::default(),
            learning: None,
            saving: None,
            users: BTreeSet::new(),
            memory,
        };
        match created.load(self.snapshots.as_ref(), part) {
            Ok(()) => Ok(created),
            Err(reason) => {
                created.memory.discard(externals);
                Err(reason.into())
            }
        }
    }

    /// The bank of a stream.
    fn bank(
        &mut self,
        origin: BankOrigin,
        embeds: bool,
        library: &DemonstrationLibrary,
    ) -> Result<&mut StreamBank, String> {
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
        self.banks.last_mut().map(|(_, bank)| bank).ok_or_else(|| "no bank".to_owned())
    }

    /// The memory that an episode has been given.
    pub(crate) fn of(&mut self, sequence: u64) -> Option<&mut SequenceMemory> {
        self.memories.get_mut(&sequence)
    }

    /// Ends an episode that its memory learns from, after its last observation: the memory learns, and is saved. If that
    /// fails, the memory is dropped.
    pub(crate) fn learn(
        &mut self,
        episode: &MemoryEpisode,
        externals: &mut ExternalMemories,
        now_ns: u64,
    ) -> Result<SnapshotReport, Unready> {
        let (Some(part), Some(folder)) = (&episode.stream, &self.snapshots) else {
            return Err("it is not part of a stream, or there is no folder for snapshots".into());
        };
        let memory = self.memories.get_mut(&part.sequence);
        let memory = memory.filter(|memory| memory.learning == Some(episode.id));
        let memory = memory.ok_or("its memory has gone on with another episode")?;
        let learned = memory.learn(episode, part, folder, externals, now_ns);
        if let Err(Unready::Refused(_)) = learned {
            self.drop_memory(part.sequence, externals);
        }
        learned
    }

    /// An episode has left its lane. A memory that was learning from it is dropped.
    pub(crate) fn release(&mut self, episode: &MemoryEpisode, externals: &mut ExternalMemories) {
        let Some(part) = episode.stream.as_ref().filter(|_| episode.begun) else { return };
        let Some(memory) = self.memories.get_mut(&part.sequence) else { return };
        if memory.learning == Some(episode.id) {
            self.drop_memory(part.sequence, externals);
        } else if memory.users.remove(&episode.id) && part.recording.is_none() {
            // It was not told anything that it could fail at.
            let _ = memory.memory.end(episode, None, externals);
        }
    }
}

impl SequenceMemory {
    fn learn(
        &mut self,
        episode: &MemoryEpisode,
        part: &SequenceEpisode,
        folder: &SnapshotFolder,
        externals: &mut ExternalMemories,
        now_ns: u64,
    ) -> Result<SnapshotReport, Unready> {
        let own = match self.saving.take() {
            Some(own) => own,
            None => self.end(episode, part, folder, externals)?,
        };
        let saved = self.memory.save(&own, externals, now_ns);
        self.saving = Some(own);
        let store_bytes = saved?;
        self.snapshot = folder.finish(part.sequence, self.snapshot)?;
        (self.learning, self.saving) = (None, None);
        Ok(SnapshotReport {
            episode: episode.id,
            snapshot: self.snapshot,
            store_bytes,
            lane: episode.lane,
            ..Zeroable::zeroed()
        })
    }

    /// Has the memory learn from an episode that is over. Returns the folder in which it is to save that.
    fn end(
        &mut self,
        episode: &MemoryEpisode,
        part: &SequenceEpisode,
        folder: &SnapshotFolder,
        externals: &mut ExternalMemories,
    ) -> Result<PathBuf, Unready> {
        let recording = part.recording.as_ref().ok_or("nothing is learned from it")?;
        let lived = &recording.lived;
        let sub_goals = lived.sub_goals();
        let end = EpisodeEnd {
            lane: episode.lane,
            episode: episode.id,
            demonstration: Some(self.bank.demonstrations.len() as u32),
            success: (part.feedback != FeedbackLevel::None).then_some(recording.is_complete),
            sub_goals: (part.feedback == FeedbackLevel::SubGoals).then_some(&sub_goals),
        };
        let views = RememberedDemonstration::lived_views(part.sequence, lived.case, &lived.states);
        let lived = RememberedDemonstration { views, ..lived.clone() };
        Arc::make_mut(&mut self.bank).demonstrations.push(Arc::new(lived));
        let own = self.begin_snapshot(folder, part.sequence)?;
        self.memory.end(episode, Some(&end), externals)?;
        Ok(own)
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
        self.memory.load(own).map_err(failed)?;
        self.snapshot = part.snapshot;
        Ok(())
    }
}

fn read_experiences(snapshot: &Path) -> Result<Vec<StoredExperience>, String> {
    let text = durable::read(&snapshot.join(EXPERIENCE_FILE)).map_err(|error| error.to_string())?;
    serde_json::from_slice(&text).map_err(|error| error.to_string())
}
