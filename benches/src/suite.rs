//! The whole paper suite with the scripted stand-in, from the command to the table: with empty caches, and again with
//! cached embeddings and documents.

use std::path::Path;
use std::process::Stdio;
use std::time::Instant;

use anyhow::Result;

use crate::runs::{new_cache, run_to_end};
use crate::{Bench, BenchSession, Measurement, Size, Target};

/// The bench.
pub const BENCH: Bench = Bench {
    name: "suite",
    about: "the paper's whole suite with the stand-in, with empty and with full caches",
    run,
};

/// Lanes of the suite's runs.
const LANES: &str = "64";

/// Most rounds: one takes minutes.
const MOST_ROUNDS: u32 = 3;

fn run(session: &BenchSession<'_>) -> Result<Vec<Measurement>> {
    let cache = session.scratch().join("cache");
    new_cache(&cache)?;
    session.progress("empty caches");
    let cold = execute(session, &cache, "cold")?;
    let mut warm = Vec::new();
    for round in 1..=session.rounds.min(MOST_ROUNDS) {
        session.progress(format_args!("full caches, round {round}"));
        warm.push(execute(session, &cache, "warm")?);
    }
    let measurement = |id: &str, caches: &str, seconds: Vec<f64>, target: f64| {
        let description = format!("the paper suite, {caches}");
        Measurement::new(id, description, "s", seconds)
            .target(Target::AtMost(target))
            .parameter("lanes", LANES)
    };
    Ok(vec![
        measurement("suite.cold", "empty caches", vec![cold], 480.0),
        measurement("suite.warm", "embeddings and documents cached", warm, 60.0),
    ])
}

/// Runs the suite and returns its duration in seconds.
fn execute(session: &BenchSession<'_>, cache: &Path, out: &str) -> Result<f64> {
    let mut command = session.run_command()?;
    command.env("MEMTRANSFER_CACHE", cache);
    command.args(["--quiet", "--fresh", "--policy", "grounded", "--lanes", LANES]);
    command.args(["--out", out]).args(session.backend_flags());
    command.args(match session.size {
        Size::Full => &["--suite", "paper"][..],
        Size::Tiny => &["--limit", "2", "--max-steps", "4", "--memory", "working"][..],
    });
    let log = session.scratch().join("run.log");
    let began = Instant::now();
    run_to_end(command.stdout(Stdio::null()), &log)?;
    Ok(began.elapsed().as_secs_f64())
}
