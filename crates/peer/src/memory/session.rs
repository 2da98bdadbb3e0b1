//! An external memory in one generation: banks, episodes, queries, answers.

use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::sync::Arc;

use bytemuck::Zeroable;
use domain::{Action, Feedback, Pose, UnknownCode};
use shm_types::banks::BankStep;
use shm_types::message::{
    ExternalAnswer, ExternalBuilt, ExternalEpisode, ExternalQuery, ExternalStore, ExternalStored,
    Learning, NO_ACTION, NOT_MEASURED, RequestId, Role, read_text,
};
use shm_types::process::monotonic_ns;
use shm_types::{
    Bank, BankReceiver, Bus, ErrorReporter, Frame, NotePublisher, Notifier, Receiver, Sender,
};

use super::answer::UnsentAnswer;
use super::{
    Demonstration, DemonstrationStep, Episode, EpisodeEnd, Memory, MemoryError, MemoryMethod,
    PastStep, Query, Step,
};
use crate::connection::{Connection, Session};
use crate::policy::FrameView;
use crate::run::ServeError;

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
    /// Step, pose and view of the last query.
    last: Option<(u32, Pose, Arc<Frame>)>,
    /// Why the episode cannot be served.
    failure: Option<MemoryError>,
}

impl<'s> MemorySession<'s> {
    pub(super) fn new(
        method: &'s dyn MemoryMethod,
        uses_frames: bool,
        bus: &Bus,
    ) -> Result<Self, ServeError> {
        let attach = bus.attach();
        Ok(Self {
            track: format!("external memory {}", method.describe().name),
            method,
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
        let mut memory = self.method.create();
        let built = self.demonstrations(Arc::new(bank), connection)?.and_then(|parts| {
            memory.build(&parts.demonstrations())?;
            Ok(memory.store_bytes().unwrap_or(0))
        });
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

    /// The demonstrations of a bank, with their views if the method looks at them.
    fn demonstrations(
        &self,
        bank: Arc<Bank>,
        connection: &mut Connection,
    ) -> Result<Result<BankParts, MemoryError>, ServeError> {
        let mut frames = Vec::new();
        let wanted = bank.steps().iter().filter(|_| self.uses_frames && bank_has_frames(&bank));
        for step in wanted {
            let Some(frame) = connection.frame(step.frame)? else {
                let id = step.frame;
                return Ok(Err(MemoryError::new(format_args!("frame {id} is not in the store"))));
            };
            frames.push(frame);
        }
        let steps: Result<Vec<_>, UnknownCode> = bank.steps().iter().map(read_step).collect();
        Ok(steps.map(|steps| BankParts { bank, steps, frames }).map_err(MemoryError::new))
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
        let place = self.lanes.get_mut(lane as usize);
        let (Some(place), Ok(instruction), Some(learning)) = (place, instruction, learning) else {
            errors.report(format_args!("episode {episode} in lane {lane}: invalid values"));
            return;
        };
        if let Some(earlier) = place.take()
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
        *place = Some(AskedEpisode {
            id: episode,
            bank,
            instruction: instruction.to_owned(),
            learning,
            image_budget,
            text_budget,
            window: Vec::new(),
            last: None,
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
        let id = RequestId { lane, episode, step };
        // Only now, because the last query of the lane's earlier episode may have arrived together with the announcement.
        let announced = self.announced.entry(lane).or_default();
        let at = announced.iter().position(|next| next.episode == episode);
        let next = at.and_then(|at| announced.drain(..=at).next_back());
        // A lane whose next episode is announced awaits no answer.
        let is_over = !announced.is_empty();
        if let Some(next) = next {
            self.begin(&next, &mut connection.errors);
        }
        let received_ns = monotonic_ns();
        let place = self.lanes.get_mut(lane as usize);
        let Some(running) = place.and_then(Option::as_mut).filter(|running| running.id == episode)
        else {
            let what = format_args!("query of unknown episode {episode} in lane {lane}");
            connection.errors.report(what);
            return Ok(false);
        };
        if is_over && message.last == 0 {
            return Ok(false);
        }
        let frame = match message.last {
            1 => None,
            _ => connection.frame(message.frame)?,
        };
        let memory = self.memories.get_mut(&running.bank).and_then(Option::as_mut);
        let answer = match &running.failure {
            Some(failure) => Err(failure.clone()),
            None => running.ask(message, frame.as_ref(), memory, self.window),
        };
        running.failure = answer.as_ref().err().cloned();
        if message.last == 1 {
            let Some(ended) = self.lanes[lane as usize].take() else { return Ok(false) };
            let Some(Some(memory)) = self.memories.get_mut(&ended.bank) else { return Ok(false) };
            if ended.learning == Learning::Learns {
                let sub_goals = sub_goals(message);
                let learned = answer.and_then(|_| {
                    memory.end_episode(&EpisodeEnd {
                        lane,
                        episode,
                        demonstration: Some(message.demonstration),
                        success: [None, Some(false), Some(true)]
                            .get(usize::from(message.outcome))
                            .copied()
                            .flatten(),
                        sub_goals: sub_goals.as_deref(),
                    })
                });
                if let Err(error) = learned {
                    self.unlearned.insert(ended.bank, error);
                }
            } else {
                let _ = memory.end_episode(&EpisodeEnd::unlearned(lane, episode));
            }
            return Ok(false);
        }
        self.send(id, answer.unwrap_or_else(UnsentAnswer::failed), received_ns)?;
        Ok(true)
    }

    /// Saves or loads what the memory of a bank knows.
    fn store(&mut self, message: &ExternalStore) -> Result<(), ServeError> {
        let &ExternalStore { bank, loads, folder_len, .. } = message;
        let folder = read_text(&message.folder, folder_len).map(Path::new);
        let unlearned = self.unlearned.remove(&bank);
        let done = match (self.memories.get_mut(&bank), folder, unlearned) {
            (_, _, Some(error)) => Err(error),
            (_, Err(_), _) => Err(MemoryError::new("the name of the folder cannot be read")),
            (Some(Some(memory)), Ok(folder), None) => {
                let done = if loads == 1 { memory.load(folder) } else { memory.save(folder) };
                done.map(|()| memory.store_bytes().unwrap_or(0))
            }
            _ => Err(MemoryError::new("there is no memory of the bank")),
        };
        let mut message = ExternalStored { bank, ..Zeroable::zeroed() };
        match done {
            Ok(store_bytes) => message.store_bytes = store_bytes,
            Err(error) => {
                tracing::warn!(bank, %error, "the memory cannot be saved or loaded");
                message.failure = self.notes.publish(NO_LANE, 0, error.to_string().as_bytes())?;
            }
        }
        self.stored.send(&message)?;
        self.host.notify()?;
        Ok(())
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

impl AskedEpisode {
    /// Passes a step to the memory and asks it, unless it is the last step.
    ///
    /// # Errors
    /// When the episode cannot be served.
    fn ask(
        &mut self,
        message: &ExternalQuery,
        frame: Option<&Arc<Frame>>,
        memory: Option<&mut Box<dyn Memory + '_>>,
        window: usize,
    ) -> Result<UnsentAnswer, MemoryError> {
        let &ExternalQuery { lane, episode, step, embedding_len, .. } = message;
        let memory = memory.ok_or_else(|| MemoryError::new("there is no memory of the bank"))?;
        let pose = Pose::try_from(message.pose).map_err(MemoryError::new)?;
        let feedback = Feedback::try_from(message.feedback).map_err(MemoryError::new)?;
        let last_action = Action::try_from(message.action).ok();
        let embedding = message.embedding.get(..embedding_len as usize);
        let embedding = embedding.filter(|numbers| !numbers.is_empty());
        if let Some((_, pose, frame)) = self.last.take() {
            self.window.push(PastStep { pose, action: last_action, feedback, frame });
            let past = self.window.len().saturating_sub(window);
            self.window.drain(..past);
        }
        let view = frame.map(|frame| FrameView::of(frame));
        let now = Step {
            lane,
            episode,
            step,
            pose,
            last_action,
            feedback,
            frame: view,
            embedding,
            pinned: frame,
        };
        if self.learning != Learning::ReadsOnly {
            memory.observe(&now)?;
        }
        if message.last == 1 {
            return Ok(UnsentAnswer::empty());
        }
        let Some(frame) = frame else {
            let id = message.frame;
            return Err(MemoryError::new(format_args!("frame {id} is not in the store")));
        };
        let query = Query {
            now,
            instruction: &self.instruction,
            window: &self.window,
            image_budget: self.image_budget,
            text_budget: self.text_budget,
            stage: None,
        };
        let items = memory.recall(&query)?;
        self.last = Some((step, pose, frame.clone()));
        let mut answer = UnsentAnswer::of(&items)?;
        answer.message.store_bytes = memory.store_bytes().unwrap_or(0);
        answer.message.tokens = memory.tokens().unwrap_or(NOT_MEASURED);
        Ok(answer)
    }
}

/// The sub-goals that the last query of an episode tells.
fn sub_goals(message: &ExternalQuery) -> Option<Vec<u32>> {
    let steps = message.sub_goals.get(..message.sub_goals_len as usize)?;
    Some(steps.iter().copied().map(u32::from).collect())
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

fn read_step(step: &BankStep) -> Result<DemonstrationStep, UnknownCode> {
    Ok(DemonstrationStep {
        pose: step.pose.try_into()?,
        action: match step.action {
            NO_ACTION => None,
            code => Some(Action::try_from(code)?),
        },
        feedback: Feedback::try_from(step.feedback)?,
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
}
