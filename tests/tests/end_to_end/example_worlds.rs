//! The example worlds, which others wrote, in short runs: `examples/worlds`.

use std::process::Command;

use memtransfer_tests::{Bench, Ended, needs, records, repository, sorted_log, words};
use serde_json::Value;

#[test]
fn the_page_of_worlds_shows_the_corridor() {
    let page = std::fs::read_to_string(repository("docs/own-world.md")).unwrap();
    let corridor = repository("python/examples/corridor_world.py");
    let corridor = std::fs::read_to_string(corridor).unwrap();
    assert!(page.contains(&format!("```python\n{corridor}```")), "the page shows another text");
}

/// How the example world `name` is started.
fn world_command(name: &str) -> String {
    let script = repository(&format!("examples/worlds/{name}/world.py"));
    format!("{} {}", needs::world_python(name).display(), script.display())
}

/// `memtransfer run` in the example world `name`, of two cases on small frames, not started yet.
fn run(bench: &Bench, name: &str, cases: &str, line: &str) -> Command {
    let mut command =
        bench.command(&["run", "--world-cmd", &world_command(name), "--cases", cases]);
    command.args(words("--frame-size 64 --max-steps 60 --starts original,new"));
    command.args(words("--routes unchanged,blocked"));
    command.args(words(line)).env("PYTHONPATH", repository("python"));
    command
}

/// How the episodes of a run with this memory ended that began at `start` on `route`.
fn endings<'a>(records: &'a [Value], memory: &str, start: &str, route: &str) -> Vec<&'a str> {
    let is_of = |record: &&Value| {
        record["memory"] == memory && record["start"] == start && record["route"] == route
    };
    records.iter().filter(is_of).map(|record| record["ending"].as_str().unwrap()).collect()
}

#[test]
fn demonstrations_of_minigrid_are_imitated_and_its_log_depends_on_no_lanes() {
    demonstrations_are_imitated("minigrid", "g1-2-pick-up,g1-5-unlock");
}

/// Lanes of Meta-World share the model of a table, and the renderer.
#[test]
fn demonstrations_of_meta_world_are_imitated_and_its_log_depends_on_no_lanes() {
    demonstrations_are_imitated("metaworld", "push-8,press-14");
}

/// In a run of two cases, which is the same with one lane and with eight, and which `validate` confirms.
fn demonstrations_are_imitated(name: &str, cases: &str) {
    let bench = Bench::new();
    let line = "--policy imitate --memory full-context,episodic";
    for lanes in ["1", "8"] {
        let line = format!("{line} --lanes {lanes} --out {lanes}");
        Ended::run(&mut run(&bench, name, cases, &line)).expect(0);
    }
    let imitated = records(&bench.out("8"));
    assert_eq!(imitated.len(), 2 * 2 * 3);
    for memory in ["full-context", "episodic"] {
        let demonstrated = endings(&imitated, memory, "original", "unchanged");
        assert_eq!(demonstrated, ["complete"; 2], "{memory}");
    }
    assert_eq!(sorted_log(&bench.out("1")), sorted_log(&bench.out("8")));
    // A log is true: every episode is acted out again.
    let world = world_command(name);
    let mut validate = bench.command(&["validate", "8"]);
    validate.env("MEMTRANSFER_WORLD_CMD", world).env("PYTHONPATH", repository("python"));
    let valid = Ended::run(&mut validate).expect(0).stdout;
    assert_eq!(valid, "12 episodes, 0 differences, 0 damaged lines\n");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn the_expert_of_minigrid_completes_every_reference() {
    the_expert_completes_every_reference("minigrid", "g0-3-put-next,g2-4-open");
}

#[test]
fn the_expert_of_meta_world_completes_every_reference() {
    the_expert_completes_every_reference("metaworld", "reach-1,pick-place-10");
}

fn the_expert_completes_every_reference(name: &str, cases: &str) {
    let bench = Bench::new();
    let line = "--policy expert --memory working --out out";
    Ended::run(&mut run(&bench, name, cases, line)).expect(0);
    let records = records(&bench.out("out"));
    for (start, route) in [("original", "unchanged"), ("new", "unchanged"), ("new", "blocked")] {
        assert_eq!(endings(&records, "working", start, route), ["complete"; 2], "{start} {route}");
    }
    assert!(records.iter().all(|record| record["steps"] == record["reference"]), "{records:?}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
