//! Runs that end in unusual ways: they leave nothing behind, and let no one in meanwhile.

use std::ffi::OsStr;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use memtransfer_tests::{
    Bench, Ended, eventually, hold, kill, process_of, processes_with, program, resume,
    shared_memory_of, signal, stop, wait_for_episodes,
};
use rustix::process::{Signal, geteuid};

/// The arguments of a run that goes on for longer than a test.
fn endless(out: &str) -> Vec<&str> {
    let mut args = vec!["run", "--cases", "t01-01,t03-02", "--memory", "working,full-context"];
    args.extend(["--frame-size", "64", "--lanes", "2", "--runs", "1000", "--out", out]);
    args
}

fn terminate(pid: u32) {
    signal(pid, Signal::TERM);
}

/// Longer than the time in which a second signal is the same request.
const ANOTHER_REQUEST: Duration = Duration::from_secs(1);

/// Another user who can write to what a run has in shared memory can stop it.
#[test]
fn everything_that_a_run_has_in_shared_memory_is_for_its_user_only() {
    let bench = Bench::new();
    let policy = format!("{} serve --policy random", program("policy-proc").display());
    let args = [&endless("run")[..], &["--policy-cmd", &policy]].concat();
    let child = bench.start(&args);
    wait_for_episodes(&bench.out("run"), 2);
    let names = shared_memory_of(&bench.runs());
    assert!(names.len() > 20, "{names:?}");
    for name in names {
        // A segment that has just gone needs no mode.
        let Ok(about) = fs::metadata(Path::new("/dev/shm").join(&name)) else { continue };
        assert_eq!(about.permissions().mode() & 0o077, 0, "{name}");
    }
    terminate(child.id());
    Ended::of(child);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// `timeout` sends its signal to the process and to its group. These arrive together: the process is stopped meanwhile, and of two
/// alike it would get one.
#[test]
fn a_signal_that_arrives_twice_stops_a_run_once() {
    let bench = Bench::new();
    for out in ["first", "second", "third"] {
        let child = bench.start(&endless(out));
        wait_for_episodes(&bench.out(out), 1);
        assert!(hold(child.id()));
        terminate(child.id());
        signal(child.id(), Signal::INT);
        resume(child.id());
        let ended = Ended::of(child);
        assert!(matches!(ended.status, Some(130 | 143)), "{:?}: {}", ended.status, ended.stderr);
        assert!(ended.stderr.contains("stopped by SIG"), "{}", ended.stderr);
        assert!(!ended.stderr.contains("at once"), "{}", ended.stderr);
        assert_eq!(bench.leftovers(), Vec::<String>::new());
    }
}

/// Stops the policy, so that the run cannot end soon, and sends signals to the process `pid` until `child` has ended: the process may
/// notice the first one late.
fn terminate_again(bench: &Bench, pid: u32, child: Child) -> Ended {
    stop(process_of(bench.registry.path(), "policy"));
    terminate(pid);
    let (running, ended) = mpsc::channel::<()>();
    thread::scope(|scope| {
        scope.spawn(move || {
            while ended.recv_timeout(ANOTHER_REQUEST) == Err(mpsc::RecvTimeoutError::Timeout) {
                terminate(pid);
            }
        });
        let ended = Ended::of(child);
        drop(running);
        ended
    })
}

#[test]
fn a_second_signal_ends_a_run_at_once_and_leaves_nothing() {
    let bench = Bench::new();
    let child = bench.start(&endless("run"));
    wait_for_episodes(&bench.out("run"), 1);
    let ended = terminate_again(&bench, child.id(), child).expect(143);
    assert!(ended.stderr.contains("ended at once by a second SIGTERM"), "{}", ended.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// The kernel ignores signals without a handler that are sent to the first process of a container.
#[test]
fn the_first_process_of_a_container_ends_as_any_other() {
    let bench = Bench::new();
    let mut unshare = vec!["--pid", "--fork"];
    if !geteuid().is_root() {
        unshare.extend(["--user", "--map-root-user"]);
    }
    let works = Command::new("unshare").args(&unshare).arg("true").output();
    if !works.is_ok_and(|output| output.status.success()) {
        println!("not tested: this machine allows no process namespaces");
        return;
    }
    // Without a policy in the namespace: seen from outside, it could not be distinguished from others.
    let command = bench.command(&endless("run"));
    let mut contained = bench.command(&[]);
    contained = {
        let mut unshared = Command::new("unshare");
        unshared.args(&unshare).arg(contained.get_program()).args(command.get_args());
        unshared.current_dir(bench.folder.path());
        unshared.env("MEMTRANSFER_RUN_DIR", bench.registry.path());
        unshared.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        unshared
    };
    let child = contained.spawn().unwrap();
    wait_for_episodes(&bench.out("run"), 1);
    let ended = terminate_again(&bench, child_of(&child), child);
    assert_eq!(ended.status, Some(143), "{}", ended.stderr);
    assert!(ended.stderr.contains("ended at once by a second SIGTERM"), "{}", ended.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// The child of a process that has one.
fn child_of(parent: &Child) -> u32 {
    let pid = parent.id();
    let children = fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).unwrap();
    children.split_whitespace().next().unwrap().parse().unwrap()
}

/// However it ends, and whichever of its threads has started the run.
#[test]
fn a_run_stops_with_the_process_that_it_is_told_to_die_with() {
    let bench = Bench::new();
    let begin = |out: &str, more: &[&str]| {
        let parent = Command::new("sleep").arg("86399").spawn().unwrap();
        let pid = parent.id().to_string();
        let child = bench.start(&[&endless(out)[..], &["--die-with", &pid], more].concat());
        (parent, child)
    };
    for (out, more) in [("kept", &[][..]), ("discarded", &["--discard"])] {
        let (mut parent, child) = begin(out, more);
        wait_for_episodes(&bench.out(out), 1);
        parent.kill().unwrap();
        parent.wait().unwrap();
        let ended = Ended::of(child).expect(143);
        assert!(ended.stderr.contains("stopped by SIGTERM: "), "{}", ended.stderr);
        // The command to resume it does not name a process that has ended.
        assert!(!ended.stderr.contains("--die-with"), "{}", ended.stderr);
        assert_eq!(bench.leftovers(), Vec::<String>::new());
        assert_eq!(bench.out(out).exists(), out == "kept");
    }
    // The end of the run is no reason to remove it.
    let (mut parent, child) = begin("ended", &["--discard"]);
    wait_for_episodes(&bench.out("ended"), 1);
    terminate(child.id());
    Ended::of(child).expect(143);
    assert!(bench.out("ended").exists());
    let pid = parent.id().to_string();
    parent.kill().unwrap();
    parent.wait().unwrap();
    let ended = bench.run(&[&endless("never")[..], &["--die-with", &pid]].concat()).expect(2);
    assert!(ended.stderr.contains(&format!("cannot watch process {pid}")), "{}", ended.stderr);
    assert!(!bench.out("never").exists());
}

/// A program that does not know what it was started for, and what it has started.
#[test]
fn commands_that_are_not_on_the_bus_end_with_the_orchestrator() {
    let bench = Bench::new();
    for flag in ["--policy-cmd", "--memory-cmd"] {
        // Of one length: the mark of no other test begins with it.
        let mark = format!("86399.{:010}", std::process::id());
        let command = format!("sh -c 'sleep {mark} & sleep {mark}; exit 1'");
        let out = flag.trim_start_matches('-');
        let args = ["run", "--limit", "1", flag, &command, "--out", out];
        let child = bench.start(&args);
        eventually("the command to start", || {
            (processes_with(mark.as_bytes()).len() >= 4).then_some(())
        });
        kill(child.id());
        Ended::of(child);
        eventually("the command to end", || {
            processes_with(mark.as_bytes()).is_empty().then_some(())
        });
    }
}

#[test]
fn an_interrupted_doctor_leaves_nothing_and_a_killed_one_what_clean_removes() {
    let bench = Bench::new();
    let scratch = bench.out("tmp");
    fs::create_dir(&scratch).unwrap();
    let marker = scratch.as_os_str().as_encoded_bytes();
    let in_scratch = |args: &[&str]| {
        let mut command = bench.command(args);
        command.env("TMPDIR", &scratch);
        command
    };
    // The process that renders or embeds is held, so that the doctor cannot be over before the signal comes.
    let started = || loop {
        let mut child = in_scratch(&["doctor"]).spawn().unwrap();
        let is_held = eventually("a view to be rendered or embedded", || {
            let is_held = processes_with(marker).into_iter().any(hold);
            let is_over = child.try_wait().unwrap().is_some();
            (is_held || is_over).then_some(is_held)
        });
        if is_held {
            return child;
        }
    };
    let child = started();
    terminate(child.id());
    let ended = Ended::of(child).expect(143);
    assert!(ended.stderr.contains("stopped by SIGTERM"), "{}", ended.stderr);
    assert_eq!(fs::read_dir(&scratch).unwrap().count(), 0);
    assert!(processes_with(marker).is_empty());

    let child = started();
    kill(child.id());
    Ended::of(child);
    eventually("its child to end", || processes_with(marker).is_empty().then_some(()));
    let left: Vec<_> = fs::read_dir(&scratch).unwrap().flatten().collect();
    assert_eq!(left.len(), 1);
    let ended = Ended::run(&mut in_scratch(&["clean"])).expect(0);
    let name = left[0].file_name().into_string().unwrap();
    assert!(ended.stdout.contains(&name), "{}", ended.stdout);
    assert_eq!(fs::read_dir(&scratch).unwrap().count(), 0);
}

/// What a killed `plan --store` or `work` was copying.
#[test]
fn clean_removes_unfinished_copies_from_store_and_cache() {
    let bench = Bench::new();
    let (store, models) = (bench.out("store"), bench.out("cache/models"));
    for folder in [&store, &models] {
        fs::create_dir_all(folder).unwrap();
        fs::write(folder.join(".memtransfer-draft-a1b2c3"), "x").unwrap();
        fs::write(folder.join("object"), "x").unwrap();
    }
    let clean = |more: &[&str]| {
        let args = [&["clean", "--store", "store"], more].concat();
        let mut command = bench.command(&args);
        command.env("MEMTRANSFER_CACHE", bench.out("cache")).env("TMPDIR", bench.folder.path());
        Ended::run(&mut command).expect(0).stdout
    };
    let names = |folder: &Path| -> Vec<_> {
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect()
    };
    assert_eq!(clean(&["--dry-run"]).matches(".memtransfer-draft-a1b2c3").count(), 2);
    assert_eq!(names(&store).len(), 2);
    assert_eq!(clean(&[]).matches(".memtransfer-draft-a1b2c3").count(), 2);
    assert_eq!((names(&store), names(&models)), (vec!["object".into()], vec!["object".into()]));
    assert_eq!(names(&store), [OsStr::new("object")]);
    assert!(clean(&[]).contains("nothing to clean"));
}

/// Memory waits for frames: its answers are overdue, too.
#[test]
fn a_stopped_simulator_is_the_one_that_hangs() {
    let bench = Bench::new();
    let args = ["run", "--cases", "t01-01,t03-02,t09-05", "--memory", "working,full-context"];
    let limits = ["--lanes", "2", "--runs", "20", "--step-timeout", "30", "--out", "run"];
    let child = bench.start(&[&args[..], &limits].concat());
    wait_for_episodes(&bench.out("run"), 2);
    stop(process_of(bench.registry.path(), "sim"));
    let ended = Ended::of(child).expect(0);
    assert!(ended.stderr.contains("the sim process has not "), "{}", ended.stderr);
    assert!(!ended.stderr.contains("the memory process"), "{}", ended.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
