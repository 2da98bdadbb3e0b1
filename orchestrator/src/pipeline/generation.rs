//! One set of processes: started, fed with episodes, looked after, asked to finish.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bytemuck::Zeroable;
use shm_types::message::{
    Decision, ErrorReport, ErrorReportKind, Handshake, Heartbeat, MemoryEpisodeConfig, Observation,
    PolicyEpisodeConfig, RecallTrace, Role, ShutdownReport, StepCommand, Stop, WIRE_VERSION,
    read_text,
};
use shm_types::process::{ProcessWatch, monotonic_ns};
use shm_types::{Attach, Bus, Notifier, Receiver, Sender};

use super::work::Work;
use super::{Crewing, Facts, Failure, Observer};
use crate::lanes::{Fault, Lanes, Owed, Turn};
use supervise::{Children, Launch};

/// How often the loop looks after processes, signals and deadlines when nobody rings.
const TICK: Duration = Duration::from_millis(50);

/// How long to wait for a message that is on its way and rings no bell.
const MOMENT: Duration = Duration::from_millis(1);

/// How long processes may take to finish once they are told to.
const FAREWELL_PATIENCE: Duration = Duration::from_secs(5);

/// One set of processes and what connects them.
///
/// The fields are dropped in order: the processes are gone before the services they use.
pub(super) struct Generation {
    children: Children,
    /// The policy's process, where somebody else started it.
    guest: Option<ProcessWatch>,
    memory_configs: Option<Sender<MemoryEpisodeConfig>>,
    policy_configs: Option<Sender<PolicyEpisodeConfig>>,
    commands: Sender<StepCommand>,
    stops: Sender<Stop>,
    inbox: Inbox,
    /// Images that memory has embedded, and when that was last known to grow.
    embedded: u64,
    memory_busy_ns: u64,
    /// When the policy last answered something that it had been asked.
    decided_ns: u64,
    notifiers: BTreeMap<Role, Notifier>,
    bus: Bus,
}

/// Everything that arrives.
struct Inbox {
    observations: Receiver<Observation>,
    traces: Receiver<RecallTrace>,
    heartbeats: Receiver<Heartbeat>,
    decisions: Receiver<Decision>,
    handshakes: Receiver<Handshake>,
    error_reports: Receiver<ErrorReport>,
    shutdown_reports: Receiver<ShutdownReport>,
}

impl Generation {
    /// Starts the processes and waits until all are ready. `None` when asked to stop meanwhile.
    pub(super) fn start(
        attach: &Attach,
        crewing: &Crewing,
        stop: &AtomicBool,
        observer: &mut dyn Observer,
    ) -> Result<Option<Self>, Failure> {
        attach.write(&attach.root)?;
        let bus = Bus::join(attach.clone(), Role::Orchestrator)?;
        let inbox = Inbox {
            observations: bus.receiver()?,
            traces: bus.receiver()?,
            heartbeats: bus.receiver()?,
            decisions: bus.receiver()?,
            handshakes: bus.receiver()?,
            error_reports: bus.receiver()?,
            shutdown_reports: bus.receiver()?,
        };
        let takes_part = |role| attach.participants.contains(&role);
        let memory_configs = takes_part(Role::Memory).then(|| bus.sender()).transpose()?;
        let policy_configs = takes_part(Role::Policy).then(|| bus.sender()).transpose()?;
        let notifiers = attach.participants.iter().map(|&role| Ok((role, bus.notifier(role)?)));
        let notifiers = notifiers.collect::<Result<_, shm_types::BusError>>()?;
        let (commands, stops) = (bus.sender()?, bus.sender()?);
        let launches: Vec<Launch> = crewing
            .launches
            .iter()
            .map(|launch| launch.clone().attached_to(&attach.root))
            .collect();
        let children = Children::start(&launches, &crewing.logs)?;
        let mut generation = Self {
            children,
            guest: None,
            memory_configs,
            policy_configs,
            commands,
            stops,
            inbox,
            embedded: 0,
            memory_busy_ns: 0,
            decided_ns: 0,
            notifiers,
            bus,
        };
        let Some(facts) = generation.wait_until_ready(crewing, stop, observer)? else {
            return Ok(None);
        };
        observer.ready(&facts)?;
        Ok(Some(generation))
    }

    /// Waits for every process's [`Handshake`]. What fails before it was ever ready would fail again; in later
    /// generations it has been ready once.
    fn wait_until_ready(
        &mut self,
        crewing: &Crewing,
        stop: &AtomicBool,
        observer: &mut dyn Observer,
    ) -> Result<Option<BTreeMap<Role, Facts>>, Failure> {
        let deadline = Instant::now() + crewing.start_deadline;
        let first = self.bus.attach().generation == 1;
        let failed = |why: String| {
            if first { Failure::Final(anyhow::Error::msg(why)) } else { Failure::Again(why) }
        };
        let mut facts = BTreeMap::new();
        let mut is_awaited = false;
        while facts.len() < self.notifiers.len() {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            observer.progress(0);
            self.bus.listener().wait(TICK)?;
            for handshake in self.inbox.handshakes.drain()? {
                let (role, said) = introduction(&handshake)?;
                if facts.contains_key(&role) || !self.notifiers.contains_key(&role) {
                    return Err(failed(unexpected(role)));
                }
                if role == Role::Policy && crewing.guest {
                    // Where it cannot be watched, it is taken to be gone when it owes an answer for too long.
                    self.guest = ProcessWatch::new(handshake.pid).ok();
                }
                facts.insert(role, said);
            }
            // A process that cannot start ends with its complaint as its last words: said once, here.
            if let Some(death) = self.children.exited() {
                let advice = death.command.as_deref().map(what_is_asked_of).unwrap_or_default();
                return Err(failed(format!("{death}{advice}")));
            }
            let late = self.notifiers.keys().filter(|role| !facts.contains_key(role));
            let late: Vec<&str> = late
                .filter(|&&role| !(crewing.guest && role == Role::Policy))
                .map(|role| role.word())
                .collect();
            if late.is_empty() && facts.len() < self.notifiers.len() && !is_awaited {
                is_awaited = true;
                observer.awaiting(&self.bus.attach().root);
            }
            if !late.is_empty() && Instant::now() > deadline {
                let policy = crewing.launches.iter().find(|launch| launch.role == Role::Policy);
                let command = policy.and_then(|launch| launch.command.as_deref());
                let advice = command.filter(|_| late.contains(&Role::Policy.word()));
                return Err(failed(format!(
                    "the {} process was not ready after {} s: see its log in {}, or allow more with \
                     --start-timeout{}",
                    late.join(" and the "),
                    crewing.start_deadline.as_secs(),
                    crewing.logs.display(),
                    advice.map(what_is_asked_of).unwrap_or_default()
                )));
            }
        }
        Ok(Some(facts))
    }

    /// Walks what is queued until all is done or `stop` is set, or a process or the observer says that there is
    /// no point in going on, and why.
    pub(super) fn work_off(
        &mut self,
        lanes: &mut Lanes<'_>,
        work: &mut Work,
        crewing: &Crewing,
        stop: &AtomicBool,
        observer: &mut dyn Observer,
    ) -> Result<Option<String>, Failure> {
        let mut looked_after = Instant::now();
        let mut more = false;
        loop {
            self.fill(lanes, work)?;
            if lanes.busy() == 0 || stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            if !more {
                self.bus.listener().wait(if lanes.is_half_told() { MOMENT } else { TICK })?;
            }
            let (steps, spent);
            (steps, spent, more) = self.take_in(lanes, work, observer)?;
            if spent.is_some() {
                return Ok(spent);
            }
            if looked_after.elapsed() >= TICK {
                looked_after = Instant::now();
                let halted = self.look_after(lanes, work, crewing, observer)?;
                if halted.is_some() {
                    return Ok(halted);
                }
            }
            observer.progress(steps);
        }
    }

    /// Begins episodes in the lanes that are free.
    fn fill(&mut self, lanes: &mut Lanes<'_>, work: &mut Work) -> Result<(), Failure> {
        let mut began = false;
        while let Some(lane) = lanes.free()
            && let Some(episode) = work.next(lanes.busy())
        {
            lanes.set_time(monotonic_ns());
            let opening = lanes.begin(lane, episode);
            if let Some(configs) = &self.memory_configs {
                again(configs.send(&opening.memory))?;
            }
            if let Some(configs) = &self.policy_configs {
                // It alone does not receive what only it is sent.
                configs.send(&opening.policy).map_err(|e| Failure::Policy(e.to_string()))?;
            }
            again(self.commands.send(&opening.command))?;
            began = true;
        }
        if began { self.notify(Role::Sim) } else { Ok(()) }
    }

    /// Takes in what waits, of decisions as many as belong into a turn, answers it, and rings the simulator once.
    /// Returns how many steps were commanded, why there is no point in going on, if the observer says so, and
    /// whether more may wait.
    ///
    /// What a message refers to was sent before it. So the queues are emptied from the last answer of a
    /// step to the first, and worked on in the opposite order.
    fn take_in(
        &mut self,
        lanes: &mut Lanes<'_>,
        work: &mut Work,
        observer: &mut dyn Observer,
    ) -> Result<(u64, Option<String>, bool), Failure> {
        let most = self.bus.attach().batch_len();
        let decisions = self.inbox.decisions.drain_some(most)?;
        let more = decisions.len() == most;
        let traces = self.inbox.traces.drain()?;
        let observations = self.inbox.observations.drain()?;
        lanes.set_time(monotonic_ns());
        let mut turns = Vec::with_capacity(decisions.len() + observations.len());
        for observation in &observations {
            turns.push(lanes.observed(observation));
        }
        for trace in &traces {
            turns.push(lanes.recalled(trace));
        }
        for decision in &decisions {
            let turn = lanes.decided(decision);
            if turn.is_ok() {
                self.decided_ns = lanes.time();
            }
            turns.push(turn);
        }
        lanes.take_stepped().try_for_each(|stamps| observer.stepped(&stamps))?;
        // What was spent is written down before what it was spent on.
        let mut halted = None;
        for spent in lanes.take_spent() {
            halted = observer.spent(&spent)?.or(halted);
        }
        let mut commands = Vec::new();
        let mut failure = None;
        // What is finished is kept first: a command that cannot be sent, or a simulator that is broken, ends
        // the generation.
        for turn in turns {
            match turn {
                Ok(Turn::Wait) => {}
                Ok(Turn::Command(command)) => commands.push(command),
                Ok(Turn::Finished(walked)) => {
                    let attempt = work.attempt(&walked.episode);
                    work.finish(&walked.episode);
                    observer.finished(&walked, attempt)?;
                }
                Err(fault @ Fault::Disagrees { .. }) => {
                    failure = Some(Failure::Again(fault.to_string()));
                }
                Err(fault) => {
                    observer.trouble(&fault.to_string());
                    if let Fault::Garbage { lane, .. } = fault
                        && let Some(episode) = lanes.give_up(lane)
                    {
                        work.spoilt(episode, &fault.to_string());
                    }
                }
            }
        }
        if let Some(failure) = failure {
            return Err(failure);
        }
        let sent_ns = monotonic_ns();
        for command in &mut commands {
            command.sent_ns = sent_ns;
            again(self.commands.send(command))?;
        }
        if !commands.is_empty() {
            self.notify(Role::Sim)?;
        }
        Ok((commands.len() as u64, halted, more))
    }

    /// Are all alive, and does nobody owe an answer for too long? Returns why there is no point in going on, if a
    /// process says so.
    fn look_after(
        &mut self,
        lanes: &mut Lanes<'_>,
        work: &mut Work,
        crewing: &Crewing,
        observer: &mut dyn Observer,
    ) -> Result<Option<String>, Failure> {
        let halted = self.hear_complaints(lanes, work, observer)?;
        if halted.is_some() {
            return Ok(halted);
        }
        for heartbeat in self.inbox.heartbeats.drain()? {
            let Ok(role) = role(heartbeat.role) else { continue };
            // An encoder that hangs is not at work.
            if role == Role::Memory && heartbeat.done > self.embedded {
                self.embedded = heartbeat.done;
                self.memory_busy_ns = monotonic_ns();
            }
            observer.heartbeat(role, &heartbeat);
        }
        if let Some(death) = self.death() {
            return Err(death);
        }
        if let Some(handshake) = self.inbox.handshakes.drain()?.first() {
            let (role, _) = introduction(handshake)?;
            let why = unexpected(role);
            return Err(match role {
                Role::Policy => Failure::Policy(why),
                _ => Failure::Again(why),
            });
        }
        self.call_in(lanes, work, crewing, observer)?;
        Ok(None)
    }

    /// Deals with answers that are overdue.
    fn call_in(
        &mut self,
        lanes: &mut Lanes<'_>,
        work: &mut Work,
        crewing: &Crewing,
        observer: &mut dyn Observer,
    ) -> Result<(), Failure> {
        let now = monotonic_ns();
        let owed = lanes.owed(self.memory_busy_ns);
        observer.waiting(&owed);
        for Owed { role, lane, since_ns, rubbish } in owed {
            let deadline = match role {
                Role::Policy => crewing.decision_deadline,
                _ => Some(crewing.answer_deadline),
            };
            let owed = Duration::from_nanos(now.saturating_sub(since_ns));
            if deadline.is_none_or(|deadline| owed <= deadline) {
                continue;
            }
            let overdue = format!(
                "the {} process has owed an answer for {} s (--step-timeout)",
                role.word(),
                owed.as_secs()
            );
            if role != Role::Policy {
                return Err(Failure::Again(format!("{overdue} and is taken to hang")));
            }
            // A policy that answered others meanwhile, or this one with something that could not be used, has
            // spoilt this episode only. What it may still say to it is late.
            if self.decided_ns <= since_ns && rubbish == 0 {
                return Err(Failure::Policy(format!("{overdue} and is taken to hang")));
            }
            let Some(episode) = lanes.give_up(lane) else { continue };
            let why = match rubbish {
                0 => format!("{overdue}, and has answered others meanwhile"),
                _ => format!("{overdue}, after {rubbish} answers that could not be used"),
            };
            observer.trouble(&format!("{}: {why}", episode.key));
            work.spoilt(episode, &why);
        }
        Ok(())
    }

    /// Hears what went wrong in the processes, and draws the consequences.
    fn hear_complaints(
        &mut self,
        lanes: &mut Lanes<'_>,
        work: &mut Work,
        observer: &mut dyn Observer,
    ) -> Result<Option<String>, Failure> {
        let mut halted = None;
        for error_report in self.inbox.error_reports.drain()? {
            let who = role(error_report.role).map_or("somebody", Role::word);
            let what = read_text(&error_report.text, error_report.text_len)
                .unwrap_or("something unreadable");
            let what = format!("{who}: {what}");
            let kind = u8::try_from(error_report.kind).map(ErrorReportKind::try_from);
            match kind {
                Ok(Ok(ErrorReportKind::Episode)) => {
                    let episode = lanes.give_up_ticket(error_report.lane, error_report.episode);
                    // One that is over already is late.
                    let Some(episode) = episode else { continue };
                    observer.trouble(&format!("{}: {what}", episode.key));
                    work.give_up(episode, what);
                }
                Ok(Ok(ErrorReportKind::Run)) => halted = Some(what),
                _ => observer.trouble(&what),
            }
        }
        Ok(halted)
    }

    fn notify(&self, role: Role) -> Result<(), Failure> {
        match self.notifiers.get(&role) {
            Some(notifier) => again(notifier.notify()),
            None => Ok(()),
        }
    }

    /// A process that died is the reason for whatever else went wrong.
    pub(super) fn explain(&mut self, failure: Failure) -> Failure {
        let (Failure::Again(_) | Failure::Policy(_)) = failure else { return failure };
        thread::sleep(TICK);
        self.death().unwrap_or(failure)
    }

    /// Which process is gone, if one is, and how.
    fn death(&mut self) -> Option<Failure> {
        if self.guest.as_ref().is_some_and(ProcessWatch::has_ended) {
            return Some(Failure::Policy("the policy that had attached is gone".to_owned()));
        }
        let death = self.children.exited()?;
        let why = death.to_string();
        Some(if death.role == Role::Policy { Failure::Policy(why) } else { Failure::Again(why) })
    }

    /// Asks the processes to finish and hears what they did with frames.
    pub(super) fn finish(self) -> BTreeMap<Role, ShutdownReport> {
        let mut said = BTreeMap::new();
        let asked = self.stops.send(&Stop::zeroed()).map_err(anyhow::Error::from).and_then(|()| {
            self.notifiers
                .values()
                .try_for_each(|notifier| notifier.notify().map_err(anyhow::Error::from))
        });
        if let Err(error) = asked {
            tracing::warn!(%error, "the processes could not be asked to finish");
            return said;
        }
        let deadline = Instant::now() + FAREWELL_PATIENCE;
        while said.len() < self.notifiers.len() && Instant::now() < deadline {
            let heard =
                self.bus.listener().wait(TICK).and_then(|_| self.inbox.shutdown_reports.drain());
            let Ok(shutdown_reports) = heard else { break };
            said.extend(shutdown_reports.iter().filter_map(|f| Some((role(f.role).ok()?, *f))));
        }
        self.children.wait_or_kill(FAREWELL_PATIENCE);
        said
    }
}

/// A failed delivery is worth another generation: a process is dying or hangs.
fn again(outcome: Result<(), shm_types::BusError>) -> Result<(), Failure> {
    outcome.map_err(|error| Failure::Again(error.to_string()))
}

fn role(code: u32) -> Result<Role, domain::pose::UnknownCode> {
    u8::try_from(code).unwrap_or(u8::MAX).try_into()
}

/// What to say of a hello that nobody waits for.
fn unexpected(role: Role) -> String {
    format!(
        "a {0} said hello, and there is one already or none is wanted: one program attached twice, or as \
         another's part",
        role.word()
    )
}

/// What somebody else's program has to do when it is started, and who can say what it does instead.
fn what_is_asked_of(command: &str) -> String {
    format!(
        "\nA policy joins the run in the folder $MEMTRANSFER_ATTACH, says hello, and stays until it is told to \
         stop (docs/external-policies.md). What this one does:\n  memtransfer conformance --policy-cmd {}",
        shlex::try_quote(command).unwrap_or_default()
    )
}

/// Who says hello, and what it tells about itself.
fn introduction(handshake: &Handshake) -> Result<(Role, Facts), Failure> {
    let role = role(handshake.role)?;
    if handshake.wire_version != WIRE_VERSION {
        return Err(Failure::Final(anyhow::anyhow!(
            "the {} process speaks wire version {} and this program {WIRE_VERSION}: use programs of \
             the same build",
            role.word(),
            handshake.wire_version
        )));
    }
    let facts = read_text(&handshake.facts, handshake.facts_len)?;
    let facts = serde_json::from_str(facts)
        .with_context(|| format!("the {} process introduced itself with {facts:?}", role.word()))?;
    Ok((role, facts))
}
