//! The serve loop of one generation: drain, join, decide, answer, ring once.

use std::sync::{Arc, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use domain::prompt_log::{Answered, Asked, Entry, Exchange, Timing, Usage as LoggedUsage};
use shm_types::message::{
    DocumentId, FrameId, Handshake, Heartbeat, NO_ACTION, NOT_MEASURED, Observation,
    PolicyEpisodeConfig, Recall, Role, ShutdownReport, Stop,
};
use shm_types::process::monotonic_ns;
use shm_types::{
    Attach, Bus, Document, DocumentError, DocumentStore, ErrorReporter, Frame, FrameError,
    FrameStore, Heartbeats, Notifier, Receiver, Sender, Spans, message,
};

use super::Decider;
use super::answers::{Answers, Said};
use super::attend::{Run, ServeError};
use super::join::{Join, Ready, Recalled};
use super::prompt_log::{LogError, PromptLog};
use super::shown::{Held, Shown};
use crate::{Decision, Request, RequestId};

/// How long the loop sleeps when nobody rings, and how often it looks whether the run goes on.
const LONGEST_SLEEP: Duration = Duration::from_millis(250);

/// How long to wait for a message that is on its way and rings no bell.
const MOMENT: Duration = Duration::from_millis(1);

/// How often the orchestrator is looked for before it is there.
const LOOK: Duration = Duration::from_millis(10);

impl From<LogError> for ServeError {
    fn from(error: LogError) -> Self {
        Self::PromptLog(error.to_string())
    }
}

/// How a generation ended for this process.
pub(super) enum End {
    /// It was told to stop.
    Stopped,
    /// Another one has followed.
    Over(Attach),
}

/// Lets `policy` decide in the generation of `run` that `bus` has joined.
pub(super) fn serve_generation(
    policy: &mut (impl Decider + ?Sized),
    bus: &Bus,
    run: &Run,
) -> Result<End, ServeError> {
    // Receivers first: nobody sends before every process has said hello.
    let mut server = Server::new(bus)?;
    let facts = std::iter::once(("policy", policy.name().to_owned())).chain(policy.facts());
    let (handshake, handshakes) = (Handshake::new(Role::Policy, facts)?, bus.sender()?);
    // The orchestrator may be late, or on its way to the next generation already.
    while !handshakes.is_complete() {
        if let Some(next) = run.next(bus.attach())? {
            return Ok(End::Over(next));
        }
        thread::sleep(LOOK);
    }
    handshakes.send(&handshake)?;
    server.orchestrator.notify()?;
    let mut looked = Instant::now();
    while !server.turn(policy)? {
        bus.listener().wait(if server.join.is_half() { MOMENT } else { LONGEST_SLEEP })?;
        if looked.elapsed() >= LONGEST_SLEEP {
            if let Some(next) = run.next(bus.attach())? {
                return Ok(End::Over(next));
            }
            looked = Instant::now();
        }
    }
    server.shutdown_report(bus)?;
    Ok(End::Stopped)
}

struct Server {
    configs: Receiver<PolicyEpisodeConfig>,
    observations: Receiver<Observation>,
    recalls: Receiver<Recall>,
    stops: Receiver<Stop>,
    decisions: Sender<message::Decision>,
    orchestrator: Notifier,
    frames: FrameStore,
    documents: DocumentStore,
    reporter: ErrorReporter,
    heartbeats: Heartbeats,
    spans: Spans,
    join: Join,
    answers: Answers,
    said: mpsc::Receiver<Said>,
    /// By lane: the request that the policy has not answered yet.
    open: Vec<Option<Open>>,
    /// Requests answered so far.
    answered: u64,
    log: Log,
}

/// Whether prompts are logged.
enum Log {
    Off,
    On(PromptLog),
    /// It cannot be written to, and the run was asked to stop: nothing is asked or answered any more, so that
    /// no step is without its entry.
    Broken,
}

/// A request that the policy has.
struct Open {
    ticket: RequestId,
    images: u32,
    received_ns: u64,
    started_ns: u64,
    /// For the prompt log.
    asked: Option<Box<Asked>>,
    exchange: Option<Box<Exchange>>,
}

impl Open {
    /// The request's entry in the prompt log.
    fn entry(self, said: Result<(&Decision, u64), &str>) -> Option<Entry> {
        let Self { ticket, images, received_ns, started_ns, asked, exchange } = self;
        let RequestId { lane, step, episode } = ticket;
        let decision = said.ok().map(|(decision, _)| decision);
        let usage = decision.and_then(|decision| decision.usage);
        let stamp = |stamp: fn(&crate::Usage) -> u64| usage.as_ref().map_or(0, stamp);
        Some(Entry {
            episode,
            step,
            lane,
            request: *asked?,
            exchange: exchange.map(|exchange| *exchange),
            answer: decision.map(|decision| Answered {
                outcome: decision.answer.outcome().word().to_owned(),
                action: decision.answer.action().map(|action| action.words().to_owned()),
                images_asked: images,
                images: decision.images,
            }),
            failed: said.err().map(str::to_owned),
            usage: usage.map(|usage| LoggedUsage {
                prompt_tokens: usage.prompt_tokens,
                completion_tokens: usage.completion_tokens,
                cached_tokens: usage.cached_tokens,
                image_tokens: usage.image_tokens,
                memory_tokens: usage.memory_tokens,
                attempts: usage.attempts,
                replayed: usage.replayed,
            }),
            timing: Timing {
                received_ns,
                started_ns,
                prompted_ns: stamp(|usage| usage.prompted_ns),
                sent_ns: stamp(|usage| usage.sent_ns),
                decided_ns: said.map_or_else(|_| monotonic_ns(), |(_, decided_ns)| decided_ns),
            },
        })
    }
}

impl Server {
    fn new(bus: &Bus) -> Result<Self, ServeError> {
        let log = PromptLog::open(bus.attach())?.map_or(Log::Off, Log::On);
        let (answers, said) = Answers::new(bus.notifier(Role::Policy)?, matches!(log, Log::On(_)));
        let lanes = bus.attach().lanes;
        Ok(Self {
            configs: bus.receiver()?,
            observations: bus.receiver()?,
            recalls: bus.receiver()?,
            stops: bus.receiver()?,
            decisions: bus.sender()?,
            orchestrator: bus.notifier(Role::Orchestrator)?,
            frames: FrameStore::new(bus)?,
            documents: DocumentStore::new(bus)?,
            reporter: ErrorReporter::new(bus)?,
            heartbeats: Heartbeats::new(bus)?,
            spans: Spans::open(bus.attach(), Role::Policy).map_err(ServeError::Spans)?,
            join: Join::new(lanes),
            answers,
            said,
            open: (0..lanes).map(|_| None).collect(),
            answered: 0,
            log,
        })
    }

    /// Passes on everything that waits, both ways; returns whether it is time to stop.
    fn turn(&mut self, policy: &mut (impl Decider + ?Sized)) -> Result<bool, ServeError> {
        let error_reports = self.reporter.count();
        self.take_messages(policy)?;
        let ready = self.join.take_ready();
        self.ask(policy, &ready)?;
        let answered = self.pass_on()?;
        self.let_go_of_frames()?;
        let beat = self.beat();
        if answered || beat || self.reporter.count() != error_reports {
            self.orchestrator.notify()?;
        }
        Ok(self.stops.next()?.is_some())
    }

    fn beat(&mut self) -> bool {
        let (answered, open, frames) = (self.answered, &self.open, &self.frames);
        self.heartbeats.beat(|| Heartbeat {
            done: answered,
            waiting: open.iter().flatten().count() as u64,
            held: frames.held() as u64,
            ..Zeroable::zeroed()
        })
    }

    /// Reads all queues. A message that refers to another one was sent after it: queues are therefore
    /// emptied effect first, and what was in them is looked at cause first.
    fn take_messages(&mut self, policy: &mut (impl Decider + ?Sized)) -> Result<(), ServeError> {
        let mut recalls = Vec::new();
        while recalls.len() < self.open.len()
            && let Some(recalled) = self.recalls.next_with(Recalled::read)?
        {
            recalls.push(recalled);
        }
        let observations = self.observations.drain()?;
        let configs = self.configs.drain()?;
        for config in &configs {
            match self.join.config(config) {
                Ok(()) => {
                    self.documents.begin(config.lane, config.episode);
                    self.open[config.lane as usize] = None;
                    policy.reset(config.lane);
                }
                Err(bad) => self.reporter.report(bad),
            }
        }
        for outcome in observations.iter().map(|message| self.join.observation(message)) {
            outcome.unwrap_or_else(|bad| self.reporter.report(bad));
        }
        for outcome in recalls.into_iter().map(|recalled| self.join.recall(recalled?)) {
            outcome.unwrap_or_else(|bad| self.reporter.report(bad));
        }
        Ok(())
    }

    /// Gives the policy all steps at once.
    fn ask(
        &mut self,
        policy: &mut (impl Decider + ?Sized),
        ready: &[Ready],
    ) -> Result<(), ServeError> {
        let received_ns = monotonic_ns();
        // Holding on to the frames keeps their pixels where they are for as long as the requests live.
        let mut held = Vec::with_capacity(ready.len());
        for step in ready {
            held.extend(self.hold(step)?);
        }
        if held.is_empty() || matches!(self.log, Log::Broken) {
            return Ok(());
        }
        let shown: Vec<Shown<'_>> = held.iter().map(Shown::new).collect();
        let trajectories: Vec<_> = shown.iter().map(Shown::trajectories).collect();
        let requests: Vec<Request<'_>> = shown
            .iter()
            .zip(&trajectories)
            .map(|(shown, trajectories)| shown.request(&self.join, trajectories))
            .collect();
        let started_ns = monotonic_ns();
        for request in &requests {
            let asked = match &mut self.log {
                Log::On(log) => log.asked(request).map(|asked| Some(Box::new(asked))),
                Log::Off | Log::Broken => Ok(None),
            };
            let asked = match asked {
                Ok(asked) => asked,
                Err(error) => {
                    self.log = Log::Broken;
                    self.reporter.stop_run(&error.to_string())?;
                    return Ok(());
                }
            };
            let (ticket, images) = (request.id(), request.images());
            let open = Open { ticket, images, received_ns, started_ns, asked, exchange: None };
            self.open[ticket.lane as usize] = Some(open);
        }
        let began = self.spans.begin();
        policy.take(&requests, &self.answers)?;
        self.spans.end(began, "policy", "decide", requests.len());
        Ok(())
    }

    /// Sends what the policy has said meanwhile; returns whether anything was sent.
    fn pass_on(&mut self) -> Result<bool, ServeError> {
        let mut sent = false;
        while let Ok(said) = self.said.try_recv() {
            sent |= match said {
                Said::Exchanged(ticket, exchange) => {
                    let open = self.open.get_mut(ticket.lane as usize).and_then(Option::as_mut);
                    if let Some(open) = open.filter(|open| open.ticket == ticket) {
                        open.exchange = Some(exchange);
                    }
                    false
                }
                Said::Decided(ticket, decision, decided_ns) => {
                    let Some(open) = self.close(ticket) else { continue };
                    let message = on_the_wire(&open, &decision, decided_ns);
                    // Before the decision leaves: what is decided is in the log.
                    if self.keep(open.entry(Ok((&decision, decided_ns))))? {
                        self.decisions.send(&message)?;
                        self.answered += 1;
                    }
                    true
                }
                Said::Failed(ticket, why) => {
                    let Some(open) = self.close(ticket) else { continue };
                    if self.keep(open.entry(Err(&why)))? {
                        self.reporter.fail_episode(ticket.lane, ticket.episode, &why)?;
                    }
                    true
                }
                Said::Halt(why) => {
                    self.reporter.stop_run(&why)?;
                    true
                }
                Said::Waiting(reason) => {
                    self.reporter.waiting(&reason)?;
                    true
                }
            };
        }
        Ok(sent)
    }

    /// Puts an entry into the prompt log, where there is one. Returns whether things may go on: if the log cannot
    /// be written to, the run is asked to stop, and what the entry tells of is not passed on.
    fn keep(&mut self, entry: Option<Entry>) -> Result<bool, ServeError> {
        let (Log::On(log), Some(entry)) = (&mut self.log, entry) else {
            return Ok(!matches!(self.log, Log::Broken));
        };
        if let Err(error) = log.write(entry) {
            self.log = Log::Broken;
            self.reporter.stop_run(&error.to_string())?;
            return Ok(false);
        }
        Ok(true)
    }

    /// The open request that `ticket` names, which is open no longer; `None` when its episode is over, or
    /// it was answered before.
    fn close(&mut self, ticket: RequestId) -> Option<Open> {
        let open = self.open.get_mut(ticket.lane as usize)?;
        open.take_if(|open| open.ticket == ticket && self.join.is_running(ticket))
    }

    /// Takes hold of the documents and frames that `step` shows. Without one of them the step cannot be
    /// decided: that is complained about.
    fn hold<'a>(&mut self, step: &'a Ready) -> Result<Option<Held<'a>>, ServeError> {
        let (lane, number) = (step.lane, step.observed.step);
        let mut held = Held { step, documents: Vec::new(), frames: Vec::new() };
        for &id in &step.recalled.documents {
            let Some(document) = self.document(id)? else {
                self.reporter.report(format_args!(
                    "lane {lane}, step {number}: document {id} was never published"
                ));
                return Ok(None);
            };
            held.documents.push(document);
        }
        for id in held.frame_ids() {
            let Some(frame) = self.frame(id)? else {
                self.reporter.report(format_args!(
                    "lane {lane}, step {number}: frame {id} is not in the store, so it was evicted too \
                     early or never published"
                ));
                return Ok(None);
            };
            held.frames.push(frame);
        }
        Ok(Some(held))
    }

    fn document(&mut self, id: DocumentId) -> Result<Option<Arc<Document>>, ServeError> {
        loop {
            match self.documents.get(id) {
                Ok(document) => return Ok(document.cloned()),
                Err(DocumentError::Bus(error)) => return Err(error.into()),
                // The store has dropped what it could not use: go on after it.
                Err(bad) => self.reporter.report(bad),
            }
        }
    }

    fn frame(&mut self, id: FrameId) -> Result<Option<Arc<Frame>>, ServeError> {
        loop {
            match self.frames.get(id) {
                Ok(frame) => return Ok(frame.cloned()),
                Err(FrameError::Bus(error)) => return Err(error.into()),
                // The store has dropped what it could not use: go on after it.
                Err(bad) => self.reporter.report(bad),
            }
        }
    }

    fn let_go_of_frames(&mut self) -> Result<(), ServeError> {
        loop {
            match self.frames.apply_evictions() {
                Ok(_) => return Ok(()),
                Err(FrameError::Bus(error)) => return Err(error.into()),
                Err(bad) => self.reporter.report(bad),
            }
        }
    }

    fn shutdown_report(&self, bus: &Bus) -> Result<(), ServeError> {
        bus.sender()?.send(&ShutdownReport {
            role: Role::Policy as u32,
            frames_received: self.frames.taken(),
            error_reports: self.reporter.count().into(),
            ..Zeroable::zeroed()
        })?;
        self.orchestrator.notify()?;
        Ok(())
    }
}

fn on_the_wire(open: &Open, decision: &Decision, decided_ns: u64) -> message::Decision {
    let &Open { ticket, images, received_ns, started_ns, .. } = open;
    let RequestId { lane, step, episode } = ticket;
    let usage = decision.usage.unwrap_or_default();
    let told = |count: Option<u32>| count.unwrap_or(NOT_MEASURED);
    message::Decision {
        episode,
        received_ns,
        started_ns,
        prompted_ns: usage.prompted_ns,
        sent_ns: usage.sent_ns,
        decided_ns,
        lane,
        step,
        prompt_tokens: told(usage.prompt_tokens),
        completion_tokens: told(usage.completion_tokens),
        cached_tokens: told(usage.cached_tokens),
        image_tokens: told(usage.image_tokens),
        memory_tokens: told(usage.memory_tokens),
        images_asked: images,
        images: decision.images,
        attempts: usage.attempts,
        outcome: decision.answer.outcome() as u8,
        action: decision.answer.action().map_or(NO_ACTION, |action| action as u8),
        replayed: usage.replayed.into(),
        reserved: [0; 21],
    }
}
