//! What the host knows about external memories: their banks, what is to be sent to them, and how their answers are read.
//!
//! An external memory is not trusted. It names demonstrations by their number in its bank and never learns their cases;
//! whatever it sends is checked here and in [`crate::items`], and what cannot be used costs its own episode.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use bytemuck::Zeroable;
use domain::Demonstrations;
use peer::memory::{EpisodeEnd, MemoryItem};
use search::Embedding;
use shm_types::description::Scope;
use shm_types::message::{
    DocumentId, EpisodeOutcome, ExternalAnswer, ExternalBuilt, ExternalEpisode, ExternalQuery,
    ExternalStore, ExternalStored, MAX_FOLDER, MAX_SUB_GOALS, MemoryEpisodeConfig, NO_DOCUMENT,
    NOT_MEASURED, shortened_reason, write_text,
};
use shm_types::{BankContent, MemoryDescription, Note, NoteTooLong};

use crate::bank::{BankSteps, Collecting, KnownView, MemoryBank, ViewId};
use crate::demonstrations::DemonstrationLibrary;
use crate::engine::LaneProgress;
use crate::episode::{
    EpisodeMemory, ExternalBank, MemoryEpisode, PendingObservation, PendingStage, Reason,
};

mod messages;

use messages::episode_message;
pub(crate) use messages::{query_message, read_items};

/// How long an external memory may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExternalLimits {
    /// To answer a query.
    pub answer: Duration,
    /// To build itself from a bank.
    pub build: Duration,
}

impl Default for ExternalLimits {
    fn default() -> Self {
        Self { answer: Duration::from_secs(30), build: Duration::from_secs(600) }
    }
}

/// A message to an external memory.
#[derive(Debug)]
pub enum ToExternal {
    /// A bank to publish, with its id.
    Bank(u64, BankContent),
    /// The id of a bank to take back.
    TakeBack(u64),
    /// An episode begins.
    Episode(Box<ExternalEpisode>),
    /// A step.
    Query(Box<ExternalQuery>),
    /// What the memory of a bank knows is to be saved or loaded.
    Store(Box<ExternalStore>),
}

/// Time that an external memory has to end once it has closed its queues. The SDK takes less: it waits for the next
/// generation first.
const LEAVING_TIME: Duration = Duration::from_secs(15);

/// Banks without an episode that are kept built.
const KEPT_BANKS: usize = 64;

/// The lane in the header of a note that is no answer.
const NO_LANE: u32 = u32::MAX;

/// The external memories of a run.
#[derive(Debug)]
pub struct ExternalMemories {
    descriptions: BTreeMap<u8, MemoryDescription>,
    pub(crate) limits: ExternalLimits,
    pub(crate) banks: BTreeMap<u64, HostBank>,
    /// The banks that are not ready.
    pub(crate) unbuilt: BTreeSet<u64>,
    /// The banks that no episode uses, the least recently used first.
    unused: VecDeque<u64>,
    last_bank: u64,
    /// By bank: since when its memory saves or loads.
    storing: HashMap<u64, u64>,
    /// By bank: the outcome.
    stored: HashMap<u64, Result<u64, Reason>>,
    /// By external memory and lane: the note of the last answer.
    notes: HashMap<(u8, u32), Note>,
    /// By external memory and note: why a bank cannot be built, saved or loaded. Several may come before the messages that
    /// name them.
    reasons: BTreeMap<(u8, DocumentId), String>,
    /// When each external memory was last seen to build, save or load: it answers nothing meanwhile.
    last_busy_ns: BTreeMap<u8, u64>,
    /// Since when each external memory that has left the run is known to have closed its queues.
    left_ns: BTreeMap<u8, u64>,
    /// The number of messages that each external memory has sent.
    heard: BTreeMap<u8, u64>,
    pub(crate) outbox: Vec<(u8, ToExternal)>,
}

/// A question that is so much older than a bank has been taken before it: an idle memory wakes up sooner.
const WAKE_NS: u64 = 200_000_000;

/// How many messages the memory `index` has sent.
fn count(heard: &BTreeMap<u8, u64>, index: u8) -> u64 {
    heard.get(&index).copied().unwrap_or(0)
}

/// The state of a bank that is published to the memory `index` now.
fn published(heard: &BTreeMap<u8, u64>, index: u8, now_ns: u64) -> BankState {
    let heard = count(heard, index);
    BankState::Building { published_ns: now_ns, since_ns: now_ns, heard }
}

/// A bank of an external memory.
#[derive(Debug)]
pub(crate) struct HostBank {
    index: u8,
    /// The case, unless the bank is of all cases, and the set; `None`: it belongs to a sequence.
    of: Option<(Option<u32>, Demonstrations)>,
    pub(crate) bank: Arc<MemoryBank>,
    pub(crate) pins_bank: bool,
    pub(crate) embeds: bool,
    with_frames: bool,
    /// The episodes that wait for it or use it.
    pub(crate) users: u32,
    pub(crate) state: BankState,
}

/// How far the building of a bank has got.
#[derive(Debug)]
pub(crate) enum BankState {
    /// The first so many views are ready.
    Waiting { ready: usize },
    /// Views are pinned and embedded a few at a time.
    Collecting(Collecting),
    /// Published at this time, when its memory had sent so many messages; it may have begun to build at the second time.
    Building { published_ns: u64, since_ns: u64, heard: u64 },
    /// Built.
    Ready { store_bytes: u64 },
    /// Not built, and why.
    Failed(Reason),
}

impl ExternalMemories {
    /// The external memories with these indices.
    pub fn new(descriptions: BTreeMap<u8, MemoryDescription>, limits: ExternalLimits) -> Self {
        Self {
            descriptions,
            limits,
            banks: BTreeMap::new(),
            unbuilt: BTreeSet::new(),
            unused: VecDeque::new(),
            last_bank: 0,
            storing: HashMap::new(),
            stored: HashMap::new(),
            notes: HashMap::new(),
            reasons: BTreeMap::new(),
            last_busy_ns: BTreeMap::new(),
            left_ns: BTreeMap::new(),
            heard: BTreeMap::new(),
            outbox: Vec::new(),
        }
    }

    /// The indices.
    pub fn indices(&self) -> impl Iterator<Item = u8> {
        self.descriptions.keys().copied()
    }

    /// Whether the external memory with this index uses embeddings.
    pub fn embeds(&self, index: u8) -> bool {
        self.descriptions.get(&index).is_some_and(|description| description.embeddings)
    }

    /// The name of an external memory.
    pub fn name(&self, index: u8) -> &str {
        self.descriptions.get(&index).map_or("unknown", |description| &description.name)
    }

    /// The bank that an episode remembers.
    pub(crate) fn bank(
        &mut self,
        config: &MemoryEpisodeConfig,
        set: Demonstrations,
        library: &DemonstrationLibrary,
    ) -> Result<ExternalBank, String> {
        let &MemoryEpisodeConfig { external: index, case, .. } = config;
        let &MemoryDescription { scope, embeddings: embeds, frames, .. } =
            self.description(index)?;
        let of = Some(((scope == Scope::Case).then_some(case), set));
        let known = self.banks.iter().find(|(_, bank)| bank.index == index && bank.of == of);
        let id = match known {
            Some((&id, _)) => id,
            None => {
                let chosen = match scope {
                    Scope::Case => library.of_case(case, set),
                    Scope::All => library.of_all_cases(set),
                };
                let chosen =
                    chosen.ok_or_else(|| format!("demonstrations {set}, which do not exist"))?;
                let bank = Arc::new(MemoryBank::new(chosen));
                let pins_bank = scope == Scope::Case && (embeds || frames);
                let with_frames = pins_bank && frames;
                let state = match scope {
                    Scope::All if embeds => BankState::Collecting(Collecting::new(&bank)),
                    Scope::Case | Scope::All => BankState::Waiting { ready: 0 },
                };
                let users = 0;
                let bank =
                    HostBank { index, of, bank, pins_bank, embeds, with_frames, users, state };
                let id = self.add(bank);
                self.unused.push_back(id);
                id
            }
        };
        let HostBank { bank, pins_bank, embeds, .. } = &self.banks[&id];
        Ok(ExternalBank { id, bank: bank.clone(), pins_bank: *pins_bank, embeds: *embeds })
    }

    /// Adds a bank that is not built. Returns its id.
    fn add(&mut self, bank: HostBank) -> u64 {
        self.last_bank += 1;
        self.banks.insert(self.last_bank, bank);
        self.unbuilt.insert(self.last_bank);
        self.last_bank
    }

    fn description(&self, index: u8) -> Result<&MemoryDescription, String> {
        let known = self.descriptions.get(&index);
        known.ok_or_else(|| format!("external memory {index}, which does not take part in the run"))
    }

    /// What is known about the bank of a sequence before its first step.
    pub(crate) fn of_stream(&self, config: &MemoryEpisodeConfig) -> Result<ExternalBank, String> {
        let embeds = self.description(config.external)?.embeddings;
        Ok(ExternalBank { id: 0, bank: Arc::default(), pins_bank: false, embeds })
    }

    /// An episode uses a bank from now on.
    pub(crate) fn retain(&mut self, id: u64) {
        if let Some(bank) = self.banks.get_mut(&id) {
            bank.users += 1;
            self.unused.retain(|unused| *unused != id);
        }
    }

    /// An episode no longer uses a bank. Those that no episode has used for long are taken back.
    pub(crate) fn release(&mut self, id: u64) {
        let Some(bank) = self.banks.get_mut(&id) else { return };
        bank.users = bank.users.saturating_sub(1);
        if bank.users == 0 {
            self.unused.push_back(id);
        }
        let in_use = |state: &BankState| {
            matches!(state, BankState::Building { .. } | BankState::Collecting(_))
        };
        while self.unused.len() > KEPT_BANKS {
            let oldest = self.unused.iter().position(|id| !in_use(&self.banks[id].state));
            let Some(id) = oldest.and_then(|at| self.unused.remove(at)) else { return };
            self.take_back(id);
        }
    }

    /// Publishes a bank whose views are known.
    pub(crate) fn publish(
        &mut self,
        id: u64,
        view: impl Fn(ViewId) -> Option<KnownView>,
        now_ns: u64,
    ) {
        let Some(bank) = self.banks.get_mut(&id) else { return };
        let steps = if bank.embeds || bank.with_frames {
            bank.bank.with_views(view)
        } else {
            Some(BankSteps::without_views(&bank.bank))
        };
        let Some(steps) = steps else { return };
        let content = steps.content(bank.with_frames);
        bank.state = published(&self.heard, bank.index, now_ns);
        self.outbox.push((bank.index, ToExternal::Bank(id, content)));
    }

    /// Starts the clocks of building and answering anew for what a memory cannot have begun: it does one thing after the
    /// other, and first builds the banks that it has got, in their order. `asked_ns` has the time of each memory's oldest
    /// question that is open: a memory that had it before the bank, and has sent nothing since, is answering.
    pub(crate) fn defer_clocks(&mut self, asked_ns: &BTreeMap<u8, u64>, now_ns: u64) {
        let storing = self.storing.keys().filter_map(|id| self.banks.get(id));
        let mut is_busy: BTreeSet<u8> = storing.map(|bank| bank.index).collect();
        let mut is_taken = is_busy.clone();
        for id in &self.unbuilt {
            if let Some(HostBank {
                index,
                state: BankState::Building { published_ns, since_ns, heard },
                ..
            }) = self.banks.get_mut(id)
            {
                if !is_taken.insert(*index) {
                    *since_ns = now_ns;
                    continue;
                }
                let asked = asked_ns.get(index).copied().unwrap_or(u64::MAX);
                let is_answering = asked.saturating_add(WAKE_NS) < *published_ns
                    && count(&self.heard, *index) == *heard;
                if !is_answering {
                    is_busy.insert(*index);
                }
            }
        }
        self.last_busy_ns.extend(is_busy.into_iter().map(|index| (index, now_ns)));
    }

    /// Publishes a bank for the memory of a sequence. Returns its id.
    pub(crate) fn publish_for_sequence(
        &mut self,
        index: u8,
        bank: &Arc<MemoryBank>,
        steps: BankSteps<'_>,
        now_ns: u64,
    ) -> u64 {
        let id = self.add(HostBank {
            index,
            of: None,
            bank: bank.clone(),
            pins_bank: false,
            embeds: self.embeds(index),
            with_frames: false,
            users: 1,
            state: published(&self.heard, index, now_ns),
        });
        self.outbox.push((index, ToExternal::Bank(id, steps.content(false))));
        id
    }

    /// Whether a bank is built.
    ///
    /// # Errors
    /// When it cannot be built: the reason.
    pub(crate) fn is_built(&self, id: u64) -> Result<bool, Reason> {
        match self.banks.get(&id).map(|bank| &bank.state) {
            Some(BankState::Ready { .. }) => Ok(true),
            Some(BankState::Failed(why)) => Err(why.clone()),
            _ => Ok(false),
        }
    }

    /// Takes back a bank.
    pub(crate) fn take_back(&mut self, id: u64) {
        self.unbuilt.remove(&id);
        self.storing.remove(&id);
        self.stored.remove(&id);
        if let Some(bank) = self.banks.remove(&id) {
            self.outbox.push((bank.index, ToExternal::TakeBack(id)));
        }
    }

    /// Tells the memory of a bank the end of an episode that it learns from.
    pub(crate) fn end(&mut self, episode: &MemoryEpisode, bank: u64, end: &EpisodeEnd<'_>) {
        let (Some(now), Some(index)) =
            (&episode.current, self.banks.get(&bank).map(|bank| bank.index))
        else {
            return;
        };
        if let EpisodeMemory::External { begun: false, .. } = episode.memory {
            self.outbox.push((index, ToExternal::Episode(episode_message(episode, bank))));
        }
        let mut message = query_message(episode, now, None, true);
        message.outcome = EpisodeOutcome::of(end.success) as u8;
        message.demonstration = end.demonstration.unwrap_or_default();
        message.sub_goals_len = NOT_MEASURED;
        if let Some(steps) = end.sub_goals.filter(|steps| steps.len() <= MAX_SUB_GOALS) {
            message.sub_goals_len = steps.len() as u32;
            for (place, &step) in message.sub_goals.iter_mut().zip(steps) {
                *place = step as u16;
            }
        }
        self.outbox.push((index, ToExternal::Query(message)));
    }

    /// Has the memory of a bank save or load what it knows.
    ///
    /// # Errors
    /// When the folder's path is too long.
    pub(crate) fn store(
        &mut self,
        id: u64,
        folder: &Path,
        loads: bool,
        now_ns: u64,
    ) -> Result<(), String> {
        let index = self.banks.get(&id).ok_or("its memory is gone")?.index;
        let absolute = std::path::absolute(folder).map_err(|error| error.to_string())?;
        let path = absolute.to_str().filter(|path| path.len() <= MAX_FOLDER).ok_or_else(|| {
            format!("{} has no name of at most {MAX_FOLDER} bytes UTF-8", absolute.display())
        })?;
        let mut message =
            Box::new(ExternalStore { bank: id, loads: loads.into(), ..Zeroable::zeroed() });
        message.folder_len = write_text(&mut message.folder, path);
        self.outbox.push((index, ToExternal::Store(message)));
        self.storing.insert(id, now_ns);
        Ok(())
    }

    /// What has become of saving or loading; `None` while it takes place.
    pub(crate) fn take_stored(&mut self, id: u64, now_ns: u64) -> Option<Result<u64, Reason>> {
        if let Some(outcome) = self.stored.remove(&id) {
            return Some(outcome);
        }
        let since_ns = *self.storing.get(&id)?;
        let limit = self.limits.build;
        (u128::from(now_ns.saturating_sub(since_ns)) > limit.as_nanos()).then(|| {
            self.storing.remove(&id);
            let name = self.name_of_bank(id);
            let why = format!("external memory {name} has not stored within {} s", limit.as_secs());
            Err(Reason::overdue(why))
        })
    }

    /// The memory of a bank has saved or loaded.
    pub(crate) fn has_stored(&mut self, index: u8, message: &ExternalStored) -> Result<(), String> {
        let &ExternalStored { bank: id, store_bytes, failure } = message;
        let is_its_own = self.banks.get(&id).is_some_and(|bank| bank.index == index);
        if !is_its_own || self.storing.remove(&id).is_none() {
            let name = self.name(index);
            return Err(format!(
                "external memory {name} has stored bank {id}, which it was not asked for"
            ));
        }
        let outcome = self.outcome(index, store_bytes, failure, "learn, save or load");
        self.stored.insert(id, outcome);
        Ok(())
    }

    /// Ends the building of a bank. Returns the bank if its views were pinned to build it.
    pub(crate) fn finish(
        &mut self,
        id: u64,
        outcome: Result<u64, Reason>,
    ) -> Option<Arc<MemoryBank>> {
        let bank = self.banks.get_mut(&id)?;
        self.unbuilt.remove(&id);
        let state = match outcome {
            Ok(store_bytes) => BankState::Ready { store_bytes },
            Err(why) => BankState::Failed(why),
        };
        let before = std::mem::replace(&mut bank.state, state);
        let was_pinned = bank.pins_bank && matches!(before, BankState::Building { .. });
        was_pinned.then(|| bank.bank.clone())
    }

    /// The name of the memory that a bank belongs to.
    pub(crate) fn name_of_bank(&self, id: u64) -> &str {
        self.banks.get(&id).map_or("unknown", |bank| self.name(bank.index))
    }

    /// Bytes that the memory of a bank stores; 0 if it does not tell.
    pub(crate) fn store_bytes(&self, id: u64) -> u64 {
        match self.banks.get(&id).map(|bank| &bank.state) {
            Some(BankState::Ready { store_bytes }) => *store_bytes,
            _ => 0,
        }
    }

    /// Asks the memory of an episode about its pending observation, if its bank is built.
    pub(crate) fn ask(
        &mut self,
        episode: &mut MemoryEpisode,
        embedding: Option<&Embedding>,
        now_ns: u64,
    ) -> LaneProgress {
        let EpisodeMemory::External { index, bank: id, begun } = episode.memory else {
            return LaneProgress::EpisodeOver;
        };
        match self.is_built(id) {
            Ok(true) => {}
            Ok(false) => return LaneProgress::Waiting,
            Err(why) => return LaneProgress::Failed(why),
        }
        if !begun {
            self.outbox.push((index, ToExternal::Episode(episode_message(episode, id))));
            episode.memory = EpisodeMemory::External { index, bank: id, begun: true };
        }
        let (Some(now), Some(pending)) = (&episode.current, &episode.pending) else {
            return LaneProgress::EpisodeOver;
        };
        let query = query_message(episode, now, embedding, false);
        self.outbox.push((index, ToExternal::Query(query)));
        let PendingObservation { received_ns, content, .. } = *pending;
        let stage = PendingStage::Asked { since_ns: now_ns };
        episode.pending = Some(PendingObservation { received_ns, content, stage });
        LaneProgress::Waiting
    }

    /// Notes that a message to an external memory found its queues closed.
    pub(crate) fn has_left(&mut self, index: u8, now_ns: u64) {
        self.left_ns.entry(index).or_insert(now_ns);
    }

    /// Why an external memory answers nothing any more, if it has left and its process should have ended by now. The
    /// orchestrator sees that end, and starts everything again.
    pub(crate) fn gone(&self, index: u8, now_ns: u64) -> Option<String> {
        let since_ns = *self.left_ns.get(&index)?;
        let is_settled = u128::from(now_ns.saturating_sub(since_ns)) > LEAVING_TIME.as_nanos();
        let name = self.name(index);
        is_settled.then(|| {
            format!("external memory {name} has closed its queues, and its process has not ended")
        })
    }

    /// Notes that an external memory has sent a message.
    pub(crate) fn hear(&mut self, index: u8) {
        *self.heard.entry(index).or_default() += 1;
    }

    /// Waits for the answer to the question of `since_ns`, as long as the time limit allows.
    pub(crate) fn wait(&self, episode: &MemoryEpisode, since_ns: u64, now_ns: u64) -> LaneProgress {
        let limit = self.limits.answer;
        let Some((index, _)) = episode.external() else { return LaneProgress::EpisodeOver };
        let since_ns = self.last_busy_ns.get(&index).map_or(since_ns, |last| since_ns.max(*last));
        if u128::from(now_ns.saturating_sub(since_ns)) <= limit.as_nanos() {
            return LaneProgress::Waiting;
        }
        let step = episode.current.as_ref().map_or(0, |now| now.step);
        LaneProgress::Failed(self.unanswered(index, step))
    }

    /// Checks that the memory itself has not taken longer than the time limit allows: [`wait`](Self::wait) cannot tell
    /// while the memory may be building a bank.
    ///
    /// # Errors
    /// When it has.
    pub(crate) fn check_time(&self, index: u8, message: &ExternalAnswer) -> Result<(), Reason> {
        let taken_ns = message.sent_ns.saturating_sub(message.received_ns);
        if u128::from(taken_ns) <= self.limits.answer.as_nanos() {
            return Ok(());
        }
        Err(self.unanswered(index, message.step))
    }

    fn unanswered(&self, index: u8, step: u32) -> Reason {
        let (name, seconds) = (self.name(index), self.limits.answer.as_secs_f64());
        Reason::overdue(format!(
            "external memory {name} has not answered step {step} within {seconds} s"
        ))
    }

    /// Takes a note.
    pub(crate) fn take_note(&mut self, index: u8, lanes: u32, note: Note) -> Result<(), String> {
        let lane = note.header.lane;
        if lane == NO_LANE {
            self.reasons.insert((index, note.header.id), readable(&note.bytes));
            let own = self.reasons.keys().copied().filter(|reason| reason.0 == index);
            let own: Vec<_> = own.collect();
            let banks = self.banks.values().filter(|bank| bank.index == index).count();
            // One for each bank is enough.
            if own.len() > banks {
                self.reasons.remove(&own[0]);
            }
            return Ok(());
        }
        if lane >= lanes {
            let name = self.name(index);
            return Err(format!("note of external memory {name}: lane {lane} of {lanes}"));
        }
        self.notes.insert((index, lane), note);
        Ok(())
    }

    /// The result of building a bank: bytes of the store, or why it failed.
    pub(crate) fn built(
        &mut self,
        index: u8,
        message: &ExternalBuilt,
    ) -> Result<Result<u64, Reason>, String> {
        let &ExternalBuilt { bank: id, store_bytes, failure, .. } = message;
        let is_building = self.banks.get(&id).is_some_and(|bank| {
            bank.index == index && matches!(bank.state, BankState::Building { .. })
        });
        if !is_building {
            let name = self.name(index);
            return Err(format!(
                "external memory {name} has built bank {id}, which it was not asked for"
            ));
        }
        Ok(self.outcome(index, store_bytes, failure, "be built"))
    }

    /// Bytes of a memory's store; or why it `cannot` do what it was asked for, if the note `failure` tells that.
    fn outcome(
        &mut self,
        index: u8,
        store_bytes: u64,
        failure: DocumentId,
        cannot: &str,
    ) -> Result<u64, Reason> {
        if failure == NO_DOCUMENT {
            return Ok(store_bytes);
        }
        let why = self.reasons.remove(&(index, failure)).unwrap_or_else(|| NO_REASON.to_owned());
        Err(format!("external memory {} cannot {cannot}: {why}", self.name(index)).into())
    }

    /// The items of an answer.
    ///
    /// # Errors
    /// When the memory failed, or its answer is not valid: the reason.
    pub(crate) fn items(
        &mut self,
        index: u8,
        message: &ExternalAnswer,
    ) -> Result<Vec<MemoryItem>, String> {
        let place = (index, message.lane);
        let note = match self.notes.get(&place).map(|note| note.header) {
            _ if message.note == 0 => None,
            // An answer that comes too late leaves the note of the episode after it.
            Some(header) if (header.id, header.episode) == (message.note, message.episode) => {
                self.notes.remove(&place)
            }
            Some(header) => {
                return Err(format!(
                    "it names note {}, but the last note of its lane is note {} of episode {}",
                    message.note, header.id, header.episode
                ));
            }
            None => return Err(format!("it names note {}, which was not published", message.note)),
        };
        let bytes = note.map_or_else(|| Ok(Vec::new()), |note| note.bytes);
        match message.failed {
            0 => read_items(message, &bytes.map_err(|too_long| too_long.to_string())?),
            1 => Err(readable(&bytes)),
            code => Err(format!("`failed` is {code}, expected 0 or 1")),
        }
    }

    /// The messages that have arisen since the last call, in order.
    pub(crate) fn take_messages(&mut self) -> Vec<(u8, ToExternal)> {
        std::mem::take(&mut self.outbox)
    }
}

/// What stands for a reason that is missing.
const NO_REASON: &str = "it gives no reason";

/// The reason of an external memory for an error message.
fn readable(note: &Result<Vec<u8>, NoteTooLong>) -> String {
    let bytes = match note {
        Ok(bytes) => bytes,
        Err(too_long) => return format!("its reason is too long: {too_long}"),
    };
    match str::from_utf8(bytes) {
        Ok("") => NO_REASON.to_owned(),
        Ok(text) => shortened_reason(text.to_owned()),
        Err(_) => "its reason is not UTF-8".to_owned(),
    }
}
