//! Scripted processes of a run: threads that speak the wire, for tests of the orchestrator.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

use std::any::{Any, TypeId};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::Duration;

use bytemuck::Zeroable;
use case_book::EpisodeFacts;
use domain::{Action, Feedback, Heading, Pose, State};
use shm_types::message::{
    Decision, EpisodeEnd, Handshake, MemoryEpisodeConfig, NO_ACTION, NO_DOCUMENT, NO_FRAME,
    Observation, PolicyEpisodeConfig, Recall, RequestId, Role, ShutdownReport, StepCommand,
    StepKind, StepReport, Stop, WorldEpisodeConfig, read_text,
};
use shm_types::{Attach, Bus, BusError, NotePublisher, Notifier, Sender};

use conformance::messages::{decision, observation, recall, recall_trace, report};

/// The fact `kind` in the handshake of a scripted process.
pub const KIND: &str = "scripted";

const TICK: Duration = Duration::from_millis(20);

/// A simulator without pixels, in which every move is blocked and no task is ever complete: episodes end at their step limit.
#[derive(Debug, Default)]
pub struct ScriptedSim {
    episodes: BTreeMap<u32, ScriptedEpisode>,
}

/// An episode in a scripted simulator.
#[derive(Debug)]
struct ScriptedEpisode {
    config: WorldEpisodeConfig,
    pose: Pose,
    blocked_moves: Vec<u32>,
}

/// What a scripted simulator answers.
#[derive(Debug, Clone)]
pub struct ScriptedStep {
    /// For the orchestrator.
    pub report: StepReport,
    /// For memory and policy.
    pub observation: Observation,
    /// The facts of the episode, if it has ended.
    pub facts: Option<EpisodeFacts>,
}

impl ScriptedSim {
    /// Begins an episode.
    pub fn begin(&mut self, config: &WorldEpisodeConfig) -> ScriptedStep {
        let &WorldEpisodeConfig { lane, episode, .. } = config;
        let (pose, blocked_moves) = (Pose::new(3, 4, Heading::E), Vec::new());
        self.episodes.insert(lane, ScriptedEpisode { config: *config, pose, blocked_moves });
        self.answer(RequestId { lane, episode, step: 0 }, Feedback::Start, NO_ACTION)
    }

    /// Executes a command.
    pub fn step(&mut self, command: &StepCommand) -> ScriptedStep {
        let &StepCommand { lane, episode, step, action, .. } = command;
        let of = self.episodes.get_mut(&lane).unwrap();
        let feedback = match StepKind::try_from(command.kind).unwrap() {
            StepKind::Stay => Feedback::NotUnderstood,
            StepKind::Act => match Action::try_from(action).unwrap().turn_quarters() {
                Some(quarters) => {
                    of.pose.heading = of.pose.heading.turned(quarters);
                    Feedback::Turned
                }
                None => {
                    of.blocked_moves.push(step);
                    Feedback::Blocked
                }
            },
        };
        self.answer(RequestId { lane, episode, step }, feedback, action)
    }

    fn answer(&self, id: RequestId, feedback: Feedback, action: u8) -> ScriptedStep {
        let ScriptedEpisode { config, pose, blocked_moves } = &self.episodes[&id.lane];
        let ends = id.step >= config.max_steps;
        let frame = if ends { NO_FRAME } else { 1 };
        let (pose, feedback, last) = (*pose, feedback as u8, ends.into());
        let observation = Observation {
            state: State::from(pose).padded(),
            feedback,
            action,
            last,
            ..observation(id, frame)
        };
        let facts = ends.then(|| EpisodeFacts {
            start_pose: Pose::new(3, 4, Heading::E),
            final_pose: pose,
            visits: Vec::new(),
            first_seen: BTreeMap::new(),
            blocked_moves: blocked_moves.clone(),
            failure: None,
            looped_at: None,
            loops: None,
            path: None,
            completes_in: (config.learns == 1).then(BTreeSet::new),
        });
        let ended = if ends { EpisodeEnd::StepLimit } else { EpisodeEnd::GoesOn } as u8;
        let report = StepReport { ended, ..report(&observation) };
        ScriptedStep { report, observation, facts }
    }
}

/// What an observation asks for.
pub fn request(observation: &Observation) -> RequestId {
    let &Observation { lane, episode, step, .. } = observation;
    RequestId { lane, episode, step }
}

/// A run as its scripted processes see it. Each method is a process: it returns when the run is over.
#[derive(Debug, Clone, Copy)]
pub struct ScriptedRun<'a> {
    /// The run's settings.
    pub attach: &'a Attach,
    /// Set when the run is over without a stop message.
    pub over: &'a AtomicBool,
}

impl ScriptedRun<'_> {
    /// A simulator.
    pub fn sim(&self) {
        let mut sim = ScriptedSim::default();
        let mut ports = None;
        self.serve(Role::Sim, |process| {
            let (configs, commands, notes) = ports.get_or_insert_with(|| {
                let configs = process.bus.receiver::<WorldEpisodeConfig>().unwrap();
                let commands = process.bus.receiver::<StepCommand>().unwrap();
                (configs, commands, NotePublisher::of_facts(&process.bus).unwrap())
            });
            let commands = commands.drain().unwrap();
            let mut steps: Vec<_> =
                configs.drain().unwrap().iter().map(|config| sim.begin(config)).collect();
            steps.extend(commands.iter().map(|command| sim.step(command)));
            for ScriptedStep { mut report, observation, facts } in steps {
                if let Some(facts) = facts {
                    let text = serde_json::to_string(&facts).unwrap();
                    // An orchestrator that has left does not get it.
                    let sent = notes.publish(report.lane, report.episode, text.as_bytes());
                    report.facts = sent.unwrap_or(NO_DOCUMENT);
                }
                process.send(&report, &[Role::Orchestrator]);
                process.send(&observation, &[Role::Memory]);
            }
        });
    }

    /// A memory that recalls nothing.
    pub fn memory(&self) {
        let mut ports = None;
        self.serve(Role::Memory, |process| {
            let (configs, reports, observations) = ports.get_or_insert_with(|| {
                let configs = process.bus.receiver::<MemoryEpisodeConfig>().unwrap();
                let reports = process.bus.receiver::<StepReport>().unwrap();
                (configs, reports, process.bus.receiver::<Observation>().unwrap())
            });
            configs.drain().unwrap();
            reports.drain().unwrap();
            for observation in observations.drain().unwrap() {
                if observation.last == 0 {
                    process.send(&recall_trace(request(&observation)), &[]);
                    process.send(&recall(request(&observation), &[]), &[Role::Policy]);
                }
            }
        });
    }

    /// A policy that turns left. `change` is called with each episode's instruction and decision.
    pub fn policy(&self, mut change: impl FnMut(&str, Decision) -> Decision) {
        let mut ports = None;
        let mut instructions = BTreeMap::new();
        self.serve(Role::Policy, |process| {
            let (configs, observations, recalls) = ports.get_or_insert_with(|| {
                process.open::<Decision>();
                let observations = process.bus.receiver::<Observation>().unwrap();
                let recalls = process.bus.receiver::<Recall>().unwrap();
                (process.bus.receiver::<PolicyEpisodeConfig>().unwrap(), observations, recalls)
            });
            // The config of an episode comes before its recalls.
            let recalls = recalls.drain().unwrap();
            observations.drain().unwrap();
            for config in configs.drain().unwrap() {
                let text = read_text(&config.instruction, config.instruction_len).unwrap();
                instructions.insert(config.episode, text.to_owned());
            }
            for Recall { episode, lane, step, .. } in recalls {
                let decision = decision(RequestId { lane, episode, step }, Action::TurnLeft);
                let decision = change(&instructions[&episode], decision);
                process.send(&decision, &[Role::Orchestrator]);
            }
        });
    }

    /// The external memory with this index: calls `turn` at every notification.
    pub fn external_memory(&self, index: u8, turn: impl FnMut(&ScriptedProcess)) {
        self.serve_on(
            Bus::join_as(self.attach.clone(), Role::ExternalMemory, index).unwrap(),
            turn,
        );
    }

    /// Joins as `role`, sends the handshake, calls `turn` at every notification until the stop message, and sends the
    /// shutdown report. Returns as well when a later generation has begun.
    pub fn serve(&self, role: Role, turn: impl FnMut(&ScriptedProcess)) {
        self.serve_on(Bus::join(self.attach.clone(), role).unwrap(), turn);
    }

    fn serve_on(&self, bus: Bus, mut turn: impl FnMut(&ScriptedProcess)) {
        let (role, index) = (bus.role(), u32::from(bus.index()));
        let stops = bus.receiver::<Stop>().unwrap();
        let all = Role::CHILDREN.into_iter().chain([Role::Orchestrator]);
        let others = all.filter(|other| *other != role);
        let notifiers = others.map(|other| (other, bus.notifier(other).unwrap())).collect();
        let process = ScriptedProcess { bus, notifiers, senders: RefCell::default() };
        // Its receivers must exist before the handshake.
        turn(&process);
        let is_past = || {
            let is_next = |now: Attach| now.generation > self.attach.generation;
            Attach::read(&self.attach.root).is_ok_and(is_next) || self.over.load(Ordering::Relaxed)
        };
        let handshakes = process.bus.sender::<Handshake>().unwrap();
        // The orchestrator may not have joined yet.
        while !handshakes.is_complete() {
            if is_past() {
                return;
            }
            sleep(TICK);
        }
        let handshake = Handshake::new(role, [("kind", KIND.to_owned())]).unwrap();
        process.send(&Handshake { index, ..handshake }, &[Role::Orchestrator]);
        while stops.next().unwrap().is_none() {
            if is_past() {
                return;
            }
            process.bus.listener().wait(TICK).unwrap();
            turn(&process);
        }
        let report = ShutdownReport { role: role as u32, index, ..Zeroable::zeroed() };
        process.send(&report, &[Role::Orchestrator]);
    }
}

/// A scripted process in its run.
#[derive(Debug)]
pub struct ScriptedProcess {
    /// Its bus.
    pub bus: Bus,
    notifiers: BTreeMap<Role, Notifier>,
    /// By type of message.
    senders: RefCell<HashMap<TypeId, Box<dyn Any>>>,
}

impl ScriptedProcess {
    /// Makes the sender of a type of message. What it sends is lost if it ends before the receiver has looked for it.
    pub fn open<M: shm_types::PortedMessage>(&self) {
        let sender = self.bus.sender::<M>().unwrap();
        self.senders.borrow_mut().insert(TypeId::of::<M>(), Box::new(sender));
    }

    /// Sends a message and notifies. A receiver that has left already does not get it.
    pub fn send<M: shm_types::PortedMessage>(&self, message: &M, notified: &[Role]) {
        if !self.senders.borrow().contains_key(&TypeId::of::<M>()) {
            self.open::<M>();
        }
        let senders = self.senders.borrow();
        let sent = senders[&TypeId::of::<M>()].downcast_ref::<Sender<M>>().unwrap().send(message);
        assert!(matches!(sent, Ok(()) | Err(BusError::Deserted { .. })), "{sent:?}");
        for role in notified {
            self.notifiers[role].notify().unwrap();
        }
    }
}
