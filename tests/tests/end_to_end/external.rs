//! External policies: started by a command, or attached to a waiting run.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use memtransfer_tests::{
    Bench, Ended, eventually, kill, process_of, processes_with, program, sorted_log, stop,
    wait_for_episodes, write_program,
};

/// The arguments of a run of twelve episodes. An external policy that is `grounded` needs plates as the built-in one does.
fn slice<'a>(out: &'a str, lanes: &'a str, policy: &[&'a str]) -> Vec<&'a str> {
    let mut args = vec!["run", "--suite", "quick", "--cases", "t01-01,t03-02,t09-05"];
    args.extend(["--memory", "working,full-context", "--plates", "on"]);
    args.extend(["--lanes", lanes, "--out", out]);
    args.extend(policy);
    args
}

/// The command that starts a built-in policy as an external one.
fn built_in(policy: &str) -> String {
    format!("{} serve --policy {policy}", program("policy-proc").display())
}

/// The log with the built-in policy, which every way of starting it must reproduce.
fn reference(bench: &Bench) -> Vec<String> {
    bench.run(&slice("reference", "4", &["--policy", "grounded"])).expect(0);
    let log = sorted_log(&bench.out("reference"));
    assert_eq!(log.len(), 12);
    log
}

#[test]
fn killing_a_policy_command_changes_no_log_and_leaves_nothing_behind() {
    let bench = Bench::new();
    let reference = reference(&bench);
    // The command also starts a process that does not exit by itself.
    let mark = format!("86400.{:010}", std::process::id());
    let command = format!("sh -c 'sleep {mark} & {}; exit $?'", built_in("grounded"));
    let child = bench.start(&slice("killed", "4", &["--policy-cmd", &command]));
    wait_for_episodes(&bench.out("killed"), 1);
    kill(process_of(bench.registry.path(), "policy"));
    let ended = Ended::of(child).expect(0);
    assert!(ended.stderr.contains("the policy process (`sh -c "), "{}", ended.stderr);
    assert!(ended.stdout.contains("was started with `sh -c "), "{}", ended.stdout);
    assert_eq!(sorted_log(&bench.out("killed")), reference);
    // Killed, it ends when it has a turn.
    eventually("the process that the command started to end", || {
        processes_with(mark.as_bytes()).is_empty().then_some(())
    });
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_command_that_is_not_a_policy_is_explained() {
    let bench = Bench::new();
    let refused = |command: &str, messages: &[&str]| {
        // Longer than the other processes take to be ready.
        let flags = ["--policy-cmd", command, "--start-timeout", "20"];
        let ended = bench.run(&slice("refused", "4", &flags)).expect(2);
        for message in messages {
            assert!(ended.stderr.contains(message), "{command}: {}", ended.stderr);
        }
    };
    refused("python 'half", &["--policy-cmd: `python 'half` is not a program"]);
    refused("./no-such-policy --x", &["cannot start the policy command `./no-such-policy --x`"]);
    std::fs::write(bench.out("script"), "print('hello')").unwrap();
    refused("./script", &["is not executable", "chmod +x"]);
    refused(
        "sh -c 'echo I cannot find my model >&2; exit 3'",
        &["ended with exit status 3", "I cannot find my model", "memtransfer conformance"],
    );
    refused("sleep 1000", &["was not ready after 20 s", "MEMTRANSFER_ATTACH"]);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// Starts a built-in policy without supervision.
fn attach(run: &Path) -> Child {
    let mut policy = Command::new(program("policy-proc"));
    policy.args(["serve", "--policy", "grounded"]).env("MEMTRANSFER_ATTACH", run);
    policy.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    policy.spawn().unwrap()
}

/// Reads the run's progress until it names the folder to attach to; the rest is read and dropped.
fn folder_to_attach_to(child: &mut Child) -> PathBuf {
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let folder = lines
        .by_ref()
        .find_map(|line| {
            let line = line.unwrap();
            let (_, folder) = line.split_once("MEMTRANSFER_ATTACH=")?;
            Some(PathBuf::from(folder.split_whitespace().next()?))
        })
        .unwrap();
    std::thread::spawn(move || lines.for_each(drop));
    folder
}

#[test]
fn a_run_waits_for_a_policy_to_attach_and_to_attach_again() {
    let bench = Bench::new();
    let reference = reference(&bench);
    let mut child = bench.start(&slice("attached", "4", &["--policy", "external"]));
    let run = folder_to_attach_to(&mut child);
    let mut first = attach(&run);
    wait_for_episodes(&bench.out("attached"), 1);

    // The second tries for two seconds, in which the run would end.
    stop(first.id());
    let second = Ended::of(attach(&run)).expect(2);
    assert!(second.stderr.contains("the run already has a policy process"), "{}", second.stderr);

    // The first policy is a zombie while the third attaches.
    let before = sorted_log(&bench.out("attached")).len();
    kill(first.id());
    let third = attach(&run);
    wait_for_episodes(&bench.out("attached"), before + 1);
    // The other processes are restarted, and the policy joins the new generation.
    kill(process_of(bench.registry.path(), "sim"));
    Ended::of(child).expect(0);
    first.wait().unwrap();
    Ended::of(third).expect(0);
    assert_eq!(sorted_log(&bench.out("attached")), reference);
    assert_eq!(bench.leftovers(), Vec::<String>::new());

    let late = Ended::of(attach(&run)).expect(2);
    assert!(late.stderr.contains("is not the folder of a run"), "{}", late.stderr);
}

#[test]
fn an_attached_policy_ends_with_the_orchestrator() {
    let bench = Bench::new();
    let mut child = bench.start(&slice("gone", "4", &["--policy", "external"]));
    let run = folder_to_attach_to(&mut child);
    let policy = attach(&run);
    wait_for_episodes(&bench.out("gone"), 1);
    kill(child.id());
    child.wait().unwrap();
    let policy = Ended::of(policy).expect(2);
    assert!(policy.stderr.contains("ended without a stop message"), "{}", policy.stderr);
    bench.run(&["clean"]).expect(0);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// The instruction of a case.
pub(crate) fn instruction(case: &str) -> String {
    let (warehouse, cases) = (warehouse::Warehouse::shipped(), warehouse::CaseSet::shipped());
    let case = cases.cases.iter().find(|other| other.id == case).unwrap();
    case.task.instruction(&warehouse.catalogue)
}

/// Runs six short episodes with a policy that fails one of them, and returns the errors of the run.
fn run_with_fault(bench: &Bench, fault: &str, out: &str) -> (Ended, Vec<String>) {
    let cases = "t01-01,t02-02,t03-02,t05-03,t07-04,t09-05";
    let command = format!(
        "{} {fault} '{}'",
        program("misbehaving-policy").display(),
        instruction("t03-02").replace('\'', r"'\''")
    );
    let mut args = vec!["run", "--suite", "quick", "--cases", cases, "--memory", "working"];
    args.extend(["--starts", "original", "--max-steps", "20", "--step-timeout", "10"]);
    args.extend(["--lanes", "6", "--out", out, "--policy-cmd", &command]);
    let ended = bench.run(&args);
    let errors = std::fs::read_to_string(bench.out(out).join("errors.jsonl")).unwrap_or_default();
    (ended, errors.lines().map(str::to_owned).collect())
}

#[test]
fn a_fault_in_one_episode_costs_that_episode_only() {
    let bench = Bench::new();
    for (fault, said) in [
        ("crash-on", "I cannot stand this one"),
        ("silent-on", " s (--step-timeout) and seems to hang"),
    ] {
        let (ended, errors) = run_with_fault(&bench, fault, fault);
        let ended = ended.expect(1);
        let [error] = &errors[..] else { panic!("{fault}: {errors:?}\n{}", ended.stderr) };
        assert!(error.contains("t03-02") && error.contains(said), "{error}");
        let finished = sorted_log(&bench.out(fault));
        assert_eq!(finished.len(), 5, "{fault}: {}", ended.stderr);
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// The arguments of a run of six short episodes without a memory, and six with the memory of `command`.
fn with_memory<'a>(out: &'a str, command: &'a str, lanes: &'a str) -> Vec<&'a str> {
    let cases = "t01-01,t02-02,t03-02,t05-03,t07-04,t09-05";
    let mut args = vec!["run", "--suite", "quick", "--cases", cases, "--memory", "working"];
    args.extend(["--starts", "original", "--max-steps", "20", "--frame-size", "64"]);
    args.extend(["--policy", "random", "--lanes", lanes, "--out", out, "--memory-cmd", command]);
    args
}

/// The command of a memory with a fault in the episodes of case t03-02.
fn faulty_memory(fault: &str) -> String {
    let victim = instruction("t03-02").replace('\'', r"'\''");
    format!("{} {fault} '{victim}'", program("misbehaving-memory").display())
}

/// The episodes of a run that ended without a result, and why.
fn errors(run: &Path) -> Vec<String> {
    let errors = std::fs::read_to_string(run.join("errors.jsonl")).unwrap_or_default();
    errors.lines().map(str::to_owned).collect()
}

#[test]
fn what_is_too_long_costs_its_own_episode_and_no_other() {
    let bench = Bench::new();
    let too_long = "17000000 bytes together, and at most 16777216 can be sent";
    for (fault, said) in [
        ("huge-text", too_long),
        ("huge-reason", too_long),
        ("sdk-huge-text", too_long),
        ("sdk-huge-reason", "xxxx"),
    ] {
        let command = faulty_memory(fault);
        let ended = bench.run(&with_memory(fault, &command, "6")).expect(1);
        let out = bench.out(fault);
        let [error] = &errors(&out)[..] else { panic!("{fault}: {}", ended.stderr) };
        assert!(error.contains("t03-02") && error.contains(said), "{fault}: {error}");
        assert!(error.len() < 4096, "{fault}: {} bytes", error.len());
        assert_eq!(sorted_log(&out).len(), 11, "{fault}: {}", ended.stderr);
        assert!(!ended.stderr.contains("starting again"), "{fault}: {}", ended.stderr);
        // Neither does a log repeat it.
        for log in std::fs::read_dir(out.join("logs")).unwrap() {
            let log = log.unwrap();
            assert!(log.metadata().unwrap().len() < 100_000, "{fault}: {:?}", log.path());
        }
    }
    let command = faulty_memory("huge-build");
    bench.run(&with_memory("huge-build", &command, "6")).expect(1);
    let errors = errors(&bench.out("huge-build"));
    assert_eq!(errors.len(), 6, "{errors:?}");
    assert!(errors.iter().all(|error| error.contains(too_long)), "{errors:?}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn what_is_too_long_at_the_start_is_refused_with_size_and_limit() {
    let bench = Bench::new();
    let command = faulty_memory("huge-description");
    let refused = bench.run(&with_memory("description", &command, "6")).expect(2).stderr;
    let said = "description.json is a file of 17000040 bytes, but must be at most 65536";
    assert!(refused.contains(said), "{refused}");
    let policy = format!("{} long-name", program("misbehaving-policy").display());
    let refused = bench.run(&slice("name", "4", &["--policy-cmd", &policy])).expect(2).stderr;
    // The facts that the SDK adds count as well.
    let said = ["the facts of the policy's handshake have 170000", " bytes of JSON, and 492 fit"];
    assert!(said.iter().all(|said| refused.contains(said)), "{refused}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_program_that_closes_its_queues_and_does_not_end_is_named() {
    let bench = Bench::new();
    // Its other episodes may have to wait for it as well.
    let command = faulty_memory("leaves");
    let ended = bench.run(&with_memory("memory", &command, "6")).expect(1);
    let out = bench.out("memory");
    let errors = errors(&out);
    assert!(!errors.is_empty() && errors.len() <= 6, "{errors:?}");
    let said = "external memory leaves has closed its queues, and its process has not ended";
    assert!(errors.iter().all(|error| error.contains(said)), "{errors:?}");
    assert!(!ended.stderr.contains("sim process"), "{}", ended.stderr);
    let finished = sorted_log(&out);
    let of_others = finished.iter().filter(|line| line.contains("\"working\"")).count();
    assert_eq!(of_others, 6, "{}", ended.stderr);

    let policy = format!("{} leaves", program("misbehaving-policy").display());
    let ended = bench.run(&slice("policy", "4", &["--policy-cmd", &policy, "--step-timeout", "5"]));
    let said = "the policy process has closed its queues and has not ended";
    assert!(ended.stderr.contains(said), "{}", ended.stderr);
    assert!(!ended.stderr.contains("the sim process ended"), "{}", ended.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn changed_code_is_refused_as_another_version_is() {
    let bench = Bench::new();
    let refused = |args: &[&str], difference: &str| {
        let refused = bench.run(args).expect(2).stderr;
        assert!(refused.contains(difference), "{refused}");
        assert!(refused.contains("Use the same settings and code to continue it"), "{refused}");
    };
    // A compiled program, which is named by its path.
    let memory = bench.out("my-memory");
    let bytes = std::fs::read(program("misbehaving-memory")).unwrap();
    write_program(&memory, &bytes);
    let command = "./my-memory well-behaved";
    let args = with_memory("memory", command, "4");
    bench.run(&args).expect(0);
    bench.run(&args).expect(0);
    write_program(&memory, [bytes, vec![0]].concat());
    refused(&args, "file ./my-memory of memory well-behaved: ");
    bench.run(&[&args[..], &["--fresh"]].concat()).expect(0);

    // The same, where the SDK tells it: the command names another file.
    let sdk = bench.out("sdk-memory");
    let bytes = std::fs::read(program("misbehaving-memory")).unwrap();
    write_program(&sdk, &bytes);
    std::fs::write(bench.out("start"), format!("exec {} sdk-huge-text none\n", sdk.display()))
        .unwrap();
    let args = with_memory("sdk", "sh start", "4");
    bench.run(&args).expect(0);
    write_program(&sdk, [bytes, vec![0]].concat());
    refused(&args, r#"code of memory sdk-huge-text: "sdk-memory="#);

    // A script of a policy; and what its SDK tells when it has started.
    let script = bench.out("policy.sh");
    let policy = bench.out("my-policy");
    let bytes = std::fs::read(program("misbehaving-policy")).unwrap();
    write_program(&policy, &bytes);
    let text = format!("exec {} crash-on nothing\n", policy.display());
    std::fs::write(&script, &text).unwrap();
    let args = |limit| {
        let mut args = vec!["run", "--memory", "working", "--starts", "original", "--limit", limit];
        args.extend(["--max-steps", "5", "--policy-cmd", "sh policy.sh", "--out", "policy"]);
        args
    };
    bench.run(&args("1")).expect(0);
    std::fs::write(&script, format!("# Changed.\n{text}")).unwrap();
    refused(&args("2"), "file policy.sh of the policy: ");
    std::fs::write(&script, &text).unwrap();
    bench.run(&args("2")).expect(0);
    write_program(&policy, [bytes, vec![0]].concat());
    refused(&args("3"), r#"code of the policy: my-policy="#);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}
