//! The serve loop: drain, join, decide, answer, ring once.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use bytemuck::Zeroable;
use shm_types::message::{
    DocumentId, Farewell, FrameId, Hello, NO_ACTION, NOT_MEASURED, Observation, PolicyBrief,
    Recall, Role, Stop, WIRE_VERSION, write_text,
};
use shm_types::process::monotonic_ns;
use shm_types::{
    Attach, Bell, Bus, BusError, Complaints, Document, DocumentError, DocumentStore, Frame,
    FrameError, FrameStore, Receiver, Sender, message,
};

use super::Policy;
use super::join::{Join, Ready};
use super::shown::{Held, Shown};
use crate::{Decision, Request};

/// How long the loop sleeps when nobody rings. Only a look around; nothing waits for it.
const LONGEST_SLEEP: Duration = Duration::from_secs(1);

/// Why serving ended before it was told to.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The run cannot be joined, or its transport failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The policy broke its contract.
    #[error("policy {policy} answered {answers} of {requests} requests: it must answer each once")]
    Answers {
        /// The policy.
        policy: String,
        /// Requests it was given.
        requests: usize,
        /// Decisions it returned.
        answers: usize,
    },
    /// What the policy says about itself does not fit into a message.
    #[error("the facts about policy {policy} take {bytes} bytes, and {most} fit: say less")]
    Facts {
        /// The policy.
        policy: String,
        /// Bytes of JSON.
        bytes: usize,
        /// Bytes there are.
        most: usize,
    },
}

/// Lets `policy` decide in the run whose folder is `attach_dir`, until the orchestrator says stop.
///
/// Messages that cannot be used are complained about and dropped.
///
/// # Errors
/// When the run cannot be joined, its transport fails, or the policy breaks its contract.
pub fn serve(policy: &mut dyn Policy, attach_dir: &Path) -> Result<(), ServeError> {
    let attach = Attach::read(attach_dir).map_err(BusError::from)?;
    let bus = Bus::join(attach, Role::Policy)?;
    // Receivers first: nobody sends before every process has said hello.
    let mut server = Server::new(&bus)?;
    bus.sender()?.send(&hello(policy)?)?;
    server.orchestrator.ring()?;
    while !server.turn(policy)? {
        bus.doorbell().wait(LONGEST_SLEEP)?;
    }
    server.farewell(&bus)
}

fn hello(policy: &dyn Policy) -> Result<Hello, ServeError> {
    let own = [("policy", policy.name().to_owned())];
    let facts: serde_json::Map<_, _> = own
        .into_iter()
        .chain(policy.facts())
        .map(|(name, value)| (name.to_owned(), value.into()))
        .collect();
    let facts = serde_json::Value::from(facts).to_string();
    let mut hello = Hello {
        wire_version: WIRE_VERSION,
        role: Role::Policy as u32,
        pid: std::process::id(),
        ..Zeroable::zeroed()
    };
    hello.facts_len = write_text(&mut hello.facts, &facts);
    if hello.facts_len as usize != facts.len() {
        let (bytes, most) = (facts.len(), hello.facts.len());
        return Err(ServeError::Facts { policy: policy.name().to_owned(), bytes, most });
    }
    Ok(hello)
}

struct Server {
    briefs: Receiver<PolicyBrief>,
    observations: Receiver<Observation>,
    recalls: Receiver<Recall>,
    stops: Receiver<Stop>,
    decisions: Sender<message::Decision>,
    orchestrator: Bell,
    frames: FrameStore,
    documents: DocumentStore,
    complaints: Complaints,
    join: Join,
}

impl Server {
    fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self {
            briefs: bus.receiver()?,
            observations: bus.receiver()?,
            recalls: bus.receiver()?,
            stops: bus.receiver()?,
            decisions: bus.sender()?,
            orchestrator: bus.bell(Role::Orchestrator)?,
            frames: FrameStore::new(bus)?,
            documents: DocumentStore::new(bus)?,
            complaints: Complaints::new(bus)?,
            join: Join::new(bus.attach().lanes),
        })
    }

    /// Answers everything that waits; returns whether it is time to stop.
    fn turn(&mut self, policy: &mut dyn Policy) -> Result<bool, ServeError> {
        let complaints = self.complaints.count();
        self.take_messages(policy)?;
        let ready = self.join.take_ready();
        let answered = self.answer(policy, &ready)?;
        self.let_go_of_frames()?;
        if answered || self.complaints.count() != complaints {
            self.orchestrator.ring()?;
        }
        Ok(self.stops.next()?.is_some())
    }

    /// Reads all queues. A message that refers to another one was sent after it: queues are therefore
    /// emptied effect first, and what was in them is looked at cause first.
    fn take_messages(&mut self, policy: &mut dyn Policy) -> Result<(), ServeError> {
        let recalls = self.recalls.drain()?;
        let observations = self.observations.drain()?;
        let briefs = self.briefs.drain()?;
        for brief in &briefs {
            match self.join.brief(brief) {
                Ok(()) => {
                    self.documents.begin(brief.lane, brief.episode);
                    policy.reset(brief.lane);
                }
                Err(bad) => self.complaints.raise(bad),
            }
        }
        let observed = observations.iter().map(|message| self.join.observation(message)).collect();
        let recalled = recalls.iter().map(|message| self.join.recall(message)).collect();
        for outcomes in [observed, recalled] {
            let outcomes: Vec<Result<(), _>> = outcomes;
            outcomes.into_iter().filter_map(Result::err).for_each(|bad| self.complaints.raise(bad));
        }
        Ok(())
    }

    /// Asks the policy about all steps at once and sends what it decides; returns whether anything was
    /// sent.
    fn answer(&mut self, policy: &mut dyn Policy, ready: &[Ready]) -> Result<bool, ServeError> {
        let received_ns = monotonic_ns();
        // Holding on to the frames keeps their pixels where they are for as long as the requests live.
        let mut held = Vec::with_capacity(ready.len());
        for step in ready {
            held.extend(self.hold(step)?);
        }
        if held.is_empty() {
            return Ok(false);
        }
        let shown: Vec<Shown<'_>> = held.iter().map(Shown::new).collect();
        let trajectories: Vec<_> = shown.iter().map(Shown::trajectories).collect();
        let requests: Vec<Request<'_>> = shown
            .iter()
            .zip(&trajectories)
            .map(|(shown, trajectories)| shown.request(&self.join, trajectories))
            .collect();
        let started_ns = monotonic_ns();
        let decisions = policy.act(&requests);
        let decided_ns = monotonic_ns();
        if decisions.len() != requests.len() {
            return Err(ServeError::Answers {
                policy: policy.name().to_owned(),
                requests: requests.len(),
                answers: decisions.len(),
            });
        }
        for (&Held { step, .. }, Decision { answer, images, tokens }) in held.iter().zip(decisions)
        {
            self.decisions.send(&message::Decision {
                episode: self.join.lane(step.lane).episode,
                received_ns,
                started_ns,
                decided_ns,
                lane: step.lane,
                step: step.observed.step,
                prompt_tokens: tokens.map_or(NOT_MEASURED, |tokens| tokens.prompt),
                completion_tokens: tokens.map_or(NOT_MEASURED, |tokens| tokens.completion),
                images,
                outcome: answer.outcome() as u8,
                action: answer.action().map_or(NO_ACTION, |action| action as u8),
                reserved: [0; 10],
            })?;
        }
        Ok(true)
    }

    /// Takes hold of the documents and frames that `step` shows. Without one of them the step cannot be
    /// decided: that is complained about.
    fn hold<'a>(&mut self, step: &'a Ready) -> Result<Option<Held<'a>>, ServeError> {
        let (lane, number) = (step.lane, step.observed.step);
        let mut held = Held { step, documents: Vec::new(), frames: Vec::new() };
        for &id in &step.recalled.documents {
            let Some(document) = self.document(id)? else {
                self.complaints.raise(format_args!(
                    "lane {lane}, step {number}: document {id} was never published"
                ));
                return Ok(None);
            };
            held.documents.push(document);
        }
        for id in held.frame_ids() {
            let Some(frame) = self.frame(id)? else {
                self.complaints.raise(format_args!(
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
                Err(bad) => self.complaints.raise(bad),
            }
        }
    }

    fn frame(&mut self, id: FrameId) -> Result<Option<Arc<Frame>>, ServeError> {
        loop {
            match self.frames.get(id) {
                Ok(frame) => return Ok(frame.cloned()),
                Err(FrameError::Bus(error)) => return Err(error.into()),
                // The store has dropped what it could not use: go on after it.
                Err(bad) => self.complaints.raise(bad),
            }
        }
    }

    fn let_go_of_frames(&mut self) -> Result<(), ServeError> {
        loop {
            match self.frames.apply_evictions() {
                Ok(_) => return Ok(()),
                Err(FrameError::Bus(error)) => return Err(error.into()),
                Err(bad) => self.complaints.raise(bad),
            }
        }
    }

    fn farewell(&self, bus: &Bus) -> Result<(), ServeError> {
        bus.sender()?.send(&Farewell {
            role: Role::Policy as u32,
            frames_held: self.frames.taken(),
            complaints: self.complaints.count().into(),
            ..Zeroable::zeroed()
        })?;
        self.orchestrator.ring()?;
        Ok(())
    }
}
