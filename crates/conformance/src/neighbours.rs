//! The neighbours of a policy, scripted: orchestrator, simulator and memory in this process, over the real bus.

use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use domain::{Action, Feedback, Heading, Pose};
use shm_types::message::{
    Decision, ErrorReport, Eviction, FrameId, Handshake, ItemKind, NO_ACTION, NO_FRAME,
    Observation, PolicyEpisodeConfig, Recall, RecalledItem, RequestId, Role, SegmentStep,
    ShutdownReport, Stop, WirePose, write_text,
};
use shm_types::process::monotonic_ns;
use shm_types::{
    Attach, Bus, BusError, DocumentPublisher, FrameError, FramePublisher, Notifier, Receiver,
    Sender,
};

/// How often [`PolicyNeighbours::until`] looks when it is not notified.
pub const TICK: Duration = Duration::from_millis(20);

/// Orchestrator, simulator and memory of a run whose only participant is the policy.
#[derive(Debug)]
pub struct PolicyNeighbours {
    /// Handshakes of the policy.
    pub handshakes: Receiver<Handshake>,
    /// Decisions of the policy.
    pub decisions: Receiver<Decision>,
    /// Error reports of the policy.
    pub error_reports: Receiver<ErrorReport>,
    /// Shutdown reports of the policy.
    pub shutdown_reports: Receiver<ShutdownReport>,
    /// Sends the recalls of memory.
    pub recalls: Sender<Recall>,
    /// Publishes the documents of memory.
    pub documents: DocumentPublisher,
    configs: Sender<PolicyEpisodeConfig>,
    observations: Sender<Observation>,
    evictions: Sender<Eviction>,
    stops: Sender<Stop>,
    frames: FramePublisher,
    /// Observations also go to the orchestrator.
    observed: Receiver<Observation>,
    policy: Notifier,
    orchestrator: Bus,
    _others: [Bus; 2],
}

impl PolicyNeighbours {
    /// Joins the run of `attach`, whose participants have to be the policy alone.
    ///
    /// # Errors
    /// When the run cannot be joined.
    pub fn join(attach: &Attach) -> Result<Self, BusError> {
        let bus = |role| Bus::join(attach.clone(), role);
        let (orchestrator, sim, memory) =
            (bus(Role::Orchestrator)?, bus(Role::Sim)?, bus(Role::Memory)?);
        Ok(Self {
            handshakes: orchestrator.receiver()?,
            decisions: orchestrator.receiver()?,
            error_reports: orchestrator.receiver()?,
            shutdown_reports: orchestrator.receiver()?,
            recalls: memory.sender()?,
            documents: DocumentPublisher::new(&memory)?,
            configs: orchestrator.sender()?,
            observations: sim.sender()?,
            evictions: sim.sender()?,
            stops: orchestrator.sender()?,
            frames: FramePublisher::new(&sim)?,
            observed: orchestrator.receiver()?,
            policy: orchestrator.notifier(Role::Policy)?,
            orchestrator,
            _others: [sim, memory],
        })
    }

    /// The run's settings.
    pub fn attach(&self) -> &Attach {
        self.orchestrator.attach()
    }

    /// Sends the config of an episode.
    ///
    /// # Errors
    /// When it cannot be delivered.
    pub fn begin(&self, config: &PolicyEpisodeConfig) -> Result<(), BusError> {
        self.configs.send(config)
    }

    /// Publishes a frame that `fill` writes.
    ///
    /// # Errors
    /// When no frame is free, or it cannot be delivered.
    pub fn publish(
        &mut self,
        content_hash: [u8; 16],
        fill: impl FnOnce(&mut [u8]),
    ) -> Result<FrameId, FrameError> {
        let mut slot = self.frames.loan()?;
        fill(slot.pixels_mut());
        self.frames.publish(slot, content_hash)
    }

    /// Evicts a frame.
    ///
    /// # Errors
    /// When the message cannot be delivered.
    pub fn evict(&self, frame: FrameId) -> Result<(), BusError> {
        self.evictions.send(&Eviction { frame })
    }

    /// Sends an observation.
    ///
    /// # Errors
    /// When it cannot be delivered.
    pub fn observe(&self, observation: &Observation) -> Result<(), BusError> {
        self.observed.drain()?;
        self.observations.send(observation)
    }

    /// Asks the policy to stop.
    ///
    /// # Errors
    /// When the message cannot be delivered.
    pub fn stop(&self) -> Result<(), BusError> {
        self.stops.send(&Stop::zeroed())?;
        self.notify()
    }

    /// Wakes the policy.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn notify(&self) -> Result<(), BusError> {
        self.policy.notify()
    }

    /// Waits for the policy's notification, for [`TICK`] at most.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn wait(&self) -> Result<bool, BusError> {
        self.orchestrator.listener().wait(TICK)
    }

    /// Calls `look` until it returns something, for `timeout` at most.
    ///
    /// # Errors
    /// When the transport fails.
    pub fn until<T>(
        &self,
        timeout: Duration,
        mut look: impl FnMut(&Self) -> Result<Option<T>, BusError>,
    ) -> Result<Option<T>, BusError> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(found) = look(self)? {
                return Ok(Some(found));
            }
            if Instant::now() > deadline {
                return Ok(None);
            }
            self.wait()?;
        }
    }
}

/// The config of an episode with a window of six steps; its seed is the number of its lane.
pub fn config(lane: u32, episode: u64, instruction: &str) -> PolicyEpisodeConfig {
    let seed = lane.into();
    let mut config =
        PolicyEpisodeConfig { lane, episode, seed, repeat: 1, window: 6, ..Zeroable::zeroed() };
    config.instruction_len = write_text(&mut config.instruction, instruction);
    config
}

/// The observation of a step, after a move forward.
pub fn observation(id: RequestId, frame: FrameId) -> Observation {
    let RequestId { lane, episode, step } = id;
    let (feedback, action) = match step {
        0 => (Feedback::Start, NO_ACTION),
        _ => (Feedback::Moved, Action::Forward as u8),
    };
    let now = monotonic_ns();
    Observation {
        lane,
        episode,
        step,
        frame,
        pose: WirePose::from(Pose::new(3, 4, Heading::E)),
        feedback: feedback as u8,
        action,
        commanded_ns: now,
        woken_ns: now,
        stepped_ns: now,
        rendered_ns: now,
        sent_ns: now,
        ..Zeroable::zeroed()
    }
}

/// The last observation of an episode.
pub fn last(id: RequestId) -> Observation {
    Observation { last: 1, ..observation(id, NO_FRAME) }
}

/// A recall with a segment, whose last view has no action; without an item if `segment` is empty.
pub fn recall(id: RequestId, segment: &[FrameId]) -> Recall {
    let RequestId { lane, episode, step } = id;
    let now = monotonic_ns();
    let mut recall =
        Recall { lane, episode, step, received_ns: now, sent_ns: now, ..Zeroable::zeroed() };
    if !segment.is_empty() {
        let item = RecalledItem { distance: 0.125, ..item(ItemKind::Steps) };
        let last = segment.len() - 1;
        let steps = segment.iter().enumerate();
        let action = |at| (at < last).then_some(Action::TurnLeft);
        let steps: Vec<_> = steps.map(|(at, &frame)| supplied(frame, action(at))).collect();
        supply(&mut recall, item, &steps);
    }
    recall
}

/// An item without a document, steps and distance.
pub fn item(kind: ItemKind) -> RecalledItem {
    RecalledItem { kind: kind as u8, distance: f32::NAN, ..Zeroable::zeroed() }
}

/// A step of an item.
pub fn supplied(frame: FrameId, action: Option<Action>) -> SegmentStep {
    let action = action.map_or(NO_ACTION, |action| action as u8);
    SegmentStep { frame, action, reserved: [0; 7] }
}

/// Adds an item to a recall, with the steps that the message holds for it.
///
/// # Panics
/// When the message has no room for them.
pub fn supply(recall: &mut Recall, item: RecalledItem, steps: &[SegmentStep]) {
    let (at, first) = (recall.items_len as usize, recall.steps_len as usize);
    recall.items[at] = item;
    recall.items_len += 1;
    if !steps.is_empty() {
        recall.items[at].first_step = recall.steps_len;
        recall.items[at].steps = steps.len() as u32;
        recall.steps[first..first + steps.len()].copy_from_slice(steps);
        recall.steps_len += steps.len() as u32;
    }
}
