//! The bare chain: four processes that pass the messages of a step round and do nothing else. What the run's own
//! processes take beyond it is theirs.
//!
//! Messages, queues, doorbells and their order are those of a run: whoever wakes drains its queues, answers all of it,
//! and rings its neighbour once. The orchestrator is the process that measures.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use bytemuck::Zeroable;
use shm_types::message::{Decision, Observation, Recall, RecallTrace, Role, StepCommand, Stop};
use shm_types::{Attach, Bus, RunDir};

use crate::parts::Part;
use crate::session::Session;

/// How long a part sleeps at most before it looks by itself.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// How long nothing may come before the chain counts as broken.
const PATIENCE: Duration = Duration::from_secs(20);

/// Steps a second through a bare chain with so many lanes, over `length` in its steady state.
///
/// # Errors
/// When a part fails or hangs.
pub fn steps_per_second(session: &Session<'_>, lanes: u32, length: Duration) -> Result<f64> {
    let run = RunDir::create(session.registry())?;
    let attach = Attach { lanes, ..run.attach() };
    attach.write(run.path())?;
    let bus = Bus::join(attach, Role::Orchestrator)?;
    let observations = bus.receiver::<Observation>()?;
    let traces = bus.receiver::<RecallTrace>()?;
    let decisions = bus.receiver::<Decision>()?;
    let (commands, stops) = (bus.sender::<StepCommand>()?, bus.sender::<Stop>()?);
    let notifiers =
        [bus.notifier(Role::Sim)?, bus.notifier(Role::Memory)?, bus.notifier(Role::Policy)?];
    let folder = run.path().display().to_string();
    let mut parts = Vec::new();
    for name in ["bare-sim", "bare-memory", "bare-policy"] {
        parts.push(Part::start(session, name, std::slice::from_ref(&folder))?);
    }
    for lane in 0..lanes {
        commands.send(&StepCommand { lane, ..StepCommand::zeroed() })?;
    }
    notifiers[0].notify()?;
    let (mut steps, mut last_came) = (0_u64, Instant::now());
    // A first part is not counted: connections are made in it, and every process has to be awake.
    let warm_until = Instant::now() + length / 4;
    let mut began = None;
    let rate = loop {
        bus.listener().wait(LONGEST_SLEEP)?;
        let decided = decisions.drain()?;
        traces.drain()?;
        observations.drain()?;
        let now = Instant::now();
        if decided.is_empty() {
            ensure!(now - last_came < PATIENCE, "nothing came for {} s", PATIENCE.as_secs());
            parts.iter_mut().try_for_each(Part::check)?;
            continue;
        }
        last_came = now;
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
    // Nobody may leave while something is on its way to him.
    let (mut under_way, deadline) = (lanes as usize, Instant::now() + PATIENCE);
    while under_way > 0 {
        ensure!(Instant::now() < deadline, "{under_way} decisions never came");
        bus.listener().wait(LONGEST_SLEEP)?;
        under_way = under_way.saturating_sub(decisions.drain()?.len());
        traces.drain()?;
        observations.drain()?;
    }
    stops.send(&Stop::zeroed())?;
    notifiers.iter().try_for_each(shm_types::Notifier::notify)?;
    parts.into_iter().try_for_each(Part::finish)?;
    Ok(rate)
}

/// Joins the run that a part is told of.
fn join(arguments: &[String], role: Role) -> Result<Bus> {
    let [folder] = arguments else { bail!("which run?") };
    Ok(Bus::join(Attach::read(Path::new(folder))?, role)?)
}

/// The part of the simulator: a command is answered with an observation.
pub(crate) fn sim(arguments: &[String]) -> Result<()> {
    let bus = join(arguments, Role::Sim)?;
    let (stops, commands) = (bus.receiver::<Stop>()?, bus.receiver::<StepCommand>()?);
    let (observations, next) = (bus.sender::<Observation>()?, bus.notifier(Role::Memory)?);
    while stops.next()?.is_none() {
        bus.listener().wait(LONGEST_SLEEP)?;
        let waiting = commands.drain()?;
        for StepCommand { episode, lane, step, .. } in &waiting {
            let (episode, lane, step) = (*episode, *lane, *step);
            observations.send(&Observation { episode, lane, step, ..Observation::zeroed() })?;
        }
        if !waiting.is_empty() {
            next.notify()?;
        }
    }
    Ok(())
}

/// The part of memory: an observation is answered with a recall and its trace.
pub(crate) fn memory(arguments: &[String]) -> Result<()> {
    let bus = join(arguments, Role::Memory)?;
    let (stops, observations) = (bus.receiver::<Stop>()?, bus.receiver::<Observation>()?);
    let (recalls, traces) = (bus.sender::<Recall>()?, bus.sender::<RecallTrace>()?);
    let next = bus.notifier(Role::Policy)?;
    while stops.next()?.is_none() {
        bus.listener().wait(LONGEST_SLEEP)?;
        let waiting = observations.drain()?;
        for Observation { episode, lane, step, .. } in &waiting {
            let (episode, lane, step) = (*episode, *lane, *step);
            traces.send(&RecallTrace { episode, lane, step, ..RecallTrace::zeroed() })?;
            recalls.send(&Recall { episode, lane, step, ..Recall::zeroed() })?;
        }
        if !waiting.is_empty() {
            next.notify()?;
        }
    }
    Ok(())
}

/// The part of the policy: a recall is answered with a decision. What it refers to was observed before.
pub(crate) fn policy(arguments: &[String]) -> Result<()> {
    let bus = join(arguments, Role::Policy)?;
    let (stops, observations) = (bus.receiver::<Stop>()?, bus.receiver::<Observation>()?);
    let (recalls, decisions) = (bus.receiver::<Recall>()?, bus.sender::<Decision>()?);
    let next = bus.notifier(Role::Orchestrator)?;
    while stops.next()?.is_none() {
        bus.listener().wait(LONGEST_SLEEP)?;
        let waiting = recalls.drain()?;
        observations.drain()?;
        for Recall { episode, lane, step, .. } in &waiting {
            let (episode, lane, step) = (*episode, *lane, *step);
            decisions.send(&Decision { episode, lane, step, ..Decision::zeroed() })?;
        }
        if !waiting.is_empty() {
            next.notify()?;
        }
    }
    Ok(())
}
