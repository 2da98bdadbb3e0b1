//! A run on a Ray cluster that loses nodes is the run of one machine.

use std::fs;
use std::process::Command;

use memtransfer_tests::{Bench, Ended, eventually, needs, program, repository, sorted_log};

const SUITE: &str = r#"
memory = ["working", "episodic"]
starts = ["original", "new"]
routes = ["unchanged"]
demos = ["original"]
limit = 10
max-steps = 40
"#;

/// Python with Ray, to its end.
fn python(bench: &Bench, args: &[&str]) -> Ended {
    let ray = tempfile::Builder::new().prefix("ray").tempdir_in("/tmp").unwrap();
    let mut command = Command::new(needs::ray_python());
    command
        .args(args)
        .current_dir(bench.folder.path())
        .env("MEMTRANSFER_RUN_DIR", bench.registry.path())
        // Ray's files, and units that are being executed.
        .env("TMPDIR", ray.path())
        .env("PYTHONPATH", repository("python"));
    Ended::run(&mut command)
}

/// `--address auto` finds the cluster of any test on this machine, so this comes before the one that starts a cluster.
fn check_messages_without_a_cluster() {
    let bench = Bench::new();
    let program = program("memtransfer");
    let run = ["-m", "memtransfer.ray", "run", "--out", "merged", "--policy", "random"];
    let ended = python(&bench, &[&run[..], &["--program", program.to_str().unwrap()]].concat());
    let said = ended.expect(2).stderr;
    assert!(said.contains("cannot join a Ray cluster at auto"), "{said}");
    assert!(said.contains("`ray start --head`") && !said.contains("Traceback"), "{said}");
    assert!(bench.out("merged.units/plan.json").exists(), "the plan waits for the next try");
    for (flags, reason) in [
        (["--program", "./nope"], "cannot start ./nope: No such file or directory"),
        (["--work", "--lanes '2"], "--work: No closing quotation"),
        (["--cpus", "0"], "--cpus: 0 is neither a whole number from 1 nor a fraction of a core"),
        (["--cpus", "2.5"], "--cpus: 2.5 is neither"),
    ] {
        let said = python(&bench, &[&run[..], &flags].concat()).expect(2).stderr;
        assert!(said.contains(reason) && !said.contains("Traceback"), "{said}");
    }
}

/// What is given on the command line of the launcher is not taken from the plan alone.
fn check_flags_of_units() {
    let print = "import sys; from memtransfer.ray import _flags_of_units as f; print(*f(sys.argv[2:], sys.argv[1].split()))";
    let flags = |args: &[&str]| {
        let found = python(&Bench::new(), &[&["-c", print], args].concat()).expect(0);
        found.stdout.trim().to_owned()
    };
    assert_eq!(flags(&["--lanes 3"]), "--allow-commands --lanes 3");
    let of_settings = "--allow-commands --base-url http://a/v1";
    assert_eq!(flags(&["", "--suite", "x", "--base-url", "http://a/v1"]), of_settings);
    assert_eq!(flags(&["", "--base-url=http://a/v1"]), of_settings.replace("l h", "l=h"));
    let of_work = ["--base-url http://b/v1", "--base-url", "http://a/v1"];
    assert_eq!(flags(&of_work), "--allow-commands --base-url http://b/v1");
}

#[test]
fn nodes_that_are_lost_and_added_do_not_change_the_log() {
    check_flags_of_units();
    check_messages_without_a_cluster();
    let bench = Bench::new();
    fs::write(bench.out("suite.toml"), SUITE).unwrap();
    let settings = ["--suite", "./suite.toml", "--policy", "grounded"];
    bench.run(&[&["run", "--out", "whole"], &settings[..]].concat()).expect(0);

    let cluster = repository("python/tests/ray_cluster.py");
    let program = program("memtransfer");
    let args = [&[cluster.to_str().unwrap(), "merged", program.to_str().unwrap()], &settings[..]];
    let ended = python(&bench, &args.concat()).expect(0);
    assert_eq!(ended.stdout.matches("killed a node").count(), 2, "{}", ended.stdout);
    assert_eq!(sorted_log(&bench.out("merged")), sorted_log(&bench.out("whole")));
    eventually("runs of lost nodes to end", || bench.leftovers().is_empty().then_some(()));
}
