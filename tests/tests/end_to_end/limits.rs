//! Limits of the shell and places that cannot be used: messages name the cause.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::os::unix::ffi::OsStrExt;
use std::process::Command;

use memtransfer_tests::{Bench, Ended, program};

/// `memtransfer` with `args` in a shell that has set a limit.
fn limited(bench: &Bench, limit: &str, args: &[&str]) -> Ended {
    let mut command = Command::new("sh");
    let script = format!("ulimit {limit}; exec \"$0\" \"$@\"");
    command.args(["-c", &script]).arg(program("memtransfer")).args(args);
    command.current_dir(bench.folder.path()).env("MEMTRANSFER_RUN_DIR", bench.registry.path());
    Ended::run(&mut command)
}

const RUN: [&str; 9] =
    ["run", "--limit", "3", "--memory", "working", "--frame-size", "64", "--out", "run"];

#[test]
fn too_few_open_files_are_the_reason_that_is_named() {
    let bench = Bench::new();
    for files in [24, 48] {
        let ended = limited(&bench, &format!("-n {files}"), &RUN).expect(2);
        assert!(ended.stderr.contains("ulimit -n"), "{files}: {}", ended.stderr);
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_limit_of_file_sizes_is_the_reason_that_is_named() {
    let bench = Bench::new();
    // Nothing can be written; shared memory cannot be reserved.
    for limit in ["-f 0", "-f 1000"] {
        let ended = limited(&bench, limit, &RUN).expect(2);
        assert!(ended.stderr.contains("ulimit -f"), "{limit}: {}", ended.stderr);
    }
    let args = ["map", "t01-01", "--out", "map.svg"];
    let ended = limited(&bench, "-f 1", &args).expect(2);
    assert!(
        ended.stderr.contains("ulimit -f") && ended.stderr.contains("map.svg"),
        "{}",
        ended.stderr
    );
}

#[test]
fn a_full_output_is_named() {
    let bench = Bench::new();
    for args in [&["ls", "cases"][..], &["generate", "--count", "40"]] {
        let mut command = bench.command(args);
        command.stdout(File::create("/dev/full").unwrap());
        let ended = Ended::of(command.spawn().unwrap()).expect(2);
        let said = "cannot write to standard output: No space left on device";
        assert!(ended.stderr.contains(said), "{}", ended.stderr);
    }
    // There is nowhere to say it.
    let mut command = bench.command(&["ls", "nothing"]);
    command.stderr(File::create("/dev/full").unwrap()).env("RUST_LOG", "=");
    Ended::of(command.spawn().unwrap()).expect(2);
}

#[test]
fn a_run_works_in_a_folder_whose_name_is_not_utf_8() {
    let bench = Bench::new();
    let folder = bench.folder.path().join(OsStr::from_bytes(b"caf\xe9"));
    fs::create_dir(&folder).unwrap();
    let mut command = bench.command(&RUN);
    command.current_dir(&folder);
    Ended::of(command.spawn().unwrap()).expect(0);
    assert!(folder.join("run/episodes.jsonl").exists());
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn numbers_that_no_machine_can_generate_are_refused() {
    let bench = Bench::new();
    let many = u64::MAX.to_string();
    for args in [
        &["generate", "--count", &many][..],
        &[
            "generate", "world", "--seed", "7", "--size", "24x40", "--cases", &many, "--out",
            "world",
        ],
    ] {
        let ended = bench.run(args).expect(2);
        assert!(ended.stderr.contains("too many"), "{}", ended.stderr);
    }
}
