//! A policy in a process of somebody else's: started by a command, or attached from outside.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use memtransfer_tests::{
    Bench, Ended, episodes, eventually, kill, process_of, processes_with, program, sorted_log,
};

/// `memtransfer run` over twelve episodes that take a moment, whoever decides.
fn slice<'a>(out: &'a str, lanes: &'a str, policy: &[&'a str]) -> Vec<&'a str> {
    let mut args = vec!["run", "--suite", "quick", "--cases", "t01-01,t03-02,t09-05"];
    args.extend(["--memory", "working,full-context", "--lanes", lanes, "--out", out]);
    args.extend(policy);
    args
}

/// The command that starts a built-in policy as if it were somebody's own.
fn own(policy: &str) -> String {
    format!("{} serve --policy {policy}", program("policy-proc").display())
}

/// The log that every way of running the slice must give: that of the built-in policy.
fn reference(bench: &Bench) -> Vec<String> {
    bench.run(&slice("reference", "4", &["--policy", "grounded"])).expect(0);
    let log = sorted_log(&bench.out("reference"));
    assert_eq!(log.len(), 12);
    log
}

/// Waits until some of the slice is in the log, and not all.
fn mid_run(run: &Path) {
    eventually("an episode to be finished", || (!episodes(run).is_empty()).then_some(()));
}

#[test]
fn a_policy_command_that_is_killed_leaves_no_trace_in_the_log_and_nothing_behind() {
    let bench = Bench::new();
    let reference = reference(&bench);
    // Beside the policy the command starts something that does not end by itself.
    let mark = format!("86400.{}", std::process::id());
    let command = format!("sh -c 'sleep {mark} & {}; exit $?'", own("grounded"));
    let child = bench.start(&slice("killed", "4", &["--policy-cmd", &command]));
    mid_run(&bench.out("killed"));
    kill(process_of(bench.registry.path(), "policy"));
    let ended = Ended::of(child).expect(0);
    assert!(ended.stderr.contains("the policy process (`sh -c "), "{}", ended.stderr);
    assert!(ended.stdout.contains("Policy: a program of its own, `sh -c "), "{}", ended.stdout);
    assert_eq!(sorted_log(&bench.out("killed")), reference);
    assert_eq!(processes_with(mark.as_bytes()), Default::default(), "what the command had started");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_command_that_is_no_policy_is_told_what_is_wrong() {
    let bench = Bench::new();
    let refused = |command: &str, said: &[&str]| {
        let flags = ["--policy-cmd", command, "--start-timeout", "3"];
        let ended = bench.run(&slice("refused", "4", &flags)).expect(2);
        for said in said {
            assert!(ended.stderr.contains(said), "{command}: {}", ended.stderr);
        }
    };
    refused("python 'half", &["--policy-cmd is \"python 'half\", but must be a program"]);
    refused("./no-such-policy --x", &["cannot start the policy command `./no-such-policy --x`"]);
    std::fs::write(bench.out("script"), "print('hello')").unwrap();
    refused("./script", &["is not executable", "chmod +x"]);
    refused(
        "sh -c 'echo I cannot find my model >&2; exit 3'",
        &["ended with exit status 3", "I cannot find my model", "memtransfer conformance"],
    );
    refused("sleep 1000", &["was not ready after 3 s", "MEMTRANSFER_ATTACH"]);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// Starts a built-in policy that nobody supervises.
fn attach(run: &Path) -> Child {
    let mut policy = Command::new(program("policy-proc"));
    policy.args(["serve", "--policy", "grounded"]).env("MEMTRANSFER_ATTACH", run);
    policy.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    policy.spawn().unwrap()
}

/// Reads what the run says until it names the folder to attach to, and goes on reading.
fn folder_to_attach_to(child: &mut Child) -> PathBuf {
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let folder = lines
        .by_ref()
        .find_map(|line| {
            let line = line.unwrap();
            let (_, said) = line.split_once("MEMTRANSFER_ATTACH=")?;
            Some(PathBuf::from(said.split_whitespace().next()?))
        })
        .unwrap();
    std::thread::spawn(move || lines.for_each(drop));
    folder
}

#[test]
fn a_policy_that_attaches_is_waited_for_and_may_come_again() {
    let bench = Bench::new();
    let reference = reference(&bench);
    let mut child = bench.start(&slice("attached", "4", &["--policy", "external"]));
    let run = folder_to_attach_to(&mut child);
    let mut first = attach(&run);
    mid_run(&bench.out("attached"));

    let second = Ended::of(attach(&run)).expect(2);
    assert!(second.stderr.contains("the run has a policy already"), "{}", second.stderr);

    // Nobody waits for the first one yet when it is dead.
    kill(first.id());
    let third = attach(&run);
    mid_run(&bench.out("attached"));
    // The others are started anew, and the policy joins them by itself.
    kill(process_of(bench.registry.path(), "sim"));
    Ended::of(child).expect(0);
    first.wait().unwrap();
    Ended::of(third).expect(0);
    assert_eq!(sorted_log(&bench.out("attached")), reference);
    assert_eq!(bench.leftovers(), Vec::<String>::new());

    let late = Ended::of(attach(&run)).expect(2);
    assert!(late.stderr.contains("is not the folder of a run"), "{}", late.stderr);
}

#[test]
fn a_policy_that_attached_ends_when_the_orchestrator_is_gone() {
    let bench = Bench::new();
    let mut child = bench.start(&slice("gone", "4", &["--policy", "external"]));
    let run = folder_to_attach_to(&mut child);
    let policy = attach(&run);
    mid_run(&bench.out("gone"));
    kill(child.id());
    child.wait().unwrap();
    let policy = Ended::of(policy).expect(2);
    assert!(policy.stderr.contains("ended without saying so"), "{}", policy.stderr);
    bench.run(&["clean"]).expect(0);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// The instruction of a case.
fn instruction(case: &str) -> String {
    let (warehouse, cases) = (warehouse::Warehouse::shipped(), warehouse::CaseSet::shipped());
    let case = cases.cases.iter().find(|other| other.id == case).unwrap();
    case.task.instruction(&warehouse.catalogue)
}

/// Walks six short episodes, and returns the keys of those that were not finished.
fn walk_with_a_victim(bench: &Bench, fault: &str, out: &str) -> (Ended, Vec<String>) {
    let cases = "t01-01,t02-02,t03-02,t05-03,t07-04,t09-05";
    let command = format!(
        "{} {fault} '{}'",
        program("misbehaving-policy").display(),
        instruction("t03-02").replace('\'', r"'\''")
    );
    let mut args = vec!["run", "--suite", "quick", "--cases", cases, "--memory", "working"];
    args.extend(["--starts", "original", "--max-steps", "20", "--step-timeout", "2"]);
    args.extend(["--lanes", "6", "--out", out, "--policy-cmd", &command]);
    let ended = bench.run(&args);
    let errors = std::fs::read_to_string(bench.out(out).join("errors.jsonl")).unwrap_or_default();
    (ended, errors.lines().map(str::to_owned).collect())
}

#[test]
fn a_policy_that_cannot_stand_one_episode_loses_that_one_only() {
    let bench = Bench::new();
    for (fault, said) in
        [("crash-on", "I cannot stand this one"), ("silent-on", "owed an answer for 2 s")]
    {
        let (ended, errors) = walk_with_a_victim(&bench, fault, fault);
        let ended = ended.expect(1);
        let [error] = &errors[..] else { panic!("{fault}: {errors:?}\n{}", ended.stderr) };
        assert!(error.contains("t03-02") && error.contains(said), "{error}");
        let finished = sorted_log(&bench.out(fault));
        assert_eq!(finished.len(), 5, "{fault}: {}", ended.stderr);
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
