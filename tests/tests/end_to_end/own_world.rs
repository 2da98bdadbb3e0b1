//! A world in Python through the real processes: none of them copies its pixels, and its death changes nothing.

use std::fs;
use std::path::Path;
use std::process::Command;

use memtransfer_tests::{
    Bench, Ended, episodes, eventually, kill, needs, processes_of, processes_with, repository,
    shutdown_total, sorted_log, wait_for_episodes, words,
};

use crate::pipeline::check_no_copies;

/// The example of a world, of four cases.
const SCRIPT: &str = "corridor_world.py";

/// A run in the world that a script serves, not started yet. It finds the package and its examples.
fn run(bench: &Bench, script: &Path, line: &str) -> Command {
    let world = format!("{} {}", needs::python().display(), script.display());
    let mut command = bench.command(&["run", "--world-cmd", &world, "--policy", "imitate"]);
    command.args(words("--starts original,new --routes unchanged,blocked --max-steps 30"));
    let folders = ["python", "python/examples"].map(repository);
    command.args(words(line)).env("PYTHONPATH", std::env::join_paths(folders).unwrap());
    command
}

/// A run in the corridor, not started yet.
fn corridor(bench: &Bench, line: &str) -> Command {
    let line = format!("--memory working,episodic --frame-size 64 --lanes 4 --runs 8 {line}");
    run(bench, &repository("python/examples").join(SCRIPT), &line)
}

/// The process of a world whose command ends with the name of a script; waits for it to start.
fn world_process(bench: &Bench, script: &str) -> u32 {
    let serves = format!("{script}\0serve\0");
    eventually(&format!("{script} to serve"), || {
        let serving = processes_with(serves.as_bytes());
        serving.intersection(&processes_of(bench.registry.path())).next().copied()
    })
}

#[test]
fn no_process_copies_the_pixels_of_a_world_in_python() {
    let bench = Bench::new();
    // Without hashes of its states, every step is rendered.
    let script = bench.out("every_step.py");
    let text = "\
from corridor_world import Corridor, main

class EveryStep(Corridor):
    def observe(self, *told, **more):
        observation = super().observe(*told, **more)
        observation.state_hash = None
        return observation

main(EveryStep)
";
    fs::write(&script, text).unwrap();
    let mut command = run(&bench, &script, "--memory episodic --runs 4 --out copies");
    let child = command.spawn().unwrap();
    check_no_copies(child, &bench, "copies", || world_process(&bench, "every_step.py"));
    assert_eq!(shutdown_total(&bench.out("copies"), "sim", "pixel_bytes_copied"), 0);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_world_in_python_that_is_killed_at_any_point_leaves_the_log_as_it_is() {
    const EPISODES: usize = 4 * 2 * 3 * 8;
    let bench = Bench::new();
    Ended::run(&mut corridor(&bench, "--out undisturbed")).expect(0);
    let reference = sorted_log(&bench.out("undisturbed"));
    assert_eq!(reference.len(), EPISODES);
    // Before its handshake; during steps; among the last steps; after them.
    for after in [0, 1, EPISODES / 2, EPISODES - 1, EPISODES] {
        let out = format!("after-{after}");
        let child = corridor(&bench, &format!("--out {out}")).spawn().unwrap();
        let world = world_process(&bench, SCRIPT);
        wait_for_episodes(&bench.out(&out), after);
        kill(world);
        Ended::of(child).expect(0);
        assert_eq!(sorted_log(&bench.out(&out)), reference, "killed after {after} episodes");
        // No episode was run twice.
        assert_eq!(episodes(&bench.out(&out)).lines().count(), EPISODES);
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_case_book_that_is_never_written_ends_the_run() {
    let bench = Bench::new();
    let world = "sh -c 'exec sleep 10000'";
    let run = ["run", "--world-cmd", world, "--start-timeout", "1", "--policy", "random"];
    let ended = bench.run(&run).expect(2);
    let message =
        "book` has not ended within 1 s (--start-timeout of a run): does a case never end?";
    assert!(ended.stderr.contains(message), "{}", ended.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
