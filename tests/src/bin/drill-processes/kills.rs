//! Kills at random moments: of each process of a run, and of the process that started it; processes that are stopped for
//! good; and a second run in the same folder at the same time. Processes that stop for a while are those of `drill-sim`.

use std::fs;
use std::path::Path;
use std::process::{Child, Command};
use std::thread;
use std::time::{Duration, Instant};

use memtransfer_tests::Ended;
use rustix::process::{Pid, Signal, kill_process};

use crate::harness::{Run, Sandbox, Trial, execute};
use crate::report::Report;
use crate::{Extent, Random};

pub(crate) const TEXT: &str = "Short runs, each disturbed once at a random moment. The run, or the same command again, must end with the log of an \
     undisturbed run; then `memtransfer clean` must leave no shared memory, no folder and no process.";

/// The programs of a run, as what they are in it.
const VICTIMS: [(&str, &str); 6] = [
    ("orchestrator", "memtransfer"),
    ("simulator", "sim-proc"),
    ("memory", "memory-proc"),
    ("policy", "policy-proc"),
    (EXTERNAL_MEMORY, "misbehaving-memory"),
    (EXTERNAL_POLICY, "policy-proc"),
];

const EXTERNAL_MEMORY: &str = "external memory";

/// The policy of a run that does not know it: to the run it is some program.
const EXTERNAL_POLICY: &str = "external policy";

/// Disturbances of a whole drill, if its time allows: with none that does harm, fewer than one in a thousand does (at 95 %
/// confidence).
const WHOLE: u64 = 3000;

/// Time limits, in seconds, of a run in which a process is stopped for good: of an answer, and of the start, which takes
/// longer on a loaded machine.
const ANSWER: &str = "5";
const START: &str = "30";

/// How long an external memory is stopped at most.
const STOP: Duration = Duration::from_secs(30);

#[derive(Clone, Copy, PartialEq)]
enum Disturbance {
    Kill,
    StopForGood,
    KillParent,
    SecondRun,
}

pub(crate) fn drill(extent: &Extent, report: &mut Report) -> Result<(), String> {
    let sandboxes = Sandbox::several(extent.jobs)?;
    let episodes = sandboxes[0].episodes();
    let (mut random, seed) = (Random::new(extent.seed), extent.seed);
    // A quick drill has a kill of each process and two of the disturbances that do not wait for a time limit.
    let (first, rest) = if extent.is_quick {
        (0..VICTIMS.len(), 3 * VICTIMS.len()..3 * VICTIMS.len() + 2)
    } else {
        (0..usize::MAX, 0..0)
    };
    let trials = first.chain(rest).map(|turn| {
        let (role, program) = VICTIMS[turn % VICTIMS.len()];
        let disturbance = match (turn / VICTIMS.len() % 4, turn % VICTIMS.len()) {
            (3, 0) => Disturbance::KillParent,
            (3, 1) => Disturbance::SecondRun,
            (3, _) => Disturbance::StopForGood,
            _ => Disturbance::Kill,
        };
        // Also shortly after the end of an undisturbed run: runs that are disturbed, or listed, take longer.
        let share = random.fraction() * 1.1;
        let worlds = 1 + (3.0 * random.fraction()) as u32;
        let class = class(disturbance, role);
        let name = format!("{class} at {share:.3} of a run, {worlds} worlds, seed {seed}");
        Trial::new(name, class, move |sandbox| {
            let moment = Duration::from_secs_f64(share * sandbox.usual);
            disturb(sandbox, disturbance, (role, program), (moment, worlds))
        })
    });
    execute(extent, report, sandboxes, WHOLE, trials);
    report.add("episodes", report.faults() as f64 * episodes as f64);
    Ok(())
}

fn class(disturbance: Disturbance, role: &str) -> String {
    match disturbance {
        Disturbance::Kill => format!("{role} killed"),
        Disturbance::StopForGood if role == EXTERNAL_MEMORY => format!("{role} stopped for long"),
        Disturbance::StopForGood => format!("{role} stopped for good"),
        Disturbance::KillParent => "the parent of the orchestrator killed".to_owned(),
        Disturbance::SecondRun => "a second run in the same folder".to_owned(),
    }
}

/// Executes a run with one disturbance. Returns whether it took place before the run was over.
fn disturb(
    sandbox: &mut Sandbox,
    disturbance: Disturbance,
    (role, program): (&str, &str),
    (moment, worlds): (Duration, u32),
) -> Result<bool, String> {
    let mut run = sandbox.run();
    run.args.extend(["--worlds".to_owned(), worlds.to_string()]);
    if role == EXTERNAL_POLICY {
        run.make_policy_external();
    }
    if disturbance == Disturbance::StopForGood {
        let limits =
            ["--step-timeout", ANSWER, "--memory-timeout", ANSWER, "--start-timeout", START];
        run.args.extend(limits.map(str::to_owned));
    }
    if disturbance == Disturbance::KillParent {
        return kill_parent(sandbox, &run, moment);
    }
    let mut child = sandbox.start(&run, &[])?;
    let has_ended = |child: &mut Child| child.try_wait().is_ok_and(|status| status.is_some());
    let began = Instant::now();
    while began.elapsed() < moment && !has_ended(&mut child) {
        thread::sleep(Duration::from_millis(2));
    }
    if has_ended(&mut child) {
        // Other runs at a time make this one faster or slower than the first was.
        sandbox.usual = 0.8 * sandbox.usual + 0.2 * began.elapsed().as_secs_f64();
        sandbox.check_recovery(&run, &Ended::of(child), false)?;
        return Ok(false);
    }
    let is_orchestrator = program == "memtransfer";
    let mut was_killed = false;
    let took_place = match disturbance {
        Disturbance::SecondRun => {
            let second = Ended::of(sandbox.start(&run, &[])?);
            // The first one may be over meanwhile; then the second has nothing to do.
            if second.status != Some(0) && second.status != Some(2) {
                return Err(format!(
                    "the second run ended with {:?}: {}",
                    second.status, second.stderr
                ));
            }
            second.status == Some(2)
        }
        _ => match victim(sandbox, &child, program) {
            None => false,
            Some(pid) => {
                let took_place = match disturbance {
                    Disturbance::Kill => signal(pid, Signal::KILL),
                    // A stopped orchestrator is the user's wish, and continues.
                    _ if is_orchestrator => false,
                    // It has ten minutes to build itself: longer than this drill waits.
                    _ if role == EXTERNAL_MEMORY => {
                        let stopped = signal(pid, Signal::STOP);
                        let until = Instant::now() + STOP;
                        while !has_ended(&mut child) && Instant::now() < until {
                            thread::sleep(Duration::from_millis(20));
                        }
                        // It is not there if it was given up meanwhile.
                        let _ = signal(pid, Signal::CONT);
                        stopped
                    }
                    _ => signal(pid, Signal::STOP),
                };
                was_killed = is_orchestrator && disturbance == Disturbance::Kill && took_place;
                took_place
            }
        },
    };
    let ended = Ended::of(child);
    sandbox.check_recovery(&run, &ended, was_killed)?;
    Ok(took_place)
}

/// The process of the run that has this program.
fn victim(sandbox: &Sandbox, orchestrator: &Child, program: &str) -> Option<Pid> {
    if program == "memtransfer" {
        return Some(Pid::from_child(orchestrator));
    }
    Pid::from_raw(i32::try_from(sandbox.process(program)?).ok()?)
}

/// Sends a signal; returns whether the process was there.
fn signal(pid: Pid, signal: Signal) -> bool {
    kill_process(pid, signal).is_ok()
}

/// Kills the shell that started a run. The orchestrator goes on by itself, as it does without a terminal.
fn kill_parent(sandbox: &Sandbox, run: &Run, moment: Duration) -> Result<bool, String> {
    let command = sandbox.command(&run.args);
    let pid_file = sandbox.folder().join("pid");
    let _ = fs::remove_file(&pid_file);
    let mut shell = Command::new("/bin/sh");
    shell.args([
        "-c",
        "\"$@\" & echo $! > \"$PID_FILE.new\"; mv \"$PID_FILE.new\" \"$PID_FILE\"; wait",
        "sh",
    ]);
    shell.arg(command.get_program()).args(command.get_args());
    sandbox.in_sandbox(&mut shell);
    shell.env("PID_FILE", &pid_file);
    let mut child = shell.spawn().map_err(|error| format!("cannot start a shell: {error}"))?;
    let began = Instant::now();
    let pid = loop {
        match fs::read_to_string(&pid_file).ok().and_then(|pid| pid.trim().parse::<i32>().ok()) {
            Some(pid) => break pid,
            None if began.elapsed() > Duration::from_secs(60) => {
                return Err("the shell does not start the run".to_owned());
            }
            None => thread::sleep(Duration::from_millis(2)),
        }
    };
    thread::sleep(moment.saturating_sub(began.elapsed()));
    let took_place = child.try_wait().is_ok_and(|status| status.is_none());
    let _ = child.kill();
    let is_there = |pid: i32| {
        let stat = fs::read_to_string(Path::new("/proc").join(pid.to_string()).join("stat"));
        stat.is_ok_and(|stat| stat.contains("(memtransfer)") && !stat.contains(") Z "))
    };
    let deadline = Instant::now() + memtransfer_tests::WATCHDOG;
    while is_there(pid) {
        if Instant::now() > deadline {
            memtransfer_tests::kill(pid.cast_unsigned());
            return Err("the orchestrator does not end without its parent".to_owned());
        }
        thread::sleep(Duration::from_millis(5));
    }
    // The output of the shell ends when the orchestrator's does.
    let shell = Ended::of(child);
    sandbox.check_log(run).map_err(|why| format!("{why}: {}", shell.stderr))?;
    let over = Ended { status: Some(0), ..shell };
    sandbox.check_recovery(run, &over, false)?;
    Ok(took_place)
}
