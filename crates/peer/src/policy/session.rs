//! The policy role in one generation: receive, join, decide, answer.

use std::sync::{Arc, mpsc};

use bytemuck::Zeroable;
use case_book::WorldDeclaration;
use domain::Reasoning;
use domain::prompt_log::{
    PromptLogEntry, RecordedAnswer, RecordedExchange, RecordedRequest, RecordedTiming,
    RecordedUsage,
};
use shm_types::message::{
    self, DocumentId, NOT_MEASURED, Observation, PolicyEpisodeConfig, Recall, RequestId, Role,
    action_code, write_text,
};
use shm_types::process::monotonic_ns;
use shm_types::{
    BusError, Document, DocumentError, DocumentStore, ErrorReporter, Receiver, Sender,
};

use super::answers::{AnswerEvent, Answers};
use super::join::{Join, Ready, Recalled};
use super::pinned::{PinnedStep, with_batch};
use super::prompt_log::{PromptLogError, PromptLogWriter};
use super::{Batch, Decider, Decision, Usage};
use crate::connection::{Connection, Session};
use crate::error::ServeError;

impl From<PromptLogError> for ServeError {
    fn from(error: PromptLogError) -> Self {
        Self::PromptLog(error.to_string())
    }
}

/// A policy in one generation.
pub(super) struct PolicySession<'p, P: ?Sized> {
    policy: &'p mut P,
    configs: Receiver<PolicyEpisodeConfig>,
    observations: Receiver<Observation>,
    recalls: Receiver<Recall>,
    decisions: Sender<message::Decision>,
    documents: DocumentStore,
    /// What the world says of itself.
    world: Arc<WorldDeclaration>,
    join: Join,
    answers: Answers,
    events: mpsc::Receiver<AnswerEvent>,
    /// By lane: the request that the policy has not answered yet.
    open: Vec<Option<OpenRequest>>,
    /// Requests answered so far.
    answered: u64,
    /// Requests that cannot be answered, and why, until that is reported.
    failed: Vec<(RequestId, String)>,
    /// Whether the run was asked to stop.
    has_stopped: bool,
    /// Facts that were learned and are not reported yet.
    learned: Option<Vec<(&'static str, String)>>,
    log: Log,
}

/// The state of the prompt log.
enum Log {
    Off,
    On(PromptLogWriter),
    /// It cannot be written, and the run was asked to stop. No further request is passed to the policy and no answer
    /// leaves, so that no step is without its entry.
    Broken,
}

/// A request that the policy has not answered yet.
struct OpenRequest {
    id: RequestId,
    images: u32,
    received_ns: u64,
    started_ns: u64,
    /// For the prompt log.
    request: Option<Box<RecordedRequest>>,
    exchange: Option<Box<RecordedExchange>>,
}

impl<'p, P: Decider + ?Sized> PolicySession<'p, P> {
    pub(super) fn new(policy: &'p mut P, connection: &Connection) -> Result<Self, ServeError> {
        let bus = connection.bus();
        let log = PromptLogWriter::open(bus.attach())?.map_or(Log::Off, Log::On);
        let (answers, events) =
            Answers::new(bus.notifier(Role::Policy)?, matches!(log, Log::On(_)));
        let lanes = bus.attach().lanes;
        Ok(Self {
            policy,
            configs: bus.receiver()?,
            observations: bus.receiver()?,
            recalls: bus.receiver()?,
            decisions: bus.sender()?,
            documents: DocumentStore::new(bus)?,
            world: Arc::clone(connection.world()),
            join: Join::new(lanes, Arc::clone(connection.world())),
            answers,
            events,
            open: (0..lanes).map(|_| None).collect(),
            answered: 0,
            failed: Vec::new(),
            has_stopped: false,
            learned: None,
            log,
        })
    }

    /// Empties all queues. A message that refers to another one was sent after it: the queues are therefore emptied in
    /// the order effect before cause, and the messages are processed in the order cause before effect.
    fn receive(&mut self, errors: &mut ErrorReporter) -> Result<(), ServeError> {
        let mut recalls = Vec::new();
        while recalls.len() < self.open.len()
            && let Some(recalled) =
                self.recalls.next_with(|recall| Recalled::read(&self.world, recall))?
        {
            recalls.push(recalled);
        }
        let observations = self.observations.drain()?;
        for config in &self.configs.drain()? {
            self.documents.begin(config.lane, config.episode);
            match self.join.begin(config) {
                Ok(()) => {
                    self.open[config.lane as usize] = None;
                    self.policy.reset(config.lane);
                }
                Err(bad) => errors.report(bad),
            }
        }
        for outcome in observations.iter().map(|message| self.join.observe(message)) {
            outcome.unwrap_or_else(|bad| errors.report(bad));
        }
        for outcome in recalls.into_iter().map(|recalled| self.join.recall(recalled?)) {
            outcome.unwrap_or_else(|bad| errors.report(bad));
        }
        Ok(())
    }

    /// Passes all complete steps to the policy.
    fn decide(&mut self, connection: &mut Connection) -> Result<(), ServeError> {
        let received_ns = monotonic_ns();
        let mut steps = Vec::new();
        for step in self.join.take_ready() {
            steps.extend(self.pin(step, connection)?.map(Arc::new));
        }
        if steps.is_empty() || matches!(self.log, Log::Broken) {
            return Ok(());
        }
        with_batch(&steps, |batch| {
            if !self.open(batch, received_ns, &mut connection.errors)? {
                return Ok(());
            }
            let began = connection.spans.begin();
            self.policy.take(batch, &self.answers)?;
            connection.spans.end(began, "policy", "decide", batch.len());
            Ok(())
        })
    }

    /// Remembers the requests of `batch` as open. Returns `false` when the prompt log is broken.
    fn open(
        &mut self,
        batch: &Batch<'_>,
        received_ns: u64,
        errors: &mut ErrorReporter,
    ) -> Result<bool, ServeError> {
        let started_ns = monotonic_ns();
        for request in batch.iter() {
            let recorded = match &mut self.log {
                Log::On(log) => log.request(request).map(|recorded| Some(Box::new(recorded))),
                Log::Off | Log::Broken => Ok(None),
            };
            let recorded = match recorded {
                Ok(recorded) => recorded,
                Err(error) => {
                    self.log = Log::Broken;
                    errors.stop_run(&error.to_string())?;
                    return Ok(false);
                }
            };
            let id = request.id();
            self.open[id.lane as usize] = Some(OpenRequest {
                id,
                images: request.images(),
                received_ns,
                started_ns,
                request: recorded,
                exchange: None,
            });
        }
        Ok(true)
    }

    /// Sends the policy's answers; returns whether anything was sent.
    fn send_answers(&mut self, errors: &mut ErrorReporter) -> Result<bool, ServeError> {
        let mut sent = false;
        while let Ok(event) = self.events.try_recv() {
            match self.checked(event) {
                AnswerEvent::Exchanged(id, exchange) => {
                    let open = self.open.get_mut(id.lane as usize).and_then(Option::as_mut);
                    if let Some(open) = open.filter(|open| open.id == id) {
                        open.exchange = Some(exchange);
                    }
                    continue;
                }
                AnswerEvent::Decided(id, decision, decided_ns) => {
                    let Some(open) = self.close(id) else { continue };
                    let message = open.message(&decision, decided_ns);
                    // The log entry is written before the decision is sent.
                    if self
                        .log_entry(open.entry(&self.world, Ok((&decision, decided_ns))), errors)?
                    {
                        self.decisions.send(&message)?;
                        self.answered += 1;
                    }
                }
                AnswerEvent::Failed(id, why) => {
                    let Some(open) = self.close(id) else { continue };
                    if self.log_entry(open.entry(&self.world, Err(&why)), errors)? {
                        self.failed.push((id, why));
                    }
                }
                AnswerEvent::Stopped(_) if self.has_stopped => continue,
                AnswerEvent::Stopped(why) => {
                    errors.stop_run(&why)?;
                    self.has_stopped = true;
                }
                AnswerEvent::Waiting(reason) => errors.waiting(&reason)?,
                AnswerEvent::Learned(facts) => self.learned = Some(facts),
            }
            sent = true;
        }
        // What the queue has no room for is reported in the next turn.
        if let Some(facts) = self.learned.take() {
            match errors.learned(facts.iter().cloned()) {
                Ok(()) => sent = true,
                Err(BusError::Full { .. }) => self.learned = Some(facts),
                Err(error) => return Err(error.into()),
            }
        }
        while let Some((id, why)) = self.failed.last() {
            match errors.fail_episode(id.lane, id.episode, why) {
                Ok(()) => drop(self.failed.pop()),
                Err(BusError::Full { .. }) => break,
                Err(error) => return Err(error.into()),
            }
        }
        Ok(sent)
    }

    /// The same event; a failure in place of a decision for an action that the world does not have.
    fn checked(&self, event: AnswerEvent) -> AnswerEvent {
        let AnswerEvent::Decided(id, ref decision, _) = event else { return event };
        match self.world.read_action(decision.answer.action()) {
            Ok(_) => event,
            Err(unknown) => AnswerEvent::Failed(id, format!("the policy's answer: {unknown}")),
        }
    }

    /// Writes an entry to the prompt log, if there is one. Returns `false` when the log is broken: the run was asked to
    /// stop, and the answer must not be sent.
    fn log_entry(
        &mut self,
        entry: Option<PromptLogEntry>,
        errors: &mut ErrorReporter,
    ) -> Result<bool, ServeError> {
        let (Log::On(log), Some(entry)) = (&mut self.log, entry) else {
            return Ok(!matches!(self.log, Log::Broken));
        };
        if let Err(error) = log.write(entry) {
            self.log = Log::Broken;
            errors.stop_run(&error.to_string())?;
            return Ok(false);
        }
        Ok(true)
    }

    /// Removes the open request `id`; `None` when its episode is over or it was answered before.
    fn close(&mut self, id: RequestId) -> Option<OpenRequest> {
        let open = self.open.get_mut(id.lane as usize)?;
        open.take_if(|open| open.id == id && self.join.is_running(id))
    }

    /// Pins the documents and frames of `step`. If one is missing or does not have what an item names, the step cannot be
    /// decided: that is reported.
    fn pin(
        &mut self,
        step: Ready,
        connection: &mut Connection,
    ) -> Result<Option<PinnedStep>, ServeError> {
        let (lane, number) = (step.lane, step.observed.step);
        let mut documents = Vec::new();
        for id in step.recalled.documents() {
            documents.extend(self.document(id, &mut connection.errors)?);
        }
        let mut pinned = match PinnedStep::new(step, &documents) {
            Ok(pinned) => pinned,
            Err(bad) => {
                connection.errors.report(bad);
                return Ok(None);
            }
        };
        let mut frames = Vec::new();
        for id in pinned.frame_ids() {
            let Some(frame) = connection.frame(id)? else {
                connection.errors.report(format_args!(
                    "lane {lane}, step {number}: frame {id} is not in the store: it was evicted too early or never \
                     published"
                ));
                return Ok(None);
            };
            frames.push(frame);
        }
        pinned.pin(frames);
        Ok(Some(pinned))
    }

    fn document(
        &mut self,
        id: DocumentId,
        errors: &mut ErrorReporter,
    ) -> Result<Option<Arc<Document>>, ServeError> {
        loop {
            match self.documents.get(id) {
                Ok(document) => return Ok(document.cloned()),
                Err(DocumentError::Bus(error)) => return Err(error.into()),
                // The store has dropped the invalid document.
                Err(error) => errors.report(error),
            }
        }
    }
}

impl<P: Decider + ?Sized> Session for PolicySession<'_, P> {
    fn turn(&mut self, connection: &mut Connection) -> Result<bool, ServeError> {
        self.receive(&mut connection.errors)?;
        self.decide(connection)?;
        self.send_answers(&mut connection.errors)
    }

    fn progress(&self) -> (u64, u64) {
        (self.answered, self.open.iter().flatten().count() as u64)
    }

    fn expects_message(&self) -> bool {
        self.join.awaits_observation()
    }

    fn idle(&mut self) -> Result<(), ServeError> {
        self.policy.idle()
    }

    fn release_frames(&mut self) {
        self.policy.release_frames();
    }
}

impl OpenRequest {
    /// The decision as a message.
    fn message(&self, decision: &Decision, decided_ns: u64) -> message::Decision {
        let &Self { id, images, received_ns, started_ns, .. } = self;
        let usage = decision.usage.clone().unwrap_or_default();
        let count = |count: Option<u32>| count.unwrap_or(NOT_MEASURED);
        let reasoning = match usage.reasoned {
            None => Reasoning::Unknown,
            Some(false) => Reasoning::Off,
            Some(true) => Reasoning::On,
        };
        let mut message = message::Decision {
            episode: id.episode,
            received_ns,
            started_ns,
            prompted_ns: usage.prompted_ns,
            sent_ns: usage.sent_ns,
            decided_ns,
            lane: id.lane,
            step: id.step,
            prompt_tokens: count(usage.prompt_tokens),
            completion_tokens: count(usage.completion_tokens),
            cached_tokens: count(usage.cached_tokens),
            image_tokens: count(usage.image_tokens),
            memory_tokens: count(usage.memory_tokens),
            reusable_tokens: count(usage.reusable_tokens),
            images_asked: images,
            images: decision.images,
            attempts: usage.attempts,
            outcome: decision.answer.outcome() as u8,
            action: action_code(decision.answer.action()),
            replayed: usage.replayed.into(),
            reasoning: reasoning as u8,
            ..Zeroable::zeroed()
        };
        let text = |text: &Option<String>, buffer: &mut [u8]| {
            // The buffers are shorter than 256 bytes.
            text.as_ref().map_or(0, |text| write_text(buffer, text) as u8)
        };
        message.finish_reason_len = text(&usage.finish_reason, &mut message.finish_reason);
        message.model_len = text(&usage.model, &mut message.model);
        message
    }

    /// The entry of the prompt log: of a decision and when it was made, or of why there is none.
    fn entry(
        self,
        world: &WorldDeclaration,
        answer: Result<(&Decision, u64), &str>,
    ) -> Option<PromptLogEntry> {
        let Self { id, images, received_ns, started_ns, request, exchange } = self;
        let decision = answer.ok().map(|(decision, _)| decision);
        let usage = decision.and_then(|decision| decision.usage.clone());
        let stamp = |stamp: fn(&Usage) -> u64| usage.as_ref().map_or(0, stamp);
        let [prompted_ns, sent_ns] =
            [stamp(|usage| usage.prompted_ns), stamp(|usage| usage.sent_ns)];
        Some(PromptLogEntry {
            episode: id.episode,
            step: id.step,
            lane: id.lane,
            request: *request?,
            exchange: exchange.map(|exchange| *exchange),
            answer: decision.map(|decision| RecordedAnswer {
                outcome: decision.answer.outcome().word().to_owned(),
                action: decision
                    .answer
                    .action()
                    .map(|action| world.action_words(action).to_owned()),
                images_asked: images,
                images: decision.images,
            }),
            failed: answer.err().map(str::to_owned),
            usage: usage.map(|usage| RecordedUsage {
                prompt_tokens: usage.prompt_tokens,
                completion_tokens: usage.completion_tokens,
                cached_tokens: usage.cached_tokens,
                image_tokens: usage.image_tokens,
                memory_tokens: usage.memory_tokens,
                reusable_tokens: usage.reusable_tokens,
                attempts: usage.attempts,
                replayed: usage.replayed,
                finish_reason: usage.finish_reason,
                reasoned: usage.reasoned,
                model: usage.model,
            }),
            timing: RecordedTiming {
                received_ns,
                started_ns,
                prompted_ns,
                sent_ns,
                decided_ns: answer.map_or_else(|_| monotonic_ns(), |(_, decided_ns)| decided_ns),
            },
        })
    }
}
