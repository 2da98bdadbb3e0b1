//! A step through all four processes, beside the [bare chain](crate::bare_chain) of the same messages.
//!
//! Views are rendered before the first step (`--warm-views`) and memory is `working` or external, so nothing is rendered
//! or embedded while the clock runs.

use std::path::Path;
use std::time::Duration;

use anyhow::Result;

use crate::bare_chain;
use crate::runs::{BenchRun, steady_rate};
use crate::{Bench, BenchSession, Measurement, Target};

/// The bench.
pub const BENCH: Bench = Bench {
    name: "chain",
    about: "steps through all four processes, beside a bare chain of the same messages",
    run,
};

/// Lanes of the throughput measurements.
const LANES: u32 = 64;

/// Who answers the steps of a run.
#[derive(Clone, Copy)]
enum Participants {
    /// The built-in policy `random` and the built-in working memory.
    BuiltIn,
    /// A Python policy that returns at once.
    PythonPolicy,
    /// The policy `random`, and a Python memory that supplies nothing.
    PythonMemory,
}

/// Runs with many lanes.
struct ManyLanes {
    id: &'static str,
    participants: Participants,
    description: &'static str,
    /// Repetitions of the fifty cases.
    runs: u32,
    /// Least share of the bare chain's rate.
    share: f64,
}

const MANY_LANES: [ManyLanes; 3] = [
    ManyLanes {
        id: "random",
        participants: Participants::BuiltIn,
        description: "policy `random`",
        runs: 24,
        share: 0.6,
    },
    ManyLanes {
        id: "python-policy",
        participants: Participants::PythonPolicy,
        description: "a Python policy that returns at once",
        runs: 6,
        share: 0.3,
    },
    ManyLanes {
        id: "python-memory",
        participants: Participants::PythonMemory,
        description: "a Python memory that supplies nothing",
        runs: 6,
        share: 0.3,
    },
];

fn run(session: &BenchSession<'_>) -> Result<Vec<Measurement>> {
    let length = Duration::from_millis(session.size.pick(50, 2000));
    let lanes = session.size.pick(4, LANES);
    let (mut one, mut bare_one, mut added) = (Vec::new(), Vec::new(), Vec::new());
    let (mut many, mut bare_many) = ([const { Vec::new() }; MANY_LANES.len()], Vec::new());
    for round in 1..=session.rounds {
        session.progress(format_args!("round {round}: one lane"));
        let step_us = |participants| -> Result<Option<f64>> {
            let rate = rate(session, participants, 1, 3)?;
            Ok(rate.map(|rate| 1e6 / rate))
        };
        let built_in = step_us(Participants::BuiltIn)?;
        one.extend(built_in);
        bare_one.push(1e6 / bare_chain::steps_per_second(session, 1, length)?);
        let with_memory = step_us(Participants::PythonMemory)?;
        added.extend(with_memory.zip(built_in).map(|(with, without)| with - without));

        session.progress(format_args!("round {round}: {lanes} lanes"));
        bare_many.push(bare_chain::steps_per_second(session, lanes, length)?);
        for (rates, ManyLanes { participants, runs, .. }) in many.iter_mut().zip(MANY_LANES) {
            rates.extend(rate(session, participants, lanes, runs)?);
        }
    }
    // A step of the bare chain is four hops; a query to a memory and its answer are two.
    let two_hops: Vec<f64> = bare_one.iter().map(|step| step / 2.0).collect();
    let mut measurements = vec![
        Measurement::new("chain.1.random", "a step of one lane, policy `random`", "us", one)
            .beside("the bare chain", bare_one)
            .target(Target::RatioAtMost(1.5)),
        Measurement::new("chain.1.python-memory", "what a Python memory adds to it", "us", added)
            .beside("two hops of the bare chain", two_hops)
            .target(Target::RatioAtMost(1.5)),
    ];
    for (rates, ManyLanes { id, description, share, .. }) in many.into_iter().zip(MANY_LANES) {
        let description = format!("steps of {lanes} lanes, {description}");
        measurements.push(
            Measurement::new(format!("chain.64.{id}"), description, "steps/s", rates)
                .beside("the bare chain", bare_many.clone())
                .target(Target::RatioAtLeast(share)),
        );
    }
    measurements.retain(|measurement| !measurement.ours.is_empty());
    Ok(measurements)
}

/// Steps per second of a run; `None` when it needs a Python environment that was not given.
fn rate(
    session: &BenchSession<'_>,
    participants: Participants,
    lanes: u32,
    runs: u32,
) -> Result<Option<f64>> {
    let package = Path::new(env!("CARGO_MANIFEST_DIR")).join("../python");
    let python = |script: &str| {
        let script = package.join("examples").join(script);
        Some(format!("'{}' -s '{}'", session.python?.display(), script.display()))
    };
    let command = match participants {
        Participants::BuiltIn => Some(String::new()),
        Participants::PythonPolicy => python("return_at_once.py"),
        Participants::PythonMemory => python("supply_nothing.py"),
    };
    let Some(command) = command else { return Ok(None) };
    let mut flags = vec!["--suite", "quick", "--warm-views", "--starts", "new"];
    match participants {
        Participants::BuiltIn => flags.extend(["--policy", "random", "--memory", "working"]),
        Participants::PythonPolicy => {
            flags.extend(["--policy-cmd", &command, "--memory", "working"]);
        }
        Participants::PythonMemory => {
            flags.extend(["--policy", "random", "--memory", "none", "--memory-cmd", &command])
        }
    }
    let few = ["--limit", "6", "--max-steps", "6", "--frame-size", "64"];
    flags.extend(session.size.pick(&few[..], &[]));
    let mut bench_run = BenchRun::new(lanes, session.size.pick(1, runs), &flags);
    bench_run.env.push(("PYTHONPATH".to_owned(), package.display().to_string()));
    Ok(Some(steady_rate(&bench_run.execute(session, "run")?)?))
}
