//! The pipeline among scripted peers: threads on the wire, some of which send invalid messages.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::Result;
use conformance::scripted::{self, ScriptedRun, ScriptedSim};
use conformance::testing::ScratchRun;
use domain::{Arm, Representation};
use orchestrator::lanes::{FinishedEpisode, Lanes, Rules};
use orchestrator::pipeline::{Ending, Facts, Observer, Participant, PipelineOptions, run_episodes};
use orchestrator::plan::plan;
use results::conditions::{Condition, Demonstrations, Route, Start, Variation};
use shm_types::message::{Decision, MAX_EXTERNAL_MEMORIES, Role};
use supervise::{Children, Launch, System};
use warehouse::{CaseSet, Variant, Warehouse, step};

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
    fn ready(&mut self, facts: &BTreeMap<Participant, Facts>) -> Result<()> {
        assert_eq!(facts.len(), 3);
        assert!(facts.values().all(|facts| facts["kind"] == scripted::KIND));
        Ok(())
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

/// A simulator that is a shell script.
fn simulator(script: &str) -> Launch {
    Launch {
        role: Role::Sim,
        index: 0,
        program: "/bin/sh".into(),
        args: vec!["-c".into(), script.into()],
        command: Some(script.to_owned()),
        env: Vec::new(),
    }
}

/// Runs the first eight cases among scripted peers, of which the policy spoils the victim's decisions.
fn run(spoil: fn(Decision) -> Decision) -> (Seen, Ending) {
    let scratch = ScratchRun::new(&Role::CHILDREN, |attach| attach.lanes = LANES);
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
    let ids: Vec<&str> = cases.cases.iter().map(|case| case.id.as_str()).collect();
    let condition = Condition {
        memory: Representation::Working.into(),
        start: Start::Original,
        route: Route::Unchanged,
        demonstrations: Demonstrations::NONE,
        variation: Variation::STANDARD,
        arm: Arm::Frozen,
    };
    let conditions = [(condition, 1)];
    let episodes = plan(&conditions, &[0, 1, 2, 3, 4, 5, 6, 7], &ids, 1);
    let rules = Rules { expert: false, ..RULES };
    let mut lanes = Lanes::new(&warehouse, &cases, rules, LANES as usize);
    // The peers are threads; the process that the pipeline watches only has to live.
    let options = PipelineOptions {
        launcher: Arc::new(System),
        launches: vec![simulator("exec sleep 300")],
        external_policy: false,
        logs: scratch.base().join("logs"),
        start_timeout: Duration::from_secs(60),
        answer_timeout: Duration::from_secs(2),
        decision_timeout: Some(Duration::from_secs(2)),
        memories: Vec::new(),
        memory_timeout: Duration::from_secs(2),
    };
    let mut seen = Seen::default();
    let over = AtomicBool::new(false);
    let peers = ScriptedRun { attach: scratch.attach(), over: &over };
    let victim = cases.cases[VICTIM].task.instruction(&warehouse.catalogue);
    let sim = ScriptedSim::new(|_, pose, action| {
        step(&warehouse.layout, &Variant::UNCHANGED, pose, action)
    });
    let outcome = thread::scope(|scope| {
        scope.spawn(|| peers.sim(sim));
        scope.spawn(|| peers.memory());
        scope.spawn(|| {
            peers.policy(|instruction, decision| match instruction {
                _ if instruction == victim => spoil(decision),
                _ => decision,
            });
        });
        let (attach, stop, none) = (scratch.attach(), AtomicBool::new(false), Children::default());
        let outcome = run_episodes(&mut lanes, episodes, attach, &options, none, &stop, &mut seen);
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
    let scratch = ScratchRun::new(&[Role::Sim], |attach| attach.lanes = 1);
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
    let condition = "working/original/unchanged/none".parse().unwrap();
    let conditions = [(condition, 1)];
    let episodes = plan(&conditions, &[0], &["t01-01"], 1);
    let rules = Rules { expert: true, ..RULES };
    let mut lanes = Lanes::new(&warehouse, &cases, rules, 1);
    let options = PipelineOptions {
        launcher: Arc::new(System),
        launches: vec![simulator(script)],
        external_policy: false,
        logs: scratch.base().join("logs"),
        start_timeout: Duration::from_secs(60),
        answer_timeout: Duration::from_secs(2),
        decision_timeout: None,
        memories: Vec::new(),
        memory_timeout: Duration::from_secs(2),
    };
    let (mut seen, stop) = (Seen::default(), AtomicBool::new(false));
    let (attach, none) = (scratch.attach(), Children::default());
    let outcome = run_episodes(&mut lanes, episodes, attach, &options, none, &stop, &mut seen);
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
