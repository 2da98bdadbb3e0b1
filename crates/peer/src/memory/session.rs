//! An external memory in one generation: banks, episodes, queries, answers.

use std::collections::{HashMap, VecDeque};
use std::fmt;
use std::path::Path;
use std::sync::Arc;

use bytemuck::Zeroable;
use case_book::WorldDeclaration;
use domain::State;
use shm_types::banks::BankStep;
use shm_types::message::{
    EpisodeOutcome, ExternalAnswer, ExternalBuilt, ExternalEpisode, ExternalQuery, ExternalStore,
    ExternalStored, FrameId, Learning, NOT_MEASURED, RequestId, Role, read_action, read_flag,
    read_text,
};
use shm_types::process::monotonic_ns;
use shm_types::{
    Bank, BankReceiver, ErrorReporter, Frame, NotePublisher, Notifier, Receiver, Sender,
};

use super::answer::UnsentAnswer;
use super::{
    Demonstration, DemonstrationStep, Episode, EpisodeEnd, Memory, MemoryError, MemoryMethod,
    PastStep, Query, Step,
};
use crate::connection::{Connection, Session};
use crate::error::ServeError;
use crate::policy::FrameView;

/// The lane in the header of a note that is no answer.
const NO_LANE: u32 = u32::MAX;

/// Batches of queries that are answered before the process looks at its other duties.
const MAX_BATCHES: usize = 16;

/// A method of remembering in one generation.
pub(super) struct MemorySession<'s> {
    method: &'s dyn MemoryMethod,
    uses_frames: bool,
    /// Where its spans stand in a trace.
    track: String,
    banks: BankReceiver,
    episodes: Receiver<ExternalEpisode>,
    queries: Receiver<ExternalQuery>,
    stores: Receiver<ExternalStore>,
    stored: Sender<ExternalStored>,
    built: Sender<ExternalBuilt>,
    answers: Sender<ExternalAnswer>,
    notes: NotePublisher,
    host: Notifier,
    /// Wakes this process itself.
    own: Notifier,
    /// By the id of the bank: the memory that was built from it.
    memories: HashMap<u64, Option<Box<dyn Memory + 's>>>,
    /// By the id of the bank: why the memory could not learn from its last episode.
    unlearned: HashMap<u64, MemoryError>,
    lanes: Vec<Option<AskedEpisode>>,
    /// By lane: episodes whose first query has not been read.
    announced: HashMap<u32, VecDeque<ExternalEpisode>>,
    /// What is to be saved or loaded after the queries that wait.
    storing: Vec<ExternalStore>,
    /// What the world says of itself.
    world: Arc<WorldDeclaration>,
    window: usize,
    batch: usize,
    answered: u64,
}

/// The episode that runs in a lane.
struct AskedEpisode {
    id: u64,
    bank: u64,
    instruction: String,
    learning: Learning,
    image_budget: u32,
    text_budget: u32,
    window: Vec<PastStep>,
    /// State and view of the last query.
    last_view: Option<(State, Arc<Frame>)>,
    /// Why the episode cannot be served.
    failure: Option<MemoryError>,
}

impl<'s> MemorySession<'s> {
    pub(super) fn new(
        method: &'s dyn MemoryMethod,
        uses_frames: bool,
        connection: &Connection,
    ) -> Result<Self, ServeError> {
        let bus = connection.bus();
        let attach = bus.attach();
        Ok(Self {
            track: format!("external memory {}", method.describe().name),
            method,
            world: Arc::clone(connection.world()),
            uses_frames,
            banks: BankReceiver::new(bus)?,
            episodes: bus.receiver()?,
            queries: bus.receiver()?,
            stores: bus.receiver()?,
            stored: bus.sender()?,
            built: bus.sender()?,
            answers: bus.sender()?,
            notes: NotePublisher::new(bus)?,
            host: bus.notifier(Role::Memory)?,
            own: bus.notifier(Role::ExternalMemory)?,
            memories: HashMap::new(),
            unlearned: HashMap::new(),
            lanes: (0..attach.lanes).map(|_| None).collect(),
            announced: HashMap::new(),
            storing: Vec::new(),
            window: attach.window as usize,
            batch: attach.batch_len(),
            answered: 0,
        })
    }

    /// Builds a memory from a bank, or drops that of a bank that is taken back.
    fn take_bank(&mut self, bank: Bank, connection: &mut Connection) -> Result<(), ServeError> {
        if bank.demonstrations().is_empty() {
            self.memories.remove(&bank.id());
            return Ok(());
        }
        let id = bank.id();
        let started_ns = monotonic_ns();
        let Some(demonstrations) = self.demonstrations(Arc::new(bank), connection)? else {
            return Ok(());
        };
        let mut memory = self.method.create(&self.world);
        let built = demonstrations.and_then(|parts| {
            memory.build(&parts.demonstrations())?;
            Ok(memory.store_bytes().unwrap_or(0))
        });
        self.method.check()?;
        let mut message = ExternalBuilt { bank: id, ..Zeroable::zeroed() };
        match built {
            Ok(store_bytes) => {
                message.store_bytes = store_bytes;
                self.memories.insert(id, Some(memory));
            }
            Err(error) => {
                tracing::warn!(bank = id, %error, "the memory cannot be built");
                message.failure = self.notes.publish(NO_LANE, 0, error.to_string().as_bytes())?;
                self.memories.insert(id, None);
            }
        }
        message.took_ns = monotonic_ns().saturating_sub(started_ns);
        self.built.send(&message)?;
        self.host.notify()?;
        Ok(())
    }

    /// The demonstrations of a bank, with their views if the method looks at them. `None` if one is missing: see [`report_missing`].
    fn demonstrations(
        &self,
        bank: Arc<Bank>,
        connection: &mut Connection,
    ) -> Result<Option<Result<BankParts, MemoryError>>, ServeError> {
        let mut frames = Vec::new();
        let wanted = bank.steps().iter().filter(|_| self.uses_frames && bank_has_frames(&bank));
        for step in wanted {
            let Some(frame) = connection.frame(step.frame)? else {
                report_missing(step.frame, format_args!("bank {}", bank.id()), connection);
                return Ok(None);
            };
            frames.push(frame);
        }
        let steps = bank.steps().iter().map(|step| read_demonstration_step(&self.world, step));
        let steps: Result<Vec<_>, MemoryError> = steps.collect();
        Ok(Some(steps.map(|steps| BankParts { bank, steps, frames })))
    }

    fn begin(&mut self, message: &ExternalEpisode, errors: &mut ErrorReporter) {
        let &ExternalEpisode {
            lane,
            episode,
            bank,
            seed,
            text_budget,
            image_budget,
            repeat,
            learning,
            ..
        } = message;
        let learning = u8::try_from(learning).ok().and_then(|code| Learning::try_from(code).ok());
        let instruction = read_text(&message.instruction, message.instruction_len);
        let slot = self.lanes.get_mut(lane as usize);
        let (Some(slot), Ok(instruction), Some(learning)) = (slot, instruction, learning) else {
            errors.report(format_args!("episode {episode} in lane {lane}: invalid values"));
            return;
        };
        if let Some(earlier) = slot.take()
            && let Some(Some(memory)) = self.memories.get_mut(&earlier.bank)
        {
            // The end of an episode that nothing is learned from cannot fail it.
            let _ = memory.end_episode(&EpisodeEnd::unlearned(lane, earlier.id));
        }
        let announced = Episode {
            lane,
            episode,
            instruction,
            seed,
            repeat,
            image_budget,
            text_budget,
            learns: learning == Learning::Learns,
        };
        let begun = match self.memories.get_mut(&bank) {
            Some(Some(memory)) => memory.begin_episode(&announced),
            Some(None) => Err(MemoryError::new("the memory could not be built")),
            None => Err(MemoryError::new(format_args!("bank {bank} was not received"))),
        };
        *slot = Some(AskedEpisode {
            id: episode,
            bank,
            instruction: instruction.to_owned(),
            learning,
            image_budget,
            text_budget,
            window: Vec::new(),
            last_view: None,
            failure: begun.err(),
        });
    }

    /// Passes a step to the memory, and answers it unless it is the last. Returns whether an answer was sent.
    fn query(
        &mut self,
        message: &ExternalQuery,
        connection: &mut Connection,
    ) -> Result<bool, ServeError> {
        let &ExternalQuery { lane, episode, step, .. } = message;
        self.begin_announced(lane, episode, connection);
        let received_ns = monotonic_ns();
        let slot = self.lanes.get_mut(lane as usize);
        let Some(slot) = slot.filter(|slot| slot.as_ref().is_some_and(|own| own.id == episode))
        else {
            let problem = format_args!("query of unknown episode {episode} in lane {lane}");
            connection.errors.report(problem);
            return Ok(false);
        };
        if message.last == 1 {
            if let Some(ended) = slot.take() {
                self.end(ended, message);
            }
            return Ok(false);
        }
        // A lane whose next episode is announced awaits no answer.
        let is_over = self.announced.get(&lane).is_some_and(|waiting| !waiting.is_empty());
        let Some(running) = slot.as_mut().filter(|_| !is_over) else { return Ok(false) };
        let Some(frame) = connection.frame(message.frame)? else {
            report_missing(message.frame, format_args!("lane {lane}, step {step}"), connection);
            return Ok(false);
        };
        let memory = self.memories.get_mut(&running.bank).and_then(Option::as_mut);
        let answer = running.answer(message, &self.world, &frame, memory, self.window);
        self.method.check()?;
        running.failure = answer.as_ref().err().cloned();
        let id = RequestId { lane, episode, step };
        self.send(id, answer.unwrap_or_else(UnsentAnswer::failed), received_ns)?;
        Ok(true)
    }

    /// Begins an episode whose first query has arrived. Only now, because the last query of the lane's earlier episode may have
    /// arrived together with the announcement. Episodes that were announced before it are dropped.
    fn begin_announced(&mut self, lane: u32, episode: u64, connection: &mut Connection) {
        let Some(announced) = self.announced.get_mut(&lane) else { return };
        let Some(position) = announced.iter().position(|next| next.episode == episode) else {
            return;
        };
        announced.drain(..position);
        if let Some(next) = announced.pop_front() {
            self.begin(&next, &mut connection.errors);
        }
    }

    /// Passes the last step of an episode to the memory, and tells it the end.
    fn end(&mut self, mut ended: AskedEpisode, message: &ExternalQuery) {
        let &ExternalQuery { lane, episode, .. } = message;
        let Some(Some(memory)) = self.memories.get_mut(&ended.bank) else { return };
        let observed = read_step(&self.world, message, None)
            .and_then(|step| ended.observe(&step, memory.as_mut(), self.window));
        if ended.learning != Learning::Learns {
            // The end of an episode that nothing is learned from cannot fail it.
            let _ = memory.end_episode(&EpisodeEnd::unlearned(lane, episode));
            return;
        }
        let learned = observed.and_then(|()| {
            let sub_goals = read_sub_goals(message)?;
            let outcome = EpisodeOutcome::try_from(message.outcome).map_err(MemoryError::new)?;
            memory.end_episode(&EpisodeEnd {
                lane,
                episode,
                demonstration: Some(message.demonstration),
                success: outcome.success(),
                sub_goals: sub_goals.as_deref(),
            })
        });
        if let Err(error) = learned {
            self.unlearned.insert(ended.bank, error);
        }
    }

    /// Saves or loads what the memory of a bank knows, and answers.
    fn store(&mut self, message: &ExternalStore) -> Result<(), ServeError> {
        let bank = message.bank;
        let mut answer = ExternalStored { bank, ..Zeroable::zeroed() };
        let stored = self.save_or_load(message);
        self.method.check()?;
        match stored {
            Ok(store_bytes) => answer.store_bytes = store_bytes,
            Err(error) => {
                tracing::warn!(bank, %error, "the memory cannot be saved or loaded");
                answer.failure = self.notes.publish(NO_LANE, 0, error.to_string().as_bytes())?;
            }
        }
        self.stored.send(&answer)?;
        self.host.notify()?;
        Ok(())
    }

    /// Saves or loads what the memory of a bank knows. Returns the bytes of its store; 0 if it does not tell.
    fn save_or_load(&mut self, message: &ExternalStore) -> Result<u64, MemoryError> {
        let &ExternalStore { bank, loads, folder_len, .. } = message;
        if let Some(error) = self.unlearned.remove(&bank) {
            return Err(error);
        }
        let folder = read_text(&message.folder, folder_len).map(Path::new);
        let folder =
            folder.map_err(|_| MemoryError::new("the name of the folder cannot be read"))?;
        let Some(Some(memory)) = self.memories.get_mut(&bank) else {
            return Err(MemoryError::new("there is no memory of the bank"));
        };
        if read_flag(loads).map_err(MemoryError::new)? {
            memory.load(folder)?;
        } else {
            memory.save(folder)?;
        }
        Ok(memory.store_bytes().unwrap_or(0))
    }

    fn send(
        &mut self,
        id: RequestId,
        answer: UnsentAnswer,
        received_ns: u64,
    ) -> Result<(), ServeError> {
        let RequestId { lane, episode, step } = id;
        let mut message = ExternalAnswer { episode, lane, step, received_ns, ..answer.message };
        if !answer.note.is_empty() {
            message.note = self.notes.publish(lane, episode, &answer.note)?;
        }
        message.sent_ns = monotonic_ns();
        self.answers.send(&message)?;
        self.answered += 1;
        Ok(())
    }
}

/// Reports a frame that is not in the store. What asks for it is not answered, because neither the memory nor the episode has failed:
/// usually the world has ended, and the run is about to start again.
fn report_missing(id: FrameId, needed_by: fmt::Arguments<'_>, connection: &mut Connection) {
    connection.errors.report(format_args!("{needed_by}: frame {id} is not in the store"));
}

impl AskedEpisode {
    /// Passes a step to the memory, and asks it.
    ///
    /// # Errors
    /// When the episode cannot be served.
    fn answer(
        &mut self,
        message: &ExternalQuery,
        world: &WorldDeclaration,
        frame: &Arc<Frame>,
        memory: Option<&mut Box<dyn Memory + '_>>,
        window: usize,
    ) -> Result<UnsentAnswer, MemoryError> {
        if let Some(failure) = &self.failure {
            return Err(failure.clone());
        }
        let memory = memory.ok_or_else(|| MemoryError::new("there is no memory of the bank"))?;
        let now = read_step(world, message, Some(frame))?;
        self.observe(&now, memory.as_mut(), window)?;
        let query = Query {
            now,
            instruction: &self.instruction,
            window: &self.window,
            image_budget: self.image_budget,
            text_budget: self.text_budget,
        };
        let items = memory.recall(&query)?;
        self.last_view = Some((now.state, frame.clone()));
        let mut answer = UnsentAnswer::of(&items)?;
        answer.message.store_bytes = memory.store_bytes().unwrap_or(0);
        answer.message.tokens = memory.tokens().unwrap_or(NOT_MEASURED);
        Ok(answer)
    }

    /// Adds the step before `now` to the window, and passes `now` to the memory if it may learn from it.
    ///
    /// # Errors
    /// When the episode cannot be served.
    fn observe(
        &mut self,
        now: &Step<'_>,
        memory: &mut (dyn Memory + '_),
        window: usize,
    ) -> Result<(), MemoryError> {
        if let Some(failure) = &self.failure {
            return Err(failure.clone());
        }
        if let Some((state, frame)) = self.last_view.take() {
            let (action, feedback) = (now.last_action, now.feedback);
            self.window.push(PastStep { state, action, feedback, frame });
            let excess = self.window.len().saturating_sub(window);
            self.window.drain(..excess);
        }
        match self.learning {
            Learning::OutsideOfStreams | Learning::Learns => memory.observe(now),
            Learning::ReadsOnly => Ok(()),
        }
    }
}

/// The step that a query describes.
///
/// # Errors
/// When a code or a length is not valid.
fn read_step<'a>(
    world: &WorldDeclaration,
    message: &'a ExternalQuery,
    frame: Option<&'a Arc<Frame>>,
) -> Result<Step<'a>, MemoryError> {
    let &ExternalQuery { lane, episode, step, embedding_len, .. } = message;
    read_flag(message.last).map_err(MemoryError::new)?;
    let embedding = message.embedding.get(..embedding_len as usize).ok_or_else(|| {
        MemoryError::new(format_args!("an embedding of {embedding_len} numbers is too long"))
    })?;
    Ok(Step {
        lane,
        episode,
        step,
        state: world.read_state(&message.state).map_err(MemoryError::new)?,
        last_action: world
            .read_action(read_action(message.action).map_err(MemoryError::new)?)
            .map_err(MemoryError::new)?,
        feedback: world.read_feedback(message.feedback).map_err(MemoryError::new)?,
        frame: frame.map(|frame| FrameView::of(frame)),
        embedding: Some(embedding).filter(|numbers| !numbers.is_empty()),
        pinned: frame,
    })
}

/// The sub-goals that the last query of an episode tells; `None` if it tells none.
///
/// # Errors
/// When there are more than a message holds.
fn read_sub_goals(message: &ExternalQuery) -> Result<Option<Vec<u32>>, MemoryError> {
    let count = message.sub_goals_len;
    if count == NOT_MEASURED {
        return Ok(None);
    }
    let steps = message.sub_goals.get(..count as usize);
    let steps =
        steps.ok_or_else(|| MemoryError::new(format_args!("{count} sub-goals are too many")))?;
    Ok(Some(steps.iter().copied().map(u32::from).collect()))
}

/// A bank in the form in which a memory is given it.
struct BankParts {
    bank: Arc<Bank>,
    steps: Vec<DemonstrationStep>,
    frames: Vec<Arc<Frame>>,
}

impl BankParts {
    fn demonstrations(&self) -> Vec<Demonstration<'_>> {
        let Self { bank, steps, frames } = self;
        let demonstrations = bank.demonstrations().iter().map(|demonstration| {
            let first = demonstration.first_step as usize;
            let end = first + demonstration.steps as usize;
            let dimension = bank.dimension();
            Demonstration {
                instruction: bank.instruction(demonstration),
                steps: &steps[first..end],
                embeddings: &bank.embeddings()[first * dimension..end * dimension],
                frames: frames.get(first..end).unwrap_or_default(),
                stages: &[],
                bank: Some(bank),
            }
        });
        demonstrations.collect()
    }
}

fn bank_has_frames(bank: &Bank) -> bool {
    bank.steps().first().is_some_and(|step| step.frame != shm_types::message::NO_FRAME)
}

fn read_demonstration_step(
    world: &WorldDeclaration,
    step: &BankStep,
) -> Result<DemonstrationStep, MemoryError> {
    let action = read_action(step.action).map_err(MemoryError::new)?;
    Ok(DemonstrationStep {
        state: world.read_state(&step.state).map_err(MemoryError::new)?,
        action: world.read_action(action).map_err(MemoryError::new)?,
        feedback: world.read_feedback(step.feedback).map_err(MemoryError::new)?,
        content_hash: step.content_hash,
    })
}

impl Session for MemorySession<'_> {
    fn turn(&mut self, connection: &mut Connection) -> Result<bool, ServeError> {
        for _ in 0..MAX_BATCHES {
            // Effects are read first: a query is sent after its episode, and that after its bank is built.
            // A memory is saved after the last query of its episode, and loaded after it is built.
            self.storing.extend(self.stores.drain()?);
            let queries = self.queries.drain_some(self.batch)?;
            for episode in self.episodes.drain()? {
                self.announced.entry(episode.lane).or_default().push_back(episode);
            }
            let mut banks = 0;
            while let Some(bank) = self.banks.take()? {
                banks += 1;
                match bank {
                    Ok(bank) => self.take_bank(bank, connection)?,
                    Err(bad) => connection.errors.report(bad),
                }
            }
            let began = connection.spans.begin();
            let mut answered = 0;
            for query in &queries {
                answered += usize::from(self.query(query, connection)?);
            }
            connection.spans.end(began, &self.track, "recall", answered);
            if answered > 0 {
                self.host.notify()?;
            }
            if queries.len() < self.batch {
                for store in std::mem::take(&mut self.storing) {
                    self.store(&store)?;
                }
            }
            if queries.is_empty() && banks == 0 {
                // The orchestrator learns of answers from the host.
                return Ok(false);
            }
        }
        // Further messages may wait, whose notification has been taken.
        self.own.notify()?;
        Ok(false)
    }

    fn progress(&self) -> (u64, u64) {
        (self.answered, 0)
    }

    fn idle(&mut self) -> Result<(), ServeError> {
        self.method.check()
    }
}
