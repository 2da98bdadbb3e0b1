//! What the host knows about external memories: their banks, what is to be sent to them, and how their answers are read.
//! `crate::hosted` is how episodes see them.
//!
//! An external memory is not trusted. It names demonstrations by their number in its bank and never learns their cases;
//! whatever it sends is checked here and in [`crate::items`], and what cannot be used costs its own episode.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::time::Duration;

use peer::memory::{EpisodeEnd, MemoryItem};
use search::Embedding;
use shm_types::message::{
    DocumentId, EpisodeOutcome, ExternalAnswer, ExternalEpisode, ExternalQuery, ExternalStore,
    MAX_SUB_GOALS, NO_DOCUMENT, NOT_MEASURED, shortened_reason,
};
use shm_types::{BankContent, MemoryDescription, Note, NoteTooLong};

use crate::episode::{MemoryEpisode, PendingStage, Reason, Unready};

mod banks;
mod messages;

use banks::HostBank;
pub(crate) use messages::read_items;
use messages::{episode_message, query_message};

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

/// The lane in the header of a note that is no answer.
const NO_LANE: u32 = u32::MAX;

/// The external memories of a run.
#[derive(Debug, Default)]
pub struct ExternalMemories {
    limits: ExternalLimits,
    memories: BTreeMap<u8, ExternalMemory>,
    banks: BTreeMap<u64, HostBank>,
    /// The banks that no episode uses, the least recently used first.
    unused: VecDeque<u64>,
    last_bank: u64,
    outbox: Vec<(u8, ToExternal)>,
}

/// An external memory.
#[derive(Debug, Default)]
struct ExternalMemory {
    description: MemoryDescription,
    /// The number of messages that it has sent.
    messages: u64,
    /// When it was last seen to build, save or load: it answers nothing meanwhile.
    last_busy_ns: u64,
    /// Since when it is known to have closed its queues, if it has left the run.
    left_ns: Option<u64>,
    /// By lane: the note of the last answer.
    notes: HashMap<u32, Note>,
    /// By note: why a bank cannot be built, saved or loaded. Several may come before the messages that name them.
    reasons: BTreeMap<DocumentId, String>,
}

impl ExternalMemories {
    /// The external memories with these indices.
    pub fn new(descriptions: BTreeMap<u8, MemoryDescription>, limits: ExternalLimits) -> Self {
        let memory = |(index, description)| {
            (index, ExternalMemory { description, ..ExternalMemory::default() })
        };
        Self { limits, memories: descriptions.into_iter().map(memory).collect(), ..Self::default() }
    }

    /// The indices.
    pub fn indices(&self) -> impl Iterator<Item = u8> {
        self.memories.keys().copied()
    }

    /// Whether the external memory with this index uses embeddings.
    pub fn embeds(&self, index: u8) -> bool {
        self.description(index).is_ok_and(|description| description.embeddings)
    }

    /// The name of an external memory.
    pub fn name(&self, index: u8) -> &str {
        self.description(index).map_or("unknown", |description| &description.name)
    }

    fn description(&self, index: u8) -> Result<&MemoryDescription, String> {
        let known = self.memories.get(&index).map(|memory| &memory.description);
        known.ok_or_else(|| format!("external memory {index}, which does not take part in the run"))
    }

    /// Tells the memory of a bank that an episode begins.
    pub(crate) fn begin(&mut self, episode: &MemoryEpisode, bank: u64) {
        if let Some(index) = episode.external() {
            self.outbox.push((index, ToExternal::Episode(episode_message(episode, bank))));
        }
    }

    /// Asks the memory of a bank about the pending observation of an episode, and has the episode wait for the answer as
    /// long as the time limit allows.
    pub(crate) fn ask(
        &mut self,
        episode: &mut MemoryEpisode,
        bank: u64,
        embedding: Option<&Embedding>,
        now_ns: u64,
    ) -> Unready {
        let (Some(index), Some(pending)) = (episode.external(), &episode.pending) else {
            return "the episode has not begun".into();
        };
        if let PendingStage::Asked { since_ns, .. } = pending.stage {
            return self.wait(episode, index, since_ns, now_ns);
        }
        let question = query_message(episode, embedding);
        self.outbox.extend(question.map(|question| (index, ToExternal::Query(question))));
        if let Some(pending) = &mut episode.pending {
            pending.stage = PendingStage::Asked { bank, since_ns: now_ns };
        }
        Unready::Waiting
    }

    /// Waits for the answer to the question of `since_ns`, as long as the time limit allows.
    fn wait(&self, episode: &MemoryEpisode, index: u8, since_ns: u64, now_ns: u64) -> Unready {
        let last_busy_ns = self.memories.get(&index).map_or(0, |memory| memory.last_busy_ns);
        if !is_over(self.limits.answer, since_ns.max(last_busy_ns), now_ns) {
            return Unready::Waiting;
        }
        let step = episode.current.as_ref().map_or(0, |current| current.step);
        self.unanswered(index, step).into()
    }

    /// Tells an external memory the end of an episode, unless that was given up.
    pub(crate) fn end(&mut self, episode: &MemoryEpisode, end: &EpisodeEnd<'_>) {
        let last = query_message(episode, None).filter(|message| message.last == 1);
        let (Some(index), Some(mut message)) = (episode.external(), last) else { return };
        if let Some(demonstration) = end.demonstration {
            message.outcome = EpisodeOutcome::of(end.success) as u8;
            message.demonstration = demonstration;
            message.sub_goals_len = NOT_MEASURED;
        }
        if let Some(steps) = end.sub_goals.filter(|steps| steps.len() <= MAX_SUB_GOALS) {
            message.sub_goals_len = steps.len() as u32;
            for (place, &step) in message.sub_goals.iter_mut().zip(steps) {
                *place = step as u16;
            }
        }
        self.outbox.push((index, ToExternal::Query(message)));
    }

    /// Notes that a message to an external memory found its queues closed.
    pub(crate) fn has_left(&mut self, index: u8, now_ns: u64) {
        if let Some(memory) = self.memories.get_mut(&index) {
            memory.left_ns.get_or_insert(now_ns);
        }
    }

    /// Why an external memory answers nothing any more, if it has left and its process should have ended by now. The
    /// orchestrator sees that end, and starts everything again.
    pub(crate) fn gone(&self, index: u8, now_ns: u64) -> Option<String> {
        let since_ns = self.memories.get(&index)?.left_ns?;
        let name = self.name(index);
        is_over(LEAVING_TIME, since_ns, now_ns).then(|| {
            format!("external memory {name} has closed its queues, and its process has not ended")
        })
    }

    /// Notes that an external memory has sent a message.
    pub(crate) fn hear(&mut self, index: u8) {
        if let Some(memory) = self.memories.get_mut(&index) {
            memory.messages += 1;
        }
    }

    /// Checks that the memory itself has not taken longer than the time limit allows: [`wait`](Self::wait) cannot tell
    /// while the memory may be building a bank.
    ///
    /// # Errors
    /// When it has.
    pub(crate) fn check_time(&self, index: u8, message: &ExternalAnswer) -> Result<(), Reason> {
        match is_over(self.limits.answer, message.received_ns, message.sent_ns) {
            true => Err(self.unanswered(index, message.step)),
            false => Ok(()),
        }
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
        if lane != NO_LANE && lane >= lanes {
            let name = self.name(index);
            return Err(format!("note of external memory {name}: lane {lane} of {lanes}"));
        }
        let Some(memory) = self.memories.get_mut(&index) else { return Ok(()) };
        if lane != NO_LANE {
            memory.notes.insert(lane, note);
            return Ok(());
        }
        memory.reasons.insert(note.header.id, readable(&note.bytes));
        // One for each bank is enough.
        if memory.reasons.len() > self.banks.values().filter(|bank| bank.index == index).count() {
            memory.reasons.pop_first();
        }
        Ok(())
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
        let memory = self.memories.get_mut(&index);
        let why = memory.and_then(|memory| memory.reasons.remove(&failure));
        let why = why.unwrap_or_else(|| NO_REASON.to_owned());
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
        let Some(ExternalMemory { notes, .. }) = self.memories.get_mut(&index) else {
            return Err("it does not take part in the run".to_owned());
        };
        let note = match notes.get(&message.lane).map(|note| note.header) {
            _ if message.note == 0 => None,
            // An answer that comes too late leaves the note of the episode after it.
            Some(header) if (header.id, header.episode) == (message.note, message.episode) => {
                notes.remove(&message.lane)
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

/// Whether more time than `limit` has passed.
fn is_over(limit: Duration, since_ns: u64, now_ns: u64) -> bool {
    u128::from(now_ns.saturating_sub(since_ns)) > limit.as_nanos()
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
