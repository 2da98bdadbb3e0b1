//! A step through all four processes, beside the [bare chain](crate::bare_chain) of the same messages.
//!
//! Views are rendered before the first step (`--warm-views`) and memory is `working`, so nothing is rendered or embedded
//! while the clock runs.

use std::path::Path;
use std::time::Duration;

use anyhow::Result;

use crate::Bench;
use crate::bare_chain;
use crate::figure::{Better, FigureBound, Measurement};
use crate::runs::{BenchRun, steady_rate};
use crate::session::BenchSession;

/// The bench.
pub const BENCH: Bench = Bench {
    name: "chain",
    about: "steps through all four processes, beside a bare chain of the same messages",
    run,
};

/// Lanes of the throughput figures.
const LANES: u32 = 64;

/// Flags of every run of this bench.
pub(crate) const WARM: [&str; 7] =
    ["--suite", "quick", "--warm-views", "--memory", "working", "--starts", "new"];

/// Runs with many lanes: id, description, repetitions of the cases, target as a share of the bare chain's rate.
const MANY_LANES: [(&str, &str, u32, Option<f64>); 4] = [
    ("random", "policy `random`", 24, Some(0.6)),
    ("grounded", "policy `grounded`", 12, None),
    ("python", "a Python policy that returns at once", 6, Some(0.3)),
    ("memory", "policy `random`, a Python memory that supplies nothing", 6, Some(0.3)),
];

fn run(session: &mut BenchSession<'_>) -> Result<Vec<Measurement>> {
    let length = Duration::from_millis(session.size.pick(50, 2000));
    let lanes = session.size.pick(4, LANES);
    // Fifty cases of up to 200 steps, repeated.
    let alone =
        BenchRun::new(1, session.size.pick(1, 3), &[&WARM[..], &["--policy", "random"]].concat());
    let (mut one, mut bare_one) = (Vec::new(), Vec::new());
    let mut added = Vec::new();
    let (mut many, mut bare_many) = (vec![Vec::new(); MANY_LANES.len()], Vec::new());
    for round in 1..=session.rounds() {
        session.say(format_args!("round {round}: one lane"));
        one.push(1e6 / steady_rate(&shrunk(session, alone.clone()).make(session, "one")?)?);
        bare_one.push(1e6 / bare_chain::steps_per_second(session, 1, length)?);
        if let Some(with_memory) = many_lanes(session, "memory", 1, session.size.pick(1, 3)) {
            let step =
                1e6 / steady_rate(&shrunk(session, with_memory).make(session, "one-memory")?)?;
            added.push(step - one.last().copied().unwrap_or_default());
        }
        session.say(format_args!("round {round}: {lanes} lanes"));
        bare_many.push(bare_chain::steps_per_second(session, lanes, length)?);
        for (rates, (id, _, runs, _)) in many.iter_mut().zip(MANY_LANES) {
            let Some(bench_run) = many_lanes(session, id, lanes, session.size.pick(1, runs)) else {
                continue;
            };
            rates.push(steady_rate(&shrunk(session, bench_run).make(session, id)?)?);
        }
    }
    let mut figures = vec![
        Measurement::new(
            "chain.1.random",
            "a step of one lane through four processes, warm, policy `random`",
            "us",
            Better::Lower,
        )
        .ours(one)
        .baseline("the bare chain", "", bare_one.clone())
        .target(FigureBound::Ratio(1.5), "within 1.5 x")
        .parameter("lanes", 1),
    ];
    if !added.is_empty() {
        // A step of the bare chain is four hops; a query and its answer are two.
        let two_hops: Vec<f64> = bare_one.iter().map(|step| step / 2.0).collect();
        figures.push(
            Measurement::new(
                "chain.1.memory",
                "what a Python memory that supplies nothing adds to a step of one lane",
                "us",
                Better::Lower,
            )
            .ours(added)
            .baseline("two hops of the bare chain", "", two_hops)
            .target(FigureBound::Ratio(1.5), "within 1.5 x")
            .parameter("lanes", 1),
        );
    }
    for (rates, (id, what, _, target)) in many.into_iter().zip(MANY_LANES) {
        if rates.is_empty() {
            continue;
        }
        let figure = Measurement::new(
            format!("chain.64.{id}"),
            format!("steps of {lanes} lanes through four processes, warm, {what}"),
            "steps/s",
            Better::Higher,
        )
        .ours(rates)
        .baseline("the bare chain", "", bare_many.clone())
        .parameter("lanes", lanes);
        figures.push(match target {
            Some(share) => {
                figure.target(FigureBound::Ratio(share), format!("{share} of the bare chain"))
            }
            None => figure,
        });
    }
    Ok(figures)
}

/// The run `id` with many lanes; `None` when it needs a Python environment that was not given.
fn many_lanes(session: &BenchSession<'_>, id: &str, lanes: u32, runs: u32) -> Option<BenchRun> {
    let script = match id {
        "python" => "examples/return_at_once.py",
        "memory" => "examples/supply_nothing.py",
        policy => {
            return Some(BenchRun::new(lanes, runs, &[&WARM[..], &["--policy", policy]].concat()));
        }
    };
    let package = Path::new(env!("CARGO_MANIFEST_DIR")).join("../python");
    let python = session.python?.display().to_string();
    let command = format!("'{python}' -s '{}'", package.join(script).display());
    let flags = match id {
        "python" => [&WARM[..], &["--policy-cmd", &command]].concat(),
        _ => [
            &["--suite", "quick", "--warm-views", "--starts", "new", "--policy", "random"][..],
            &["--memory", "none", "--memory-cmd", &command],
        ]
        .concat(),
    };
    let mut bench_run = BenchRun::new(lanes, runs, &flags);
    bench_run.env.push(("PYTHONPATH".to_owned(), package.display().to_string()));
    Some(bench_run)
}

/// Shrinks the run in a tiny session.
pub(crate) fn shrunk(session: &BenchSession<'_>, mut bench_run: BenchRun) -> BenchRun {
    let few = ["--limit", "6", "--max-steps", "6", "--frame-size", "64"];
    bench_run.flags.extend(session.size.pick(&few[..], &[]).iter().map(|flag| (*flag).to_owned()));
    bench_run
}
