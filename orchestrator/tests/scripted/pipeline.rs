//! The pipeline among scripted peers: threads on the wire, some of which send invalid messages.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use orchestrator::lanes::{Lanes, Rules};
use orchestrator::pipeline::{Ending, run_episodes};
use orchestrator::plan::plan;
use rigs::process::ScratchRun;
use rigs::scripted::ScriptedRun;
use shm_types::message::{Decision, Role};
use supervise::{Children, Launch};

use crate::common::{MAX_STEPS, RULES, Seen, books, options};

const LANES: u32 = 4;
/// The case whose episode the policy spoils.
const VICTIM: usize = 2;

/// A simulator that is a shell script.
fn simulator(script: &str) -> Launch {
    Launch {
        role: Role::Sim,
        index: 0,
        program: "/bin/sh".into(),
        args: vec!["-c".into(), script.into()],
        command: Some(script.to_owned()),
        env: Vec::new(),
        needs_keys: false,
    }
}

/// Runs the first eight cases among scripted peers, of which the policy spoils the victim's decisions.
fn run(spoil: fn(Decision) -> Decision) -> (Seen, Ending) {
    run_with_policy(|of_victim, decision, _| if of_victim { spoil(decision) } else { decision })
}

/// Runs the first eight cases among scripted peers. The policy's decisions are changed by `change`, which is told whether they
/// are the victim's, and can stop the run.
fn run_with_policy(
    mut change: impl FnMut(bool, Decision, &AtomicBool) -> Decision + Send,
) -> (Seen, Ending) {
    let scratch = ScratchRun::new(&Role::CHILDREN, |attach| attach.lanes = LANES);
    let books = books();
    let ids = books.cases.book.ids();
    let conditions = [("working/original/unchanged/none".parse().unwrap(), 1)];
    let episodes = plan(&conditions, &[0, 1, 2, 3, 4, 5, 6, 7], &ids, 1);
    let mut lanes = Lanes::new(&books, RULES, LANES as usize);
    // The peers are threads; the process that the pipeline watches only has to live.
    // One of the policies makes the run wait so long.
    let options = options(&scratch, vec![simulator("exec sleep 3600")], Duration::from_secs(20));
    let mut seen = Seen::default();
    let (over, stop) = (AtomicBool::new(false), AtomicBool::new(false));
    let peers = ScriptedRun { attach: scratch.attach(), over: &over };
    let victim = &books.cases.book.cases[VICTIM].instruction;
    let outcome = thread::scope(|scope| {
        scope.spawn(|| peers.sim());
        scope.spawn(|| peers.memory());
        scope.spawn(|| {
            peers.policy(|instruction, decision| change(instruction == *victim, decision, &stop));
        });
        let (attach, none) = (scratch.attach(), Children::default());
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

#[test]
fn answers_that_wait_when_the_run_is_stopped_are_recorded() {
    let mut sent = 0;
    let (seen, ending) = run_with_policy(|_, decision, stop| {
        sent += 1;
        stop.store(true, Ordering::Relaxed);
        Decision { prompt_tokens: 900, completion_tokens: 3, ..decision }
    });
    assert!(ending.interrupted && sent > 0);
    assert_eq!(seen.answered, sent);
}

/// Runs one episode with a simulator that executes `script` whenever it is started. Returns how often that was, and the
/// error.
fn run_with_simulator(script: &str) -> (u32, String) {
    let scratch = ScratchRun::new(&[Role::Sim], |attach| attach.lanes = 1);
    let books = books();
    let conditions = [("working/original/unchanged/none".parse().unwrap(), 1)];
    let episodes = plan(&conditions, &[0], &["t01-01"], 1);
    let rules = Rules { expert: true, ..RULES };
    let mut lanes = Lanes::new(&books, rules, 1);
    let options = options(&scratch, vec![simulator(script)], Duration::from_secs(2));
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
