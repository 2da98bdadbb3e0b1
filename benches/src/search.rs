//! Exact search beside FAISS's flat index.
//!
//! Both sides use the same vectors: `memory-proc vectors` writes those that `memory-proc profile` measures with. The
//! largest memory fits the machine only once, so the process of one side ends before that of the other starts.

use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use domain::search_profile::SearchMeasurement;
use orchestrator::machine::memory_available;
use serde_json::{Value, json};

use crate::session::threads;
use crate::{Baseline, Bench, BenchSession, Measurement, Target};

/// The bench.
pub const BENCH: Bench =
    Bench { name: "search", about: "exact search, beside FAISS's flat index", run };

/// Queries in a batch.
const BATCH: usize = 64;

/// Queries given to the baseline, which repeats them.
const QUERIES: usize = 1024;

/// Numbers in a vector.
const DIMENSION: u32 = 384;

/// Sizes of the memory.
const SIZES: [u32; 5] = [1_000, 10_000, 100_000, 1_000_000, 10_000_000];

/// Number of entries from which rounds are limited to [`FEW_ROUNDS`]: filling such a memory takes minutes.
const LARGE: u32 = 1_000_000;

/// Most rounds with a large memory.
const FEW_ROUNDS: u32 = 2;

/// The median times of both sides in seconds, one value per round.
#[derive(Default)]
struct SearchTimes {
    one: Vec<f64>,
    batch: Vec<f64>,
    baseline_one: Vec<f64>,
    baseline_batch: Vec<f64>,
    /// Version of the baseline.
    version: String,
}

fn run(session: &BenchSession<'_>) -> Result<Vec<Measurement>> {
    let mut measurements = Vec::new();
    for &entries in session.size.pick(&[300][..], &SIZES) {
        let bytes = u64::from(entries) * u64::from(DIMENSION) * 4;
        // The vectors, their codes, and some room.
        if bytes / 4 * 6 > memory_available() {
            session.progress(format_args!("{entries}: the machine has too little memory"));
            continue;
        }
        measurements.extend(measurements_of(entries, time(session, entries)?));
    }
    Ok(measurements)
}

fn time(session: &BenchSession<'_>, entries: u32) -> Result<SearchTimes> {
    let mut times = SearchTimes::default();
    let rounds = if entries < LARGE { session.rounds } else { session.rounds.min(FEW_ROUNDS) };
    let seconds = session.size.pick(0.05, 2.0);
    for round in 1..=rounds {
        session.progress(format_args!("{entries} entries, round {round}"));
        for measured in profile(session, entries, seconds)? {
            let batch = if measured.batch == BATCH { &mut times.batch } else { &mut times.one };
            batch.push(measured.seconds());
        }
        let Some(python) = session.python else { continue };
        let mut baseline = Baseline::start(python, "search_faiss.py", session.scratch())?;
        let loaded = baseline.ask(&load_request(session, entries)?)?;
        loaded["version"].as_str().unwrap_or_default().clone_into(&mut times.version);
        let mut median_seconds = |batch: usize| {
            let request = json!({"do": "time", "batch": batch, "seconds": seconds});
            baseline.ask_number(&request, "seconds")
        };
        times.baseline_one.push(median_seconds(1)?);
        times.baseline_batch.push(median_seconds(BATCH)?);
    }
    Ok(times)
}

/// Measures one memory of ours, with single queries and with batches.
fn profile(
    session: &BenchSession<'_>,
    entries: u32,
    seconds: f64,
) -> Result<Vec<SearchMeasurement>> {
    let mut command = Command::new(session.program("memory-proc")?);
    command
        .args(["profile", "--entries", &entries.to_string()])
        .args(["--dimension", &DIMENSION.to_string(), "--seconds", &seconds.to_string()])
        .stdin(Stdio::null());
    let output = command.output().context("cannot start memory-proc")?;
    let messages = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "memory-proc profile: {messages}");
    let lines = String::from_utf8(output.stdout)?;
    lines.lines().map(|line| Ok(serde_json::from_str(line)?)).collect()
}

/// The request that makes the baseline load a memory.
fn load_request(session: &BenchSession<'_>, entries: u32) -> Result<Value> {
    let program = session.program("memory-proc")?.display().to_string();
    let [count, dimension, queries] =
        [entries.to_string(), DIMENSION.to_string(), QUERIES.to_string()];
    Ok(json!({
        "do": "load",
        "command": [program, "vectors", "--entries", count, "--dimension", dimension, "--queries", queries],
        "entries": entries,
        "dimension": DIMENSION,
        "queries": QUERIES,
        "threads": threads(),
    }))
}

fn measurements_of(entries: u32, times: SearchTimes) -> [Measurement; 2] {
    let SearchTimes { one, batch, baseline_one, baseline_batch, version } = times;
    let us = |seconds: Vec<f64>| seconds.into_iter().map(|s| s * 1e6).collect::<Vec<_>>();
    let rates =
        |seconds: Vec<f64>| seconds.into_iter().map(|s| BATCH as f64 / s).collect::<Vec<_>>();
    let measurement = |id: &str, description: String, unit, ours| {
        Measurement::new(format!("search.{entries}.{id}"), description, unit, ours)
            .parameter("dimension", DIMENSION)
            .parameter("threads, at most", threads())
    };
    let (name, description) =
        (format!("FAISS {version}"), format!("one query of {entries} vectors"));
    [
        measurement("one", description, "us", us(one))
            .beside(name.clone(), us(baseline_one))
            .target(Target::RatioAtMost(1.0)),
        measurement("batch", format!("{BATCH} at once of {entries}"), "queries/s", rates(batch))
            .beside(name, rates(baseline_batch))
            .target(Target::RatioAtLeast(5.0)),
    ]
}
