//! The serve loop: drain, join, decide, answer, ring once.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use bytemuck::Zeroable;
use shm_types::message::{
    Farewell, FrameId, Hello, NO_ACTION, NOT_MEASURED, Observation, PolicyBrief, Recall, Role,
    Stop, WIRE_VERSION, write_text,
};
use shm_types::process::monotonic_ns;
use shm_types::{
    Attach, Bell, Bus, BusError, Complaints, Frame, FrameError, FrameStore, Receiver, Sender,
    message,
};

use super::Policy;
use super::join::{Join, Ready};
use crate::{Decision, FrameView, PastView, Request, Segment, SegmentView};

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
                Ok(()) => policy.reset(brief.lane),
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
        let mut held = Vec::new();
        let mut steps = Vec::with_capacity(ready.len());
        for step in ready {
            if self.hold_frames(step, &mut held)? {
                steps.push(step);
            }
        }
        if steps.is_empty() {
            return Ok(false);
        }
        let shown = Shown::new(&held, &steps);
        let requests = shown.requests(&self.join, &steps);
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
        for (step, Decision { answer, images, tokens }) in steps.into_iter().zip(decisions) {
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

    /// Adds the frames that `step` shows to `held`, in the order [`frame_ids`] gives. Without one of
    /// them the step cannot be decided: that is complained about, and nothing is added.
    fn hold_frames(
        &mut self,
        step: &Ready,
        held: &mut Vec<Arc<Frame>>,
    ) -> Result<bool, ServeError> {
        let already = held.len();
        for id in frame_ids(step) {
            let Some(frame) = self.frame(id)? else {
                let (lane, step) = (step.lane, step.observed.step);
                self.complaints.raise(format_args!(
                    "lane {lane}, step {step}: frame {id} is not in the store, so it was evicted too \
                     early or never published"
                ));
                held.truncate(already);
                return Ok(false);
            };
            held.push(frame);
        }
        Ok(true)
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

/// Every frame that a step shows: the current one, the window's, the segment's.
fn frame_ids(step: &Ready) -> impl Iterator<Item = FrameId> {
    let window = step.recalled.window.iter().map(|&(frame, ..)| frame);
    let segment = step.recalled.segment.iter().map(|&(frame, _)| frame);
    std::iter::once(step.observed.frame).chain(window).chain(segment)
}

/// The views of a batch, laid out so that requests can borrow them.
struct Shown<'a> {
    /// One for each step.
    current: Vec<FrameView<'a>>,
    /// All steps' windows, one after the other.
    windows: Vec<PastView<'a>>,
    /// All steps' segments, one after the other.
    segments: Vec<SegmentView<'a>>,
}

impl<'a> Shown<'a> {
    /// `held` are the frames of all steps in the order of [`frame_ids`].
    fn new(held: &'a [Arc<Frame>], steps: &[&Ready]) -> Self {
        let mut views = held.iter().map(|frame| {
            let size = frame.size();
            let (width, height) = (size.width, size.height);
            FrameView { id: frame.id(), width, height, pixels: frame.pixels() }
        });
        let mut shown = Self { current: Vec::new(), windows: Vec::new(), segments: Vec::new() };
        for step in steps {
            shown.current.extend(views.by_ref().take(1));
            // The views come second in the zips, so that the shorter side ends them and no view is lost.
            let window = step.recalled.window.iter().zip(views.by_ref());
            shown.windows.extend(window.map(|(&(_, action, feedback), frame)| PastView {
                frame,
                action,
                feedback,
            }));
            let segment = step.recalled.segment.iter().zip(views.by_ref());
            shown
                .segments
                .extend(segment.map(|(&(_, action), frame)| SegmentView { frame, action }));
        }
        shown
    }

    fn requests(&'a self, join: &'a Join, steps: &[&Ready]) -> Vec<Request<'a>> {
        let (mut windows, mut segments) = (&self.windows[..], &self.segments[..]);
        let request = |(step, &frame): (&&Ready, _)| {
            let window = windows.split_off(..step.recalled.window.len()).unwrap_or_default();
            let views = segments.split_off(..step.recalled.segment.len()).unwrap_or_default();
            let lane = join.lane(step.lane);
            Request {
                lane: step.lane,
                step: step.observed.step,
                episode_seed: lane.seed,
                instruction: &lane.instruction,
                pose: step.observed.pose,
                feedback: step.observed.feedback,
                frame,
                window,
                segment: (!views.is_empty())
                    .then_some(Segment { distance: step.recalled.distance, steps: views }),
            }
        };
        steps.iter().zip(&self.current).map(request).collect()
    }
}
