//! What the command line asks the world: lists, and whether the log of a run is true.

use std::fs;
use std::path::Path;

use memtransfer_tests::Bench;
use serde_json::{Value, json};

#[test]
fn lists_fit_a_terminal() {
    let bench = Bench::new();
    for what in ["cases", "histories", "tasks", "items", "suites", "streams"] {
        let listed = bench.run(&["ls", what]).expect(0).stdout;
        assert!(listed.lines().count() > 3, "{listed}");
        assert!(listed.lines().all(|line| line.chars().count() <= 100), "{listed}");
    }
}

/// The records of a journal, without their checksums.
fn records(path: &Path) -> Vec<Value> {
    let text = fs::read_to_string(path).unwrap();
    let record = |line: &str| {
        let mut record: Value = serde_json::from_str(line).unwrap();
        record.as_object_mut().unwrap().remove("checksum");
        record
    };
    text.lines().map(record).collect()
}

/// Writes the journal with the checksums that the lines have to have.
fn write(path: &Path, records: &[Value]) {
    let line = |record: &Value| {
        let text = record.to_string();
        let checksum = &blake3::hash(text.as_bytes()).to_hex()[..8];
        format!("{},\"checksum\":\"{checksum}\"}}\n", &text[..text.len() - 1])
    };
    fs::write(path, records.iter().map(line).collect::<String>()).unwrap();
}

/// A field, which records can be edited, and the edit.
type EditOf<'a> = (&'a str, &'a dyn Fn(&Value) -> bool, &'a dyn Fn(&mut Value));

#[test]
fn a_true_run_is_valid_and_an_edited_action_ending_or_sub_goal_is_found() {
    let bench = Bench::new();
    let args = ["run", "--suite", "rq2", "--limit", "3", "--runs", "1", "--policy", "random"];
    let more = ["--memory", "working", "--max-steps", "60", "--frame-size", "64", "--out", "r"];
    bench.run(&[&args[..], &more].concat()).expect(0);
    let path = bench.out("r/episodes.jsonl");
    let all = records(&path);
    write(&path, &all);
    let valid = bench.run(&["validate", "r"]).expect(0).stdout;
    let count = format!("{} episodes, 0 differences, 0 damaged lines\n", all.len());
    assert_eq!(valid, count);
    let is_open = |record: &Value| {
        let met = record["sub_goals"].as_array().unwrap().len() as u64;
        record["ending"] == "out-of-steps" && met + 1 < record["required"].as_u64().unwrap()
    };
    let has_blocked_move = |record: &Value| record["world"]["blocked_moves"][0].is_u64();
    let edits: [EditOf<'_>; 3] = [
        // Another move into what blocked the way, or not: the log says that it did.
        ("blocked_moves", &has_blocked_move, &|record| {
            let at = record["world"]["blocked_moves"][0].as_u64().unwrap() as usize - 1;
            let actions = record["actions"].as_str().unwrap();
            let other = if actions[at..].starts_with('f') { "b" } else { "f" };
            let edited = format!("{}{other}{}", &actions[..at], &actions[at + 1..]);
            record["actions"] = edited.into();
        }),
        ("ending", &|record| record["ending"] == "out-of-steps", &|record| {
            record["ending"] = "complete".into();
            let (steps, required) = (record["steps"].clone(), record["required"].clone());
            record["sub_goals"] = vec![steps; required.as_u64().unwrap() as usize].into();
        }),
        ("sub_goals", &is_open, &|record| {
            let met = record["sub_goals"].as_array_mut().unwrap();
            met.push(json!(60));
        }),
    ];
    for (field, may, edit) in edits {
        let mut edited = all.clone();
        let record = edited.iter_mut().find(|record| may(record)).unwrap();
        edit(record);
        let key = record["key"].as_str().unwrap().to_owned();
        write(&path, &edited);
        let found = bench.run(&["validate", "r"]).expect(1).stdout;
        assert!(found.contains(&format!("FAIL {key}: \"{field}\" is ")), "{field}: {found}");
        assert!(found.lines().all(|line| !line.starts_with("FAIL") || line.contains(&key)));
    }
    fs::write(&path, &fs::read(&path).unwrap()[1..]).unwrap();
    let damaged = bench.run(&["validate", "r", "--json"]).expect(1).stdout;
    let damaged: Value = serde_json::from_str(&damaged).unwrap();
    assert_eq!(damaged["damaged"].as_array().unwrap().len(), 1);
}
