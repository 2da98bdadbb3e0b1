//! The external memory under test.

mod answers;
pub(crate) mod checks;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Instant;

use anyhow::Context;
use bytemuck::Zeroable;
use domain::{Action, Feedback, Heading, Pose, State};
use shm_types::banks::{BankDemonstration, BankStep};
use shm_types::description::{DESCRIPTION_FILE, Scope, memory_folder};
use shm_types::message::{
    ExternalAnswer, ExternalBuilt, ExternalEpisode, ExternalStore, ExternalStored, FrameId,
    MAX_FOLDER, NO_ACTION, NO_FRAME, RequestId, Role, write_text,
};
use shm_types::{
    Attach, AttachError, BankContent, BusError, FramePublisher, MemoryDescription, Note,
};
use supervise::Children;

use self::answers::Supplied;
use crate::messages::{external_episode, query, scripted_world};
use crate::neighbours::{ExternalMemoryNeighbours, TICK};
use crate::subject::{CheckResult, SeesFrames, Subject, Terms, TestedRole, wrong};

/// The index of the memory under test. Not 0: a memory has to take it from its folder.
pub(crate) const INDEX: u8 = 3;

/// Numbers of an embedding.
const DIMENSION: usize = 384;

/// Different views in the banks of a memory that looks at pixels: a part of the frame store.
const BANK_VIEWS: u64 = 96;

/// The lane in the header of a note that is no answer.
const NO_LANE: u32 = u32::MAX;

/// The role of an external memory.
#[derive(Debug, Default)]
pub(crate) struct MemoryRole {
    pub(crate) description: MemoryDescription,
    /// By id: the number of steps of each demonstration.
    banks: BTreeMap<u64, Vec<u32>>,
    /// The banks that are published and not built.
    pending: BTreeSet<u64>,
    /// The banks that cannot be used: why the memory refused those it refused.
    unusable: BTreeMap<u64, Option<String>>,
    /// The bank whose memory saves or loads.
    storing: Option<u64>,
    /// By episode: the bank it remembers.
    episodes: BTreeMap<u64, u64>,
    /// By lane: the note that came last.
    notes: BTreeMap<u32, Note>,
    /// By seed: the resident views.
    views: BTreeMap<u64, FrameId>,
    last_bank: u64,
}

/// An answer and the note that it names.
#[derive(Debug, Clone)]
pub(crate) struct ReceivedAnswer {
    pub(crate) message: ExternalAnswer,
    note: Result<Vec<u8>, String>,
}

/// An external memory in one generation.
pub(crate) type TestedMemory<'a> = Subject<'a, MemoryRole>;

impl TestedRole for MemoryRole {
    const ROLE: Role = Role::ExternalMemory;
    const A_PROCESS: &'static str = "an external memory";
    const NAME_FACT: &'static str = "memory";
    const ANSWER: &'static str = "answer";
    const AN_ANSWER: &'static str = "an answer";
    const ANSWERED: &'static str = "answered";
    const WAITS_FOR_RUN: bool = true;

    type Neighbours = ExternalMemoryNeighbours;
    type Answer = ReceivedAnswer;

    fn settings(attach: Attach) -> Attach {
        Attach { external_memories: vec![INDEX], ..attach }
    }

    fn index() -> u8 {
        INDEX
    }

    fn folder(root: &Path) -> PathBuf {
        memory_folder(root, INDEX)
    }

    fn prepare(folder: &Path) -> CheckResult<()> {
        match fs::remove_file(folder.join(DESCRIPTION_FILE)) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                Err(anyhow::Error::from(error).into())
            }
            _ => Ok(()),
        }
    }

    fn introduce(
        &mut self,
        folder: &Path,
        children: &mut Children,
        terms: &Terms<'_>,
    ) -> CheckResult<()> {
        self.description = wait_for_description(folder, children, terms)?;
        Ok(())
    }

    fn join(attach: &Attach) -> Result<ExternalMemoryNeighbours, BusError> {
        ExternalMemoryNeighbours::join(attach)
    }

    fn receive(
        &mut self,
        neighbours: &mut ExternalMemoryNeighbours,
    ) -> CheckResult<Vec<(RequestId, ReceivedAnswer)>> {
        // A note is published before the message that names it.
        let (built, answers) = (neighbours.built.drain()?, neighbours.answers.drain()?);
        let stored = neighbours.stored.drain()?;
        for note in neighbours.notes.drain()? {
            self.notes.insert(note.header.lane, note);
        }
        for message in built {
            self.take_built(&message)?;
        }
        for message in stored {
            self.take_stored(&message)?;
        }
        let answers = answers.into_iter().map(|message| {
            let ExternalAnswer { lane, episode, step, .. } = message;
            let note = self.note_of(&message);
            (RequestId { lane, episode, step }, ReceivedAnswer { message, note })
        });
        Ok(answers.collect())
    }

    fn check(&self, id: RequestId, answer: &ReceivedAnswer) -> Result<(), String> {
        self.supplied(id, answer).map(drop)
    }

    fn evicted(&mut self) {
        self.views.clear();
    }

    fn refusal(ReceivedAnswer { message, note }: &ReceivedAnswer) -> Option<String> {
        let reason = || match note {
            Ok(note) => String::from_utf8_lossy(note).into_owned(),
            Err(error) => error.clone(),
        };
        (message.failed == 1).then(reason)
    }
}

impl SeesFrames for MemoryRole {
    fn frames(neighbours: &mut ExternalMemoryNeighbours) -> &mut FramePublisher {
        &mut neighbours.frames
    }
}

impl MemoryRole {
    fn take_built(
        &mut self,
        &ExternalBuilt { bank, failure, .. }: &ExternalBuilt,
    ) -> CheckResult<()> {
        let reason = self.reason(failure);
        if let Some(refused) = self.unusable.get_mut(&bank) {
            *refused = reason;
            return Ok(());
        }
        if !self.pending.remove(&bank) {
            return wrong(format_args!(
                "it has built bank {bank}, which does not wait to be built"
            ));
        }
        reason.map_or(Ok(()), |reason| {
            wrong(format_args!("it cannot build itself from a bank: {reason}"))
        })
    }

    fn take_stored(
        &mut self,
        &ExternalStored { bank, failure, .. }: &ExternalStored,
    ) -> CheckResult<()> {
        if self.storing.take_if(|storing| *storing == bank).is_none() {
            return wrong(format_args!(
                "it has saved or loaded bank {bank}, which it was not asked for"
            ));
        }
        self.reason(failure)
            .map_or(Ok(()), |reason| wrong(format_args!("it cannot learn, save or load: {reason}")))
    }

    /// Why something failed, as the note `failure` says; `None` if it did not.
    fn reason(&mut self, failure: u64) -> Option<String> {
        let note = self.notes.remove(&NO_LANE).filter(|note| note.header.id == failure);
        let missing =
            || format!("(note {failure} with the reason was not published, with lane {NO_LANE})");
        let text = |note: Note| match note.bytes {
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(too_long) => format!("({too_long})"),
        };
        (failure != 0).then(|| note.map_or_else(missing, text))
    }

    /// The note that an answer names.
    fn note_of(&mut self, message: &ExternalAnswer) -> Result<Vec<u8>, String> {
        let ExternalAnswer { lane, episode, note: id, .. } = *message;
        if id == 0 {
            return Ok(Vec::new());
        }
        match self.notes.remove(&lane) {
            None => Err(format!("note {id} was not published, with the lane of the answer")),
            Some(note) if (note.header.id, note.header.episode) != (id, episode) => Err(format!(
                "it names note {id}, and the last note of its lane is note {} of episode {}",
                note.header.id, note.header.episode
            )),
            Some(note) => note.bytes.map_err(|too_long| too_long.to_string()),
        }
    }

    /// What an answer supplies.
    ///
    /// # Errors
    /// When it is not valid.
    pub(crate) fn supplied(
        &self,
        id: RequestId,
        answer: &ReceivedAnswer,
    ) -> Result<Vec<Supplied>, String> {
        let bank = self.episodes.get(&id.episode).and_then(|bank| self.banks.get(bank));
        let demonstrations = bank.map_or(&[][..], Vec::as_slice);
        let actions = scripted_world().actions.len();
        answers::read(&answer.message, answer.note.as_deref(), demonstrations, actions)
    }
}

/// Waits for the description in a memory's folder.
pub(crate) fn wait_for_description(
    folder: &Path,
    children: &mut Children,
    terms: &Terms<'_>,
) -> CheckResult<MemoryDescription> {
    let deadline = Instant::now() + terms.start_timeout;
    loop {
        match MemoryDescription::read(folder) {
            Ok(description) => return Ok(description),
            Err(AttachError::File { .. }) => {}
            Err(error) => return wrong(error),
        }
        terms.check_stop()?;
        if let Some(exit) = children.exited() {
            return wrong(format_args!(
                "it ended without writing {DESCRIPTION_FILE} into its folder, {}",
                exit.how()
            ));
        }
        if Instant::now() > deadline {
            let seconds = terms.start_timeout.as_secs();
            return wrong(format_args!("no {DESCRIPTION_FILE} in its folder within {seconds} s"));
        }
        thread::sleep(TICK);
    }
}

/// A demonstration to remember.
#[derive(Debug, Clone)]
pub(crate) struct ScriptedDemonstration {
    pub(crate) instruction: String,
    /// The seeds of the views of its steps.
    pub(crate) views: Vec<u64>,
}

/// A demonstration of `steps` steps, with views of its own.
pub(crate) fn demonstrated(instruction: &str, number: u64, steps: u64) -> ScriptedDemonstration {
    let first = 1000 * number;
    ScriptedDemonstration {
        instruction: instruction.to_owned(),
        views: (first..first + steps).collect(),
    }
}

/// The pose from which the view of `seed` is seen.
fn pose(seed: u64) -> Pose {
    let headings = [Heading::N, Heading::E, Heading::S, Heading::W];
    let [x, y] = [seed % 20, seed / 20 % 20].map(|number| 2 + number as u8);
    Pose::new(x, y, headings[(seed % 4) as usize])
}

/// The embedding of the view of `seed`: of length 1, and different for each.
fn embedding(seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut numbers: Vec<f32> = (0..DIMENSION)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 40) as f32 / (1 << 23) as f32 - 1.0
        })
        .collect();
    let length = numbers.iter().map(|number| number * number).sum::<f32>().sqrt();
    numbers.iter_mut().for_each(|number| *number /= length);
    numbers
}

impl TestedMemory<'_> {
    fn shows_frames(&self) -> bool {
        self.role.description.frames && self.role.description.scope == Scope::Case
    }

    /// The view of `seed`, which is published once.
    pub(crate) fn seen(&mut self, seed: u64) -> CheckResult<FrameId> {
        if let Some(&frame) = self.role.views.get(&seed) {
            return Ok(frame);
        }
        let frame = self.view(seed)?;
        self.role.views.insert(seed, frame);
        Ok(frame)
    }

    /// The content of a bank, with what the memory asked for.
    pub(crate) fn content(
        &mut self,
        demonstrations: &[ScriptedDemonstration],
    ) -> CheckResult<BankContent> {
        let mut content = BankContent::default();
        let embeds = self.role.description.embeddings;
        let knows_content = embeds || self.shows_frames();
        for ScriptedDemonstration { instruction, views } in demonstrations {
            content.demonstrations.push(BankDemonstration {
                first_step: content.steps.len() as u32,
                steps: views.len() as u32,
                first_byte: content.text.len() as u32,
                bytes: instruction.len() as u32,
            });
            content.text.push_str(instruction);
            for (at, &seed) in views.iter().enumerate() {
                let (mut frame, mut seed) = (NO_FRAME, seed);
                if self.shows_frames() {
                    seed %= BANK_VIEWS;
                    frame = self.seen(seed)?;
                }
                let mut content_hash = [0; 16];
                if knows_content {
                    content_hash[..8].copy_from_slice(&(1 + seed).to_le_bytes());
                }
                let is_last = at + 1 == views.len();
                content.steps.push(BankStep {
                    frame,
                    content_hash: self.content_of(frame).unwrap_or(content_hash),
                    state: State::from(pose(seed)).padded(),
                    action: if is_last { NO_ACTION } else { Action::Forward as u8 },
                    feedback: if at == 0 { Feedback::Start } else { Feedback::Moved } as u8,
                    reserved: [0; 6],
                });
                if embeds {
                    content.embeddings.extend(embedding(seed));
                }
            }
        }
        Ok(content)
    }

    /// Publishes a bank, which has to be built. Returns its id.
    pub(crate) fn publish_bank(&mut self, content: &BankContent) -> CheckResult<u64> {
        let id = self.next_bank();
        let steps = content.demonstrations.iter().map(|demonstration| demonstration.steps);
        self.role.banks.insert(id, steps.collect());
        self.role.pending.insert(id);
        self.neighbours.banks.publish(id, content)?;
        self.notify()?;
        Ok(id)
    }

    /// Publishes a bank that cannot be used.
    pub(crate) fn publish_unusable(&mut self, content: &BankContent) -> CheckResult<u64> {
        let id = self.next_bank();
        self.role.unusable.insert(id, None);
        self.neighbours.banks.publish(id, content)?;
        self.notify()?;
        Ok(id)
    }

    /// Whether the memory refused a bank that cannot be used.
    pub(crate) fn refused(&self, bank: u64) -> bool {
        self.role.unusable.get(&bank).is_some_and(Option::is_some)
    }

    fn next_bank(&mut self) -> u64 {
        self.role.last_bank += 1;
        self.role.last_bank
    }

    /// Publishes a bank and waits until it is built. Returns its id.
    pub(crate) fn remember(
        &mut self,
        demonstrations: &[ScriptedDemonstration],
    ) -> CheckResult<u64> {
        let content = self.content(demonstrations)?;
        let id = self.publish_bank(&content)?;
        self.wait_for_banks()?;
        Ok(id)
    }

    /// Waits until every published bank is built.
    pub(crate) fn wait_for_banks(&mut self) -> CheckResult<()> {
        let timeout = self.terms.start_timeout;
        self.listen_until(
            timeout,
            |subject| subject.role.pending.is_empty(),
            |subject| {
                let count = subject.role.pending.len();
                format!("{count} banks were not built within {} s", timeout.as_secs())
            },
        )
    }

    /// Has the memory of a bank save into `folder`, or load from it, and waits for that.
    pub(crate) fn store(&mut self, bank: u64, folder: &Path, loads: bool) -> CheckResult<()> {
        let mut message = ExternalStore { bank, loads: loads.into(), ..Zeroable::zeroed() };
        let path = folder.to_str().filter(|path| path.len() <= MAX_FOLDER);
        let path =
            path.with_context(|| format!("{} is no folder to save into", folder.display()))?;
        message.folder_len = write_text(&mut message.folder, path);
        self.role.storing = Some(bank);
        self.neighbours.stores.send(&message)?;
        self.notify()?;
        let (verb, timeout) = (if loads { "loaded" } else { "saved" }, self.terms.start_timeout);
        self.listen_until(
            timeout,
            |subject| subject.role.storing.is_none(),
            |_| format!("it has not {verb} within {} s", timeout.as_secs()),
        )
    }

    /// The memory of a bank can name the steps of another episode. Returns the number of the demonstration.
    pub(crate) fn add_experience(&mut self, bank: u64, steps: u32) -> u32 {
        let known = self.role.banks.entry(bank).or_default();
        known.push(steps);
        known.len() as u32 - 1
    }

    /// Takes back a bank.
    pub(crate) fn take_back(&mut self, bank: u64) -> CheckResult<()> {
        self.neighbours.banks.take_back(bank)?;
        self.notify()
    }

    /// Begins an episode in `lane` that remembers `bank`; the lane's earlier one is over.
    pub(crate) fn begin(
        &mut self,
        lane: u32,
        bank: u64,
        instruction: &str,
    ) -> CheckResult<RequestId> {
        self.begin_with(external_episode(lane, 0, bank, instruction))
    }

    /// As [`Self::begin`], with the message but for its episode.
    pub(crate) fn begin_with(&mut self, message: ExternalEpisode) -> CheckResult<RequestId> {
        let id = self.next_episode(message.lane);
        self.role.episodes.insert(id.episode, message.bank);
        self.neighbours.episodes.send(&ExternalEpisode { episode: id.episode, ..message })?;
        Ok(id)
    }

    /// Sends the query of a step at which the agent sees the view of `seed`. Does not notify.
    pub(crate) fn query(&mut self, id: RequestId, seed: u64) -> CheckResult<()> {
        let frame = self.seen(seed)?;
        let numbers = if self.role.description.embeddings { embedding(seed) } else { Vec::new() };
        let message = query(id, frame, pose(seed), &numbers);
        Ok(self.neighbours.queries.send(&message)?)
    }

    /// Makes a query. Does not notify.
    pub(crate) fn ask(&mut self, id: RequestId, seed: u64) -> CheckResult<()> {
        self.expect(id);
        self.query(id, seed)
    }

    /// Makes a query, waits for its answer, and returns it with what it supplies.
    pub(crate) fn ask_and_wait(
        &mut self,
        id: RequestId,
        seed: u64,
    ) -> CheckResult<(ExternalAnswer, Vec<Supplied>)> {
        self.ask(id, seed)?;
        self.wait()?;
        self.supplied(id)
    }

    /// The answer to a query that has been answered, and what it supplies.
    pub(crate) fn supplied(&self, id: RequestId) -> CheckResult<(ExternalAnswer, Vec<Supplied>)> {
        let answer = self.answer(id)?;
        let items = self.role.supplied(id, &answer);
        items.map_or_else(wrong, |items| Ok((answer.message, items)))
    }
}
