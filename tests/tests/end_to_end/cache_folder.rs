//! A cache folder that this user can only read, and one in which a plan of another user has planted a library.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::Command;

use memory_proc::paths::CacheFolder;
use memtransfer_tests::{Bench, Ended, words};
use rustix::process::geteuid;

/// A run whose memories need a document and the encoder. One case: each of its views is embedded here for the first time.
const RUN: &str =
    "run --memory summary,episodic --cases t01-01 --starts new --max-steps 6 --frame-size 64";

/// `memtransfer ARGUMENTS` with the cache folder `cache`. For root permissions hold, too: without its capability to override them.
fn command(bench: &Bench, cache: &Path, args: &[&str]) -> Command {
    let memtransfer = bench.command(args);
    let mut command = Command::new("setpriv");
    if geteuid().is_root() {
        command.arg("--bounding-set=-dac_override,-dac_read_search").arg(memtransfer.get_program());
    } else {
        command = Command::new(memtransfer.get_program());
    }
    command.args(memtransfer.get_args()).current_dir(bench.folder.path());
    for (name, value) in memtransfer.get_envs() {
        match value {
            Some(value) => command.env(name, value),
            None => command.env_remove(name),
        };
    }
    command.env("MEMTRANSFER_CACHE", cache);
    command
}

/// Makes all folders and files below `folder`, which are no links, read-only, or writable again.
fn set_writable(folder: &Path, writable: bool) {
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap()) {
        let kind = entry.file_type().unwrap();
        if kind.is_dir() {
            set_writable(&entry.path(), writable);
        } else if kind.is_file() {
            let mode = if writable { 0o644 } else { 0o444 };
            fs::set_permissions(entry.path(), fs::Permissions::from_mode(mode)).unwrap();
        }
    }
    let mode = if writable { 0o755 } else { 0o555 };
    fs::set_permissions(folder, fs::Permissions::from_mode(mode)).unwrap();
}

#[test]
fn a_cache_folder_that_holds_everything_need_not_be_writable() {
    let can_drop = Command::new("setpriv").args(["--bounding-set=-dac_override", "true"]).output();
    if geteuid().is_root() && !can_drop.is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: root may write anywhere, and `setpriv` cannot take that away here");
        return;
    }
    let bench = Bench::new();
    let cache = bench.out("cache");
    fs::create_dir(&cache).unwrap();
    let shared = CacheFolder::from_environment().unwrap();
    for part in ["models", "onnxruntime"] {
        symlink(shared.root().join(part), cache.join(part)).unwrap();
    }
    let doctor = || {
        let output = Ended::run(&mut command(&bench, &cache, &["doctor", "--json"]));
        let findings: serde_json::Value = serde_json::from_str(&output.stdout).unwrap();
        let findings = findings.as_array().unwrap().iter();
        findings.clone().find(|one| one["what"] == "cache folder").unwrap().clone()
    };
    let run = |out: &str| {
        let args = [&words(RUN)[..], &["--out", out]].concat();
        Ended::run(&mut command(&bench, &cache, &args))
    };
    run("writable").expect(0);
    assert_eq!((&doctor()["ok"], &doctor()["doubtful"]), (&true.into(), &serde_json::Value::Null));

    fs::remove_file(cache.join("documents/lock")).unwrap();
    set_writable(&cache, false);
    let finding = doctor();
    let ended = run("read-only");
    // Before anything fails, so that the folder can be removed.
    set_writable(&cache, true);
    ended.expect(0);
    assert!(!cache.join("documents/lock").exists());
    let about = finding["about"].as_str().unwrap();
    assert_eq!((&finding["ok"], &finding["doubtful"]), (&true.into(), &true.into()), "{about}");
    assert!(about.contains("cannot be written") && about.contains("MEMTRANSFER_CACHE"), "{about}");

    // What is missing is built only where it can be written, and the message says where it cannot.
    fs::remove_dir_all(cache.join("documents")).unwrap();
    set_writable(&cache, false);
    let ended = run("missing");
    set_writable(&cache, true);
    let said = ended.expect(2).stderr;
    assert!(said.contains("cannot create ") && said.contains("documents"), "{said}");
}

/// A suite's command is started once the command line allows it.
#[test]
fn commands_of_a_suite_are_started_when_they_are_allowed() {
    let bench = Bench::new();
    let policy = memtransfer_tests::program("policy-proc");
    let command = format!("{} serve --policy random", policy.display());
    let suite =
        format!("policy-cmd = \"{command}\"\nmemory = [\"working\"]\nlimit = 1\nmax-steps = 4");
    fs::write(bench.out("suite.toml"), suite).unwrap();
    let args = ["run", "--suite", "./suite.toml", "--out", "run"];
    assert!(bench.run(&args).expect(2).stderr.contains("--allow-commands"));
    let ended = bench.run(&[&args[..], &["--allow-commands"]].concat()).expect(0);
    assert!(ended.stderr.contains(&format!("policy-cmd: {command}")), "{}", ended.stderr);
}
