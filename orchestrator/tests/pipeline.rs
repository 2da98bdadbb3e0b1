//! The pipeline among scripted peers: threads that speak the wire, some of them badly.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::Result;
use bytemuck::Zeroable;
use domain::{Action, Feedback, Pose, Representation};
use orchestrator::lanes::{AnsweredRequest, FinishedEpisode, Lanes, Rules};
use orchestrator::pipeline::{Ending, Facts, Observer, PipelineOptions, run_episodes};
use orchestrator::plan::plan;
use results::conditions::{Condition, Demonstrations, Route, Start, Variation};
use shm_types::message::{
    Decision, Handshake, MAX_EXTERNAL_MEMORIES, MemoryEpisodeConfig, Observation,
    PolicyEpisodeConfig, Recall, RecallTrace, Role, ShutdownReport, StepCommand, StepKind, Stop,
    WIRE_VERSION, write_text,
};
use shm_types::{Attach, Bus, FrameSize, Notifier, RunDir};
use supervise::Launch;
use warehouse::{CaseSet, Variant, Warehouse, step};

const TICK: Duration = Duration::from_millis(20);
const LANES: u32 = 4;
const MAX_STEPS: u32 = 10;
const RULES: Rules = Rules {
    horizon: 6,
    hits: 1,
    keyframes: 40,
    memory_images: 40,
    memory_text_bytes: 65_536,
    max_steps: MAX_STEPS,
    expert: false,
    external_memories: [None; MAX_EXTERNAL_MEMORIES],
};
/// The case whose episode the policy spoils.
const VICTIM: usize = 2;

fn handshake(role: Role) -> Handshake {
    let mut handshake = Handshake {
        wire_version: WIRE_VERSION,
        role: role as u32,
        pid: std::process::id(),
        facts_len: 0,
        external: 0,
        facts: [0; 492],
    };
    handshake.facts_len = write_text(&mut handshake.facts, "{\"kind\": \"scripted\"}");
    handshake
}

/// A run as a peer sees it.
struct Run<'a> {
    attach: &'a Attach,
    /// Set when the pipeline has returned, whatever it said to its peers.
    over: &'a AtomicBool,
}

/// Joins as `role`, sends the handshake, calls `turn` at every notification until asked to stop, sends the report.
/// `turn` receives the bus and a function that notifies others.
fn peer(run: &Run<'_>, role: Role, mut turn: impl FnMut(&Bus, &dyn Fn(Role))) {
    let Run { attach, over } = *run;
    let bus = Bus::join(attach.clone(), role).unwrap();
    let stops = bus.receiver::<Stop>().unwrap();
    let others = Role::ALL.iter().filter(|other| **other != role);
    let notifiers: BTreeMap<Role, Notifier> =
        others.map(|&of| (of, bus.notifier(of).unwrap())).collect();
    let notify = |of: Role| notifiers[&of].notify().unwrap();
    // Receivers must exist before the handshake.
    turn(&bus, &notify);
    bus.sender().unwrap().send(&handshake(role)).unwrap();
    notify(Role::Orchestrator);
    while stops.next().unwrap().is_none() {
        if over.load(Ordering::Relaxed) {
            return;
        }
        bus.listener().wait(TICK).unwrap();
        turn(&bus, &notify);
    }
    let shutdown_report = ShutdownReport { role: role as u32, ..Zeroable::zeroed() };
    bus.sender().unwrap().send(&shutdown_report).unwrap();
    notify(Role::Orchestrator);
}

fn sim(run: &Run<'_>) {
    let warehouse = Warehouse::shipped();
    let mut poses = BTreeMap::new();
    let mut commands = None;
    peer(run, Role::Sim, |bus, notify| {
        let commands = commands.get_or_insert_with(|| bus.receiver::<StepCommand>().unwrap());
        for command in commands.drain().unwrap() {
            let pose: &mut Pose =
                poses.entry(command.lane).or_insert(command.start.try_into().unwrap());
            let feedback = match StepKind::try_from(command.kind).unwrap() {
                StepKind::Reset => {
                    *pose = command.start.try_into().unwrap();
                    Feedback::Start
                }
                StepKind::Stay => Feedback::NotUnderstood,
                StepKind::Act => {
                    let action = Action::try_from(command.action).unwrap();
                    let feedback;
                    (*pose, feedback) = step(&warehouse.layout, &Variant::UNCHANGED, *pose, action);
                    feedback
                }
            };
            let observation = Observation {
                episode: command.episode,
                frame: u64::from(command.last == 0),
                lane: command.lane,
                step: command.step,
                pose: (*pose).into(),
                feedback: feedback as u8,
                last: command.last,
                ..Zeroable::zeroed()
            };
            bus.sender().unwrap().send(&observation).unwrap();
            notify(Role::Memory);
            notify(Role::Orchestrator);
        }
    });
}

fn memory(run: &Run<'_>) {
    let mut ports = None;
    peer(run, Role::Memory, |bus, notify| {
        let (configs, observations) = ports.get_or_insert_with(|| {
            (bus.receiver::<MemoryEpisodeConfig>().unwrap(), bus.receiver::<Observation>().unwrap())
        });
        configs.drain().unwrap();
        for Observation { episode, lane, step, last, .. } in observations.drain().unwrap() {
            if last == 1 {
                continue;
            }
            let trace = RecallTrace { episode, lane, step, ..Zeroable::zeroed() };
            let recall = Recall { episode, lane, step, ..Zeroable::zeroed() };
            bus.sender().unwrap().send(&trace).unwrap();
            bus.sender().unwrap().send(&recall).unwrap();
            notify(Role::Policy);
        }
    });
}

/// Turns left for ever, except that `spoil` may change the decisions on the victim's episode.
fn policy(run: &Run<'_>, spoil: fn(Decision) -> Decision) {
    let cases = CaseSet::shipped();
    let catalogue = Warehouse::shipped().catalogue;
    let instruction = cases.cases[VICTIM].task.instruction(&catalogue);
    let mut ports = None;
    let mut victims = Vec::new();
    peer(run, Role::Policy, |bus, notify| {
        let (configs, observations, recalls) = ports.get_or_insert_with(|| {
            let observations = bus.receiver::<Observation>().unwrap();
            (
                bus.receiver::<PolicyEpisodeConfig>().unwrap(),
                observations,
                bus.receiver::<Recall>().unwrap(),
            )
        });
        let recalls = recalls.drain().unwrap();
        observations.drain().unwrap();
        for config in configs.drain().unwrap() {
            if config.instruction.starts_with(instruction.as_bytes()) {
                victims.push(config.episode);
            }
        }
        for Recall { episode, lane, step, .. } in recalls {
            let action = Action::TurnLeft as u8;
            let decision = Decision { episode, lane, step, action, ..Zeroable::zeroed() };
            let spoilt = victims.contains(&episode);
            let decision = if spoilt { spoil(decision) } else { decision };
            bus.sender().unwrap().send(&decision).unwrap();
            notify(Role::Orchestrator);
        }
    });
}

/// What an observer saw.
#[derive(Default)]
struct Seen {
    finished: Vec<usize>,
    problems: Vec<String>,
    generations: u32,
    steps: u64,
}

impl Observer for Seen {
    fn starting(&mut self, generation: u32) {
        self.generations = generation;
    }
    fn awaiting_policy(&mut self, _folder: &Path) {}
    fn ready(&mut self, facts: &BTreeMap<Role, Facts>) -> Result<()> {
        assert_eq!(facts.len(), 3);
        assert!(facts.values().all(|facts| facts["kind"] == "scripted"));
        Ok(())
    }
    fn answered(&mut self, _: &AnsweredRequest) -> Result<Option<String>> {
        Ok(None)
    }
    fn finished(&mut self, finished: &FinishedEpisode, _attempt: u32) -> Result<()> {
        assert_eq!(finished.record.steps, MAX_STEPS);
        self.finished.push(finished.episode.case_index);
        Ok(())
    }
    fn progress(&mut self, steps: u64) {
        self.steps += steps;
    }
    fn problem(&mut self, what: &str) {
        self.problems.push(what.to_owned());
    }
}

/// Runs the first eight cases among scripted peers, of which the policy spoils the victim's decisions.
fn run(spoil: fn(Decision) -> Decision) -> (Seen, Ending) {
    let base = tempfile::Builder::new().prefix("mt").tempdir_in("/tmp").unwrap();
    let dir = RunDir::create(base.path()).unwrap();
    let frame = FrameSize { width: 64, height: 64 };
    let attach = Attach { frame, lanes: LANES, frame_capacity: 32, ..dir.attach() };
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
    let ids: Vec<&str> = cases.cases.iter().map(|case| case.id.as_str()).collect();
    let condition = Condition {
        memory: Representation::Working.into(),
        start: Start::Original,
        route: Route::Unchanged,
        demonstrations: Demonstrations::NONE,
        variation: Variation::STANDARD,
    };
    let episodes = plan(&[(condition, 1)], &[0, 1, 2, 3, 4, 5, 6, 7], &ids, 1);
    let rules = Rules { expert: false, ..RULES };
    let mut lanes = Lanes::new(&warehouse, &cases, rules, LANES as usize);
    // The peers are threads; the process that the pipeline watches only has to live.
    let sleeper = Launch {
        role: Role::Sim,
        program: "/bin/sh".into(),
        args: vec!["-c".into(), "exec sleep 300".into()],
        command: Some("sleeper".to_owned()),
        env: Vec::new(),
    };
    let options = PipelineOptions {
        launches: vec![sleeper],
        external_policy: false,
        logs: base.path().join("logs"),
        start_timeout: Duration::from_secs(60),
        answer_timeout: Duration::from_secs(2),
        decision_timeout: Some(Duration::from_secs(2)),
    };
    let mut seen = Seen::default();
    let over = AtomicBool::new(false);
    let peers = Run { attach: &attach, over: &over };
    let outcome = thread::scope(|scope| {
        scope.spawn(|| sim(&peers));
        scope.spawn(|| memory(&peers));
        scope.spawn(|| policy(&peers, spoil));
        let stop = AtomicBool::new(false);
        let outcome = run_episodes(&mut lanes, episodes, &attach, &options, &stop, &mut seen);
        over.store(true, Ordering::Relaxed);
        outcome
    });
    seen.finished.sort();
    (seen, outcome.unwrap())
}

fn check_only_the_victim_suffers(seen: &Seen, ending: &Ending, said: &str) {
    assert_eq!(seen.finished, [0, 1, 3, 4, 5, 6, 7]);
    assert_eq!(seen.generations, 1, "nothing was restarted: {:?}", seen.problems);
    let unfinished: Vec<_> =
        ending.unfinished.iter().map(|(episode, why)| (episode.case_index, why)).collect();
    let [(VICTIM, why)] = unfinished[..] else { panic!("{unfinished:?}") };
    assert!(why.contains(said), "{why}");
}

#[test]
fn peers_that_behave_finish_everything() {
    let (seen, ending) = run(|decision| decision);
    assert_eq!(seen.finished, [0, 1, 2, 3, 4, 5, 6, 7]);
    assert_eq!((seen.problems, seen.steps), (vec![], 8 * u64::from(MAX_STEPS)));
    assert!(ending.unfinished.is_empty() && !ending.interrupted);
    assert_eq!(ending.shutdown_reports.len(), 3);
}

#[test]
fn a_policy_that_sends_garbage_spoils_that_episode_and_no_other() {
    let (seen, ending) = run(|decision| Decision { outcome: 77, action: 99, ..decision });
    check_only_the_victim_suffers(&seen, &ending, "77 is not an outcome");
    assert!(!seen.problems.is_empty());
}

#[test]
fn a_policy_that_answers_something_else_spoils_that_episode_and_no_other() {
    let (seen, ending) = run(|decision| Decision { step: decision.step + 5, ..decision });
    check_only_the_victim_suffers(&seen, &ending, "answers that could not be used");
}

/// Runs one episode with a simulator that executes `script` whenever it is started. Returns how often that was, and the
/// error.
fn run_with_simulator(script: &str) -> (u32, String) {
    let base = tempfile::Builder::new().prefix("mt").tempdir_in("/tmp").unwrap();
    let dir = RunDir::create(base.path()).unwrap();
    let attach = Attach { participants: vec![Role::Sim], frame_capacity: 8, ..dir.attach() };
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
    let condition = "working/original/unchanged/none".parse().unwrap();
    let episodes = plan(&[(condition, 1)], &[0], &["t01-01"], 1);
    let rules = Rules { expert: true, ..RULES };
    let mut lanes = Lanes::new(&warehouse, &cases, rules, 1);
    let launch = Launch {
        role: Role::Sim,
        program: "/bin/sh".into(),
        args: vec!["-c".into(), script.into()],
        command: Some(script.to_owned()),
        env: Vec::new(),
    };
    let options = PipelineOptions {
        launches: vec![launch],
        external_policy: false,
        logs: base.path().join("logs"),
        start_timeout: Duration::from_secs(60),
        answer_timeout: Duration::from_secs(2),
        decision_timeout: None,
    };
    let (mut seen, stop) = (Seen::default(), AtomicBool::new(false));
    let outcome = run_episodes(&mut lanes, episodes, &attach, &options, &stop, &mut seen);
    (seen.generations, outcome.unwrap_err().to_string())
}

#[test]
fn a_process_that_is_killed_while_the_run_starts_is_started_again() {
    let (generations, error) = run_with_simulator("kill -9 $$");
    assert_eq!(generations, 4, "{error}");
    assert!(error.contains("signal 9") && error.contains("4 times in a row"), "{error}");
}

#[test]
fn a_process_that_cannot_start_ends_the_run_at_once() {
    let (generations, error) = run_with_simulator("echo 'sim-proc: no device' >&2; exit 2");
    assert_eq!(generations, 1, "{error}");
    assert!(error.contains("exit status 2") && error.contains("no device"), "{error}");
}
