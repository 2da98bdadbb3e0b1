//! Demonstrations in another warehouse, through the real processes.

use std::fs;

use memtransfer_tests::{
    Bench, Ended, episodes, kill, process_of, records, sorted_log, wait_for_episodes, words,
};
use serde_json::Value;

/// Two cases with every built-in memory.
const SLICE: &str = "run --suite transfer --policy grounded --runs 1 --cases t01-01,t09-05 --max-steps 30 \
    --demos original,elsewhere --memory working,full-context,summary,semantic,hybrid,episodic,adaptive";

/// Two cases under thirteen conditions.
const EPISODES: usize = 2 * 13;

fn run(bench: &Bench, more: &[&str]) -> Ended {
    bench.run(&[&words(SLICE)[..], more].concat())
}

#[test]
fn tasks_demonstrated_elsewhere_are_tested_here_and_nothing_changes_the_log() {
    let bench = Bench::new();
    run(&bench, &["--lanes", "1", "--out", "one"]).expect(0);
    let reference = sorted_log(&bench.out("one"));
    assert_eq!(reference.len(), EPISODES);
    run(&bench, &["--lanes", "16", "--out", "wide"]).expect(0);
    assert_eq!(sorted_log(&bench.out("wide")), reference, "1 lane or 16");
    let child = bench.start(&[&words(SLICE)[..], &["--lanes", "4", "--out", "killed"]].concat());
    for (role, after) in [("sim", 2), ("memory", 8)] {
        wait_for_episodes(&bench.out("killed"), after);
        kill(process_of(bench.registry.path(), role));
    }
    Ended::of(child).expect(0);
    assert_eq!(sorted_log(&bench.out("killed")), reference, "its processes killed in turn");

    // What was retrieved says where it is from.
    for record in records(&bench.out("one")) {
        let Some(retrieved) = record["retrieved"].as_str() else { continue };
        let is_elsewhere = record["demonstrations"] == "elsewhere";
        let mut words = retrieved.split_whitespace().peekable();
        assert!(words.peek().is_some(), "{record}");
        assert!(words.all(|word| word.starts_with('w') == is_elsewhere), "{record}");
    }
    let manifest = fs::read_to_string(bench.out("one/manifest.json")).unwrap();
    let manifest: Value = serde_json::from_str(&manifest).unwrap();
    assert!(manifest["hashes"]["elsewhere"].is_string(), "{manifest}");
    bench.run(&["report", "one"]).expect(0);
    let page = fs::read_to_string(bench.out("one/report/report.html")).unwrap();
    assert!(page.contains("Demonstrations in another warehouse"), "{page}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_run_grows_by_another_warehouse_and_keeps_to_it() {
    let bench = Bench::new();
    let expand = |demos, more: &[&str]| {
        let mut args = vec!["run", "--policy", "grounded", "--cases", "t01-01", "--starts", "new"];
        args.extend(["--memory", "working,semantic,episodic", "--demos", demos]);
        args.extend(["--max-steps", "40", "--out", "run"]);
        bench.run(&[&args[..], more].concat())
    };
    expand("original", &[]).expect(0);
    assert!(!bench.out("run/elsewhere.json").exists());
    let before = episodes(&bench.out("run"));
    expand("original,elsewhere", &[]).expect(0);
    assert!(episodes(&bench.out("run")).starts_with(&before));
    assert_eq!(records(&bench.out("run")).len(), 5);

    // The documents of both warehouses lie side by side, and differ.
    let text = |name: &str| {
        let file = fs::read_to_string(bench.out("run/documents").join(name)).unwrap();
        let document: Value = serde_json::from_str(&file).unwrap();
        document["text"].as_str().unwrap().to_owned()
    };
    assert_ne!(text("semantic-original.json"), text("semantic-elsewhere.json"));

    let generate = ["generate", "world", "--seed", "5", "--size", "16x30", "--out", "other"];
    bench.run(&generate).expect(0);
    let refused = expand("original,elsewhere", &["--elsewhere", "other"]).expect(2);
    assert!(refused.stderr.contains("contents of elsewhere"), "{}", refused.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
