//! `memtransfer conformance` passes for policies that keep to the wire, and names the faults of others.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use memtransfer_tests::{Bench, program};
use serde_json::Value;

/// A check's verdict and what happened, by its name.
type Findings = BTreeMap<String, (String, String)>;

/// Checks `command`, which is expected to end with `status`.
fn conformance(bench: &Bench, command: &str, status: i32) -> Findings {
    let mut args = vec!["conformance", "--policy-cmd", command, "--json"];
    args.extend(["--step-timeout", "2", "--start-timeout", "3"]);
    let report: Value = serde_json::from_str(&bench.run(&args).expect(status).stdout).unwrap();
    assert_eq!(report["conforms"], status == 0);
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let checks = report["checks"].as_array().unwrap().iter();
    checks.map(|c| (text(&c["name"]), (text(&c["verdict"]), text(&c["happened"])))).collect()
}

fn check_conforms(bench: &Bench, command: &str) {
    let findings = conformance(bench, command, 0);
    let others: Findings = findings.into_iter().filter(|(_, (v, _))| v != "passed").collect();
    assert_eq!(others, Findings::new(), "{command}");
}

#[test]
fn the_built_in_policies_conform() {
    let bench = Bench::new();
    for policy in ["random", "grounded"] {
        let program = program("policy-proc");
        check_conforms(&bench, &format!("{} serve --policy {policy}", program.display()));
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
    // They mostly wait.
    for together in faults.chunks(4) {
        std::thread::scope(|scope| {
            for &(fault, check, happened) in together {
                let bench = &bench;
                scope.spawn(move || check_fault(bench, fault, check, happened));
            }
        });
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

fn check_fault(bench: &Bench, fault: &str, check: &str, happened: &str) {
    let command = format!("{} {fault}", program("misbehaving-policy").display());
    let findings = conformance(bench, &command, 1);
    let (verdict, what) = &findings[check];
    assert!(verdict == "failed" && what.contains(happened), "{fault}: {check}: {verdict}: {what}");
    if fault == "draws" {
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

/// Builds the example as its readers do, but into this workspace's target folder and with its lock file, so that shared
/// dependencies are neither built twice nor downloaded.
#[test]
fn the_example_in_rust_conforms_and_decides_in_a_run() {
    let bench = Bench::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let example = root.join("examples/rust-policy");
    std::fs::copy(root.join("Cargo.lock"), example.join("Cargo.lock")).unwrap();
    let release = program("memtransfer").parent().unwrap().to_owned();
    let built = Command::new(env!("CARGO"))
        .args(["build", "--release", "--offline", "--target-dir"])
        .arg(release.parent().unwrap())
        .env("CARGO_PROFILE_RELEASE_DEBUG", "line-tables-only")
        .env("CARGO_PROFILE_RELEASE_OVERFLOW_CHECKS", "true")
        .current_dir(&example)
        .output()
        .unwrap();
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let policy = program("rust-policy");
    check_conforms(&bench, policy.to_str().unwrap());

    let mut args = vec!["run", "--cases", "t01-01,t09-05", "--starts", "original"];
    args.extend(["--memory", "working,full-context", "--max-steps", "30", "--out", "own"]);
    args.extend(["--policy-cmd", policy.to_str().unwrap()]);
    let ended = bench.run(&args).expect(0);
    assert!(ended.stdout.contains("Policy: external wanderer, started with `"), "{}", ended.stdout);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
