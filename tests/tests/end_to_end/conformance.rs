//! `memtransfer conformance` passes for policies, memories and worlds that keep to the wire, and names the faults of others.

use std::collections::BTreeMap;
use std::process::Command;
use std::sync::Mutex;

use memtransfer_tests::{
    Bench, Ended, needs, program, records, repository, shutdown_total, sorted_log,
};
use serde_json::Value;

/// A check's verdict and what happened, by its name.
type Findings = BTreeMap<String, (String, String)>;

/// Seconds for an answer and for a start: more than any process takes on a slow machine.
const LONG: [&str; 2] = ["60", "120"];

/// Checks the command that `flag` starts, which is expected to end with `status`. Returns the checks.
fn checks(
    bench: &Bench,
    [flag, command]: [&str; 2],
    [step, start]: [&str; 2],
    status: i32,
) -> Vec<Value> {
    let limits = ["--step-timeout", step, "--start-timeout", start];
    let args = [&["conformance", flag, command, "--json"], &limits[..]].concat();
    let report: Value = serde_json::from_str(&bench.run(&args).expect(status).stdout).unwrap();
    assert_eq!(report["conforms"], status == 0);
    report["checks"].as_array().unwrap().clone()
}

fn findings(checks: &[Value]) -> Findings {
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let finding = |c: &Value| (text(&c["name"]), (text(&c["verdict"]), text(&c["happened"])));
    checks.iter().map(finding).collect()
}

fn check_conforms(bench: &Bench, command: [&str; 2]) -> Vec<Value> {
    let checks = checks(bench, command, LONG, 0);
    let mut others = findings(&checks);
    others.retain(|_, (verdict, _)| verdict != "passed");
    assert_eq!(others, Findings::new(), "{command:?}");
    checks
}

/// The command of a test process with one fault.
fn misbehaving(role: &str, fault: &str) -> String {
    format!("{} {fault}", program(&format!("misbehaving-{role}")).display())
}

/// Asserts that `docs/conformance.md` lists just these checks under `heading`.
fn assert_documented(heading: &str, checks: &[Value]) {
    let page = std::fs::read_to_string(repository("docs/conformance.md")).unwrap();
    let (_, section) = page.split_once(&format!("\n## {heading}\n")).unwrap();
    let section = section.split("\n## ").next().unwrap();
    let text = |check: &Value, field: &str| check[field].as_str().unwrap().to_owned();
    let row = |check| format!("| {} | {} |\n", text(check, "name"), text(check, "expected"));
    let rows: String = checks.iter().map(row).collect();
    let count = format!("{} checks", checks.len());
    assert!(section.contains(&count) && section.contains(&rows), "expected: {count}\n{rows}");
}

#[test]
fn the_built_in_policies_conform() {
    let bench = Bench::new();
    for policy in ["random", "grounded"] {
        let program = program("policy-proc");
        let command = format!("{} serve --policy {policy}", program.display());
        assert_documented("Policies", &check_conforms(&bench, ["--policy-cmd", &command]));
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn faults_of_a_policy_are_named() {
    let bench = Bench::new();
    let faults = [
        ("no-handshake", "joins", "no handshake within 3 s"),
        ("old", "joins", "its handshake has wire version"),
        ("silent", "answers a step", "no answer to step 0 of lane 0 within 2 s"),
        ("wrong-lane", "answers a step", "without a request: the lane has no such episode"),
        ("no-such-lane", "answers a step", "a decision for lane 4242, but the lanes are 0 to 63"),
        ("wrong-step", "answers a step", "without a request: its last request is step 0"),
        ("garbage", "answers a step", "is invalid: 77 is not an outcome"),
        ("twice", "answers a step", "a second decision for step 0 of lane 0"),
        ("flood", "answers a step", "a second decision for step 0 of lane 0"),
        ("decides-the-end", "runs an episode", "which could not be decided"),
        ("miscounts", "counts correctly", "`images` is 4294967294 for a request with 4 images"),
        ("crash", "answers 64 lanes at once", "I am no good at this"),
        ("takes-the-late", "ignores late messages", "which could not be decided"),
        ("decides-early", "waits for slow messages", "which could not be decided"),
        ("knows-no-captions", "takes items of every kind", "I know no captions"),
        ("keeps-frames", "releases frames", "it still keeps most of the"),
        (
            "draws",
            "survives invalid messages",
            "after a feedback code of 77: a decision for step 0 of lane 20",
        ),
        ("ignores-stop", "stops", "after 2 s it has neither sent a shutdown report nor ended"),
        ("no-shutdown-report", "stops", "it ended without a shutdown report"),
        ("outlives", "ends with the orchestrator", "it still runs after 2 s"),
        ("ignores-the-wire-version", "refuses another wire version", "it still runs"),
    ];
    check_faults(&bench, "policy", &faults);
    let crash = misbehaving("policy", "crash");
    let checks = checks(&bench, ["--policy-cmd", &crash], LONG, 1);
    let printed = |check: &Value| Some(check["printed"].as_str()?.contains("I am no good at this"));
    assert!(checks.iter().any(|check| printed(check) == Some(true)), "{checks:?}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn faults_of_a_memory_are_named() {
    let bench = Bench::new();
    let faults = [
        ("undescribed", "describes itself", "no description.json in its folder within 3 s"),
        ("nameless", "describes itself", "name is \"My Memory\", but must be"),
        ("hasty", "describes itself", "it did not wait for the run"),
        ("no-handshake", "joins", "no handshake within 3 s"),
        ("old", "joins", "its handshake has wire version"),
        ("wrong-index", "joins", "`index` 4, and its folder is that of index 3"),
        ("builds-nothing", "builds itself", "1 banks were not built within 3 s"),
        ("builds-another", "builds itself", "it has built bank 2, which does not wait"),
        ("cannot-build", "builds itself", "it cannot build itself from a bank: I have no idea"),
        ("silent", "answers a query", "no answer to step 0 of lane 0 within 2 s"),
        ("fails", "answers a query", "it failed at step 0 of lane 0: Zurück zum Tor."),
        ("wrong-lane", "answers a query", "without a request: the lane has no such episode"),
        ("no-such-lane", "answers a query", "an answer for lane 4242, but the lanes are 0 to 63"),
        ("wrong-step", "answers a query", "without a request: its last request is step 0"),
        ("wrong-note", "answers a query", "was not published, with the lane of the answer"),
        ("garbage", "answers a query", "has kind 77"),
        ("unknown-demonstration", "answers a query", "demonstration 77, and the bank has 3"),
        ("past-the-end", "answers a query", "names 1000 steps from step 0 of demonstration 0"),
        ("past-the-note", "answers a query", "of the note, which has 16"),
        ("not-utf-8", "answers a query", "has a text that is not UTF-8"),
        ("not-a-distance", "answers a query", "has the distance inf"),
        ("nine-items", "answers a query", "it has 11 items, and at most 8 are allowed"),
        ("twice", "answers a query", "a second answer for step 0 of lane 0"),
        ("flood", "answers a query", "a second answer for step 0 of lane 0"),
        ("answers-the-end", "runs an episode", "which could not be answered"),
        ("no-times", "tells its times", "`sent_ns` 0"),
        ("crash", "answers 64 lanes at once", "I am no good at this"),
        ("mixes-lanes", "keeps lanes apart", "answer for step"),
        ("one-bank", "stays within its bank", "demonstration 1, and the bank has 1"),
        ("keeps-old-episodes", "begins a new episode", "no answer to step 0 of lane 9"),
        ("answers-late", "ignores late queries", "which could not be answered"),
        ("small", "remembers 1,000 demonstrations", "too many demonstrations"),
        ("one-task", "remembers mixed histories", "demonstrations of two tasks"),
        ("ascii", "reads any text", "I read ASCII only"),
        ("keeps-frames", "releases frames", "it still keeps most of the"),
        ("keeps-banks", "releases banks", ""),
        ("believes", "survives invalid messages", "after a feedback code of 77: an answer"),
        ("draws", "answers the same again", "it calls itself deterministic"),
        ("saves-nothing", "learns and saves", "it has not saved within 3 s"),
        ("saves-the-time", "loads what it has saved", "other bytes after it was loaded: learned"),
        ("loads-nothing", "loads what it has saved", "the same query differ after it was loaded"),
        ("learns-from-evaluations", "evaluates without learning", "it saves other bytes after an"),
        ("leaves-a-lock", "can be restarted", "I run already"),
        ("ignores-stop", "stops", "after 2 s it has neither sent a shutdown report nor ended"),
        ("no-shutdown-report", "stops", "it ended without a shutdown report"),
        ("outlives", "ends with the orchestrator", "it still runs after 2 s"),
        ("waits-forever", "ends if the run does not begin", "it still runs after 2 s"),
        ("ignores-the-wire-version", "refuses another wire version", "it still runs"),
    ];
    check_faults(&bench, "memory", &faults);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn faults_of_a_world_are_named() {
    let bench = Bench::new();
    let faults = [
        ("no-book", "writes its case book", "`book` ended with exit status: 1: I cannot write"),
        ("another-book", "writes its case book", "another case-book.json the second time"),
        ("no-new", "writes its case book", "case corridor-1 has no reference from its new start"),
        ("case-twice", "writes its case book", "it has case corridor-1 twice"),
        ("lacks-feedback", "writes its case book", "a demonstration has 10 states, 9 feedbacks"),
        ("no-handshake", "joins", "no handshake within 3 s"),
        ("begins-elsewhere", "begins as its case book says", "and the case book says 0"),
        ("draws", "begins the same again", "another state or picture in another lane"),
        ("other-hashes", "begins the same again", "in two lanes"),
        ("never-completes", "completes its references", "does not complete the task in 9 steps"),
        ("early", "completes its references", "in 8 steps, and the case book says 9"),
        ("resets", "begins anew only when asked", "which could not be executed"),
        ("silent", "begins anew only when asked", "no error report about a command after the end"),
        ("no-limit", "stops at the step limit", "`ended` is 0 and `last` 0"),
        ("walks-on", "stays without an action", "the state is another one"),
        ("still", "shows what changes", "9 frames are equal, and states are not"),
        ("transparent", "shows what changes", "it has pixels whose alpha is not 255"),
        ("never-blocks", "blocks the way", "case corridor-1: at its new start, neither"),
        ("other-views", "shows memory what lanes see", "memory gets another picture than a lane"),
        (
            "believes",
            "survives invalid messages",
            "after a command that leaves out a step: an observation",
        ),
        ("gives-up", "survives invalid messages", "it gave up the episode of lane 64"),
        ("acts-nothing", "acts out episodes", "`act` has answered 0 of"),
        ("acts-otherwise", "acts out episodes", "it begins elsewhere than in 0"),
        ("leaves-a-lock", "can be restarted", "I run already"),
        ("ignores-stop", "stops", "it still runs 2 s after its shutdown report"),
        ("outlives", "ends with the orchestrator", "it still runs after 2 s"),
        ("ignores-the-wire-version", "refuses another wire version", "it still runs"),
    ];
    check_faults(&bench, "world", &faults);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn worlds_without_faults_conform() {
    let bench = Bench::new();
    let command = misbehaving("world", "well-behaved");
    assert_documented("Worlds", &check_conforms(&bench, ["--world-cmd", &command]));
    check_conforms(&bench, ["--world-cmd", program("sim-proc").to_str().unwrap()]);
    // What a world does at random is not compared.
    let command = misbehaving("world", "random");
    let checks = checks(&bench, ["--world-cmd", &command], LONG, 0);
    let skipped = |check: &&Value| check["verdict"] == "skipped";
    let skipped: Vec<_> = checks.iter().filter(skipped).map(|check| &check["name"]).collect();
    assert_eq!(
        skipped,
        [
            "begins the same again",
            "completes its references",
            "blocks the way",
            "shows memory what lanes see",
            "acts out episodes"
        ]
    );
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn the_example_world_in_rust_conforms() {
    let bench = Bench::new();
    check_conforms(&bench, ["--world-cmd", &build_example("rust-world")]);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// A test of the pages that it was written from, too.
#[test]
fn the_example_world_on_plain_iceoryx2_conforms_and_its_log_is_true_and_depends_on_no_lanes() {
    let bench = Bench::new();
    let script = repository("examples/wire-world/wire_world.py");
    let world = format!("{} {}", needs::python().display(), script.display());
    check_conforms(&bench, ["--world-cmd", &world]);

    // Full-context memory names its views, and episodic memory matches them; a frame budget that evicts some.
    for [lanes, budget] in [["1", "11"], ["3", "1000"]] {
        let mut args = vec!["run", "--world-cmd", &world, "--policy", "imitate", "--lanes", lanes];
        args.extend(["--memory", "working,full-context,episodic,adaptive", "--max-steps", "20"]);
        args.extend(["--starts", "original,new", "--routes", "unchanged,blocked"]);
        args.extend(["--frame-size", "64", "--frame-budget", budget, "--window", "2"]);
        bench.run(&[&args[..], &["--out", lanes]].concat()).expect(0);
    }
    assert_eq!(sorted_log(&bench.out("1")), sorted_log(&bench.out("3")));
    assert!(shutdown_total(&bench.out("1"), "sim", "frames_evicted") > 0);
    let records = records(&bench.out("3"));
    assert_eq!(records.len(), 4 * 4 * 3);
    let is_demonstrated = |record: &&Value| {
        let place = (&record["start"], &record["route"]);
        record["memory"] == "episodic" && place == (&"original".into(), &"unchanged".into())
    };
    let demonstrated: Vec<&Value> = records.iter().filter(is_demonstrated).collect();
    assert_eq!(demonstrated.len(), 4);
    assert!(demonstrated.iter().all(|record| record["ending"] == "complete"), "{demonstrated:?}");

    let mut validate = bench.command(&["validate", "3"]);
    let valid = Ended::run(validate.env("MEMTRANSFER_WORLD_CMD", &world)).expect(0).stdout;
    assert_eq!(valid, "48 episodes, 0 differences, 0 damaged lines\n");
    let mut view = bench.command(&["view", "3", "--out", "pages"]);
    Ended::run(view.env("MEMTRANSFER_WORLD_CMD", &world)).expect(0);
    assert!(std::fs::read_dir(bench.out("pages/run1/views")).unwrap().count() > 8);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_memory_without_faults_conforms() {
    let bench = Bench::new();
    let command = misbehaving("memory", "well-behaved");
    assert_documented("Memories", &check_conforms(&bench, ["--memory-cmd", &command]));
    // A memory may leave it to the run to drop items.
    let command = misbehaving("memory", "ignores-budgets");
    let found = findings(&checks(&bench, ["--memory-cmd", &command], LONG, 0));
    let (verdict, what) = &found["heeds budgets"];
    assert!(verdict == "warning" && what.contains("a run would drop 1 of 1 items"), "{what}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// Checks processes with one fault each: the check that fails, and what happened.
fn check_faults(bench: &Bench, role: &str, faults: &[(&str, &str, &str)]) {
    let remaining = Mutex::new(faults.iter());
    let next = || remaining.lock().unwrap().next();
    std::thread::scope(|scope| {
        // They mostly wait.
        for _ in 0..8 {
            scope.spawn(|| {
                while let Some((fault, check, happened)) = next() {
                    check_fault(bench, role, fault, check, happened);
                }
            });
        }
    });
}

fn check_fault(bench: &Bench, role: &str, fault: &str, check: &str, happened: &str) {
    let (flag, command) = (format!("--{role}-cmd"), misbehaving(role, fault));
    let [step, start] = LONG;
    // Short ones only where the process is to exceed them.
    let waits = happened.contains("2 s") || happened.starts_with("no ");
    let step = if waits { "2" } else { step };
    let start = if happened.contains("3 s") { "3" } else { start };
    let findings = findings(&checks(bench, [&flag, &command], [step, start], 1));
    let (verdict, what) = &findings[check];
    assert!(verdict == "failed" && what.contains(happened), "{fault}: {check}: {verdict}: {what}");
    if (role, fault) == ("policy", "draws") {
        let (verdict, what) = &findings["decides the same again"];
        assert!(verdict == "warning" && what.contains("the same request"), "{verdict}: {what}");
    }
}

#[test]
fn a_command_that_cannot_be_started_is_an_error() {
    let bench = Bench::new();
    let ended = bench.run(&["conformance", "--policy-cmd", "./no-such-policy"]).expect(2);
    assert!(ended.stderr.contains("there is no program `./no-such-policy`"), "{}", ended.stderr);
}

/// Builds an example as its readers do, but into this workspace's target folder, with its lock file, so that nothing is
/// downloaded, and without optimisation, because it is a workspace of its own, whose dependencies are built again. Returns
/// its program.
fn build_example(name: &str) -> String {
    let example = repository("examples").join(name);
    std::fs::copy(repository("Cargo.lock"), example.join("Cargo.lock")).unwrap();
    let release = program("memtransfer").parent().unwrap().to_owned();
    let built = Command::new(env!("CARGO"))
        .args(["build", "--release", "--offline", "--config", "profile.release.opt-level=0"])
        .arg("--target-dir")
        .arg(release.parent().unwrap())
        .current_dir(&example)
        .output()
        .unwrap();
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    program(name).to_str().unwrap().to_owned()
}

#[test]
fn the_example_policy_in_rust_conforms_and_decides_in_a_run() {
    let bench = Bench::new();
    let policy = build_example("rust-policy");
    check_conforms(&bench, ["--policy-cmd", &policy]);

    let mut args = vec!["run", "--cases", "t01-01,t09-05", "--starts", "original"];
    args.extend(["--memory", "working,full-context", "--max-steps", "30", "--out", "own"]);
    args.extend(["--policy-cmd", &policy]);
    let ended = bench.run(&args).expect(0);
    assert!(ended.stdout.contains("Policy: external (wanderer)."), "{}", ended.stdout);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn the_example_memories_in_rust_and_on_plain_iceoryx2_conform_and_run_a_slice_of_rq1() {
    let bench = Bench::new();
    let script = repository("examples/wire-memory/wire_memory.py");
    let memories = [
        build_example("rust-memory"),
        format!("{} {}", needs::python().display(), script.display()),
    ];
    for memory in &memories {
        check_conforms(&bench, ["--memory-cmd", memory]);
    }
    let mut args = vec!["run", "--suite", "rq1", "--cases", "t01-01", "--runs", "1"];
    args.extend(["--memory", "working", "--out", "own"]);
    args.extend(memories.iter().flat_map(|memory| ["--memory-cmd", memory]));
    bench.run(&args).expect(0);
    let records = records(&bench.out("own"));
    for name in ["nearest", "wire-places"] {
        assert!(records.iter().any(|record| record["memory"] == name), "{name}: {records:?}");
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
