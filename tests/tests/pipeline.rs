//! The whole program: four processes, real frames, the real encoder.

use std::fs;
use std::path::Path;

use memtransfer_tests::{
    Bench, Ended, episodes, eventually, kill, process_of, processes_of, records, shared_memory_of,
    sorted_log, success_rate,
};
use serde_json::Value;

/// Cases of three task types that differ: single, exhaustive, revisit.
const FEW_CASES: &str = "t01-01,t03-02,t09-05";

/// `memtransfer run` over a few cases, all memories and both starts.
fn slice<'a>(out: &'a str, lanes: &'a str) -> Vec<&'a str> {
    let mut args = vec!["run", "--suite", "quick", "--policy", "grounded", "--cases", FEW_CASES];
    args.extend(["--lanes", lanes, "--out", out]);
    args
}

/// The log that every way of running the slice must give.
fn reference(bench: &Bench) -> Vec<String> {
    bench.run(&slice("reference", "1")).expect(0);
    let log = sorted_log(&bench.out("reference"));
    assert_eq!(log.len(), 36);
    log
}

#[test]
fn the_log_depends_neither_on_lanes_nor_on_crashes() {
    let bench = Bench::new();
    let reference = reference(&bench);
    bench.run(&slice("wide", "32")).expect(0);
    assert_eq!(sorted_log(&bench.out("wide")), reference, "1 lane and 32");

    for role in ["sim", "memory", "policy"] {
        let out = format!("{role}-killed");
        let child = bench.start(&slice(&out, "4"));
        mid_run(&bench.out(&out));
        kill(process_of(bench.registry.path(), role));
        let ended = Ended::of(child).expect(0);
        assert!(ended.stderr.contains(&format!("the {role} process")), "{}", ended.stderr);
        assert_eq!(sorted_log(&bench.out(&out)), reference, "{role} killed");
    }

    let child = bench.start(&slice("killed", "4"));
    mid_run(&bench.out("killed"));
    kill(child.id());
    Ended::of(child);
    eventually("the orphans to end", || {
        processes_of(bench.registry.path()).is_empty().then_some(())
    });
    let dead = bench.runs();
    assert!(!shared_memory_of(&dead).is_empty(), "kill -9 leaves shared memory behind");
    let before = episodes(&bench.out("killed"));
    assert!(sorted_log(&bench.out("killed")).len() < reference.len(), "killed in the middle");
    bench.run(&slice("killed", "4")).expect(0);
    assert_eq!(sorted_log(&bench.out("killed")), reference, "orchestrator killed");
    let whole_lines = &before[..before.rfind('\n').map_or(0, |end| end + 1)];
    let after = episodes(&bench.out("killed"));
    assert!(after.starts_with(whole_lines), "finished episodes were kept and not run twice");

    bench.run(&["clean"]).expect(0);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
    assert_eq!(shared_memory_of(&dead), Vec::<String>::new());
}

/// Waits until some of the slice is in the log, and not all.
fn mid_run(run: &Path) {
    eventually("an episode to be finished", || (episodes(run).lines().count() >= 2).then_some(()));
}

#[test]
fn the_expert_is_perfect_and_the_random_policy_is_not() {
    let bench = Bench::new();
    let all = ["--limit", "100", "--starts", "original,new", "--routes", "unchanged,blocked"];
    let expert = [&["run", "--policy", "expert", "--out", "expert"][..], &all[..]].concat();
    bench.run(&expert).expect(0);
    let walked = records(&bench.out("expert"));
    assert_eq!(walked.len(), 300);
    assert_eq!(success_rate(&walked, |_| true), 100.0);
    assert!(walked.iter().all(|r| r["steps"] == r["reference"]), "SPL of 1 for every episode");

    let random = [&["run", "--policy", "random", "--out", "random"][..], &all[..]].concat();
    bench.run(&random).expect(0);
    let walked = records(&bench.out("random"));
    assert_eq!(walked.len(), 300);
    assert!(success_rate(&walked, |_| true) < 15.0);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn views_are_rendered_with_the_requested_backend() {
    let bench = Bench::new();
    let run = |out, backend: &[&str]| {
        let few = ["run", "--policy", "random", "--limit", "1", "--out", out];
        bench.run(&[&few[..], backend].concat())
    };
    run("cpu", &["--backend", "cpu"]).expect(0);
    let manifest = fs::read(bench.out("cpu").join("manifest.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    assert_eq!(manifest["processes"]["sim"]["backend"], "cpu");
    let Ended { stderr, .. } = run("abacus", &["--adapter", "abacus"]).expect(2);
    assert!(stderr.contains("contains \"abacus\"; there are: "), "{stderr}");
    assert!(stderr.contains("--backend cpu renders without one"), "{stderr}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn success_comes_from_pixels() {
    let bench = Bench::new();
    // Every fifth case: two of each task type.
    let cases: Vec<String> =
        (1..=10).flat_map(|task| [2, 7].map(|n| format!("t{task:02}-{n:02}"))).collect();
    let cases = cases.join(",");
    let rate = |frames: &str, memory: &str| {
        let out = format!("{frames}-{memory}");
        let mut args = vec!["run", "--policy", "grounded", "--starts", "original"];
        args.extend(["--memory", memory, "--frames", frames, "--cases", &cases, "--out", &out]);
        bench.run(&args).expect(0);
        success_rate(&records(&bench.out(&out)), |_| true)
    };
    let seen = rate("rendered", "episodic");
    assert!(seen >= 95.0, "episodic memory at the original start: {seen} %");
    let without_memory = rate("rendered", "working");
    assert!(without_memory <= seen - 30.0, "working memory: {without_memory} % of {seen} %");
    for control in ["blank", "swapped"] {
        let unseen = rate(control, "episodic");
        assert!(unseen <= 30.0, "{control} frames: {unseen} %");
    }
}

/// Bytes that the process has moved through system calls, read and written; `None` once it is gone.
fn moved_by_system_calls(pid: u32) -> Option<u64> {
    let text = fs::read_to_string(format!("/proc/{pid}/io")).ok()?;
    let value =
        |key| text.lines().find_map(|line| line.strip_prefix(key)?.trim().parse::<u64>().ok());
    Some(value("rchar:")? + value("wchar:")?)
}

/// Pixels can cross a process boundary in three ways: in shared memory that both map, in a message, or
/// through a system call. A message has no room for them. So the bytes moved by system calls are counted
/// while frames are rendered, embedded and looked at, and everybody's own account of copies is read.
#[test]
fn no_pixel_crosses_a_process_boundary_by_copy() {
    let bench = Bench::new();
    let run = bench.out("copies");
    let mut args = vec!["run", "--policy", "grounded", "--starts", "new", "--memory", "episodic"];
    args.extend(["--limit", "20", "--out", "copies"]);
    let mut child = bench.start(&args);
    let roles = ["sim", "memory", "policy"];
    // Models are read before the first episode ends; what counts is what moves from there on.
    eventually("the first episode", || (!episodes(&run).is_empty()).then_some(()));
    let pids = roles.map(|role| process_of(bench.registry.path(), role));
    let before = pids.map(|pid| moved_by_system_calls(pid).unwrap());
    let mut after = before;
    while child.try_wait().unwrap().is_none() {
        for (moved, pid) in after.iter_mut().zip(pids) {
            *moved = moved_by_system_calls(pid).unwrap_or(*moved);
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    Ended::of(child).expect(0);

    let sessions = fs::read_to_string(run.join("sessions.jsonl")).unwrap();
    let ended: Value = sessions
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap())
        .find(|event| event["event"] == "ended")
        .unwrap();
    let told = |role: &str, key: &str| ended["farewells"][role][key].as_u64().unwrap();
    let frames = told("sim", "frames_rendered");
    assert!(frames > 100, "{frames} frames");
    for role in ["memory", "policy"] {
        assert_eq!(told(role, "frames_received"), frames, "every frame reached {role}");
        assert_eq!(told(role, "pixel_bytes_copied"), 0, "{role}");
    }
    let all_pixels = frames * 448 * 448 * 4;
    for ((role, before), after) in roles.into_iter().zip(before).zip(after) {
        let moved = after - before;
        assert!(
            moved < all_pixels / 20,
            "{role} moved {moved} bytes by system calls; the {frames} frames have {all_pixels}"
        );
    }
}
