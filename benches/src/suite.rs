//! The whole paper suite with the scripted stand-in, from the command to the table: with empty caches, and again with
//! cached embeddings and documents.

use std::path::Path;
use std::time::Instant;

use anyhow::Result;

use crate::Bench;
use crate::figure::{Better, FigureBound, Measurement};
use crate::runs::{ended_well, new_cache};
use crate::session::{BenchSession, Size};

/// The bench.
pub const BENCH: Bench =
    Bench { name: "suite", about: "the paper's whole suite with the stand-in, cold and warm", run };

/// Lanes of the suite's runs.
const LANES: &str = "64";

fn run(session: &mut BenchSession<'_>) -> Result<Vec<Measurement>> {
    let cache = session.scratch().join("cache");
    new_cache(&cache)?;
    session.say("cold");
    let cold = execute(session, &cache, "cold")?;
    let mut warm = Vec::new();
    // A round takes minutes.
    for round in 1..=session.rounds().min(3) {
        session.say(format_args!("warm, round {round}"));
        warm.push(execute(session, &cache, "warm")?);
    }
    let figure = |id: &str, what: &str, seconds: Vec<f64>, target: (f64, &str)| {
        Measurement::new(id, what, "s", Better::Lower)
            .ours(seconds)
            .target(FigureBound::Value(target.0), target.1)
            .parameter("lanes", LANES)
    };
    Ok(vec![
        figure(
            "suite.warm",
            "the paper suite with `grounded`, embeddings and documents cached",
            warm,
            (60.0, "1 minute"),
        ),
        figure(
            "suite.cold",
            "the paper suite with `grounded`, empty caches",
            vec![cold],
            (480.0, "under 8 minutes"),
        ),
    ])
}

/// Runs the suite and returns its duration in seconds.
fn execute(session: &BenchSession<'_>, cache: &Path, out: &str) -> Result<f64> {
    let mut command = session.run_command()?;
    command.env("MEMTRANSFER_CACHE", cache);
    command.args(["--quiet", "--fresh", "--policy", "grounded", "--lanes", LANES]);
    command.args(["--out", out]);
    command.args(match session.size {
        Size::Full => &["--suite", "paper"][..],
        Size::Tiny => &["--limit", "2", "--max-steps", "4", "--memory", "working"][..],
    });
    let log = session.scratch().join("run.log");
    let began = Instant::now();
    ended_well(command.stdout(std::process::Stdio::null()), &log)?;
    Ok(began.elapsed().as_secs_f64())
}
