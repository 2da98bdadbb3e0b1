//! Kills at random moments: of each process of a run, and of the process that started it; processes that are stopped for
//! good; a second run in the same folder at the same time; and an external world that does once what it must not. Processes that stop for a while are those of `drill-sim`.

use std::fs;
use std::path::Path;
use std::process::{Child, Command};
use std::thread;
use std::time::{Duration, Instant};

use memtransfer_tests::{Ended, STRAY_FAULTS};
use rustix::process::{Pid, Signal, kill_process};

use crate::harness::{EXTERNAL_WORLD, Run, RunWorld, Sandbox, Trial, execute};
use crate::report::Report;
use crate::{Extent, Random};

pub(crate) const TEXT: &str = "Short runs, each disturbed once at a random moment. The run, or the same command again, must end with the log of an \
     undisturbed run; then `memtransfer clean` must leave no shared memory, no folder and no process.";

/// The programs of a run, as what they are in it.
const VICTIMS: [(&str, &str); 8] = [
    ("orchestrator", "memtransfer"),
    ("simulator", "sim-proc"),
    ("memory", "memory-proc"),
    ("policy", "policy-proc"),
    (EXTERNAL_MEMORY, "misbehaving-memory"),
    (EXTERNAL_POLICY, "policy-proc"),
    ("external world", EXTERNAL_WORLD),
    (FAULTY_WORLD, EXTERNAL_WORLD),
];

/// An external world that is not disturbed, but disturbs the run.
const FAULTY_WORLD: &str = "faulty external world";

/// Steps of a run in an external world, about: at one of them it commits one of [`STRAY_FAULTS`].
const STEPS: f64 = 100.0;

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
    /// One of [`STRAY_FAULTS`] at a step.
    Fault(&'static str, u32),
    StopForGood,
    KillParent,
    SecondRun,
}

pub(crate) fn drill(extent: &Extent, report: &mut Report) -> Result<(), String> {
    let worlds = [RunWorld::Warehouse, RunWorld::External];
    let sandboxes = Sandbox::several(extent.jobs, &worlds)?;
    let (mut random, seed) = (Random::new(extent.seed), extent.seed);
    // A quick drill has a kill of each process and two of the disturbances that do not wait for a time limit.
    let (first, rest) = if extent.is_quick {
        (0..VICTIMS.len(), 3 * VICTIMS.len()..3 * VICTIMS.len() + 2)
    } else {
        (0..WHOLE as usize * VICTIMS.len(), 0..0)
    };
    let trials = first.chain(rest).map(|turn| {
        let (role, program) = VICTIMS[turn % VICTIMS.len()];
        // Also shortly after the end of an undisturbed run: runs that are disturbed, or listed, take longer.
        let share = random.fraction() * 1.1;
        let round = turn / VICTIMS.len();
        let disturbance = match (round % 4, turn % VICTIMS.len()) {
            _ if role == FAULTY_WORLD => Disturbance::Fault(
                STRAY_FAULTS[round % STRAY_FAULTS.len()],
                1 + (share * STEPS) as u32,
            ),
            (3, 0) => Disturbance::KillParent,
            (3, 1) => Disturbance::SecondRun,
            (3, _) => Disturbance::StopForGood,
            _ => Disturbance::Kill,
        };
        let worlds = 1 + (3.0 * random.fraction()) as u32;
        let class = class(disturbance, role);
        let name = format!("{class} at {share:.3} of a run, {worlds} worlds, seed {seed}");
        Trial::new(name, class, move |sandbox| {
            disturb(sandbox, disturbance, (role, program), (share, worlds))
        })
    });
    let trials = trials.filter(|trial| trial.class.contains(&extent.only));
    execute(extent, report, sandboxes, WHOLE, trials);
    Ok(())
}

fn class(disturbance: Disturbance, role: &str) -> String {
    match disturbance {
        Disturbance::Kill => format!("{role} killed"),
        Disturbance::Fault(fault, _) => format!("{role}: {fault}"),
        Disturbance::StopForGood if role == EXTERNAL_MEMORY => format!("{role} stopped for long"),
        Disturbance::StopForGood => format!("{role} stopped for good"),
        Disturbance::KillParent => "the parent of the orchestrator killed".to_owned(),
        Disturbance::SecondRun => "a second run in the same folder".to_owned(),
    }
}

/// Executes a run with one disturbance, after this share of the time that it takes. Returns whether it took place before the run
/// was over.
fn disturb(
    sandbox: &mut Sandbox,
    disturbance: Disturbance,
    (role, program): (&str, &str),
    (share, worlds): (f64, u32),
) -> Result<bool, String> {
    let is_external = program == EXTERNAL_WORLD;
    let world = if is_external { RunWorld::External } else { RunWorld::Warehouse };
    let mut run = sandbox.run_in_world(world);
    let moment = Duration::from_secs_f64(share * sandbox.usual(&run));
    run.args.extend(["--worlds".to_owned(), worlds.to_string()]);
    if role == EXTERNAL_POLICY {
        run.make_policy_external();
    }
    let limits = ["--step-timeout", ANSWER, "--memory-timeout", ANSWER, "--start-timeout", START];
    let limits = match disturbance {
        Disturbance::StopForGood => &limits[..],
        // Its process has begun.
        Disturbance::Fault(..) => &limits[..2],
        _ => &[],
    };
    run.args.extend(limits.iter().copied().map(str::to_owned));
    if disturbance == Disturbance::KillParent {
        return kill_parent(sandbox, &run, moment);
    }
    if let Disturbance::Fault(fault, step) = disturbance {
        return commit(sandbox, &run, fault, step);
    }
    let mut child = sandbox.start(&run, &[])?;
    let has_ended = |child: &mut Child| child.try_wait().is_ok_and(|status| status.is_some());
    let began = Instant::now();
    while began.elapsed() < moment && !has_ended(&mut child) {
        thread::sleep(Duration::from_millis(2));
    }
    if has_ended(&mut child) {
        sandbox.took(&run, began.elapsed().as_secs_f64());
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

/// Executes a run whose world commits a fault at a step, once. Returns whether it came to that.
fn commit(sandbox: &Sandbox, run: &Run, fault: &str, step: u32) -> Result<bool, String> {
    let token = sandbox.folder().join("committed");
    let _ = fs::remove_file(&token);
    let variables = [
        ("MISBEHAVE_FAULT", fault.to_owned()),
        ("MISBEHAVE_STEP", step.to_string()),
        ("MISBEHAVE_TOKEN", token.display().to_string()),
    ];
    let ended = Ended::of(sandbox.start(run, &variables)?);
    sandbox.check_recovery(run, &ended, false)?;
    Ok(token.exists())
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
