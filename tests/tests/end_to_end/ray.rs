//! A run on a Ray cluster that loses nodes is the run of one machine.

use std::fs;
use std::process::{Command, Stdio};

use memtransfer_tests::{
    Bench, Ended, eventually, needs, processes_of, program, repository, sorted_log,
};

const SUITE: &str = r#"
memory = ["working", "episodic"]
starts = ["original", "new"]
routes = ["unchanged"]
demos = ["original"]
limit = 10
max-steps = 40
frame-size = 128
"#;

#[test]
fn nodes_that_are_lost_and_added_do_not_change_the_log() {
    let bench = Bench::new();
    fs::write(bench.out("suite.toml"), SUITE).unwrap();
    let settings = ["--suite", "./suite.toml", "--policy", "grounded"];
    bench.run(&[&["run", "--out", "whole"], &settings[..]].concat()).expect(0);

    let package = repository("python");
    let ray = tempfile::Builder::new().prefix("ray").tempdir_in("/tmp").unwrap();
    let mut command = Command::new(needs::ray_python());
    command
        .arg(package.join("tests/ray_cluster.py"))
        .arg("merged")
        .arg(program("memtransfer"))
        .args(settings)
        .current_dir(bench.folder.path())
        .env("MEMTRANSFER_RUN_DIR", bench.registry.path())
        // Ray's files, and units that are being executed.
        .env("TMPDIR", ray.path())
        .env("PYTHONPATH", &package)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let ended = Ended::of(command.spawn().unwrap()).expect(0);
    assert_eq!(ended.stdout.matches("killed a node").count(), 2, "{}", ended.stdout);
    assert_eq!(sorted_log(&bench.out("merged")), sorted_log(&bench.out("whole")));
    eventually("processes of lost nodes to end", || {
        processes_of(bench.registry.path()).is_empty().then_some(())
    });
}
