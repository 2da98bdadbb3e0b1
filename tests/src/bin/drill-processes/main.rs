//! Drills of real processes: short runs that are disturbed on purpose, and must end with the log of an undisturbed one.
//! `cargo xtask drill` starts it.

mod disk;
mod grid;
mod kills;
mod report;
mod runs;
mod soak;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;
use std::thread;

use clap::{Parser, ValueEnum};
use report::Report;
use runs::Sandbox;

/// No new disturbance begins in a quick drill after so many minutes.
const QUICK_MINUTES: f64 = 1.0;

/// Disturb short runs on purpose; each must end with the log of an undisturbed one
///
/// Exit status: 0 no violation, 1 violations, 2 error.
#[derive(Debug, Parser)]
struct Arguments {
    /// What is disturbed
    drill: DrillName,
    #[command(flatten)]
    extent: Extent,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum DrillName {
    /// A process is killed before and after each call that matters, or the call fails
    Grid,
    /// Kills and stops at random moments
    Kills,
    /// Full, read-only and foreign disks, full shared memory, little memory
    Disk,
    /// One long run with kills, in which nothing may grow
    Soak,
}

/// How much a drill does.
#[derive(Debug, clap::Args)]
pub(crate) struct Extent {
    /// A small part, in about 20 seconds
    #[arg(long = "quick")]
    is_quick: bool,
    /// The seed of what is drawn
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// End after so many minutes, if it is not done before
    #[arg(long, value_name = "M", default_value_t = 600.0)]
    minutes: f64,
    /// Runs of `grid` and `kills` at a time; they wait much and compute little
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    jobs: u32,
    /// Episodes of `soak`
    #[arg(long, value_name = "N", default_value_t = 100_000)]
    episodes: u32,
    /// The only cell of `grid`, as a violation names it
    #[arg(long, value_name = "CELL")]
    cell: Option<String>,
    /// Write what was found as JSON, also while the drill goes on
    #[arg(long, value_name = "FILE", default_value = "/dev/null")]
    json: PathBuf,
    /// The command that repeats the drill, for the report.
    #[arg(skip)]
    command: String,
}

impl Extent {
    /// Whether the drill has to end; records what it has found so far.
    fn is_over(&self, report: &Report) -> bool {
        if let Err(error) = report.write(&self.json, &self.command) {
            eprintln!("{error}");
        }
        let minutes = if self.is_quick { self.minutes.min(QUICK_MINUTES) } else { self.minutes };
        report.seconds() > minutes * 60.0
    }
}

/// What a trial did, and whether its disturbance took place before the run was over; or what it violated.
pub(crate) struct Outcome {
    what: String,
    class: String,
    took_place: Result<bool, String>,
}

/// Executes `trials`, one in each sandbox at a time, until all are done, `most` faults took place or time is over. `kinds`
/// names the figures of all trials, and of those whose disturbance did not take place.
pub(crate) fn execute<T>(
    extent: &Extent,
    report: Report,
    (kinds, most): ([&str; 2], u64),
    sandboxes: Vec<Sandbox>,
    trials: impl Iterator<Item = T> + Send,
    disturb: impl Fn(&mut Sandbox, T) -> Outcome + Sync,
) -> Report {
    let next = Mutex::new((report, trials));
    let lock = || next.lock().expect("no thread panics");
    let next_trial = || {
        let (report, trials) = &mut *lock();
        let is_over = report.faults() >= most || extent.is_over(report);
        if is_over { None } else { trials.next() }
    };
    let (disturb, next_trial) = (&disturb, &next_trial);
    thread::scope(|scope| {
        for mut sandbox in sandboxes {
            scope.spawn(move || {
                while let Some(trial) = next_trial() {
                    let Outcome { what, class, took_place } = disturb(&mut sandbox, trial);
                    let (report, _) = &mut *lock();
                    let [all, not_reached] = kinds;
                    report.add(all, 1.0);
                    match took_place {
                        Ok(false) => report.add(not_reached, 1.0),
                        Ok(true) => report.fault(&class),
                        Err(violation) => {
                            report.fault(&class);
                            report.outcome(&what, Err(violation));
                        }
                    }
                }
            });
        }
    });
    next.into_inner().expect("no thread panics").0
}

fn main() -> ExitCode {
    match run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

/// Returns whether no violation was found.
fn run() -> Result<bool, String> {
    let Arguments { drill, mut extent } = Arguments::parse();
    extent.command = command();
    let report = match drill {
        DrillName::Grid => grid::drill(&extent)?,
        DrillName::Kills => kills::drill(&extent)?,
        DrillName::Disk => disk::drill(&extent)?,
        DrillName::Soak => soak::drill(&extent)?,
    };
    report.write(&extent.json, &extent.command)?;
    Ok(report.is_clean())
}

/// `cargo xtask drill` with the arguments of this program, but for `--json FILE`.
fn command() -> String {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let json = arguments.iter().position(|argument| argument == "--json");
    let is_kept = |at: usize| json.is_none_or(|json| ![json, json + 1].contains(&at));
    let kept = arguments.iter().enumerate().filter(|(at, _)| is_kept(*at));
    let (own, passed_on): (Vec<&str>, Vec<&str>) =
        kept.map(|(_, argument)| argument.as_str()).partition(|argument| {
            DrillName::from_str(argument, false).is_ok() || *argument == "--quick"
        });
    let separator: &[&str] = if passed_on.is_empty() { &[] } else { &["--"] };
    [&["cargo xtask drill"], &*own, separator, &*passed_on].concat().join(" ")
}

/// Numbers that follow from a seed alone (SplitMix64).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Other numbers for each `name`, and the same ones again for the same.
    pub(crate) fn of(seed: u64, name: &str) -> Self {
        Self(name.bytes().fold(seed, |state, byte| Self(state ^ u64::from(byte)).next()))
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number from 0 to 1.
    pub(crate) fn fraction(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}
