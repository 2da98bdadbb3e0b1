//! Policies, memories and worlds in Python whose process ends, or is interrupted, in one of ten cases.

use std::process::{ChildStderr, ChildStdout};

use super::*;

const CASES: usize = 10;

/// The command that starts `faulty.py` in a role.
fn faulty(role: &str, fault: &str) -> String {
    script("tests/faulty.py", &format!("{role} {fault}"))
}

/// A run of all ten cases with a policy, a memory and a world, whose commands are `flags`, not started yet.
fn parcels(bench: &Bench, out: &str, flags: &[&str]) -> Command {
    let mut command = bench.command(&["run", "--out", out, "--starts", "original"]);
    command.args(words("--lanes 3 --max-steps 20 --frame-size 64")).args(flags);
    command.env("PYTHONPATH", package());
    command
}

/// As [`parcels`], where the process with `role` has a fault.
fn with_fault(bench: &Bench, out: &str, role: &str, fault: &str) -> Command {
    let of = |one| faulty(one, if one == role { fault } else { "none" });
    let (policy, memory, world) = (of("policy"), of("memory"), of("world"));
    let flags = ["--policy-cmd", &policy, "--memory", "none", "--memory-cmd", &memory];
    parcels(bench, out, &[&flags[..], &["--world-cmd", &world]].concat())
}

/// The log without the episodes of the case that is a role's victim.
fn without_victim(log: &[String], case: &str) -> Vec<String> {
    log.iter().filter(|line| !line.contains(case)).cloned().collect()
}

#[test]
fn a_process_that_ends_in_one_case_costs_that_case_and_no_other() {
    let bench = Bench::new();
    finish(with_fault(&bench, "reference", "none", "")).expect(0);
    let reference = sorted_log(&bench.out("reference"));
    assert_eq!(reference.len(), CASES);
    let dies = |how| ["fails whenever this episode runs, even alone", how];
    for (role, case, fault, said) in [
        ("policy", "parcel-2", "exit", ["policy east raised SystemExit", "I have had enough"]),
        ("memory", "parcel-5", "exit", ["raised SystemExit", "I have had enough"]),
        ("world", "parcel-7", "exit", ["SystemExit", "I have had enough"]),
        ("policy", "parcel-2", "exit-at-once", dies("ended with exit status 3; the last lines of")),
        ("memory", "parcel-5", "exit-at-once", dies("ended with exit status 3; the last lines of")),
        ("world", "parcel-7", "crash", dies("signal 11")),
    ] {
        let out = format!("{role}-{fault}");
        let ended = finish(with_fault(&bench, &out, role, fault)).expect(1);
        let errors = json_lines(&bench.out(&out).join("errors.jsonl"));
        let [error] = &errors[..] else { panic!("{out}: {errors:?}\n{}", ended.stderr) };
        let error = error.to_string();
        assert!(error.contains(case), "{out}: {error}");
        assert!(said.iter().all(|said| error.contains(said)), "{out}: {error}");
        assert_eq!(fault == "exit-at-once", error.contains("I leave"), "{out}: {error}");
        let is_restarted = ended.stderr.contains("starting again");
        assert_eq!(is_restarted, fault != "exit", "{out}: {}", ended.stderr);
        assert_eq!(sorted_log(&bench.out(&out)), without_victim(&reference, case), "{out}");
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// Waits for a line of the run that names how to start a role, and returns the words of that line. What follows is to be read, too.
fn told(lines: &mut impl Iterator<Item = String>, role: &str) -> Vec<String> {
    lines.find(|line| line.contains(&format!("Start your {role}"))).unwrap();
    let line = lines.next().unwrap();
    words(&line).into_iter().map(str::to_owned).collect()
}

fn lines_of(output: ChildStderr) -> impl Iterator<Item = String> {
    BufReader::new(output).lines().map(Result::unwrap)
}

/// The lines that a process prints, as they come.
fn printed_by(output: ChildStdout) -> impl Iterator<Item = String> {
    BufReader::new(output).lines().map(Result::unwrap)
}

/// The folder in `MEMTRANSFER_ATTACH=FOLDER`.
fn folder_in(words: &[String]) -> &str {
    words.iter().find_map(|word| word.strip_prefix("MEMTRANSFER_ATTACH=")).unwrap()
}

#[test]
fn a_run_waits_for_what_is_interrupted_and_goes_on_with_the_same_episode() {
    let bench = Bench::new();
    finish(with_fault(&bench, "reference", "none", "")).expect(0);
    let book = bench.out("book");
    let book = book.to_str().unwrap();
    python(&["tests/faulty.py", "world", "none", "book", "--out", book], &[]).expect(0);
    let flags = ["--policy", "external", "--memory", "external", "--world", "external"];
    let mut run = parcels(&bench, "attached", &[&flags[..], &["--world-book", book]].concat())
        .spawn()
        .unwrap();
    let mut lines = lines_of(run.stderr.take().unwrap());

    let counts = ["memory", "policy", "world"].map(|role| bench.out(&format!("{role}-interrupts")));
    let [of_memory, of_policy, of_world] = counts.each_ref().map(|path| path.to_str().unwrap());
    let in_memory = told(&mut lines, "memory");
    let memory = ["tests/faulty.py", "memory", "interrupt", folder_in(&in_memory)];
    let mut memory = start_python(&memory, &[("FAULTY_INTERRUPTS", of_memory)]);
    let mut printed = printed_by(memory.stdout.take().unwrap());
    let (in_world, in_policy) = (told(&mut lines, "world"), told(&mut lines, "policy"));
    std::thread::spawn(move || lines.for_each(drop));
    // It waits for the others, and no Python code runs.
    send(memory.id(), Signal::INT);
    assert_eq!(printed.next().unwrap(), "interrupted");
    let policy = ["tests/faulty.py", "policy", "interrupt", folder_in(&in_policy)];
    let policy = start_python(&policy, &[("FAULTY_INTERRUPTS", of_policy)]);
    // The program of a world ends with status 130, and is started again by hand.
    let verb = in_world.iter().position(|word| word == "serve").unwrap();
    let mut world = vec!["tests/faulty.py", "world", "interrupt"];
    world.extend(in_world[verb..].iter().map(String::as_str));
    let variables = [("FAULTY_INTERRUPTS", of_world), ("MEMTRANSFER_ATTACH", folder_in(&in_world))];
    for _ in 0..3 {
        let interrupted = python(&world, &variables).expect(130);
        assert!(!interrupted.stderr.contains("Traceback"), "{}", interrupted.stderr);
    }
    python(&world, &variables).expect(0);
    assert_eq!(Ended::of(run).status, Some(0));
    let interrupts = printed.filter(|line| line == "interrupted").count();
    assert_eq!(interrupts, 3);
    Ended::of(memory).expect(0);
    let policy = Ended::of(policy).expect(0);
    assert_eq!(policy.stdout, "interrupted\n".repeat(3));
    for count in counts {
        assert_eq!(fs::read_to_string(count).unwrap(), "xxx");
    }
    assert_eq!(sorted_log(&bench.out("attached")), sorted_log(&bench.out("reference")));
    assert_eq!(json_lines(&bench.out("attached").join("errors.jsonl")), Vec::<Value>::new());
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_memory_that_cannot_be_copied_is_refused_with_what_to_pass() {
    let source = "import threading, memtransfer as m\n\
        class Locked(m.Memory):\n\
        \x20def __init__(self): self.lock = threading.Lock()\n\
        \x20def recall(self, query): return []\n";
    let said = "Locked(...) cannot be copied, and each bank of demonstrations gets a copy (TypeError: cannot pickle \
                '_thread.lock' object): pass the class: Locked, not Locked(...)";
    for call in ["m.run(Locked())", "m.evaluate(memory=Locked(), out='never')"] {
        let ended = python(&["-c", &format!("{source}{call}")], &[]).expect(1);
        assert!(ended.stderr.trim_end().ends_with(said), "{}", ended.stderr);
    }
    let ended = python(&["-c", &format!("{source}m.run(Locked)")], &[]).expect(2);
    assert!(ended.stderr.contains("MEMTRANSFER_ATTACH is not set"), "{}", ended.stderr);
}
