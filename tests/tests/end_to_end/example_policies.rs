//! The example policies in Python that follow memory: with the package, and on plain iceoryx2.

use memtransfer_tests::{Bench, Ended, needs, records, repository, success_rate};

/// Runs ten cases of the quick suite with the script as the policy; it finds the package in `package`.
fn run_script(bench: &Bench, script: &str, package: &str) -> Vec<serde_json::Value> {
    let policy = format!("{} {}", needs::python().display(), repository(script).display());
    let mut command = bench.command(&["run", "--suite", "quick", "--limit", "10", "--out", "out"]);
    command
        .args(["--memory", "working,full-context,episodic", "--policy-cmd", &policy])
        .env("PYTHONPATH", package);
    Ended::run(&mut command).expect(0);
    let records = records(&bench.out("out"));
    assert_eq!(records.len(), 60);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
    records
}

/// A policy that follows the retrieved segment succeeds from the original start, and fails most episodes
/// without one.
fn assert_follows_segments(records: &[serde_json::Value]) {
    let rate = |memory: &str, start: &str| {
        success_rate(records, |record| record["memory"] == memory && record["start"] == start)
    };
    assert!(rate("episodic", "original") > 90.0, "{records:?}");
    assert!(rate("working", "original") < 50.0, "{records:?}");
    assert!(rate("episodic", "new") > 0.0, "{records:?}");
}

#[test]
fn the_policy_that_follows_memory_succeeds_with_episodic_memory() {
    let bench = Bench::new();
    let package = repository("python");
    let package = package.to_str().unwrap();
    let records = run_script(&bench, "python/examples/follow_memory.py", package);
    assert_follows_segments(&records);
}

#[test]
fn a_policy_on_plain_iceoryx2_takes_part_in_a_run() {
    let bench = Bench::new();
    let records = run_script(&bench, "examples/wire-policy/wire_policy.py", "");
    assert_follows_segments(&records);
    let uses_one_image = |record: &serde_json::Value| record["images"] == record["requests"];
    assert!(records.iter().all(uses_one_image), "{records:?}");
}
