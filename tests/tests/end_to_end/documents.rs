//! Documents built by the whole program and supplied in a run.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::Path;

use domain::{Demonstrations, Pose};
use memtransfer_tests::{Bench, Ended, eventually};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use warehouse::{CaseSet, Warehouse};

use crate::real_server::stored;

/// The document whose file name is `name` and an address.
fn document(folder: &Path, name: &str) -> (Value, String) {
    let json = fs::read_to_string(stored(folder, name).unwrap()).unwrap();
    let value: Value = serde_json::from_str(&json).unwrap();
    (value["provenance"].clone(), value["text"].as_str().unwrap().to_owned())
}

/// The states that a summary tells, in sentences.
fn told(summary: &str) -> BTreeSet<String> {
    let states = summary.lines().filter_map(|line| line.split_once(": You are in "));
    states.map(|(_, state)| format!("You are in {state}")).collect()
}

/// The instructions of the demonstrations of `selection`, and the states in which each begins and completes sub-goals, in
/// sentences.
fn demonstrated(selection: Demonstrations) -> (BTreeSet<String>, BTreeSet<String>) {
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
    let (mut instructions, mut states) = (BTreeSet::new(), BTreeSet::new());
    for history in (0..cases.cases.len()).flat_map(|case| cases.histories(case, selection)) {
        let of = cases.demonstrated(&warehouse, history).unwrap();
        instructions.insert(of.instruction());
        let replay = of.replay();
        for step in [0].iter().chain(&replay.goal_steps) {
            let Pose { cell, heading } = replay.poses[*step as usize];
            let (x, y, heading) = (cell.x, cell.y, heading.word());
            states.insert(format!("You are in column {x}, row {y}, and face {heading}."));
        }
    }
    (instructions, states)
}

#[test]
fn documents_contain_what_their_demonstrations_contain_and_nothing_else() {
    let bench = Bench::new();
    let build =
        ["memory", "build", "--demos", "original,4", "--plates", "on", "--out", "documents"];
    let built = bench.run(&build).expect(0);
    assert!(built.stderr.contains("4 built, 0 current"), "{}", built.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
    let folder = bench.out("documents");

    for selection in [Demonstrations::ORIGINAL, Demonstrations::ALL] {
        let (provenance, summary) = document(&folder, &format!("summary-{selection}"));
        assert_eq!(provenance["trajectories"].as_u64(), Some(100 * selection.own().count() as u64));
        let (instructions, states) = demonstrated(selection);
        assert_eq!(told(&summary), states);
        let named =
            summary.lines().filter_map(|line| line.strip_prefix("## \"")?.strip_suffix('"'));
        assert_eq!(named.map(str::to_owned).collect::<BTreeSet<_>>(), instructions);

        let (_, semantic) = document(&folder, &format!("semantic-{selection}"));
        assert_eq!(told(&semantic), BTreeSet::new());
        assert!(!instructions.iter().any(|of| semantic.contains(of)), "{semantic}");
        assert!(!summary.contains("plate") && !semantic.contains("plate"));
    }

    let again = bench.run(&build).expect(0);
    assert!(again.stderr.contains("0 built, 4 current"), "{}", again.stderr);
    // They are current for frames that look like theirs.
    let list = ["memory", "ls", "--documents", "documents", "--json"];
    for (plates, state) in [("on", "current"), ("off", "outdated")] {
        let listed = bench.run(&[&list[..], &["--plates", plates]].concat()).expect(0);
        let listed: Vec<Value> = serde_json::from_str(&listed.stdout).unwrap();
        assert!(listed.len() == 4 && listed.iter().all(|document| document["state"] == state));
    }
    let show = ["memory", "show", "summary", "4", "--documents", "documents", "--plates", "on"];
    assert_eq!(bench.run(&show).expect(0).stdout, document(&folder, "summary-4").1);

    supplied_in_a_run(&bench, &folder);
}

/// A signal while a run builds its documents is answered with what was kept and how to go on.
#[test]
fn a_run_that_is_stopped_while_it_builds_documents_says_so() {
    let bench = Bench::new();
    let (cache, messages) = (bench.out("cache"), bench.out("messages"));
    // Another build has the folder, so that this one cannot be over before the signal.
    fs::create_dir_all(cache.join("documents")).unwrap();
    let lock = File::create(cache.join("documents/lock")).unwrap();
    lock.lock().unwrap();
    let mut command = bench.command(&["run", "--policy", "random", "--memory", "summary"]);
    command.args(["--limit", "1"]).env("MEMTRANSFER_CACHE", &cache);
    let child = command.stderr(File::create(&messages).unwrap()).spawn().unwrap();
    let read = || fs::read_to_string(&messages).unwrap();
    eventually("the build to begin", || read().contains("another build").then_some(()));
    let pid = Pid::from_child(&child);
    kill_process(pid, Signal::TERM).unwrap();
    Ended::of(child).expect(128 + 15);
    let messages = read();
    for said in ["stopped by SIGTERM while documents were being built", "--memory summary"] {
        assert!(messages.contains(said), "{messages}");
    }
    assert!(!messages.contains("documents: done"), "{messages}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// A run reads the documents, copies them, records which they were, and resumes with its own copies.
fn supplied_in_a_run(bench: &Bench, folder: &Path) {
    let mut args = vec!["run", "--policy", "random", "--memory", "hybrid", "--demos", "original"];
    args.extend(["--starts", "new", "--limit", "1", "--max-steps", "5", "--out", "out"]);
    args.extend(["--documents", "./documents", "--plates", "on"]);
    bench.run(&args).expect(0);
    let read = |name: &str| {
        let text = fs::read_to_string(bench.out("out").join(name)).unwrap();
        serde_json::from_str::<Value>(&text).unwrap()
    };
    let manifest = read("manifest.json");
    for kind in ["summary", "semantic"] {
        let (provenance, text) = document(folder, &format!("{kind}-original"));
        let facts = &manifest["documents"][&format!("{kind}/original")];
        assert_eq!(facts["sha256"], provenance["text_sha256"]);
        assert_eq!(
            (&facts["builder"], facts["bytes"].as_u64()),
            (&Value::from("extractive"), Some(text.len() as u64),)
        );
        assert_eq!(read(&format!("documents/{kind}-original.json"))["text"], text);
    }
    // What the run was supplied with is its own; a document that was changed there is not supplied.
    fs::remove_dir_all(folder).unwrap();
    bench.run(&args).expect(0);
    // A dry run of the finished run has the same settings and documents.
    let dry = bench.run(&[&args[..], &["--dry-run"]].concat()).expect(0);
    assert!(dry.stdout.contains("\n0 of 1 episodes"), "{}", dry.stdout);
    let late = bench.run(&[&args[..], &["--log-prompts"]].concat()).expect(0);
    assert!(late.stderr.contains("nothing is logged, because all 1 episodes"), "{}", late.stderr);
    let own = bench.out("out").join("documents/summary-original.json");
    let changed = fs::read_to_string(&own).unwrap().replacen("Summary of", "Summery of", 1);
    fs::write(&own, changed).unwrap();
    let refused = bench.run(&args).expect(2);
    assert!(refused.stderr.contains("memtransfer memory build"), "{}", refused.stderr);
}
