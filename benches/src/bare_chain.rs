//! The bare chain: four processes that pass the messages of a step and do nothing else. It is the lower bound of what a
//! step through the real processes can cost.
//!
//! Messages, queues, notifications and their order are those of a run: a process that wakes drains its queues, answers
//! everything, and notifies its neighbour once. The measuring process plays the orchestrator.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use bytemuck::Zeroable;
use shm_types::message::{
    Decision, Observation, Recall, RecallTrace, Role, StepCommand, StepReport, Stop,
};
use shm_types::{Attach, Bus, PortedMessage, RunDir};

use crate::BenchSession;
use crate::processes::BenchProcess;

/// Longest wait for a notification.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// Longest time without a message before the chain counts as broken.
const PATIENCE: Duration = Duration::from_secs(20);

/// Steps per second through a bare chain of `lanes`, over `length` in its steady state.
///
/// # Errors
/// When a process fails or hangs.
pub fn steps_per_second(session: &BenchSession<'_>, lanes: u32, length: Duration) -> Result<f64> {
    let run = RunDir::create(session.registry())?;
    let attach = Attach { lanes, ..run.attach() };
    attach.write(run.path())?;
    let bus = Bus::join(attach, Role::Orchestrator)?;
    let reports = bus.receiver::<StepReport>()?;
    let traces = bus.receiver::<RecallTrace>()?;
    let decisions = bus.receiver::<Decision>()?;
    let (commands, stops) = (bus.sender::<StepCommand>()?, bus.sender::<Stop>()?);
    let notifiers =
        [bus.notifier(Role::Sim)?, bus.notifier(Role::Memory)?, bus.notifier(Role::Policy)?];
    let folder = run.path().display().to_string();
    let mut processes = Vec::new();
    for name in ["bare-sim", "bare-memory", "bare-policy"] {
        processes.push(BenchProcess::start(session, name, std::slice::from_ref(&folder))?);
    }
    commands.wait_for_receivers(PATIENCE)?;
    for lane in 0..lanes {
        commands.send(&StepCommand { lane, ..StepCommand::zeroed() })?;
    }
    notifiers[0].notify()?;
    let (mut steps, mut last_received) = (0_u64, Instant::now());
    // The warm-up is not counted: connections are made, and every process has to be awake.
    let warm_until = Instant::now() + length / 4;
    let mut began = None;
    let rate = loop {
        bus.listener().wait(LONGEST_SLEEP)?;
        let decided = decisions.drain()?;
        traces.drain()?;
        reports.drain()?;
        let now = Instant::now();
        if decided.is_empty() {
            ensure!(now - last_received < PATIENCE, "no message for {} s", PATIENCE.as_secs());
            processes.iter_mut().try_for_each(BenchProcess::check)?;
            continue;
        }
        last_received = now;
        for decision in &decided {
            let (episode, lane, step) = (decision.episode, decision.lane, decision.step + 1);
            commands.send(&StepCommand { episode, lane, step, ..StepCommand::zeroed() })?;
        }
        notifiers[0].notify()?;
        steps += decided.len() as u64;
        match began {
            None if now >= warm_until => {
                began = Some(now);
                steps = 0;
            }
            Some(began) if now >= began + length => {
                break steps as f64 / (now - began).as_secs_f64();
            }
            _ => {}
        }
    };
    // Receive what is in flight before anything stops.
    let (mut in_flight, deadline) = (lanes as usize, Instant::now() + PATIENCE);
    while in_flight > 0 {
        ensure!(Instant::now() < deadline, "{in_flight} decisions did not arrive");
        bus.listener().wait(LONGEST_SLEEP)?;
        in_flight = in_flight.saturating_sub(decisions.drain()?.len());
        traces.drain()?;
        reports.drain()?;
    }
    stops.send(&Stop::zeroed())?;
    notifiers.iter().try_for_each(shm_types::Notifier::notify)?;
    processes.into_iter().try_for_each(BenchProcess::finish)?;
    Ok(rate)
}

/// Joins the run named in the arguments.
fn join(arguments: &[String], role: Role) -> Result<Bus> {
    let [folder] = arguments else { bail!("the run folder is missing") };
    Ok(Bus::join(Attach::read(Path::new(folder))?, role)?)
}

/// Answers what arrives, all that has arrived at once, and notifies `next`, until the run stops.
fn relay<M: PortedMessage>(
    bus: &Bus,
    next: Role,
    mut answer: impl FnMut(&[M]) -> Result<()>,
) -> Result<()> {
    let (stops, arriving) = (bus.receiver::<Stop>()?, bus.receiver::<M>()?);
    let next = bus.notifier(next)?;
    while stops.next()?.is_none() {
        bus.listener().wait(LONGEST_SLEEP)?;
        let waiting = arriving.drain()?;
        if !waiting.is_empty() {
            answer(&waiting)?;
            next.notify()?;
        }
    }
    Ok(())
}

/// Plays the simulator: answers a command with a report and an observation.
pub(crate) fn sim(arguments: &[String]) -> Result<()> {
    let bus = join(arguments, Role::Sim)?;
    let (reports, observations) = (bus.sender()?, bus.sender()?);
    observations.wait_for_receivers(PATIENCE)?;
    relay(&bus, Role::Memory, |commands| {
        for &StepCommand { episode, lane, step, .. } in commands {
            reports.send(&StepReport { episode, lane, step, ..StepReport::zeroed() })?;
            observations.send(&Observation { episode, lane, step, ..Observation::zeroed() })?;
        }
        Ok(())
    })
}

/// Plays memory: answers an observation with a recall and its trace.
pub(crate) fn memory(arguments: &[String]) -> Result<()> {
    let bus = join(arguments, Role::Memory)?;
    let (recalls, traces) = (bus.sender()?, bus.sender()?);
    let reports = bus.receiver::<StepReport>()?;
    recalls.wait_for_receivers(PATIENCE)?;
    relay(&bus, Role::Policy, |observations| {
        reports.drain()?;
        for &Observation { episode, lane, step, .. } in observations {
            traces.send(&RecallTrace { episode, lane, step, ..RecallTrace::zeroed() })?;
            recalls.send(&Recall { episode, lane, step, ..Recall::zeroed() })?;
        }
        Ok(())
    })
}

/// Plays the policy: answers a recall with a decision.
pub(crate) fn policy(arguments: &[String]) -> Result<()> {
    let bus = join(arguments, Role::Policy)?;
    let (observations, decisions) = (bus.receiver::<Observation>()?, bus.sender()?);
    relay(&bus, Role::Orchestrator, |recalls| {
        observations.drain()?;
        for &Recall { episode, lane, step, .. } in recalls {
            decisions.send(&Decision { episode, lane, step, ..Decision::zeroed() })?;
        }
        Ok(())
    })
}
