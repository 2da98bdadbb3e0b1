//! Approximate search against FAISS's HNSW and usearch from Python, each at the least effort at which it finds what is
//! asked for.
//!
//! Every side has the same vectors, the same neighbours a node and the same effort in building. How many nodes are kept in
//! sight while the graph is walked is raised until the recall is reached, since what that number is worth is
//! not the same to all. A graph of ten million would take hours to build on two cores: the sizes end where a round
//! takes minutes.

use anyhow::{Context, Result};
use serde_json::json;

use crate::Bench;
use crate::figure::{Better, Bound, Figure};
use crate::peers::Peer;
use crate::search::{BATCH, Line, load, profile, threads};
use crate::session::Session;

/// This bench.
pub const BENCH: Bench = Bench {
    name: "approximate",
    about: "approximate search against FAISS HNSW and usearch at the same recall",
    run,
};

/// Entries and dimension of the memories.
const SIZES: &[(u32, u32)] = &[(10_000, 384), (100_000, 384)];

/// The recall at ten that is asked for.
const RECALL: f64 = 0.9;

/// Nodes kept in sight, from the least on.
const SEARCHING: [usize; 6] = [16, 32, 64, 128, 256, 512];

/// Neighbours of a node, and nodes kept in sight while building: of all sides.
const CONNECTIVITY: usize = 16;
const BUILDING: usize = 128;

/// The peers: script, name.
const PEERS: [(&str, &str); 2] =
    [("search_faiss.py", "FAISS HNSW"), ("search_usearch.py", "usearch from Python")];

/// What one side came to in one round.
#[derive(Debug, Clone, Copy)]
struct Found {
    one: f64,
    batch: f64,
    recall: f64,
    searching: usize,
}

fn run(session: &mut Session<'_>) -> Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for &size in session.size.pick(&[(300, 32)][..], SIZES) {
        let (mut exact, mut ours) = (Vec::new(), Vec::new());
        let mut peers: Vec<(Option<Peer>, String, Vec<Found>)> =
            PEERS.iter().map(|_| (None, String::new(), Vec::new())).collect();
        for round in 1..=session.rounds() {
            session.say(format_args!("{} of {}, round {round}", size.0, size.1));
            let (found, exactly) = our_round(session, size)?;
            ours.push(found);
            exact.push(exactly);
            let Some(python) = session.peers else { continue };
            for ((peer, version, rounds), (script, _)) in peers.iter_mut().zip(PEERS) {
                let peer = match peer {
                    Some(peer) => peer,
                    None => {
                        let mut started = Peer::start(python, script, session.scratch())?;
                        let mut request = load(session, size)?;
                        request["graph"] =
                            json!({"connectivity": CONNECTIVITY, "building": BUILDING});
                        let answer = started.ask(&request)?;
                        *version = answer["version"].as_str().unwrap_or_default().to_owned();
                        peer.insert(started)
                    }
                };
                rounds.push(their_round(session, peer)?);
            }
        }
        figures.extend(figures_of(size, &exact, &ours, &peers));
    }
    Ok(figures)
}

/// Ours at the least effort that reaches the recall, and the median of an exact search of the same memory.
fn our_round(session: &Session<'_>, size: (u32, u32)) -> Result<(Found, f64)> {
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
    let graph: Vec<&Line> = lines.iter().filter(|line| line.searching.is_some()).collect();
    let reached = |line: &&&Line| line.recall_at_10 >= RECALL;
    let first = graph.iter().find(reached).or(graph.last()).context("no approximate search")?;
    let of =
        |batch| graph.iter().find(|line| line.searching == first.searching && line.batch == batch);
    let (one, batch) = (of(1).context("no single query")?, of(BATCH).context("no batch")?);
    let found = Found {
        one: one.seconds(),
        batch: batch.seconds(),
        recall: one.recall_at_10,
        searching: one.searching.unwrap_or_default(),
    };
    Ok((found, exact))
}

/// A peer at the least effort that reaches the recall.
fn their_round(session: &Session<'_>, peer: &mut Peer) -> Result<Found> {
    let mut walk = |searching: usize, batch: usize, seconds: f64| -> Result<(f64, f64)> {
        let request =
            json!({"do": "walk", "searching": searching, "batch": batch, "seconds": seconds});
        let answer = peer.ask(&request)?;
        let number = |key: &str| answer[key].as_f64().context("a number is missing");
        Ok((number("recall_at_10")?, number("seconds")?))
    };
    let mut searching = SEARCHING[0];
    for tried in SEARCHING {
        searching = tried;
        if walk(tried, 1, 0.0)?.0 >= RECALL {
            break;
        }
    }
    let seconds = session.size.pick(0.02, 1.0);
    let (recall, one) = walk(searching, 1, seconds)?;
    let (_, batch) = walk(searching, BATCH, seconds)?;
    Ok(Found { one, batch, recall, searching })
}

fn figures_of(
    (entries, dimension): (u32, u32),
    exact: &[f64],
    ours: &[Found],
    peers: &[(Option<Peer>, String, Vec<Found>)],
) -> Vec<Figure> {
    let of = |rounds: &[Found], value: fn(&Found) -> f64| -> Vec<f64> {
        rounds.iter().map(value).collect()
    };
    let micros: fn(&Found) -> f64 = |found| found.one * 1e6;
    let rate: fn(&Found) -> f64 = |found| BATCH as f64 / found.batch;
    let last = |rounds: &[Found]| {
        rounds.last().map_or_else(String::new, |found| {
            format!("{:.3} with {} nodes in sight", found.recall, found.searching)
        })
    };
    let named = |figure: Figure| {
        figure
            .parameter("entries", entries)
            .parameter("dimension", dimension)
            .parameter("recall at ten asked for", RECALL)
            .parameter("neighbours of a node", CONNECTIVITY)
            .parameter("nodes in sight while building", BUILDING)
            .parameter("threads of a batch", threads())
            .parameter("ours found", last(ours))
    };
    let id = |what: &str| format!("approximate.{entries}x{dimension}.{what}");
    let mut figures = vec![named(
        Figure::new(
            id("one.exact"),
            format!("one approximate query of {entries} vectors, beside our exact search"),
            "us",
            Better::Lower,
        )
        .ours(of(ours, micros))
        .peer("ours, exact", "", exact.iter().map(|s| s * 1e6).collect::<Vec<_>>()),
    )];
    for ((_, version, rounds), (script, name)) in peers.iter().zip(PEERS) {
        if rounds.is_empty() {
            continue;
        }
        let short = script.trim_start_matches("search_").trim_end_matches(".py");
        let figure = |what: &str, text: String, unit: &str, better, value: fn(&Found) -> f64| {
            named(
                Figure::new(id(&format!("{what}.{short}")), text, unit, better)
                    .ours(of(ours, value))
                    .peer(name, version.clone(), of(rounds, value))
                    .target(Bound::Ratio(1.0), "same recall, no slower")
                    .parameter("peer found", last(rounds)),
            )
        };
        let text = format!("one approximate query of {entries} vectors of {dimension}");
        figures.push(figure("one", text, "us", Better::Lower, micros));
        let text = format!("approximate queries, {BATCH} at once, of {entries} vectors");
        figures.push(figure("batch", text, "queries/s", Better::Higher, rate));
    }
    figures
}
