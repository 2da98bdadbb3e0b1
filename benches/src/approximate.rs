//! Approximate search against FAISS's HNSW and usearch from Python, at equal recall.
//!
//! Every side has the same vectors, the same neighbours per node and the same construction effort. The search effort (ef)
//! is raised until the recall is reached, because equal effort does not mean equal recall. A graph of ten million vectors
//! would take hours to build on two cores, so the sizes end where a round takes minutes.

use anyhow::{Context, Result};
use domain::search_profile::SearchMeasurement;
use serde_json::json;

use crate::Bench;
use crate::baselines::Baseline;
use crate::figure::{Better, FigureBound, Measurement};
use crate::search::{BATCH, load, profile, threads};
use crate::session::BenchSession;

/// The bench.
pub const BENCH: Bench = Bench {
    name: "approximate",
    about: "approximate search against FAISS HNSW and usearch at the same recall",
    run,
};

/// Entries and dimension of each memory.
const SIZES: &[(u32, u32)] = &[(10_000, 384), (100_000, 384)];

/// Required recall at 10.
const RECALL: f64 = 0.9;

/// Search efforts (ef), ascending.
const SEARCHING: [usize; 6] = [16, 32, 64, 128, 256, 512];

/// Neighbours per node (M) and construction effort (ef_construction) of every side.
const CONNECTIVITY: usize = 32;
const BUILDING: usize = 128;

/// Baselines: script and name.
const BASELINES: [(&str, &str); 2] =
    [("search_faiss.py", "FAISS HNSW"), ("search_usearch.py", "usearch from Python")];

/// Result of one side in one round.
#[derive(Debug, Clone, Copy)]
struct SideResult {
    one: f64,
    batch: f64,
    recall: f64,
    searching: usize,
}

fn run(session: &mut BenchSession<'_>) -> Result<Vec<Measurement>> {
    let mut figures = Vec::new();
    for &size in session.size.pick(&[(300, 32)][..], SIZES) {
        let (mut exact, mut ours) = (Vec::new(), Vec::new());
        let mut baselines: Vec<(Option<Baseline>, String, Vec<SideResult>)> =
            BASELINES.iter().map(|_| (None, String::new(), Vec::new())).collect();
        for round in 1..=session.rounds() {
            session.say(format_args!("{} of {}, round {round}", size.0, size.1));
            let (found, exactly) = our_round(session, size)?;
            ours.push(found);
            exact.push(exactly);
            let Some(python) = session.python else { continue };
            for ((baseline, version, rounds), (script, _)) in baselines.iter_mut().zip(BASELINES) {
                let baseline = match baseline {
                    Some(baseline) => baseline,
                    None => {
                        let mut started = Baseline::start(python, script, session.scratch())?;
                        let mut request = load(session, size)?;
                        request["graph"] =
                            json!({"connectivity": CONNECTIVITY, "building": BUILDING});
                        let answer = started.ask(&request)?;
                        *version = answer["version"].as_str().unwrap_or_default().to_owned();
                        baseline.insert(started)
                    }
                };
                rounds.push(their_round(session, baseline)?);
            }
        }
        figures.extend(figures_of(size, &exact, &ours, &baselines));
    }
    Ok(figures)
}

/// Measures ours at the least effort that reaches the recall, and the median of an exact search of the same memory.
fn our_round(session: &BenchSession<'_>, size: (u32, u32)) -> Result<(SideResult, f64)> {
    let searching = SEARCHING.map(|n| n.to_string()).join(",");
    let (connectivity, building) = (CONNECTIVITY.to_string(), BUILDING.to_string());
    let seconds = session.size.pick("0.02", "1");
    let lines = profile(
        session,
        size,
        &[
            ["--search", "both"],
            ["--searching", &searching],
            ["--connectivity", &connectivity],
            ["--building", &building],
            ["--seconds", seconds],
        ]
        .concat(),
    )?;
    let exact = lines.iter().find(|line| line.searching.is_none() && line.batch == 1);
    let exact = exact.context("no exact search")?.seconds();
    let graph: Vec<&SearchMeasurement> =
        lines.iter().filter(|line| line.searching.is_some()).collect();
    let reached = |line: &&&SearchMeasurement| line.recall_at_10 >= RECALL;
    let first = graph.iter().find(reached).or(graph.last()).context("no approximate search")?;
    let of =
        |batch| graph.iter().find(|line| line.searching == first.searching && line.batch == batch);
    let (one, batch) = (of(1).context("no single query")?, of(BATCH).context("no batch")?);
    let found = SideResult {
        one: one.seconds(),
        batch: batch.seconds(),
        recall: one.recall_at_10,
        searching: one.searching.unwrap_or_default(),
    };
    Ok((found, exact))
}

/// Measures a baseline at the least effort that reaches the recall.
fn their_round(session: &BenchSession<'_>, baseline: &mut Baseline) -> Result<SideResult> {
    let mut query = |searching: usize, batch: usize, seconds: f64| -> Result<(f64, f64)> {
        let request =
            json!({"do": "query", "searching": searching, "batch": batch, "seconds": seconds});
        let answer = baseline.ask(&request)?;
        let number = |key: &str| answer[key].as_f64().context("a number is missing");
        Ok((number("recall_at_10")?, number("seconds")?))
    };
    let mut searching = SEARCHING[0];
    for tried in SEARCHING {
        searching = tried;
        if query(tried, 1, 0.0)?.0 >= RECALL {
            break;
        }
    }
    let seconds = session.size.pick(0.02, 1.0);
    let (recall, one) = query(searching, 1, seconds)?;
    let (_, batch) = query(searching, BATCH, seconds)?;
    Ok(SideResult { one, batch, recall, searching })
}

fn figures_of(
    (entries, dimension): (u32, u32),
    exact: &[f64],
    ours: &[SideResult],
    baselines: &[(Option<Baseline>, String, Vec<SideResult>)],
) -> Vec<Measurement> {
    let of = |rounds: &[SideResult], value: fn(&SideResult) -> f64| -> Vec<f64> {
        rounds.iter().map(value).collect()
    };
    let micros: fn(&SideResult) -> f64 = |found| found.one * 1e6;
    let rate: fn(&SideResult) -> f64 = |found| BATCH as f64 / found.batch;
    let last = |rounds: &[SideResult]| {
        rounds.last().map_or_else(String::new, |found| {
            format!("{:.3} at ef {}", found.recall, found.searching)
        })
    };
    let named = |figure: Measurement| {
        figure
            .parameter("entries", entries)
            .parameter("dimension", dimension)
            .parameter("required recall at 10", RECALL)
            .parameter("neighbours per node", CONNECTIVITY)
            .parameter("construction effort", BUILDING)
            .parameter("threads per batch", threads())
            .parameter("ours found", last(ours))
    };
    let id = |what: &str| format!("approximate.{entries}x{dimension}.{what}");
    let mut figures = vec![named(
        Measurement::new(
            id("one.exact"),
            format!("one approximate query of {entries} vectors, beside our exact search"),
            "us",
            Better::Lower,
        )
        .ours(of(ours, micros))
        .baseline("ours, exact", "", exact.iter().map(|s| s * 1e6).collect::<Vec<_>>()),
    )];
    for ((_, version, rounds), (script, name)) in baselines.iter().zip(BASELINES) {
        if rounds.is_empty() {
            continue;
        }
        let short = script.trim_start_matches("search_").trim_end_matches(".py");
        let figure =
            |what: &str, text: String, unit: &str, better, value: fn(&SideResult) -> f64| {
                named(
                    Measurement::new(id(&format!("{what}.{short}")), text, unit, better)
                        .ours(of(ours, value))
                        .baseline(name, version.clone(), of(rounds, value))
                        .target(FigureBound::Ratio(1.0), "same recall, no slower")
                        .parameter("baseline found", last(rounds)),
                )
            };
        let text = format!("one approximate query of {entries} vectors of {dimension}");
        figures.push(figure("one", text, "us", Better::Lower, micros));
        let text = format!("approximate queries, {BATCH} at once, of {entries} vectors");
        figures.push(figure("batch", text, "queries/s", Better::Higher, rate));
    }
    figures
}
