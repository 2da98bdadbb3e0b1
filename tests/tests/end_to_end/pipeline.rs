//! Whole runs: four processes, rendered frames, the real encoder.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use memtransfer_tests::{
    Bench, Ended, episodes, kill, needs, process_of, process_of_world, records, shared_memory_of,
    shutdown_total, sorted_log, success_rate, wait_for_episodes, words,
};
use png_file::RgbaImage;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// Cases of three kinds of tasks: single, exhaustive, revisit.
const FEW_CASES: &str = "t01-01,t03-02,t09-05";

/// The arguments of a run of these cases with all memories and both starts.
fn slice<'a>(out: &'a str, lanes: &'a str) -> Vec<&'a str> {
    let mut args = vec!["run", "--suite", "quick", "--policy", "grounded", "--cases", FEW_CASES];
    args.extend(["--max-steps", "40", "--lanes", lanes, "--out", out]);
    args
}

/// The log that every run of the slice must produce.
fn reference(bench: &Bench) -> Vec<String> {
    bench.run(&slice("reference", "1")).expect(0);
    let log = sorted_log(&bench.out("reference"));
    assert_eq!(log.len(), 36);
    log
}

#[test]
fn an_encoder_that_cannot_be_used_is_named() {
    let bench = Bench::new();
    let cache = bench.out("cache");
    for (flags, said) in [
        (["--encoder", "dinov3"], "unknown encoder `dinov3`; the model manifest has `dinov2-s14`"),
        (["--encoder-file", "nowhere.onnx"], "cannot read the model file nowhere.onnx"),
        (["--encoder", "dinov2-s14"], "which is not there; run `cargo xtask setup"),
    ] {
        let args = ["run", "--memory", "episodic", "--limit", "1", "--out", "run"];
        let mut command = bench.command(&[&args[..], &flags].concat());
        if flags[1] == "dinov2-s14" {
            command.env("MEMTRANSFER_CACHE", &cache);
        }
        let stderr = Ended::run(&mut command).expect(2).stderr;
        assert!(stderr.contains(said), "{flags:?}: {stderr}");
    }
}

#[test]
fn the_log_depends_neither_on_lanes_nor_on_crashes() {
    let bench = Bench::new();
    let reference = reference(&bench);
    bench.run(&slice("wide", "32")).expect(0);
    assert_eq!(sorted_log(&bench.out("wide")), reference, "1 lane or 32");

    let child = bench.start(&slice("parts-killed", "4"));
    let roles = [("sim", 2), ("memory", 8), ("policy", 14)];
    for (role, after) in roles {
        wait_for_episodes(&bench.out("parts-killed"), after);
        kill(process_of(bench.registry.path(), role));
    }
    let ended = Ended::of(child).expect(0);
    for (role, _) in roles {
        assert!(ended.stderr.contains(&format!("the {role} process")), "{}", ended.stderr);
    }
    assert_eq!(sorted_log(&bench.out("parts-killed")), reference, "its processes killed in turn");

    let child = bench.start(&slice("killed", "4"));
    wait_for_episodes(&bench.out("killed"), 2);
    bench.kill_run(child);
    let dead = bench.runs();
    assert!(!shared_memory_of(&dead).is_empty(), "kill -9 leaves shared memory behind");
    let before = episodes(&bench.out("killed"));
    assert!(
        sorted_log(&bench.out("killed")).len() < reference.len(),
        "the run was over before the kill"
    );
    bench.run(&slice("killed", "4")).expect(0);
    assert_eq!(sorted_log(&bench.out("killed")), reference, "orchestrator killed");
    let whole_lines = &before[..before.rfind('\n').map_or(0, |end| end + 1)];
    let after = episodes(&bench.out("killed"));
    assert!(after.starts_with(whole_lines), "a finished episode is missing or was run twice");

    bench.run(&["clean"]).expect(0);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
    assert_eq!(shared_memory_of(&dead), Vec::<String>::new());
}

#[test]
fn the_log_depends_neither_on_the_number_of_worlds_nor_on_the_death_of_one() {
    let bench = Bench::new();
    let args = |out, worlds| [&slice(out, "6")[..], &["--worlds", worlds]].concat();
    for worlds in ["1", "3"] {
        bench.run(&args(worlds, worlds)).expect(0);
    }
    let reference = sorted_log(&bench.out("1"));
    assert_eq!(reference.len(), 36);
    assert_eq!(sorted_log(&bench.out("3")), reference);
    for log in ["sim.log", "sim-1.log", "sim-2.log"] {
        assert!(bench.out("3").join("logs").join(log).exists(), "{log}");
    }
    let manifest = fs::read_to_string(bench.out("3").join("manifest.json")).unwrap();
    let manifest: Value = serde_json::from_str(&manifest).unwrap();
    assert_eq!(manifest["processes"]["sim 2"], manifest["processes"]["sim"]);

    let child = bench.start(&args("killed", "3"));
    wait_for_episodes(&bench.out("killed"), 3);
    kill(process_of_world(bench.registry.path(), 2));
    let ended = Ended::of(child).expect(0);
    assert!(ended.stderr.contains("the sim process 2 ended on signal 9"), "{}", ended.stderr);
    assert_eq!(sorted_log(&bench.out("killed")), reference);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// A closed terminal sends SIGHUP, and usually twice: once for the shell and once for its jobs.
#[test]
fn a_closed_terminal_stops_a_run_and_nohup_lets_it_go_on() {
    let bench = Bench::new();
    let args = |out, runs| {
        let small = ["--memory", "working,full-context", "--frame-size", "64", "--runs", runs];
        [&slice(out, "1")[..], &small].concat()
    };
    // More than the machine can do before the signal comes.
    let endless = "1000";
    // The tests themselves may have been started by nohup.
    let listening = ["env", "--default-signal=HUP"];
    let child = through(&bench, &listening, &args("stopped", endless)).spawn().unwrap();
    wait_for_episodes(&bench.out("stopped"), 2);
    hang_up(child.id());
    hang_up(child.id());
    let ended = Ended::of(child);
    assert!(ended.stderr.contains("SIGHUP"), "{}", ended.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());

    // A terminal that is really closed: nothing more can be printed.
    let log = bench.out("closed").join("episodes.jsonl");
    let terminal = ["env", "--default-signal=HUP", "python3", "-c", IN_A_TERMINAL];
    let terminal = [&terminal[..], &[log.to_str().unwrap()]].concat();
    let child = through(&bench, &terminal, &args("closed", endless)).spawn().unwrap();
    Ended::of(child).expect(0);
    let sessions = fs::read_to_string(bench.out("closed").join("sessions.jsonl")).unwrap();
    assert!(sessions.contains("\"reason\":\"SIGHUP\""), "{sessions}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());

    let child = through(&bench, &["nohup"], &args("kept", "20")).spawn().unwrap();
    wait_for_episodes(&bench.out("kept"), 2);
    hang_up(child.id());
    Ended::of(child).expect(0);
    assert_eq!(records(&bench.out("kept")).len(), 20 * 12);
}

/// `memtransfer` with `args`, started by another program.
fn through(bench: &Bench, starter: &[&str], args: &[&str]) -> Command {
    let command = bench.command(args);
    let mut through = Command::new(starter[0]);
    through.args(&starter[1..]).arg(command.get_program()).args(command.get_args());
    through.current_dir(bench.folder.path()).env("MEMTRANSFER_RUN_DIR", bench.registry.path());
    through.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    through
}

/// Executes a command in a terminal, and closes the terminal when the log has two lines.
const IN_A_TERMINAL: &str = r#"
import os, pty, select, sys
log, *command = sys.argv[1:]
pid, terminal = pty.fork()
if pid == 0:
    os.execv(command[0], command)
lines = 0
while lines < 2:
    if select.select([terminal], [], [], 0.01)[0]:
        os.read(terminal, 65536)
    if os.path.exists(log):
        lines = open(log).read().count("\n")
os.close(terminal)
os.waitpid(pid, 0)
"#;

fn hang_up(pid: u32) {
    let pid = Pid::from_raw(pid.cast_signed()).unwrap();
    kill_process(pid, Signal::HUP).unwrap();
}

#[test]
fn the_expert_always_succeeds_and_the_random_policy_rarely() {
    let bench = Bench::new();
    // Neither policy looks at its frames, so small ones do.
    let all = ["--limit", "100", "--starts", "original,new", "--routes", "unchanged,blocked"];
    let expert = ["run", "--policy", "expert", "--frame-size", "64", "--out", "expert"];
    // A run of more cases and conditions goes on in the same folder, and finished episodes stay.
    bench.run(&[&expert[..], &["--limit", "20", "--starts", "new"]].concat()).expect(0);
    let before = episodes(&bench.out("expert"));
    assert_eq!(before.lines().count(), 20);
    bench.run(&[&expert[..], &all[..]].concat()).expect(0);
    assert!(episodes(&bench.out("expert")).starts_with(&before));
    let finished = records(&bench.out("expert"));
    assert_eq!(finished.len(), 300);
    assert_eq!(success_rate(&finished, |_| true), 100.0);
    assert!(finished.iter().all(|r| r["steps"] == r["reference"]), "an episode has an SPL below 1");

    let random = ["run", "--policy", "random", "--frame-size", "64", "--out", "random"];
    bench.run(&[&random[..], &all[..]].concat()).expect(0);
    let finished = records(&bench.out("random"));
    assert_eq!(finished.len(), 300);
    assert!(success_rate(&finished, |_| true) < 15.0);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn views_are_rendered_with_the_requested_backend() {
    let bench = Bench::new();
    let run = |out, backend: &[&str]| {
        let few = ["run", "--policy", "random", "--limit", "1", "--out", out];
        bench.run(&[&few[..], backend].concat())
    };
    run("cpu", &["--backend", "cpu"]).expect(0);
    let manifest = fs::read(bench.out("cpu").join("manifest.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    assert_eq!(manifest["processes"]["sim"]["backend"], "cpu");
    let Ended { stderr, .. } = run("abacus", &["--adapter", "abacus"]).expect(2);
    assert!(stderr.contains("contains \"abacus\"; there are: "), "{stderr}");
    assert!(stderr.contains("--backend cpu renders without one"), "{stderr}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// How many plates the reader finds in the views that a run logged, those that memory supplied among them.
fn plates_in_logged_views(run: &Path) -> usize {
    let views = fs::read_dir(run.join("prompts/images")).unwrap();
    let views: Vec<_> = views.map(|view| RgbaImage::read(&view.unwrap().path()).unwrap()).collect();
    assert!(views.len() > 20, "{} views", views.len());
    let read = |view: &RgbaImage| plates::read(view.width(), view.height(), view.as_bytes());
    views.iter().map(|view| read(view).len()).sum()
}

#[test]
fn frames_have_plates_for_the_policy_that_needs_them_and_for_no_other() {
    let bench = Bench::new();
    let run = |out, flags: &str| {
        let line = "run --cases t07-08 --starts original --max-steps 12 --log-prompts --out";
        bench.run(&[&words(line)[..], &[out], &words(flags)[..]].concat())
    };
    let Ended { stderr, .. } = run("refused", "--policy grounded --plates off").expect(2);
    assert!(stderr.contains("sees nothing but plates"), "{stderr}");
    assert!(!bench.out("refused").exists());
    for (out, flags, plates) in [
        ("grounded", "--policy grounded --memory full-context,episodic", "on"),
        // With every memory of the suite.
        ("imitate", "--policy imitate", "off"),
        ("asked-for", "--policy imitate --memory full-context --plates on", "on"),
    ] {
        run(out, flags).expect(0);
        let manifest = fs::read(bench.out(out).join("manifest.json")).unwrap();
        let manifest: Value = serde_json::from_slice(&manifest).unwrap();
        assert_eq!(manifest["settings"]["plates"], plates, "{out}");
        assert_eq!(plates_in_logged_views(&bench.out(out)) > 0, plates == "on", "{out}");
    }
    assert_eq!(records(&bench.out("imitate")).len(), 6);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn success_comes_from_pixels() {
    let bench = Bench::new();
    // Every fifth case: two of each task type.
    let cases: Vec<String> =
        (1..=10).flat_map(|task| [2, 7].map(|n| format!("t{task:02}-{n:02}"))).collect();
    let cases = cases.join(",");
    let rate = |frames: &str, memory: &str| {
        let out = format!("{frames}-{memory}");
        let mut args = vec!["run", "--policy", "grounded", "--starts", "original"];
        args.extend(["--memory", memory, "--frames", frames, "--cases", &cases, "--out", &out]);
        bench.run(&args).expect(0);
        success_rate(&records(&bench.out(&out)), |_| true)
    };
    let rendered = rate("rendered", "episodic");
    assert!(rendered >= 95.0, "episodic memory at the original start: {rendered} %");
    let without_memory = rate("rendered", "working");
    assert!(without_memory <= rendered - 30.0, "working {without_memory} %, episodic {rendered} %");
    for control in ["blank", "swapped"] {
        let controlled = rate(control, "episodic");
        assert!(controlled <= 30.0, "{control} frames: {controlled} %");
    }
}

/// Bytes that the process has read and written through system calls; `None` when it has ended.
fn bytes_through_system_calls(pid: u32) -> Option<u64> {
    let text = fs::read_to_string(format!("/proc/{pid}/io")).ok()?;
    let value =
        |key| text.lines().find_map(|line| line.strip_prefix(key)?.trim().parse::<u64>().ok());
    Some(value("rchar:")? + value("wchar:")?)
}

#[test]
fn no_pixel_crosses_a_process_boundary_by_copy() {
    let bench = Bench::new();
    let mut args = vec!["run", "--policy", "grounded", "--starts", "new", "--memory", "episodic"];
    args.extend(["--limit", "20", "--out", "copies"]);
    let registry = bench.registry.path();
    check_no_copies(bench.start(&args), &bench, "copies", || process_of(registry, "sim"));
}

/// Pixels can cross a process boundary in shared memory, in a message, or through a system call. Messages have no room
/// for them. Counts the bytes that go through system calls while frames of the default size are rendered, embedded and read, and
/// checks each process's own count of copied bytes. `run` is a run in the folder `out`, and `world` finds its world's process.
pub(crate) fn check_no_copies(
    mut run: Child,
    bench: &Bench,
    out: &str,
    world: impl FnOnce() -> u32,
) {
    let folder = bench.out(out);
    // What the processes read at their start is not counted.
    wait_for_episodes(&folder, 1);
    let [memory, policy] = ["memory", "policy"].map(|role| process_of(bench.registry.path(), role));
    let pids = [world(), memory, policy];
    let before = pids.map(|pid| bytes_through_system_calls(pid).unwrap());
    let mut after = before;
    while run.try_wait().unwrap().is_none() {
        for (moved, pid) in after.iter_mut().zip(pids) {
            *moved = bytes_through_system_calls(pid).unwrap_or(*moved);
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    Ended::of(run).expect(0);

    let total = |role: &str, key: &str| shutdown_total(&folder, role, key);
    let frames = total("sim", "frames_rendered");
    assert!(frames > 100, "{frames} frames");
    for role in ["memory", "policy"] {
        assert_eq!(total(role, "frames_received"), frames, "every frame reached {role}");
        assert_eq!(total(role, "pixel_bytes_copied"), 0, "{role}");
    }
    let all_pixels = frames * 448 * 448 * 4;
    // Memory reads its model at the first view of which there is no embedding yet.
    let model = fs::metadata(needs::encoder_model()).unwrap().len();
    for ((role, before), after) in ["sim", "memory", "policy"].into_iter().zip(before).zip(after) {
        let moved = after - before;
        let models = if role == "memory" { model } else { 0 };
        assert!(
            moved < all_pixels / 20 + models,
            "{role} moved {moved} bytes by system calls; the {frames} frames have {all_pixels}"
        );
    }
}
