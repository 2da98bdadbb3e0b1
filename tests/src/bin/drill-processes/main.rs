//! Drills of real processes: short runs that are disturbed on purpose, and must end with the log of an undisturbed one.
//! `cargo xtask drill` starts it. Faults of files, and of the order and the time of messages, are those of `drill-sim`.

mod disk;
mod grid;
mod harness;
mod kills;
mod report;
mod soak;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use clap::builder::PossibleValuesParser;
use report::Report;

/// No new disturbance begins in a quick drill after so many minutes.
const QUICK_MINUTES: f64 = 1.0;

/// A kind of drill.
struct Drill {
    name: &'static str,
    /// What it does, for the reader of its report.
    text: &'static str,
    run: fn(&Extent, &mut Report) -> Result<(), String>,
}

/// All kinds.
const DRILLS: [Drill; 4] = [
    Drill { name: "grid", text: grid::TEXT, run: grid::drill },
    Drill { name: "kills", text: kills::TEXT, run: kills::drill },
    Drill { name: "disk", text: disk::TEXT, run: disk::drill },
    Drill { name: "soak", text: soak::TEXT, run: soak::drill },
];

/// Disturb short runs on purpose; each must end with the log of an undisturbed one
///
/// Exit status: 0 no violation, 1 violations, 2 error.
#[derive(Debug, Parser)]
struct Arguments {
    /// The drill
    #[arg(value_parser = PossibleValuesParser::new(DRILLS.map(|drill| drill.name)))]
    drill: String,
    #[command(flatten)]
    extent: Extent,
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
    /// Only disturbances of `grid` and `kills` whose kind or process has this text, such as "external world"
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    only: String,
    /// The only cell of `grid`, as a violation names it
    #[arg(long, value_name = "CELL")]
    cell: Option<String>,
    /// Write what was found as JSON, also while the drill goes on
    #[arg(long, value_name = "FILE", default_value = "/dev/null")]
    json: PathBuf,
}

impl Extent {
    /// Whether the drill has to end; records what it has found so far.
    fn is_over(&self, report: &Report) -> bool {
        if let Err(error) = report.write(&self.json) {
            eprintln!("{error}");
        }
        let minutes = if self.is_quick { self.minutes.min(QUICK_MINUTES) } else { self.minutes };
        report.seconds() > minutes * 60.0
    }
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
    let Arguments { drill, extent } = Arguments::parse();
    let found = DRILLS.iter().find(|known| known.name == drill);
    let Drill { text, run, .. } = found.ok_or_else(|| format!("there is no drill {drill}"))?;
    let mut report = Report::new(text);
    run(&extent, &mut report)?;
    report.write(&extent.json)?;
    eprintln!("{}", report.summary());
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
