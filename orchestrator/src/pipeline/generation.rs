//! One generation: a set of processes, the services that connect them, and the loop that feeds them.

use std::collections::BTreeMap;
use std::os::unix::process::ExitStatusExt;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bytemuck::Zeroable;
use domain::{ExternalName, MemoryKind};
use shm_types::clock::{Instant, sleep};
use shm_types::message::{
    Decision, ErrorReport, Heartbeat, MemoryEpisodeConfig, PolicyEpisodeConfig, RecallTrace, Role,
    ShutdownReport, SnapshotReport, StepCommand, StepReport, Stop, WorldEpisodeConfig,
};
use shm_types::notes::Note;
use shm_types::process::{ProcessWatch, monotonic_ns};
use shm_types::{Bus, BusError, HandshakeReceiver, NoteReceiver, Notifier, Receiver, Sender};
use supervise::Children;

use super::queue::Culpable;
use super::vital_signs::VitalSigns;
use super::{Failure, MemoryState, Participant, PipelineOptions, PipelineRun};
use crate::lanes::{AnswerError, Turn};

/// Time between two checks of processes, signals and time limits, and the longest wait for a message.
pub(super) const TICK: Duration = Duration::from_millis(50);

/// Longest wait for a message that is on its way and comes without a notification.
const SHORT_WAIT: Duration = Duration::from_millis(1);

/// How long a policy or an external memory may take to end once it has closed its queues.
const LEAVING_TIMEOUT: Duration = Duration::from_secs(2);

/// Why a policy failed that takes no messages any more.
pub(super) const POLICY_LEFT: &str = "the policy process has closed its queues and has not ended";

/// One set of processes and what connects them.
///
/// The fields are dropped in order: the processes end before the services they use.
pub(super) struct Generation {
    pub(super) children: Children,
    /// The processes that were started by someone else.
    pub(super) external: Vec<(Participant, ProcessWatch)>,
    pub(super) memory_configs: Option<Sender<MemoryEpisodeConfig>>,
    pub(super) policy_configs: Option<Sender<PolicyEpisodeConfig>>,
    pub(super) worlds: Vec<WorldSenders>,
    pub(super) stops: Sender<Stop>,
    pub(super) inbox: Inbox,
    /// Facts that have arrived before the report that names them.
    pub(super) facts: Vec<Note>,
    /// What processes have told at their end.
    pub(super) shutdown_reports: BTreeMap<Participant, ShutdownReport>,
    /// What the heartbeats of the simulator and of memory say.
    pub(super) vital_signs: VitalSigns,
    /// When the policy last sent an answer that was awaited.
    pub(super) decided_ns: u64,
    /// When each external memory last answered.
    pub(super) recalled_ns: BTreeMap<ExternalName, u64>,
    pub(super) notifiers: BTreeMap<Participant, Notifier>,
    pub(super) bus: Bus,
}

/// What is sent to one world.
pub(super) struct WorldSenders {
    pub(super) configs: Sender<WorldEpisodeConfig>,
    pub(super) commands: Sender<StepCommand>,
    /// Whether it has messages that it was not notified of.
    pub(super) is_due: bool,
}

/// Everything that arrives.
pub(super) struct Inbox {
    pub(super) reports: Receiver<StepReport>,
    /// The facts of episodes that have ended.
    pub(super) facts: NoteReceiver,
    pub(super) traces: Receiver<RecallTrace>,
    pub(super) snapshots: Receiver<SnapshotReport>,
    pub(super) heartbeats: Receiver<Heartbeat>,
    pub(super) decisions: Receiver<Decision>,
    pub(super) handshakes: HandshakeReceiver,
    pub(super) error_reports: Receiver<ErrorReport>,
    pub(super) shutdown_reports: Receiver<ShutdownReport>,
}

/// What one turn of the loop did.
#[derive(Default)]
struct TurnReport {
    steps: u64,
    /// Why the observer wants to stop, if it does.
    halted: Option<String>,
    /// Whether more messages may wait.
    has_more: bool,
}

impl Generation {
    /// Runs queued episodes until all are done or the run is asked to stop. Returns why it has to stop early, if a
    /// process or the observer says so.
    pub(super) fn run_queue(
        &mut self,
        run: &mut PipelineRun<'_, '_>,
    ) -> Result<Option<String>, Failure> {
        let mut checked = Instant::now();
        let mut has_more = false;
        loop {
            self.fill_lanes(run)?;
            if run.lanes.busy() == 0 || run.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            if !has_more {
                let is_short = run.lanes.has_early_decision();
                self.bus.listener().wait(if is_short { SHORT_WAIT } else { TICK })?;
            }
            let turn = self.turn(run)?;
            has_more = turn.has_more;
            if turn.halted.is_some() {
                return Ok(turn.halted);
            }
            if checked.elapsed() >= TICK {
                checked = Instant::now();
                let halted = self.supervise(run)?;
                if halted.is_some() {
                    return Ok(halted);
                }
            }
            run.observer.progress(turn.steps);
        }
    }

    /// Begins episodes in the free lanes.
    fn fill_lanes(&mut self, run: &mut PipelineRun<'_, '_>) -> Result<(), Failure> {
        while let Some(lane) = run.lanes.free()
            && let Some(episode) = run.queue.next(run.lanes.busy())
        {
            run.lanes.set_time(monotonic_ns());
            let opening = run.lanes.begin(lane, episode);
            if let Some(configs) = &self.memory_configs {
                retry(configs.send(&opening.memory))?;
            }
            if let Some(configs) = &self.policy_configs {
                // Only the policy receives these: a delivery that fails is its failure, and not because of this episode.
                if let Err(error) = configs.send(&opening.policy) {
                    run.queue.interrupted(run.lanes.give_up(lane as u32).into_iter().collect());
                    return Err(Failure::Of(Culpable::Policy, error.to_string()));
                }
            }
            let world = self.world_of(opening.world.lane);
            retry(world.configs.send(&opening.world))?;
            world.is_due = true;
        }
        self.notify_worlds()
    }

    /// Takes the waiting messages, decisions up to one batch, sends what follows, and notifies each world once.
    fn turn(&mut self, run: &mut PipelineRun<'_, '_>) -> Result<TurnReport, Failure> {
        let batch = self.bus.attach().batch_len();
        let (mut commands, report) = self.receive(run, batch)?;
        let sent_ns = monotonic_ns();
        for command in &mut commands {
            command.sent_ns = sent_ns;
            let world = self.world_of(command.lane);
            retry(world.commands.send(command))?;
            world.is_due = true;
        }
        self.notify_worlds()?;
        Ok(report)
    }

    /// Takes the waiting messages, decisions up to `batch`, and records what they say. Returns the commands that follow.
    ///
    /// A message refers only to messages that were sent before it. So the queues are emptied from the last answer of
    /// a step to the first, and handled in the opposite order.
    fn receive(
        &mut self,
        run: &mut PipelineRun<'_, '_>,
        batch: usize,
    ) -> Result<(Vec<StepCommand>, TurnReport), Failure> {
        let decisions = self.inbox.decisions.drain_some(batch)?;
        let snapshots = self.inbox.snapshots.drain()?;
        let traces = self.inbox.traces.drain()?;
        let reports = self.inbox.reports.drain()?;
        self.facts.extend(self.inbox.facts.drain()?);
        let has_more = decisions.len() == batch;
        let lanes = &mut *run.lanes;
        lanes.set_time(monotonic_ns());
        let mut turns = Vec::with_capacity(decisions.len() + reports.len() + snapshots.len());
        turns.extend(reports.iter().map(|report| lanes.reported(report, &self.facts)));
        self.forget_facts(&reports);
        for trace in &traces {
            if !run.options.memories.is_empty()
                && let Some(MemoryKind::External(name)) = lanes.memory_of(trace.lane, trace.episode)
            {
                self.recalled_ns.insert(name, lanes.time());
            }
            turns.push(lanes.recalled(trace));
        }
        for decision in &decisions {
            let turn = lanes.decided(decision);
            if turn.is_ok() {
                self.decided_ns = lanes.time();
            }
            turns.push(turn);
        }
        turns.extend(snapshots.iter().map(|report| lanes.learned(report)));
        lanes.take_stepped().try_for_each(|stamps| run.observer.stepped(&stamps))?;
        // What an answer cost is recorded before the step that it leads to.
        let mut halted = None;
        for request in lanes.take_answered() {
            halted = run.observer.answered(&request)?.or(halted);
        }
        let commands = follow_up(run, turns)?;
        let report = TurnReport { steps: commands.len() as u64, halted, has_more };
        Ok((commands, report))
    }

    /// Forgets the facts of episodes that `reports` have ended. Facts can arrive a turn before their report; of a simulator that
    /// sends no report for them, only those of as many episodes as there are lanes are kept.
    fn forget_facts(&mut self, reports: &[StepReport]) {
        self.facts.retain(|note| reports.iter().all(|report| report.facts != note.header.id));
        let excess = self.facts.len().saturating_sub(self.bus.attach().lanes as usize);
        self.facts.drain(..excess);
    }

    /// Records the answers and the facts that have arrived since the last turn: what answers cost was spent.
    fn receive_last(&mut self, run: &mut PipelineRun<'_, '_>) -> Result<(), Failure> {
        let received = self.receive(run, usize::MAX).and_then(|_| self.read_last_facts(run));
        match received {
            Err(failure @ Failure::Fatal(_)) => Err(failure),
            // The generation ends anyway.
            _ => Ok(()),
        }
    }

    /// The world of a lane.
    fn world_of(&mut self, lane: u32) -> &mut WorldSenders {
        &mut self.worlds[usize::from(self.bus.attach().world_of(lane))]
    }

    /// Notifies the worlds that were sent something.
    fn notify_worlds(&mut self) -> Result<(), Failure> {
        for (index, world) in (0..).zip(&mut self.worlds) {
            if std::mem::take(&mut world.is_due)
                && let Some(notifier) = self.notifiers.get(&Participant::world(index))
            {
                retry(notifier.notify())?;
            }
        }
        Ok(())
    }

    /// Asks the processes to end, records their last answers and collects their reports.
    pub(super) fn finish(
        mut self,
        run: &mut PipelineRun<'_, '_>,
    ) -> Result<BTreeMap<Participant, ShutdownReport>, Failure> {
        let mut reports = std::mem::take(&mut self.shutdown_reports);
        // What a process sends is lost if it ends before its messages have been asked for once.
        self.receive_last(run)?;
        let asked = self.stops.send(&Stop::zeroed());
        let asked = asked.and_then(|()| self.notifiers.values().try_for_each(Notifier::notify));
        if let Err(error) = asked {
            tracing::warn!(%error, "the processes could not be asked to end");
            return Ok(reports);
        }
        let timeout = run.options.shutdown_timeout;
        let deadline = Instant::now() + timeout;
        while reports.len() < self.notifiers.len() && Instant::now() < deadline {
            let received = self.bus.listener().wait(TICK);
            let received = received.and_then(|_| self.inbox.shutdown_reports.drain());
            let Ok(received) = received else { break };
            self.receive_last(run)?;
            for report in received {
                let role = role(report.role).ok();
                let sender = role.and_then(|role| run.options.participant(role, report.index));
                reports.extend(sender.map(|sender| (sender, report)));
            }
        }
        self.children.wait_or_kill(timeout);
        Ok(reports)
    }

    /// Whether the policy has closed its queues.
    pub(super) fn has_policy_left(&self) -> bool {
        self.policy_configs.as_ref().is_some_and(|configs| !configs.is_complete())
    }

    /// The exit of a process, if one has exited or was interrupted: it is the cause of whatever else failed.
    ///
    /// A policy or an external memory closes its queues before its process ends. In between, the processes that could not
    /// send to it seem to be the ones that failed. A policy that has closed its queues and does not end is the cause, too.
    pub(super) fn root_cause(
        &mut self,
        options: &PipelineOptions,
        mut failure: Failure,
    ) -> Failure {
        let deadline = Instant::now() + LEAVING_TIMEOUT;
        loop {
            if let Failure::Fatal(_) = failure {
                return failure;
            }
            sleep(TICK);
            if let Some(left) = self.left(options) {
                return left;
            }
            failure = self.exited(options).unwrap_or(failure);
            let has_policy_left = self.has_policy_left();
            let may_leave = has_policy_left || !options.memories.is_empty();
            let exit = self.children.exited();
            let was_killed = exit.is_some_and(|exit| exit.status.signal().is_some());
            let is_settled = !matches!(failure, Failure::Retry(_)) || !may_leave || was_killed;
            if !is_settled && has_policy_left && Instant::now() >= deadline {
                return Failure::Of(Culpable::Policy, POLICY_LEFT.to_owned());
            }
            if is_settled || Instant::now() >= deadline {
                return failure;
            }
        }
    }
}

/// Records what is finished and what failed; returns the commands to send. What is finished comes first: a message that
/// cannot be sent ends the generation.
fn follow_up(
    run: &mut PipelineRun<'_, '_>,
    turns: Vec<Result<Turn, AnswerError>>,
) -> Result<Vec<StepCommand>, Failure> {
    let mut commands = Vec::new();
    for turn in turns {
        match turn {
            Ok(Turn::Wait) => {}
            Ok(Turn::Command(command)) => commands.push(command),
            Ok(Turn::Finished(finished)) => {
                let attempt = run.queue.attempt(&finished.episode);
                run.queue.finish(&finished.episode);
                if let MemoryKind::External(name) = finished.episode.key.condition.memory
                    && run.memory_failures.remove(&name).is_some()
                {
                    run.observer.memory_state(name, &MemoryState::Ready)?;
                }
                run.observer.finished(&finished, attempt)?;
            }
            Err(error) => {
                run.observer.problem(&error.to_string());
                if let AnswerError::Invalid { lane, .. } = error
                    && let Some(episode) = run.lanes.give_up(lane)
                {
                    run.queue.spoiled(episode, &error.to_string());
                }
            }
        }
    }
    Ok(commands)
}

/// A failed delivery is worth another generation: a process is dying or hangs.
pub(super) fn retry(outcome: Result<(), BusError>) -> Result<(), Failure> {
    outcome.map_err(|error| Failure::Retry(error.to_string()))
}

/// The role that `code` stands for.
pub(super) fn role(code: u32) -> Result<Role, domain::pose::UnknownCode> {
    u8::try_from(code).unwrap_or(u8::MAX).try_into()
}
