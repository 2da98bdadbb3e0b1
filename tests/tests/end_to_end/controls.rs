//! Control arms outside of streams through the real processes.

use std::collections::BTreeMap;
use std::fs;

use memtransfer_tests::{
    Bench, kill, process_of, program, records, sorted_log, success_rate, wait_for_episodes, words,
};
use serde_json::Value;

/// Two cases with a memory of each kind, on both routes.
const SLICE: &str = "run --policy grounded --cases t01-01,t05-05 --max-steps 90 --starts new \
    --routes unchanged,blocked --demos original,4 --memory working,full-context,summary,episodic";

/// On either route: working memory; of each of three memories two sets and the oracle; wrong content of one and of two
/// histories, and of documents.
const CONDITIONS: usize = 2 * (1 + 3 * 3 + 2 * 2 + 1);

fn json(bench: &Bench, file: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(bench.out(file)).unwrap()).unwrap()
}

/// The success rate of a condition in percent.
fn rate(bench: &Bench, run: &str, condition: &str) -> f64 {
    let of_condition = format!("{condition}/run");
    let is_of = |record: &Value| record["key"].as_str().unwrap().starts_with(&of_condition);
    success_rate(&records(&bench.out(run)), is_of)
}

#[test]
fn controls_run_beside_each_memory_and_no_crash_changes_the_log() {
    let bench = Bench::new();
    let arms = [&words(SLICE)[..], &["--arms", "frozen,oracle,wrong"]].concat();
    let into = |out| [&arms[..], &["--lanes", "4", "--out", out]].concat();
    bench.run(&into("one")).expect(0);
    let reference = sorted_log(&bench.out("one"));
    assert_eq!(reference.len(), 2 * CONDITIONS);
    let child = bench.start(&into("killed"));
    for (role, after) in [("memory", 10), ("sim", 25)] {
        wait_for_episodes(&bench.out("killed"), after);
        kill(process_of(bench.registry.path(), role));
    }
    wait_for_episodes(&bench.out("killed"), 40);
    bench.kill_run(child);
    bench.run(&into("killed")).expect(0);
    assert_eq!(sorted_log(&bench.out("killed")), reference);

    let mut letters: BTreeMap<(String, String), String> = BTreeMap::new();
    for record in records(&bench.out("one")) {
        let Some(retrieved) = record["retrieved"].as_str() else { continue };
        let arm = record["arm"].as_str().unwrap_or("frozen").to_owned();
        let route = record["route"].as_str().unwrap().to_owned();
        let of = letters.entry((arm.clone(), route)).or_default();
        for word in retrieved.split_whitespace() {
            let (case, view) = word.rsplit_once(':').unwrap_or(("", word));
            assert_eq!(case.is_empty(), arm != "wrong", "{record}");
            of.extend(view.chars().next().filter(|letter| !of.contains(*letter)));
        }
        assert!(arm != "oracle" || record["blocked"]["stale"].as_u64().unwrap_or(0) == 0);
    }
    let of = |arm: &str, route: &str| letters[&(arm.to_owned(), route.to_owned())].clone();
    assert_eq!((of("oracle", "unchanged"), of("oracle", "blocked")), ("t".into(), "b".into()));
    assert!(!of("frozen", "blocked").contains(['t', 'b']));
    for route in ["unchanged", "blocked"] {
        let rate = rate(&bench, "one", &format!("episodic/new/{route}/original/oracle"));
        assert_eq!(rate, 100.0, "the stand-in follows the reference");
    }
    let held = |file: &str| json(&bench, file)["cases"][0]["new"].is_u64();
    assert!(held("one/demonstrations.json"));

    // Without the arm the names, seeds and outcomes are the same, and no reference is among the demonstrations.
    bench.run(&[&words(SLICE)[..], &["--lanes", "4", "--out", "frozen"]].concat()).expect(0);
    assert!(!held("frozen/demonstrations.json"));
    let frozen = sorted_log(&bench.out("frozen"));
    assert!(frozen.iter().all(|line| reference.contains(line)));
    assert!(json(&bench, "frozen/manifest.json")["settings"]["group"][0].get("arms").is_none());
    bench.run(&["report", "one"]).expect(0);
    let page = fs::read_to_string(bench.out("one/report/report.html")).unwrap();
    assert!(page.contains("Controls: right and wrong content"), "{page}");
    bench.run(&["validate", "one"]).expect(0);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn another_world_has_the_controls_that_its_cases_allow() {
    let bench = Bench::new();
    let world = format!("{} well-behaved", program("misbehaving-world").display());
    let run = |line: &str| {
        let args = ["run", "--world-cmd", &world, "--policy", "imitate", "--starts", "new"];
        bench.run(&[&args[..], &words("--max-steps 40 --out own --fresh"), &words(line)].concat())
    };
    run("--memory working,episodic --routes unchanged,blocked --arms frozen,oracle").expect(0);
    for route in ["unchanged", "blocked"] {
        let rate = rate(&bench, "own", &format!("episodic/new/{route}/original/oracle"));
        assert_eq!(rate, 100.0);
    }
    let ended = run("--memory episodic --arms frozen,wrong").expect(2);
    let lacks = "case corridor-1 has no `irrelevant` histories, which the arm `wrong` holds";
    assert!(ended.stderr.contains(lacks), "{}", ended.stderr);
    let ended = run("--memory summary --arms frozen,wrong").expect(2);
    assert!(ended.stderr.contains("names a world that has none"), "{}", ended.stderr);
}
