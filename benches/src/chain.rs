//! A step through all four processes, beside the [bare chain](crate::bare_chain) of the same messages.
//!
//! Views are rendered before the first step (`--warm-views`; the world in Python has one) and memory is `working` or external, so
//! nothing is rendered or embedded while the clock runs.

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
    /// The policy `random` and working memory in a Python world that returns at once.
    PythonWorld,
}

impl Participants {
    /// The script that takes part, if one does.
    const fn script(self) -> Option<&'static str> {
        match self {
            Self::BuiltIn => None,
            Self::PythonPolicy => Some("return_at_once.py"),
            Self::PythonMemory => Some("supply_nothing.py"),
            Self::PythonWorld => Some("step_at_once.py"),
        }
    }
}

/// Runs with many lanes.
struct ManyLanes {
    id: &'static str,
    participants: Participants,
    description: &'static str,
    /// Repetitions of the fifty cases.
    runs: u32,
    /// What it is compared with: the measurement with this index, or the bare chain.
    beside: Option<usize>,
    /// Least share of the rate of that.
    share: f64,
}

/// The index of the Python policy in [`MANY_LANES`].
const PYTHON_POLICY: usize = 1;

const MANY_LANES: [ManyLanes; 4] = [
    ManyLanes {
        id: "random",
        participants: Participants::BuiltIn,
        description: "policy `random`",
        runs: 24,
        beside: None,
        share: 0.6,
    },
    ManyLanes {
        id: "python-policy",
        participants: Participants::PythonPolicy,
        description: "a Python policy that returns at once",
        runs: 6,
        beside: None,
        share: 0.3,
    },
    ManyLanes {
        id: "python-memory",
        participants: Participants::PythonMemory,
        description: "a Python memory that supplies nothing",
        runs: 6,
        beside: None,
        share: 0.3,
    },
    ManyLanes {
        id: "python-world",
        participants: Participants::PythonWorld,
        description: "a Python world that returns at once",
        runs: 6,
        beside: Some(PYTHON_POLICY),
        share: 0.5,
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
    for (rates, of) in many.iter().zip(MANY_LANES) {
        let ManyLanes { id, description, beside, share, .. } = of;
        let description = format!("steps of {lanes} lanes, {description}");
        let (name, values) = match beside {
            Some(index) => (MANY_LANES[index].description, &many[index]),
            None => ("the bare chain", &bare_many),
        };
        measurements.push(
            Measurement::new(format!("chain.64.{id}"), description, "steps/s", rates.clone())
                .beside(name, values.clone())
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
    let command = match (participants.script(), session.python) {
        (None, _) => String::new(),
        (Some(_), None) => return Ok(None),
        (Some(script), Some(python)) => {
            let script = package.join("examples").join(script);
            format!("'{}' -s '{}'", python.display(), script.display())
        }
    };
    let backend = session.backend_flags();
    let mut flags = vec!["--starts", "new"];
    match participants {
        Participants::BuiltIn => flags.extend(["--policy", "random", "--memory", "working"]),
        Participants::PythonPolicy => {
            flags.extend(["--policy-cmd", &command, "--memory", "working"]);
        }
        Participants::PythonMemory => {
            flags.extend(["--policy", "random", "--memory", "none", "--memory-cmd", &command]);
        }
        Participants::PythonWorld => {
            flags.extend(["--policy", "random", "--memory", "working", "--world-cmd", &command]);
        }
    }
    if !matches!(participants, Participants::PythonWorld) {
        flags.extend(["--suite", "quick", "--warm-views"]);
        flags.extend(backend.iter().map(String::as_str));
    }
    let few = ["--limit", "6", "--max-steps", "6", "--frame-size", "64"];
    flags.extend(session.size.pick(&few[..], &[]));
    let mut bench_run = BenchRun::new(lanes, session.size.pick(1, runs), &flags);
    bench_run.env.push(("PYTHONPATH".to_owned(), package.display().to_string()));
    Ok(Some(steady_rate(&bench_run.execute(session, "run")?)?))
}
