//! Exact search against FAISS's flat index, and against the memory's bandwidth.
//!
//! Both sides use the same vectors: `memory-proc vectors` writes those that `memory-proc profile` measures with. The
//! largest memory fits the machine only once, so there the process of one side ends before that of the other starts.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use domain::search_profile::SearchMeasurement;
use orchestrator::machine::floors::{Effort, measure};
use orchestrator::machine::memory_available;
use serde_json::{Value, json};

use crate::Bench;
use crate::baselines::Baseline;
use crate::figure::{Better, FigureBound, Measurement};
use crate::session::BenchSession;

/// The bench.
pub const BENCH: Bench = Bench {
    name: "search",
    about: "exact search against FAISS flat and the memory's bandwidth",
    run,
};

/// Queries in a batch.
pub(crate) const BATCH: usize = 64;

/// Queries given to the baseline, which repeats them.
pub(crate) const QUERIES: usize = 1024;

/// Entries and dimension of each memory.
const SIZES: &[(u32, u32)] = &[
    (1_000, 384),
    (10_000, 384),
    (100_000, 384),
    (1_000_000, 384),
    (10_000_000, 384),
    (1_000_000, 768),
    (5_000_000, 768),
];

/// Bytes of vectors above which only one memory is loaded at a time and rounds are limited.
const HUGE: u64 = 6 << 30;

/// Rounds of such a memory, whose filling takes minutes.
const HUGE_ROUNDS: u32 = 2;

/// Bytes of quantized codes above which a search is bound by memory bandwidth.
const BEYOND_CACHES: u64 = 300 << 20;

/// Measurement of one memory by `memory-proc profile`.
pub(crate) fn profile(
    session: &BenchSession<'_>,
    (entries, dimension): (u32, u32),
    flags: &[&str],
) -> Result<Vec<SearchMeasurement>> {
    let mut command = Command::new(session.program("memory-proc")?);
    command
        .args(["profile", "--entries", &entries.to_string()])
        .args(["--dimension", &dimension.to_string()])
        .args(flags)
        .stdin(Stdio::null());
    let output = command.output().context("cannot start memory-proc")?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "memory-proc profile: {said}");
    let lines = String::from_utf8(output.stdout)?;
    lines.lines().map(|line| Ok(serde_json::from_str(line)?)).collect()
}

/// The request that makes a baseline load a memory.
pub(crate) fn load(session: &BenchSession<'_>, (entries, dimension): (u32, u32)) -> Result<Value> {
    let program = session.program("memory-proc")?.display().to_string();
    let (count, length, queries) =
        (entries.to_string(), dimension.to_string(), QUERIES.to_string());
    Ok(json!({
        "do": "load",
        "command": [program, "vectors", "--entries", count, "--dimension", length, "--queries", queries],
        "entries": entries,
        "dimension": dimension,
        "queries": QUERIES,
        "threads": threads(),
    }))
}

/// Threads of either side.
pub(crate) fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Measurements of one memory, one value per round.
#[derive(Default)]
struct SearchRounds {
    one: Vec<f64>,
    batch: Vec<f64>,
    read: Vec<f64>,
    bandwidth: Vec<f64>,
    baseline_one: Vec<f64>,
    baseline_batch: Vec<f64>,
    version: String,
    real: u32,
}

fn run(session: &mut BenchSession<'_>) -> Result<Vec<Measurement>> {
    let mut figures = Vec::new();
    for &size in session.size.pick(&[(300, 32)][..], SIZES) {
        let (entries, dimension) = size;
        let bytes = u64::from(entries) * u64::from(dimension) * 4;
        if bytes / 4 * 6 > memory_available() {
            session
                .say(format_args!("{entries} of {dimension}: the machine has too little memory"));
            continue;
        }
        let rounds = measured(session, size, bytes)?;
        figures.extend(figures_of(size, rounds));
    }
    Ok(figures)
}

fn measured(session: &BenchSession<'_>, size: (u32, u32), bytes: u64) -> Result<SearchRounds> {
    let huge = bytes > HUGE;
    let mut rounds = SearchRounds::default();
    let mut kept = None;
    let count = if huge { session.rounds().min(HUGE_ROUNDS) } else { session.rounds() };
    for round in 1..=count {
        session.say(format_args!("{} of {}, round {round}", size.0, size.1));
        let seconds = session.size.pick("0.05", "2");
        let lines = profile(session, size, &["--seconds", seconds])?;
        for line in lines {
            rounds.real = line.real;
            if line.batch == BATCH {
                rounds.batch.push(line.seconds());
            } else {
                rounds.one.push(line.seconds());
                rounds.read.extend((bytes / 4 >= BEYOND_CACHES).then_some(line.bytes_per_s));
            }
        }
        if bytes / 4 >= BEYOND_CACHES {
            rounds.bandwidth.push(measure(Effort::FULL)?.read_all_cores);
        }
        let Some(python) = session.python else { continue };
        let mut baseline = match kept.take() {
            Some(baseline) => baseline,
            None => loaded(session, python, size, &mut rounds)?,
        };
        let mut time = |batch: usize| {
            let seconds = session.size.pick(0.05, 2.0);
            baseline
                .ask_number(&json!({"do": "time", "batch": batch, "seconds": seconds}), "seconds")
        };
        rounds.baseline_one.push(time(1)?);
        rounds.baseline_batch.push(time(BATCH)?);
        kept = Some(baseline).filter(|_| !huge);
    }
    Ok(rounds)
}

fn loaded(
    session: &BenchSession<'_>,
    python: &Path,
    size: (u32, u32),
    rounds: &mut SearchRounds,
) -> Result<Baseline> {
    let mut baseline = Baseline::start(python, "search_faiss.py", session.scratch())?;
    let answer = baseline.ask(&load(session, size)?)?;
    rounds.version = answer["version"].as_str().unwrap_or_default().to_owned();
    Ok(baseline)
}

fn figures_of((entries, dimension): (u32, u32), rounds: SearchRounds) -> Vec<Measurement> {
    let SearchRounds { one, batch, read, bandwidth, baseline_one, baseline_batch, version, real } =
        rounds;
    let micros = |seconds: Vec<f64>| seconds.into_iter().map(|s| s * 1e6).collect::<Vec<_>>();
    let rates =
        |seconds: Vec<f64>| seconds.into_iter().map(|s| BATCH as f64 / s).collect::<Vec<_>>();
    let named = |figure: Measurement| {
        figure
            .parameter("entries", entries)
            .parameter("dimension", dimension)
            .parameter("embeddings among them", real)
            .parameter("threads, at most", threads())
    };
    let id = |what: &str| format!("search.{entries}x{dimension}.{what}");
    let mut single = Measurement::new(
        id("one"),
        format!("one exact query of {entries} vectors of {dimension}"),
        "us",
        Better::Lower,
    )
    .ours(micros(one))
    .target(FigureBound::Ratio(1.0), "at or above FAISS");
    let mut many = Measurement::new(
        id("batch"),
        format!("exact queries, {BATCH} at once, of {entries} vectors of {dimension}"),
        "queries/s",
        Better::Higher,
    )
    .ours(rates(batch))
    .target(FigureBound::Ratio(5.0), "five times FAISS");
    if !baseline_one.is_empty() {
        single = single.baseline("FAISS flat", version.clone(), micros(baseline_one));
        many = many.baseline("FAISS flat", version, rates(baseline_batch));
    }
    let mut figures = vec![named(single), named(many)];
    if !read.is_empty() {
        let giga = |rates: Vec<f64>| rates.into_iter().map(|rate| rate / 1e9).collect::<Vec<_>>();
        let figure = Measurement::new(
            id("read"),
            format!("memory read by one exact query of {entries} vectors of {dimension}"),
            "GB/s",
            Better::Higher,
        )
        .ours(giga(read))
        .baseline("a plain read loop", "", giga(bandwidth))
        .target(FigureBound::Ratio(0.8), "80 % of the bandwidth")
        .note("reads the quantized codes, a quarter of the vectors' size");
        figures.push(named(figure));
    }
    figures
}
