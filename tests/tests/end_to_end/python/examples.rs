//! The example policies of the package.

use memtransfer_tests::{
    Bench, Ended, episodes, eventually, kill, processes_of, processes_with, records, sorted_log,
};
use rigs::chat_server::{Reaction, Server};
use serde_json::json;

use super::{finish, package, read_run, script, slice};

#[test]
fn the_random_example_conforms_to_the_wire() {
    let bench = Bench::new();
    let random = script("examples/random_policy.py", "");
    let mut command = bench.command(&["conformance", "--policy-cmd", &random]);
    command.env("PYTHONPATH", package());
    finish(command).expect(0);
}

#[test]
fn a_run_with_the_random_example_survives_a_kill_and_is_read_as_data_frames() {
    let bench = Bench::new();
    let random = script("examples/random_policy.py", "");
    let more = ["--memory", "working,full-context,episodic", "--lanes", "4"];
    finish(slice(&bench, "whole", &random, &more)).expect(0);
    let whole = sorted_log(&bench.out("whole"));
    assert_eq!(whole.len(), 9);

    let child = slice(&bench, "killed", &random, &more).spawn().unwrap();
    let marker = package().join("examples/random_policy.py");
    let marker = marker.as_os_str().as_encoded_bytes();
    let policy = eventually("an episode and its policy", || {
        // The orchestrator has the script's name in its arguments, too.
        let of_run = &processes_with(marker) & &processes_of(bench.registry.path());
        let policy = of_run.into_iter().find(|&pid| pid != child.id())?;
        (!episodes(&bench.out("killed")).is_empty()).then_some(policy)
    });
    kill(policy);
    let ended = Ended::of(child).expect(0);
    assert!(ended.stderr.contains("signal 9"), "{}", ended.stderr);
    assert_eq!(sorted_log(&bench.out("killed")), whole);
    assert_eq!(bench.leftovers(), Vec::<String>::new());

    let read = read_run(&bench.out("whole"));
    assert_eq!(read.len(), 9);
    for record in records(&bench.out("whole")) {
        let row = read.iter().find(|row| row["key"] == record["key"]).unwrap();
        for name in ["memory", "case", "steps", "seed"] {
            assert_eq!(row[name], record[name], "{name}");
        }
        assert_eq!(row["success"], record["ending"] == "complete");
        let (steps, reference) = (&record["steps"], &record["reference"]);
        let longest = steps.as_f64().unwrap().max(reference.as_f64().unwrap());
        let weight =
            if row["success"] == true { reference.as_f64().unwrap() / longest } else { 0.0 };
        assert!((row["spl"].as_f64().unwrap() - weight).abs() < 1e-9, "{row}");
    }
}

#[test]
fn the_pixels_example_avoids_obstacles() {
    let bench = Bench::new();
    let pixels = script("examples/pixels_policy.py", "");
    finish(slice(&bench, "pixels", &pixels, &["--memory", "working", "--max-steps", "30"]))
        .expect(0);
    let records = records(&bench.out("pixels"));
    assert_eq!(records.len(), 3);
    let (mut moves, mut blocked) = (0, 0);
    for record in &records {
        moves += record["actions"].as_str().unwrap().matches('f').count();
        blocked += record["world"]["blocked_moves"].as_array().map_or(0, Vec::len);
    }
    assert!(moves > 30 && blocked * 10 < moves, "{blocked} of {moves} moves were blocked");
}

#[test]
fn the_endpoint_example_asks_a_server() {
    let bench = Bench::new();
    let server = Server::start(|_| Reaction::says("Action: turn left")).unwrap();
    let policy = script("examples/endpoint_policy.py", "scripted");
    let more = ["--memory", "working", "--max-steps", "5", "--log-prompts"];
    let mut command = slice(&bench, "endpoint", &policy, &more);
    command.env("OPENAI_BASE_URL", server.base_url()).env("OPENAI_API_KEY", "none");
    finish(command).expect(0);
    let records = records(&bench.out("endpoint"));
    assert_eq!(records.len(), 3);
    for record in &records {
        assert_eq!(record["actions"], "LLLLL");
        assert_eq!(
            (&record["prompt_tokens"], &record["completion_tokens"]),
            (&json!(50), &json!(25))
        );
    }
    let received = server.received();
    assert_eq!(received.len(), 15);
    let system = &received[0].body["messages"][0]["content"];
    assert!(system.as_str().unwrap().contains("You control a robot in a warehouse."));
    let case = records[0]["case"].as_str().unwrap();
    let shown = bench.run(&["show", "endpoint", case, "2"]).expect(0).stdout;
    for part in
        ["Message of role user", "  [image ", "Reply\n  Action: turn left", "acted: turn left"]
    {
        assert!(shown.contains(part), "no {part:?} in {shown}");
    }
}
