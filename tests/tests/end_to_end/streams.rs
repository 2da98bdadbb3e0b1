//! Streams through the real processes: a memory persists over the episodes of its sequence, and no crash changes the log.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use memtransfer_tests::example_memories::{example, process_of_example, run, start};
use memtransfer_tests::{Bench, Ended, kill, process_of, records, sorted_log, wait_for_episodes};

/// One stream of two blocks, with a memory that learns and one that does not.
const SUITE: &str = r#"
memory = ["working", "episodic", "adaptive"]
arms = ["frozen", "learning", "oracle", "wrong"]
starts = ["new"]
max-steps = 24

[stream]
streams = 1
blocks = 2
cases-per-block = 2
events = ["swap"]
rounds = 2
orders = ["drawn", "reversed"]
feedback = "success"
"#;

/// Eight conditions, two orders, 4 learning episodes in two rounds and three times 4 evaluations.
const EPISODES: usize = 8 * 2 * (2 * 4 + 3 * 4);

/// [`SUITE`] in one order of its episodes.
fn one_order() -> String {
    SUITE.replace(r#", "reversed""#, "")
}

fn bench(suite: &str) -> Bench {
    let bench = Bench::new();
    fs::write(bench.out("suite.toml"), suite).unwrap();
    bench
}

fn arguments<'a>(out: &'a str, lanes: &'a str) -> Vec<&'a str> {
    vec!["run", "--suite", "./suite.toml", "--policy", "grounded", "--lanes", lanes, "--out", out]
}

#[test]
fn the_log_of_streams_depends_neither_on_lanes_nor_on_crashes() {
    let bench = bench(&one_order());
    bench.run(&arguments("one", "1")).expect(0);
    let reference = sorted_log(&bench.out("one"));
    assert_eq!(reference.len(), EPISODES / 2);
    bench.run(&arguments("wide", "16")).expect(0);
    assert_eq!(sorted_log(&bench.out("wide")), reference, "1 lane or 16");

    let child = bench.start(&arguments("parts-killed", "4"));
    for (role, after) in [("sim", 20), ("memory", 45), ("policy", 75)] {
        wait_for_episodes(&bench.out("parts-killed"), after);
        kill(process_of(bench.registry.path(), role));
    }
    Ended::of(child).expect(0);
    assert_eq!(sorted_log(&bench.out("parts-killed")), reference, "its processes killed in turn");
    let child = bench.start(&arguments("killed", "4"));
    wait_for_episodes(&bench.out("killed"), 60);
    bench.kill_run(child);
    bench.run(&arguments("killed", "4")).expect(0);
    assert_eq!(sorted_log(&bench.out("killed")), reference, "orchestrator killed");
}

#[test]
fn episodes_of_a_sequence_run_in_order_and_only_those_that_learn_have_snapshots() {
    let bench = bench(SUITE);
    bench.run(&arguments("run", "16")).expect(0);
    let mut last: BTreeMap<String, i64> = BTreeMap::new();
    let mut snapshots = BTreeSet::new();
    for record in records(&bench.out("run")) {
        let (place, _case) = record["key"].as_str().unwrap().rsplit_once('/').unwrap();
        let (sequence, _position) = place.rsplit_once('-').unwrap();
        let stream = &record["stream"];
        let position = stream["position"].as_i64().unwrap();
        let before = last.insert(sequence.to_owned(), position);
        assert_eq!(before.unwrap_or(-1), position - 1, "{sequence}");
        let learns = record["arm"] == "learning" && stream["round"].is_u64();
        assert_eq!(stream["snapshot"].is_string(), learns, "{record}");
        snapshots.extend(stream["snapshot"].as_str().map(str::to_owned));
    }
    assert_eq!(last.len(), 16);
    assert!(snapshots.len() > 1, "the memory changes");
    // A snapshot that is gone ends its sequence, and nothing else.
    let log = bench.out("run").join("episodes.jsonl");
    let text = fs::read_to_string(&log).unwrap();
    let is_late = |line: &&str| line.contains("/learning/run1/s0-drawn-019/");
    let kept: String =
        text.lines().filter(|line| !is_late(line)).map(|line| format!("{line}\n")).collect();
    fs::write(&log, kept).unwrap();
    fs::remove_dir_all(bench.out("run").join("snapshots")).unwrap();
    // The reason is shown, and that the same command alone does not help, as often as it is given.
    let quiet = [&arguments("run", "16")[..], &["--quiet"]].concat();
    for _ in 0..2 {
        let ended = bench.run(&quiet).expect(1);
        let said = "cannot go on, however often the run is continued. To run the sequence again";
        assert_eq!(ended.stderr.matches(said).count(), 2, "{}", ended.stderr);
        assert!(ended.stderr.contains("1 episode: "), "{}", ended.stderr);
        assert!(!ended.stderr.contains("To run them again"), "{}", ended.stderr);
        assert!(ended.stderr.contains("Do first what is said above"), "{}", ended.stderr);
    }
    let ended = bench.run(&arguments("run", "16")).expect(1);
    assert!(ended.stderr.contains("snapshot"), "{}", ended.stderr);
    assert_eq!(sorted_log(&bench.out("run")).len(), EPISODES - 1);
}

#[test]
fn a_memory_in_python_learns_and_no_crash_changes_the_log() {
    // For the control of external memories, in short episodes.
    let suite = one_order().replace(r#", "episodic", "adaptive""#, "").replace("= 24", "= 12");
    let bench = bench(&suite);
    let memories = [example("learning"), example("top-k")];
    run(&bench, &arguments("one", "1"), &memories).expect(0);
    let reference = sorted_log(&bench.out("one"));
    let mut conditions: BTreeMap<String, usize> = BTreeMap::new();
    let mut snapshots = BTreeSet::new();
    for record in records(&bench.out("one")) {
        let key = record["key"].as_str().unwrap();
        let (condition, _) = key.split_once("/run1").unwrap();
        *conditions.entry(condition.replace("/new/unchanged", "")).or_default() += 1;
        snapshots.extend(record["stream"]["snapshot"].as_str().map(str::to_owned));
    }
    // Of the two, only one learns.
    let arms = ["learning", "top-k"]
        .map(|memory| ["", "/oracle", "/wrong"].map(|arm| (format!("{memory}/original{arm}"), 20)));
    let others = [("learning/original/learning".to_owned(), 20), ("working/none".to_owned(), 20)];
    assert_eq!(conditions, arms.into_iter().flatten().chain(others).collect());
    assert!(snapshots.len() > 1, "the memory changes");

    let child = start(&bench, &arguments("parts-killed", "4"), &memories);
    wait_for_episodes(&bench.out("parts-killed"), 30);
    kill(process_of(bench.registry.path(), "memory"));
    wait_for_episodes(&bench.out("parts-killed"), 60);
    kill(process_of_example(&bench, "learning"));
    Ended::of(child).expect(0);
    assert_eq!(sorted_log(&bench.out("parts-killed")), reference, "its memories killed in turn");
    let child = start(&bench, &arguments("killed", "4"), &memories);
    wait_for_episodes(&bench.out("killed"), 60);
    bench.kill_run(child);
    run(&bench, &arguments("killed", "8"), &memories).expect(0);
    assert_eq!(sorted_log(&bench.out("killed")), reference, "orchestrator killed");
}
