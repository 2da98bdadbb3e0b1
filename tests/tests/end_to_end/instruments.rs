//! Live status, traces and latencies of a run.

use std::collections::BTreeSet;
use std::fs;

use memtransfer_tests::{Bench, Ended, eventually, records};
use serde_json::Value;

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// The values of `key` in these objects.
fn values<'a>(objects: impl IntoIterator<Item = &'a Value>, key: &str) -> BTreeSet<&'a str> {
    objects.into_iter().filter_map(|object| object[key].as_str()).collect()
}

#[test]
fn a_run_has_a_live_status_a_trace_and_latencies() {
    let bench = Bench::new();
    let args = ["run", "--policy", "grounded", "--memory", "working,episodic", "--limit", "10"];
    let more = ["--lanes", "4", "--out", "seen", "--trace", "trace.json", "--fresh"];
    // Each process sends a heartbeat about once a second.
    let processes = |seen: &Value| seen["processes"].as_object().map_or(0, serde_json::Map::len);
    let is_under_way = |seen: &Value| processes(seen) == 3 && seen["steps"].as_u64() > Some(0);
    // Again, if it was over before it was looked at.
    let (child, status) = loop {
        let mut child = bench.start(&[&args[..], &more].concat());
        let status = eventually("heartbeats of every process, and steps", || {
            let is_over = child.try_wait().unwrap().is_some();
            let seen = bench.run(&["top", "seen", "--once", "--json"]);
            let seen = (seen.status == Some(0)).then(|| json(&seen.stdout)).filter(is_under_way);
            (seen.is_some() || is_over).then_some(seen)
        });
        match status {
            Some(status) => break (child, status),
            None => drop(Ended::of(child).expect(0)),
        }
    };
    assert_eq!((&status["lanes"], &status["episodes"]["planned"]), (&json("4"), &json("40")));
    let shown = bench.run(&["top", "seen", "--once"]);
    Ended::of(child).expect(0);
    assert!(shown.status != Some(0) || shown.stdout.contains("frame"), "{}", shown.stdout);
    let over = bench.run(&["top", "seen"]).expect(2).stderr;
    assert!(over.contains("seen"), "{over}");

    let steps: u64 = records(&bench.out("seen")).iter().map(|r| r["steps"].as_u64().unwrap()).sum();
    let trace = json(&fs::read_to_string(bench.out("trace.json")).unwrap());
    let events = trace["traceEvents"].as_array().unwrap();
    let of = |phase: &'static str| events.iter().filter(move |event| event["ph"] == phase);
    assert!(
        of("X").all(|slice| slice["ts"].as_f64() >= Some(0.0) && slice["dur"].as_f64() > Some(0.0))
    );
    // Perfetto drops a slice that overlaps another one on its track.
    let ns = |slice: &Value, key: &str| (slice[key].as_f64().unwrap() * 1000.0).round() as u64;
    let track = |slice: &Value| (slice["pid"].as_u64(), slice["tid"].as_u64());
    let mut slices_by_track: Vec<_> =
        of("X").map(|slice| (track(slice), ns(slice, "ts"), ns(slice, "dur"))).collect();
    slices_by_track.sort_unstable();
    for pair in slices_by_track.windows(2) {
        let (one, next) = (pair[0], pair[1]);
        assert!(one.0 != next.0 || one.1 + one.2 <= next.1, "{one:?} overlaps {next:?}");
    }
    let slices = values(of("X"), "name");
    for name in ["step", "draw", "render", "recall", "search", "decide"] {
        assert!(slices.contains(name), "{name} is not in {slices:?}");
    }
    let traced_steps = of("X").filter(|slice| slice["name"] == "step").count() as u64;
    assert_eq!(traced_steps, steps);
    let tracks = values(
        of("M").map(|track| &track["args"]).filter(|track| track["name"].is_string()),
        "name",
    );
    for name in ["orchestrator", "sim", "memory", "policy", "lane 3", "renderer 0"] {
        assert!(tracks.contains(name), "{name} is not in {tracks:?}");
    }

    let latency = fs::read_to_string(bench.out("seen").join("latency.jsonl")).unwrap();
    let lines: Vec<Value> = latency.lines().map(json).collect();
    assert_eq!(values(&lines, "memory"), BTreeSet::from(["working", "episodic"]));
    let whole = lines.iter().filter(|line| line["stage"] == "step");
    assert_eq!(whole.map(|line| line["count"].as_u64().unwrap()).sum::<u64>(), traced_steps);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_quick_profile_measures_every_way_of_running() {
    let bench = Bench::new();
    let line = ["profile", "--quick", "--out", "measured", "--lanes", "2", "--quiet"];
    bench.run(&line).expect(0);
    let measured = json(&fs::read_to_string(bench.out("measured/profile.json")).unwrap());
    let ways: Vec<_> = measured["runs"]
        .as_array()
        .unwrap()
        .iter()
        .map(|run| {
            assert!(!run["latencies"].as_array().unwrap().is_empty(), "{run}");
            (
                run["caches"].as_str().unwrap(),
                run["lanes"].as_u64().unwrap(),
                run["spin_us"].as_u64() > Some(0),
            )
        })
        .collect();
    assert_eq!(
        ways,
        [("cold", 1, false), ("warm", 1, false), ("warm", 1, true), ("warm", 2, false)]
    );
}
