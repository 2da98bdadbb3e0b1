//! External memories in Python: the examples, what a memory is given, and what its faults cost.

use std::collections::BTreeMap;
use std::fs;

use memtransfer_tests::example_memories::{command, example, process_of_example, run, start};
use memtransfer_tests::llama::{LlamaServer, MODEL};
use memtransfer_tests::{
    Bench, Ended, kill, needs, process_of, records, repository, sorted_log, success_rate,
    wait_for_episodes, words,
};
use serde_json::Value;

use crate::external::instruction;

/// The examples that need no server.
const EXAMPLES: [&str; 6] = ["top-k", "bm25", "robotmem", "langgraph", "mem0", "stitch"];

/// The command that starts the test memory with one trait.
fn scripted(memory_trait: &str, argument: &str) -> String {
    let script = repository("python/tests/memories/scripted.py");
    let argument = argument.replace('\'', r"'\''");
    format!("{} {} {memory_trait} '{argument}'", needs::python().display(), script.display())
}

/// Number of records of each memory.
fn counts(records: &[Value]) -> BTreeMap<&str, usize> {
    let mut counts = BTreeMap::new();
    for record in records {
        *counts.entry(record["memory"].as_str().unwrap()).or_default() += 1;
    }
    counts
}

#[test]
fn the_examples_run_slices_of_rq1_and_rq2_beside_built_in_memories() {
    let bench = Bench::new();
    let memories = EXAMPLES.map(example);
    for (suite, cases, episodes) in [("rq1", "t01-01", 5), ("rq2", "t01-01,t03-02", 4)] {
        let line = format!(
            "run --suite {suite} --cases {cases} --runs 1 --max-steps 20 --memory working,episodic --out {suite}"
        );
        run(&bench, &words(&line), &memories).expect(0);
        let records = records(&bench.out(suite));
        let mut expected = BTreeMap::from(EXAMPLES.map(|name| (name, episodes)));
        expected.insert("episodic", episodes);
        expected.insert("working", counts(&records)["working"]);
        assert_eq!(counts(&records), expected, "{suite}");

        let report = run(&bench, &["report", suite], &[]).expect(0);
        let tables = bench.out(suite).join("report/tables");
        let table = fs::read_to_string(tables.join("conditions.csv")).unwrap();
        for name in EXAMPLES {
            assert!(table.contains(name), "{name} in {table}\n{}", report.stderr);
        }
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_memory_that_finds_the_demonstrated_step_transfers_it() {
    let bench = Bench::new();
    let args = words("run --limit 5 --memory working,episodic --starts original --out out");
    run(&bench, &args, &["top-k", "langgraph"].map(example)).expect(0);
    let records = records(&bench.out("out"));
    let rate = |memory| success_rate(&records, |record| record["memory"] == memory);
    for memory in ["top-k", "langgraph"] {
        assert!(rate(memory) > rate("working"), "{memory}: {} %", rate(memory));
    }
    // Four memories in every table of one report, and their differences.
    let scored = run(&bench, &["score", "out"], &[]).expect(0).stdout.to_lowercase();
    for memory in ["working", "episodic", "top-k", "langgraph"] {
        assert!(scored.contains(memory), "{memory} in {scored}");
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_plan_that_is_stitched_from_demonstrations_reaches_policy_records_and_prompts() {
    let bench = Bench::new();
    let line =
        "run --cases t01-01,t02-02 --memory working --starts new --frame-size 64 --log-prompts";
    // The stand-ins and a policy in Python follow it from a start that the case's own demonstration does not lead through.
    let script = repository("python/tests/policies/planned.py");
    let own = format!("{} {}", needs::python().display(), script.display());
    for policy in ["grounded", "imitate", "own"] {
        let given = if policy == "own" { ["--policy-cmd", &own] } else { ["--policy", policy] };
        let args = [&words(line)[..], &given, &["--out", policy]].concat();
        run(&bench, &args, &[example("stitch")]).expect(0);
        let records = records(&bench.out(policy));
        let is_stitched = |record: &Value| record["memory"] == "stitch";
        assert_eq!(success_rate(&records, is_stitched), 100.0, "{policy}");
        for record in records.iter().filter(|record| is_stitched(record)) {
            // At the first step other cases' demonstrations and the case's own, at the last the latter's alone.
            let retrieved: Vec<&str> = record["retrieved"].as_str().unwrap().split(' ').collect();
            let first: Vec<&str> = retrieved[0].split('+').collect();
            let (own, others) = first.split_last().unwrap();
            assert!(own.starts_with('o') && !others.is_empty(), "{retrieved:?}");
            assert!(others.iter().all(|source| source.contains(":o")), "{retrieved:?}");
            assert!(retrieved.last().unwrap().starts_with('o'), "{retrieved:?}");
            assert_eq!(retrieved.len() as u64, record["steps"].as_u64().unwrap());
        }
    }
    let shown = ["show", "grounded", "t01-01", "0", "--condition", "stitch"];
    let told = bench.run(&shown).expect(0).stdout;
    for words in ["Plan of ", "From the demonstration of: ", "Of the memory's own: turn "] {
        assert!(told.contains(words), "{words}: {told}");
    }
    let json = bench.run(&[&shown[..], &["--json"]].concat()).expect(0).stdout;
    let json: Value = serde_json::from_str(&json).unwrap();
    let parts = json["prompt"]["request"]["items"][0]["plan"]["parts"].as_array().unwrap();
    let planned: usize = parts.iter().map(|part| part["actions"].as_array().unwrap().len()).sum();
    let retrieved = records(&bench.out("grounded"));
    let steps = retrieved.iter().find(|of| of["memory"] == "stitch" && of["case"] == "t01-01");
    // The expert's last action may be a turn before the target, which is not needed.
    assert!(planned as u64 >= steps.unwrap()["steps"].as_u64().unwrap(), "{json}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn notes_are_written_by_a_language_model() {
    let bench = Bench::new();
    let server = LlamaServer::start(2048, 1);
    let line = "run --cases t01-01 --memory working --max-steps 5 --starts original --log-prompts --out out";
    let args = words(line);
    let mut command = command(&bench, &args, &[example("model-notes")]);
    command.env("OPENAI_BASE_URL", server.base_url()).env("NOTES_MODEL", MODEL);
    Ended::run(&mut command).expect(0);
    assert_eq!(
        counts(&records(&bench.out("out"))),
        BTreeMap::from([("model-notes", 1), ("working", 1)])
    );
    let log = bench.out("out").join("prompts/session-1/generation-1.jsonl");
    let log = fs::read_to_string(log).unwrap();
    assert!(log.contains(r#""note""#), "{log}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn killing_any_process_of_a_run_with_external_memories_changes_no_log() {
    let bench = Bench::new();
    let memories = ["top-k", "bm25"].map(example);
    let args = |out| {
        let args =
            words("run --cases t01-01,t03-02,t09-05 --max-steps 30 --memory working --lanes 3");
        [&args[..], &["--out", out]].concat()
    };
    run(&bench, &args("reference"), &memories).expect(0);
    let reference = sorted_log(&bench.out("reference"));
    assert_eq!(reference.len(), 18);
    let child = start(&bench, &args("killed"), &memories);
    wait_for_episodes(&bench.out("killed"), 1);
    kill(process_of_example(&bench, "top-k"));
    for (role, after) in [("memory", 5), ("policy", 9)] {
        wait_for_episodes(&bench.out("killed"), after);
        kill(process_of(bench.registry.path(), role));
    }
    Ended::of(child).expect(0);
    assert_eq!(sorted_log(&bench.out("killed")), reference);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// Two cases at the original start, with short episodes on small frames.
const SHORT: &str = "run --cases t01-01,t03-02 --memory working --starts original --frame-size 64 \
    --max-steps 20 --out out";

#[test]
fn a_memory_is_given_demonstrations_and_queries_without_a_copy() {
    let bench = Bench::new();
    let seen = bench.out("seen");
    let memory = scripted("Checks", seen.to_str().unwrap());
    run(&bench, &words(SHORT), &[memory]).expect(0);
    let records = records(&bench.out("out"));
    assert_eq!(counts(&records), BTreeMap::from([("scripted", 2), ("working", 2)]));
    let seen = fs::read_to_string(seen).unwrap();
    assert!(seen.contains("'banks': 2"), "{seen}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// The errors of a run with one memory, whose episodes all end without a result.
fn failures(memory_trait: &str) -> (Vec<String>, String) {
    let bench = Bench::new();
    let ended = run(&bench, &words(SHORT), &[scripted(memory_trait, "")]).expect(1);
    let out = bench.out("out");
    assert_eq!(counts(&records(&out)), BTreeMap::from([("working", 2)]), "{memory_trait}");
    let errors = fs::read_to_string(out.join("errors.jsonl")).unwrap();
    let errors: Vec<String> = errors.lines().map(str::to_owned).collect();
    assert_eq!(errors.len(), 2, "{memory_trait}: {errors:?}\n{}", ended.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
    (errors, fs::read_to_string(out.join("logs/external-memory-0.log")).unwrap())
}

#[test]
fn a_fault_of_a_memory_costs_its_own_episodes_and_is_named() {
    for (memory_trait, said) in [
        ("RaisesInBuild", "raised RuntimeError: cannot build"),
        ("Unmakable", "raised RuntimeError: cannot be made"),
        ("ReturnsNone", "recall returned None, but must return a list of items"),
        (
            "ReturnsNumbers",
            "recall returned 3, but an item is a Text, Steps, a View, a Plan or a str",
        ),
        ("Negative", "-1 is not the number of a demonstration or step"),
        ("TooFar", "99999"),
        (
            "PlansUnknownAction",
            "7 is no action of the world warehouse: give an Action, the number (0 to 6) or the words",
        ),
        ("PlansTooFar", "names 1 steps from step 99999 of demonstration 0"),
        ("PlansUnknownDemonstration", "names demonstration 99, but the bank has 1 (from 0)"),
        ("PlansNothing", "item 0 is a plan without actions"),
        ("PlansWords", "parts is a list of Source objects and actions, not 'move forward'"),
        ("TooMany", "9 items, and at most 8"),
    ] {
        let (errors, log) = failures(memory_trait);
        for error in &errors {
            assert!(error.contains(said), "{memory_trait}: {errors:?}");
        }
        let raised = memory_trait.starts_with("Raises") || memory_trait == "Unmakable";
        assert!(!raised || log.contains("Traceback"), "{memory_trait}: {log}");
    }
}

#[test]
fn an_exception_in_one_episode_costs_that_episode() {
    let bench = Bench::new();
    run(&bench, &words(SHORT), &[scripted("RaisesInOne", &instruction("t03-02"))]).expect(1);
    let records = records(&bench.out("out"));
    assert_eq!(counts(&records), BTreeMap::from([("scripted", 1), ("working", 2)]));
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
