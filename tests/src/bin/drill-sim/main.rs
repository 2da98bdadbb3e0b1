//! `drill-sim`: runs in which everything goes wrong, executed in one program, each exactly repeatable from its seed.
//!
//! Orchestrator, up to three simulators, memory, policy and an external memory are the real ones and exchange messages through iceoryx2.
//! A scheduler executes them one at a time, in an order drawn from the seed and with a virtual clock (`scheduler`). The seed
//! also draws faults: deaths, stalls, clock jumps, full queues, disks that are full or broken, writes that are torn
//! (`faults`). The run is resumed until it ends. Then its log has to equal that of an undisturbed run, line by line, and nothing may be left open
//! (`trial`). Faults of a seed that fails are removed one by one while it still fails.
//!
//! Pixels, embeddings and decisions come from stand-ins that cost nothing (`roles`), in small worlds (`scenario`).

mod external;
mod faults;
mod roles;
mod scenario;
mod scheduler;
mod trial;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use clap::{Parser, ValueEnum};

use crate::faults::{Plan, Preemption, Undisturbed};
use crate::scenario::Scenario;
use crate::scheduler::Hooks;
use crate::trial::{Outcome, Place, execute};

/// How long one trial may take in real time: a process that blocks without the scheduler's knowledge is a bug, too.
const REAL_LIMIT: Duration = Duration::from_secs(120);

/// What the page of results says about the drill.
const TEXT: &str = "Small runs in one program: the serve loops of the orchestrator, up to three simulators, memory, the policy and an external \
     memory exchange messages through iceoryx2, and a scheduler executes them one at a time, in an order drawn from the \
     seed and with a virtual clock. At every message sent or received another process may come first, so that messages of \
     different services arrive in any order; in a quarter of the runs the frame store holds just the frames that can be \
     named, so that every new view evicts another. The seed also draws up to six faults. The run is resumed until it is \
     complete. Then its log must equal that of an undisturbed run, no file, thread or shared memory may be left open, no \
     session without a fault may fail, none may hang, and none may take 20 seconds of virtual time unless a process \
     stalls, a queue is full or the clock jumps. When the power fails, half of the files that hold embeddings and views \
     are damaged. The first seed is executed twice and must take the same course. A seed that fails is repeated without \
     each of its faults, until each that is left is needed, and with ever fewer interruptions of processes.";

/// Simulated runs with deaths, stalls, clock jumps and failing disks
#[derive(Debug, Parser)]
struct Arguments {
    /// Number of seeds
    #[arg(long, value_name = "N", default_value_t = 5000)]
    seeds: u64,
    /// The first seed
    #[arg(long, value_name = "S", default_value_t = 0)]
    first_seed: u64,
    /// Run these seeds alone, and print the faults that came
    #[arg(long, value_name = "K", value_delimiter = ',')]
    seed: Vec<u64>,
    /// Stop after so many minutes
    #[arg(long, value_name = "M")]
    minutes: Option<f64>,
    /// Write a summary as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Plant these defects, one in each execution of a seed; each has to be found
    #[arg(long, value_name = "DEFECT", value_delimiter = ',')]
    plant: Vec<Plant>,
}

/// A defect that is planted to see whether it is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Plant {
    /// The log lacks an episode.
    LostLine,
    /// The log has an episode twice.
    DoubledLine,
    /// A process leaves a file open.
    LeftOpen,
    /// A process waits for a minute before it takes part.
    WaitsInVain,
    /// Decisions depend on the clock.
    OtherDecisions,
}

/// Sums over all trials.
#[derive(Default)]
struct Totals {
    seeds: u64,
    sessions: u64,
    steps: u64,
    virtual_ns: u64,
    faults: BTreeMap<&'static str, u64>,
    violations: Vec<String>,
}

fn main() -> ExitCode {
    // No log: what processes warn of is what the faults are for.
    match run(&Arguments::parse()) {
        Ok(0) => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("drill-sim: {error:#}");
            ExitCode::from(2)
        }
    }
}

/// Runs the trials; returns how many failed.
fn run(arguments: &Arguments) -> Result<usize> {
    ensure!(shm_types::clock::simulate(Box::new(Hooks)), "a simulation runs already");
    ensure!(durable::inject(Box::new(Hooks)), "faults are injected already");
    // Panics are caught, and are violations.
    std::panic::set_hook(Box::new(|_| {}));
    let files =
        tempfile::Builder::new().prefix("drill").tempdir_in("/dev/shm").context("/dev/shm")?;
    let place = Place { folder: files.path().to_owned(), registry: files.path().join("r") };
    std::os::unix::fs::DirBuilderExt::mode(&mut std::fs::DirBuilder::new(), 0o700)
        .create(&place.registry)?;
    let scenarios = Scenario::all(files.path())?;
    let current = watch_real_time();

    let mut known = Vec::new();
    for scenario in &scenarios {
        let preemption = Preemption::NONE;
        let undisturbed = Plan {
            scenario: 0,
            lanes: 2,
            worlds: 1,
            spare_frames: 64,
            preemption,
            faults: Vec::new(),
        };
        // The first execution also opens what stays open, such as the log of iceoryx2.
        let first = execute(scenario, &undisturbed, (0, None), &place, None)?;
        let outcome = execute(scenario, &undisturbed, (0, None), &place, Some(&first.log))?;
        ensure!(
            outcome.violations.is_empty() && outcome.log.len() == scenario.episodes.len(),
            "the undisturbed run of {} fails: {}",
            scenario.name,
            outcome.violations.join("\n")
        );
        ensure!(
            outcome.account.digest == first.account.digest,
            "{}: not repeatable",
            scenario.name
        );
        eprintln!(
            "{}: {} episodes of {}, {} points, {} operations on files, {:.1} s of virtual time",
            scenario.name,
            outcome.log.len(),
            scenario.episodes.len(),
            outcome.account.steps,
            outcome.account.operations,
            outcome.account.virtual_ns as f64 / 1e9
        );
        known.push(Undisturbed {
            steps: outcome.account.steps,
            operations: outcome.account.operations,
            has_external_memory: !scenario.memories.is_empty(),
            log: outcome.log,
        });
    }

    let begun = Instant::now();
    let mut totals = Totals::default();
    let seeds: Vec<u64> = match &arguments.seed[..] {
        [] => (arguments.first_seed..arguments.first_seed + arguments.seeds).collect(),
        chosen => chosen.to_vec(),
    };
    let plants: Vec<Option<Plant>> = match &arguments.plant[..] {
        [] => vec![None],
        chosen => chosen.iter().copied().map(Some).collect(),
    };
    let mut shown = Instant::now();
    for (seed, plant) in
        seeds.into_iter().flat_map(|seed| plants.iter().map(move |plant| (seed, *plant)))
    {
        let minutes = begun.elapsed().as_secs_f64() / 60.0;
        if arguments.minutes.is_some_and(|most| minutes >= most) {
            break;
        }
        current.store(seed, Ordering::Relaxed);
        let plan = Plan::draw(seed, &known);
        let scenario = &scenarios[plan.scenario];
        let trial = |plan: &Plan| {
            let expected = &known[plan.scenario].log;
            execute(scenario, plan, (seed, plant), &place, Some(expected))
        };
        let outcome = trial(&plan).with_context(|| format!("seed {seed}"))?;
        totals.add(&outcome);
        // The first seed shows that a seed can be replayed.
        if totals.seeds == 1 && trial(&plan)?.account.digest != outcome.account.digest {
            totals.violations.push(format!("seed {seed}: another execution took another course"));
        }
        if !arguments.seed.is_empty() {
            describe(&plan, scenario, &outcome);
        }
        if !outcome.violations.is_empty() {
            let (plan, outcome) = minimise(plan, outcome, trial)?;
            eprintln!("seed {seed} fails:");
            describe(&plan, scenario, &outcome);
            let violations = outcome.violations.join("; ");
            let trace = outcome.account.trace.join(", ");
            let planted = plant.map_or(String::new(), |plant| format!(", planted {plant:?}"));
            totals
                .violations
                .push(format!("seed {seed} ({}{planted}): {violations} [{trace}]", scenario.name));
        }
        if shown.elapsed() > Duration::from_secs(10) {
            shown = Instant::now();
            let (done, failed) = (totals.seeds, totals.violations.len());
            eprintln!("{done} seeds, {failed} violations, {:.0} s", begun.elapsed().as_secs_f64());
        }
    }
    current.store(u64::MAX, Ordering::Relaxed);
    let summary = totals.summary(arguments, begun.elapsed());
    eprintln!("{summary:#}");
    if let Some(file) = &arguments.json {
        std::fs::write(file, format!("{summary:#}\n"))
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(totals.violations.len())
}

/// Removes faults one by one while the trial still fails, and then looks for the last interruption of a process that it
/// needs.
fn minimise(
    mut plan: Plan,
    mut outcome: Outcome,
    trial: impl Fn(&Plan) -> Result<Outcome>,
) -> Result<(Plan, Outcome)> {
    let mut at = 0;
    while at < plan.faults.len() {
        let removed = plan.faults.remove(at);
        let without = trial(&plan)?;
        if without.violations.is_empty() {
            plan.faults.insert(at, removed);
            at += 1;
        } else {
            outcome = without;
        }
    }
    let (mut passes, mut fails) = (0, outcome.account.steps);
    while passes < fails {
        let until = passes.midpoint(fails);
        let preemption = Preemption { until, ..plan.preemption };
        let earlier = trial(&Plan { preemption, faults: plan.faults.clone(), ..plan })?;
        if earlier.violations.is_empty() {
            passes = until + 1;
        } else {
            (fails, plan.preemption, outcome) = (until, preemption, earlier);
        }
    }
    Ok((plan, outcome))
}

fn describe(plan: &Plan, scenario: &Scenario, outcome: &Outcome) {
    eprintln!(
        "  {}, {} lanes, {} worlds, {} spare frames, {} of 1024 points preempt up to point {}, {} sessions, digest {:016x}",
        scenario.name,
        plan.lanes,
        plan.worlds,
        plan.spare_frames,
        plan.preemption.of_1024,
        plan.preemption.until.min(outcome.account.steps),
        outcome.sessions,
        outcome.account.digest
    );
    plan.faults.iter().for_each(|fault| eprintln!("  planned: {fault:?}"));
    outcome.account.trace.iter().for_each(|line| eprintln!("  {line}"));
    outcome.violations.iter().for_each(|line| eprintln!("  VIOLATION: {line}"));
}

impl Totals {
    fn add(&mut self, outcome: &Outcome) {
        self.seeds += 1;
        self.sessions += outcome.sessions as u64;
        self.steps += outcome.account.steps;
        self.virtual_ns += outcome.account.virtual_ns;
        for (class, count) in &outcome.account.fired {
            *self.faults.entry(class).or_default() += count;
        }
    }

    fn summary(&self, arguments: &Arguments, real: Duration) -> serde_json::Value {
        let hours = |seconds: f64| (seconds / 360.0).round() / 10.0;
        let mut command = format!("cargo xtask drill sim -- --seeds {}", self.seeds);
        if arguments.first_seed > 0 {
            command += &format!(" --first-seed {}", arguments.first_seed);
        }
        serde_json::json!({
            "title": "Simulation",
            "command": command,
            "text": TEXT,
            "faults": self.faults,
            "figures": {
                "seeds": self.seeds,
                "seeds an hour": (self.seeds as f64 * 3600.0 / real.as_secs_f64().max(1.0)).round(),
                "sessions of runs": self.sessions,
                "scheduling points": self.steps,
                "virtual hours": hours(self.virtual_ns as f64 / 1e9),
                "real hours": hours(real.as_secs_f64()),
            },
            "violations": self.violations,
        })
    }
}

/// Ends the program when one trial takes too long in real time. Returns the seed to watch; `u64::MAX` is none.
fn watch_real_time() -> Arc<AtomicU64> {
    let current = Arc::new(AtomicU64::new(u64::MAX));
    let watched = current.clone();
    thread::spawn(move || {
        let mut since = (u64::MAX, Instant::now());
        loop {
            thread::sleep(Duration::from_secs(1));
            let seed = watched.load(Ordering::Relaxed);
            if seed != since.0 || seed == u64::MAX {
                since = (seed, Instant::now());
            } else if since.1.elapsed() > REAL_LIMIT {
                eprintln!("seed {seed} blocks: no end after {} s", REAL_LIMIT.as_secs());
                std::process::exit(3);
            }
        }
    });
    current
}
