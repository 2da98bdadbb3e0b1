//! A step through all four processes, beside the [bare chain](crate::bare) of the same messages.
//!
//! Views are drawn before the first step (`--warm-views`) and memory is `working`, so nothing is rendered and nothing
//! embedded: what is measured is the way of a step through the processes.

use std::path::Path;
use std::time::Duration;

use anyhow::Result;

use crate::Bench;
use crate::bare;
use crate::figure::{Better, Bound, Figure};
use crate::runs::{Walk, steady_rate};
use crate::session::Session;

/// This bench.
pub const BENCH: Bench = Bench {
    name: "chain",
    about: "steps through all four processes, beside a bare chain of the same messages",
    run,
};

/// Lanes of a full house.
const LANES: u32 = 64;

/// Flags of every run here.
pub(crate) const WARM: [&str; 7] =
    ["--suite", "quick", "--warm-views", "--memory", "working", "--starts", "new"];

/// What is walked with many lanes: id, what it is, repetitions of its cases, target in steps a second.
const CROWDS: [(&str, &str, u32, f64); 3] = [
    ("random", "policy `random`", 24, 200_000.0),
    ("grounded", "policy `grounded`", 12, 80_000.0),
    ("python", "a Python policy that returns at once", 6, 30_000.0),
];

fn run(session: &mut Session<'_>) -> Result<Vec<Figure>> {
    let length = Duration::from_millis(session.size.pick(50, 2000));
    let lanes = session.size.pick(4, LANES);
    // Fifty cases of up to 200 steps, each so often.
    let alone =
        Walk::new(1, session.size.pick(1, 3), &[&WARM[..], &["--policy", "random"]].concat());
    let (mut one, mut bare_one) = (Vec::new(), Vec::new());
    let (mut many, mut bare_many) = (vec![Vec::new(); CROWDS.len()], Vec::new());
    for round in 1..=session.rounds() {
        session.say(format_args!("round {round}: one lane"));
        one.push(1e6 / steady_rate(&small(session, alone.clone()).make(session, "one")?)?);
        bare_one.push(1e6 / bare::steps_per_second(session, 1, length)?);
        session.say(format_args!("round {round}: {lanes} lanes"));
        bare_many.push(bare::steps_per_second(session, lanes, length)?);
        for (rates, (id, _, runs, _)) in many.iter_mut().zip(CROWDS) {
            let Some(walk) = crowd(session, id, lanes, session.size.pick(1, runs)) else {
                continue;
            };
            rates.push(steady_rate(&small(session, walk).make(session, id)?)?);
        }
    }
    let mut figures = vec![
        Figure::new(
            "chain.1.random",
            "a step of one lane through four processes, warm, policy `random`",
            "us",
            Better::Lower,
        )
        .ours(one)
        .peer("the bare chain", "", bare_one)
        .target(Bound::Ratio(1.5), "within 1.5 x")
        .parameter("lanes", 1),
    ];
    for (rates, (id, what, _, target)) in many.into_iter().zip(CROWDS) {
        if rates.is_empty() {
            continue;
        }
        figures.push(
            Figure::new(
                format!("chain.64.{id}"),
                format!("steps of {lanes} lanes through four processes, warm, {what}"),
                "steps/s",
                Better::Higher,
            )
            .ours(rates)
            .peer("the bare chain", "", bare_many.clone())
            .target(Bound::Value(target), format!("{} steps/s", crate::figure::shown(target)))
            .parameter("lanes", lanes),
        );
    }
    Ok(figures)
}

/// The run of many lanes called `id`; `None` where it needs a Python that is not there.
fn crowd(session: &Session<'_>, id: &str, lanes: u32, runs: u32) -> Option<Walk> {
    if id != "python" {
        return Some(Walk::new(lanes, runs, &[&WARM[..], &["--policy", id]].concat()));
    }
    let package = Path::new(env!("CARGO_MANIFEST_DIR")).join("../python");
    let script = package.join("examples/return_at_once.py");
    let python = session.peers?.python.display().to_string();
    let command = format!("'{python}' -s '{}'", script.display());
    let mut walk = Walk::new(lanes, runs, &[&WARM[..], &["--policy-cmd", &command]].concat());
    walk.env.push(("PYTHONPATH".to_owned(), package.display().to_string()));
    Some(walk)
}

/// The same, small where the session is.
fn small(session: &Session<'_>, mut walk: Walk) -> Walk {
    let few = ["--limit", "6", "--max-steps", "6", "--frame-size", "64"];
    walk.flags.extend(session.size.pick(&few[..], &[]).iter().map(|flag| (*flag).to_owned()));
    walk
}
