//! One long run of many short episodes, in which a process is killed again and again: nothing grows.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use memtransfer_tests::{episodes, processes_of, shared_memory_of};

use crate::Extent;
use crate::harness::{Run, Sandbox};
use crate::report::Report;

pub(crate) const TEXT: &str = "One run of many short episodes with built-in memories and an external one. The simulator, memory, the policy and the \
     external memory are killed in turn. What the run holds is measured twice a second; the median of the last quarter \
     must not exceed that of the first (in a quick drill it is only shown).";

/// Time between two measurements.
const INTERVAL: Duration = Duration::from_millis(500);

/// Processes that are killed in turn.
const VICTIMS: [(&str, &str); 4] = [
    ("simulator", "sim-proc"),
    ("memory", "memory-proc"),
    ("policy", "policy-proc"),
    ("external memory", EXTERNAL),
];

const EXTERNAL: &str = "misbehaving-memory";

/// What is measured, and by how much it may vary.
const MEASURES: [(&str, f64); 6] = [
    ("MiB of the orchestrator", 24.0),
    ("open files of the orchestrator", 16.0),
    ("threads of the orchestrator", 3.0),
    ("open files of all processes", 64.0),
    ("MiB of shared memory", 24.0),
    ("names in shared memory", 48.0),
];

/// Episodes of a case in one repetition.
const MEMORIES_AND_STARTS: u32 = 6;

/// Cases times repetitions, and the time and the number of finished episodes between kills: processes that are killed before
/// anything is finished are given up after some times, rightly.
struct Size {
    cases: u32,
    repetitions: u32,
    pause: Duration,
    progress: usize,
}

pub(crate) fn drill(extent: &Extent, report: &mut Report) -> Result<(), String> {
    let sandbox = &mut Sandbox::one()?;
    let size = match extent.is_quick {
        true => Size { cases: 10, repetitions: 2, pause: Duration::from_secs(1), progress: 15 },
        false => Size {
            cases: 100,
            repetitions: extent.episodes.div_ceil(100 * MEMORIES_AND_STARTS),
            pause: Duration::from_secs(2),
            progress: 100,
        },
    };
    let run = soak_run(sandbox, &size);
    let planned = size.cases * size.repetitions * MEMORIES_AND_STARTS;

    let mut command = sandbox.command(&run.args);
    let errors = sandbox.folder().join("soak.txt");
    let file = fs::File::create(&errors).map_err(|error| error.to_string())?;
    command.stdout(std::process::Stdio::null()).stderr(file);
    let mut child =
        command.spawn().map_err(|error| format!("cannot start memtransfer: {error}"))?;
    let began = Instant::now();
    let (mut killed, mut kills, mut at_kill) = (Instant::now(), 0, Finished::default());
    let mut samples: Vec<[f64; 6]> = Vec::new();
    let status = loop {
        if let Some(status) = child.try_wait().map_err(|error| error.to_string())? {
            break status;
        }
        if extent.is_over(report) && !extent.is_quick {
            memtransfer_tests::kill(child.id());
        }
        thread::sleep(INTERVAL);
        samples.extend(sample(child.id(), sandbox));
        if killed.elapsed() < size.pause {
            continue;
        }
        let finished = Finished::of(&run);
        let (role, program) = VICTIMS[kills % VICTIMS.len()];
        // Its episodes come last.
        let is_due = program != EXTERNAL || finished.external > at_kill.external;
        if finished.all < at_kill.all + size.progress {
            continue;
        }
        if is_due && let Some(pid) = sandbox.process(program) {
            memtransfer_tests::kill(pid);
            report.fault(&format!("{role} killed"));
        }
        (killed, at_kill) = (Instant::now(), finished);
        kills += 1;
    };
    let seconds = began.elapsed().as_secs_f64();
    let done = episodes(&run.out).lines().count();
    report.add("episodes", done as f64);
    report.add("episodes a second", (done as f64 / seconds).round());
    let said = fs::read_to_string(&errors).unwrap_or_default();
    let complete = match status.code() {
        Some(0) if done == planned as usize => Ok(()),
        code => Err(format!("ended with {code:?} and {done} of {planned} episodes: {said}")),
    };
    report.outcome("the run", complete);
    let lines = episodes(&run.out);
    let keys: std::collections::BTreeSet<String> = lines
        .lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .map(|record| record["key"].to_string())
        .collect();
    let doubled = match keys.len() == done {
        true => Ok(()),
        false => Err(format!("{done} lines of the log name {} episodes", keys.len())),
    };
    report.outcome("the log", doubled);
    for Measured { what, slack, first, last } in measured(&samples) {
        report.add(&format!("{what}, first quarter"), first);
        report.add(&format!("{what}, last quarter"), last);
        // The first quarter of a quick drill is the start of its processes.
        if !extent.is_quick && last > first + slack {
            let grows = format!("{first} in the first quarter, {last} in the last");
            report.outcome(what, Err(grows));
        }
    }
    report.outcome("the processes", sandbox.wait_for_processes());
    report.outcome("what is left", sandbox.check_clean());
    Ok(())
}

/// Finished episodes, and those of them with the external memory.
#[derive(Default)]
struct Finished {
    all: usize,
    external: usize,
}

impl Finished {
    fn of(run: &Run) -> Self {
        let log = episodes(&run.out);
        let external = log.lines().filter(|line| line.contains("\"well-behaved/")).count();
        Self { all: log.lines().count(), external }
    }
}

/// Many short episodes.
fn soak_run(sandbox: &mut Sandbox, size: &Size) -> Run {
    let mut run = sandbox.run();
    let replaced = BTreeMap::from([("--lanes", "16".to_owned()), ("--max-steps", "12".to_owned())]);
    let mut args: Vec<String> = Vec::new();
    let mut rest = run.args.into_iter();
    while let Some(arg) = rest.next() {
        if arg == "--cases" {
            rest.next();
            args.extend(["--limit".to_owned(), size.cases.to_string()]);
            args.extend(["--runs".to_owned(), size.repetitions.to_string()]);
            continue;
        }
        let value = replaced.get(arg.as_str()).cloned();
        args.push(arg);
        if let Some(value) = value {
            rest.next();
            args.push(value);
        }
    }
    run.args = args;
    run
}

/// The measures, in the order of [`MEASURES`]; `None` when the run is over.
fn sample(orchestrator: u32, sandbox: &Sandbox) -> Option<[f64; 6]> {
    let open =
        |pid: u32| fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, |open| open.flatten().count());
    let status = fs::read_to_string(format!("/proc/{orchestrator}/status")).ok()?;
    let value = |key: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(key))?;
        line.split_whitespace().next()?.parse::<f64>().ok()
    };
    let (resident, threads) = (value("VmRSS:")? / 1024.0, value("Threads:")?);
    let all: usize = processes_of(&sandbox.registry()).into_iter().map(open).sum();
    let names = shared_memory_of(&sandbox.registered());
    let bytes: u64 = names.iter().map(|name| used(&Path::new("/dev/shm").join(name))).sum();
    let own = open(orchestrator);
    let shared = bytes as f64 / f64::from(1 << 20);
    Some([resident, own as f64, threads, (own + all) as f64, shared, names.len() as f64])
}

fn used(segment: &Path) -> u64 {
    use std::os::unix::fs::MetadataExt;
    segment.metadata().map_or(0, |about| about.blocks() * 512)
}

/// The medians of a measure in the first and in the last quarter.
struct Measured {
    what: &'static str,
    slack: f64,
    first: f64,
    last: f64,
}

/// All measures; none if there are too few samples.
fn measured(samples: &[[f64; 6]]) -> Vec<Measured> {
    let quarter = samples.len() / 4;
    let median = |samples: &[[f64; 6]], index: usize| {
        let mut values: Vec<f64> = samples.iter().map(|sample| sample[index]).collect();
        values.sort_by(f64::total_cmp);
        (values[values.len() / 2] * 10.0).round() / 10.0
    };
    let measure = |(index, (what, slack)): (usize, (&'static str, f64))| Measured {
        what,
        slack,
        first: median(&samples[..quarter], index),
        last: median(&samples[samples.len() - quarter..], index),
    };
    let all = MEASURES.into_iter().enumerate();
    if quarter == 0 { Vec::new() } else { all.map(measure).collect() }
}
