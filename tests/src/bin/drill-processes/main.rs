//! Drills of real processes: short runs that are disturbed on purpose, and must end with the log of an undisturbed one.
//!
//! `drill-processes grid|kills|disk|soak [--quick] [--seed N] [--minutes M] [--jobs N] [--episodes N] [--cell CELL] --json
//! FILE`. `cargo xtask drill` starts it. `--cell` repeats one cell of the grid, as a violation names it; `--jobs` is how many
//! runs `grid` and `kills` have at a time, which wait much and compute little.
//! Exit status: 0 no violation, 1 violations, 2 error.

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

use report::Report;
use runs::Sandbox;

/// No new disturbance begins in a quick drill after so many minutes.
const QUICK_MINUTES: f64 = 1.0;

/// How much a drill does, and where it writes what it finds.
pub(crate) struct Extent {
    /// A small part, in about 20 seconds.
    is_quick: bool,
    seed: u64,
    /// Ends the drill after so many minutes, if it is not done before.
    minutes: f64,
    /// Runs at a time.
    jobs: u32,
    /// Episodes of the soak.
    episodes: u32,
    /// The only cell of the grid.
    cell: Option<String>,
    json: PathBuf,
    command: String,
}

impl Extent {
    /// Whether the drill has to end; records what it has found so far.
    fn is_over(&self, report: &Report) -> bool {
        if let Err(error) = report.write(&self.json, &self.command) {
            eprintln!("{error}");
        }
        report.seconds() > self.minutes * 60.0
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
    let mut arguments = std::env::args().skip(1);
    let drill = arguments.next().unwrap_or_default();
    let mut extent = Extent {
        is_quick: false,
        seed: 1,
        minutes: 600.0,
        jobs: 1,
        episodes: 100_000,
        cell: None,
        json: PathBuf::from("/dev/null"),
        command: format!("cargo xtask drill {drill}"),
    };
    let mut given = String::new();
    while let Some(flag) = arguments.next() {
        if flag == "--quick" {
            extent.is_quick = true;
            extent.minutes = extent.minutes.min(QUICK_MINUTES);
            extent.command += " --quick";
            continue;
        }
        let value = arguments.next().ok_or_else(|| format!("{flag} needs a value"))?;
        if flag != "--json" {
            given += &format!(" {flag} {value}");
        }
        let wrong = || format!("{flag} is {value}, and must be a number");
        match flag.as_str() {
            "--json" => extent.json = value.into(),
            "--seed" => extent.seed = value.parse().map_err(|_| wrong())?,
            "--minutes" => extent.minutes = value.parse().map_err(|_| wrong())?,
            "--jobs" => {
                extent.jobs = value.parse().ok().filter(|jobs| *jobs > 0).ok_or_else(wrong)?
            }
            "--episodes" => extent.episodes = value.parse().map_err(|_| wrong())?,
            "--cell" => extent.cell = Some(value),
            _ => return Err(format!("unknown flag {flag}")),
        }
    }
    if !given.is_empty() {
        extent.command += &format!(" --{given}");
    }
    let report = match drill.as_str() {
        "grid" => grid::drill(&extent)?,
        "kills" => kills::drill(&extent)?,
        "disk" => disk::drill(&extent)?,
        "soak" => soak::drill(&extent)?,
        _ => return Err(format!("{drill:?} is none of grid, kills, disk, soak")),
    };
    report.write(&extent.json, &extent.command)?;
    Ok(report.is_clean())
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
