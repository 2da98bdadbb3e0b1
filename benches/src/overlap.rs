//! Overlap of rendering, embedding and deciding in a cold run, in which nothing is resident or cached. How close is the
//! run to its slowest stage alone?
//!
//! Alone means with the whole machine. Stages that need the same cores cannot overlap, and then a run takes at least the
//! sum of its stages. Both bounds are reported.

use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use memory_proc::embedding_cache::stored;
use serde_json::Value;
use sim_proc::renderer::Samples;
use sim_proc::view_control::every_pose;
use warehouse::Warehouse;

use crate::Bench;
use crate::embed;
use crate::figure::{Better, FigureBound, Measurement};
use crate::render;
use crate::runs::{TimingLine, ended_well, lines, new_cache};
use crate::search::threads;
use crate::session::BenchSession;

/// The bench.
pub const BENCH: Bench = Bench {
    name: "overlap",
    about: "a cold run, beside rendering, embedding and deciding each alone",
    run,
};

/// Clock ticks per second in /proc.
const TICKS_PER_SECOND: f64 = 100.0;

/// Measurements, one value per round, in seconds.
#[derive(Default)]
struct OverlapRounds {
    cold: Vec<f64>,
    busy: Vec<f64>,
    rendering: Vec<f64>,
    embedding: Vec<f64>,
    deciding: Vec<f64>,
}

fn run(session: &mut BenchSession<'_>) -> Result<Vec<Measurement>> {
    let warehouse = Warehouse::shipped();
    let poses: Vec<_> =
        every_pose(&warehouse.layout).step_by(7).take(session.size.pick(2, 128)).collect();
    let frames = embed::drawn(session, &warehouse, &poses)?;
    let mut encoder = embed::open(session)?;
    let dimension = encoder.facts().dimension;
    let (mut rounds, mut views) = (OverlapRounds::default(), (0, 0));
    for round in 1..=session.rounds() {
        session.say(format_args!("round {round}"));
        let cache = session.scratch().join(format!("cache-{round}"));
        new_cache(&cache)?;
        let cold = execute(session, &cache, &[])?;
        views = (cold.rendered, stored(&cache.join("embeddings"), dimension).len());
        ensure!(views.0 > 0 && views.1 > 0, "{views:?} views were rendered and embedded");
        // The same with cached embeddings and resident views: stepping, lookup, deciding and logging remain.
        let again = execute(session, &cache, session.size.pick(&[][..], &["--warm-views"]))?;
        let drawing = render::ours(session, Samples::Four)?;
        rounds.rendering.push(views.0 as f64 / drawing.views_per_second);
        rounds.embedding.push(views.1 as f64 / embed::rate(&mut encoder, &frames)?);
        rounds.deciding.push(again.seconds);
        rounds.busy.push(100.0 * cold.busy);
        rounds.cold.push(cold.seconds);
    }
    Ok(figures(&rounds, views))
}

fn figures(rounds: &OverlapRounds, (drawn, embedded): (usize, usize)) -> Vec<Measurement> {
    let OverlapRounds { cold, busy, rendering, embedding, deciding } = rounds;
    let stages = |round: usize| [rendering[round], embedding[round], deciding[round]];
    let share = |of: fn([f64; 3]) -> f64| -> Vec<f64> {
        cold.iter().enumerate().map(|(n, cold)| 100.0 * of(stages(n)) / cold).collect()
    };
    let figure = |id: &str, what: &str, unit: &str, values: &[f64]| {
        let better = if unit == "%" { Better::Higher } else { Better::Lower };
        Measurement::new(format!("overlap.{id}"), what, unit, better)
            .ours(values)
            .parameter("views rendered", drawn)
            .parameter("embedded", embedded)
            .parameter("cores", threads())
    };
    let slowest = share(|stages| stages.into_iter().fold(0.0, f64::max));
    let sum = share(|stages| stages.into_iter().sum());
    vec![
        figure("share", "the slowest stage alone, as a share of a cold run", "%", &slowest)
            .target(FigureBound::Value(90.0), "overlap of 90 %"),
        figure(
            "work",
            "all stages alone, one after the other, as a share of a cold run",
            "%",
            &sum,
        )
        .note("where every stage needs all cores, 100 is the most that is possible"),
        figure("busy", "share of the cores' time that a cold run uses", "%", busy),
        figure("cold", "a cold run, from its first step to its last", "s", cold),
        figure("rendering", "rendering as many views alone", "s", rendering),
        figure("embedding", "embedding as many views alone", "s", embedding),
        figure("deciding", "the same run with resident views and cached embeddings", "s", deciding),
    ]
}

/// Measurements of a run.
struct RunMeasurement {
    /// Seconds from its first step to its last.
    seconds: f64,
    /// Share of the cores' time that the run used, from start to end.
    busy: f64,
    /// Rendered views.
    rendered: usize,
}

/// Runs cases with episodic memory and `cache` as the cache folder.
fn execute(session: &BenchSession<'_>, cache: &Path, flags: &[&str]) -> Result<RunMeasurement> {
    let mut command = session.run_command()?;
    command.env("MEMTRANSFER_CACHE", cache).args(["--fresh", "--quiet", "--out", "run"]);
    command.args(["--policy", "grounded", "--memory", "episodic", "--starts", "new"]);
    command.args(["--routes", "unchanged", "--lanes", "32"]);
    command.args(["--demos", session.size.pick("original", "4")]);
    // The case with the shortest demonstration, or many.
    command.args(session.size.pick(["--cases", "t02-03"], ["--limit", "50"]));
    command.args(["--max-steps", session.size.pick("4", "200")]).args(flags);
    let (before, began) = (work_of_children()?, Instant::now());
    ended_well(command.stdout(Stdio::null()), &session.scratch().join("run.log"))?;
    let wall = began.elapsed().as_secs_f64();
    let busy = (work_of_children()? - before) / (wall * threads() as f64);
    let folder = session.scratch().join("run");
    let timings: Vec<TimingLine> = lines(&folder.join("timings.jsonl"))?;
    let first = timings.iter().map(|timing| timing.started_ns).min();
    let last = timings.iter().map(|timing| timing.ended_ns).max();
    let (first, last) = first.zip(last).context("no episode was executed")?;
    let sessions: Vec<Value> = lines(&folder.join("sessions.jsonl"))?;
    let rendered = sessions
        .iter()
        .find_map(|event| event["shutdown_reports"]["sim"]["frames_rendered"].as_u64())
        .context("the simulator did not report how many views it rendered")?;
    Ok(RunMeasurement { seconds: (last - first) as f64 / 1e9, busy, rendered: rendered as usize })
}

/// CPU seconds of all ended child processes and their children.
fn work_of_children() -> Result<f64> {
    let text = fs::read_to_string("/proc/self/stat").context("cannot read /proc/self/stat")?;
    let fields = text.rsplit_once(") ").map(|(_, fields)| fields.split(' ').skip(13).take(2));
    let ticks = fields.context("/proc/self/stat has an unexpected format")?.map(str::parse::<f64>);
    Ok(ticks.sum::<Result<f64, _>>()? / TICKS_PER_SECOND)
}
