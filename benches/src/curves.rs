//! Scaling: steps per second against lanes, case generation against the number of cases, a report against episodes; each
//! with its fitted and its expected exponent.

use std::fs;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};

use crate::Bench;
use crate::chain::{WARM, shrunk};
use crate::figure::{Better, FigureBound, Measurement};
use crate::runs::{BenchRun, ended_well, steady_rate};
use crate::session::BenchSession;

/// The bench.
pub const BENCH: Bench =
    Bench { name: "curves", about: "how speed and time grow with lanes, cases and episodes", run };

/// Points at the right end of a curve that its exponent is fitted to; constant costs dominate further left.
const FITTED: usize = 3;

/// A curve to measure.
struct MeasuredCurve {
    id: &'static str,
    plot: &'static str,
    axis: &'static str,
    unit: &'static str,
    better: Better,
    /// Largest allowed exponent of a duration; rates have none.
    expected: Option<f64>,
    xs: &'static [u32],
    tiny: &'static [u32],
    /// Measures one point.
    at: fn(&BenchSession<'_>, u32) -> Result<f64>,
}

const CURVES: [MeasuredCurve; 3] = [
    MeasuredCurve {
        id: "lanes",
        plot: "Steps per second against lanes (policy `random`, warm views)",
        axis: "lanes",
        unit: "steps/s",
        better: Better::Higher,
        expected: None,
        xs: &[1, 2, 4, 8, 16, 32, 64, 128, 256],
        tiny: &[1, 2],
        at: lanes,
    },
    MeasuredCurve {
        id: "generate",
        plot: "Generating cases: `memtransfer generate` against their number",
        axis: "cases",
        unit: "s",
        better: Better::Lower,
        expected: Some(1.0),
        xs: &[100, 200, 400, 800, 1600],
        tiny: &[100, 120],
        at: generate,
    },
    MeasuredCurve {
        id: "report",
        plot: "A report: `memtransfer report` against episodes",
        axis: "episodes",
        unit: "s",
        better: Better::Lower,
        expected: Some(1.0),
        xs: &[500, 1000, 2000, 4000, 8000],
        tiny: &[10, 20],
        at: report,
    },
];

/// Tolerance of an exponent, for a logarithmic factor and noise.
const SLACK: f64 = 0.15;

fn run(session: &mut BenchSession<'_>) -> Result<Vec<Measurement>> {
    execute(session)?;
    let rounds = session.rounds().min(3);
    let mut figures = Vec::new();
    for curve in &CURVES {
        session.say(curve.plot);
        let xs = session.size.pick(curve.tiny, curve.xs);
        let mut values = vec![Vec::new(); xs.len()];
        for _ in 0..rounds {
            for (values, &x) in values.iter_mut().zip(xs) {
                values.push((curve.at)(session, x)?);
            }
        }
        let exponents: Vec<f64> = (0..rounds as usize)
            .filter_map(|round| {
                let points =
                    xs.iter().zip(&values).map(|(&x, values)| (f64::from(x), values[round]));
                exponent(&points.collect::<Vec<_>>())
            })
            .collect();
        let last = xs.len().min(FITTED);
        let fitted = format!("{} to {}", xs[xs.len() - last], xs[xs.len() - 1]);
        let mut fit = Measurement::new(
            format!("curves.{}.exponent", curve.id),
            format!("{}: the exponent", curve.plot),
            "",
            curve.better,
        )
        .ours(exponents)
        .parameter(curve.axis, fitted);
        if let Some(expected) = curve.expected {
            fit = fit.target(
                FigureBound::Value(expected + SLACK),
                format!("grows as its size ({expected}, at most {})", expected + SLACK),
            );
        }
        figures.push(fit);
        figures.extend(xs.iter().zip(values).map(|(&x, values)| {
            Measurement::new(
                format!("curves.{}.{x}", curve.id),
                format!("{}: {x} {}", curve.plot, curve.axis),
                curve.unit,
                curve.better,
            )
            .ours(values)
        }));
    }
    Ok(figures)
}

/// Fits the exponent to the right end of a curve.
fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    let end = &points[points.len().saturating_sub(FITTED)..];
    let logs: Vec<(f64, f64)> = end.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    fitted_slope(&logs)
}

/// Slope of the least-squares line; `None` when all points have the same x.
pub(crate) fn fitted_slope(points: &[(f64, f64)]) -> Option<f64> {
    let n = points.len() as f64;
    let mean_x = points.iter().map(|(x, _)| x).sum::<f64>() / n;
    let mean_y = points.iter().map(|(_, y)| y).sum::<f64>() / n;
    let across: f64 = points.iter().map(|(x, _)| (x - mean_x).powi(2)).sum();
    let along: f64 = points.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    (across > 0.0).then(|| along / across)
}

fn lanes(session: &BenchSession<'_>, lanes: u32) -> Result<f64> {
    // Long enough for a second or more with any number of lanes.
    let runs = session.size.pick(1, 4 + lanes.min(50));
    let flags = [&WARM[..], &["--policy", "random"]].concat();
    steady_rate(&shrunk(session, BenchRun::new(lanes, runs, &flags)).make(session, "lanes")?)
}

fn generate(session: &BenchSession<'_>, cases: u32) -> Result<f64> {
    let mut command = session.memtransfer()?;
    command.args(["generate", "--force", "--out", "cases.toml", "--count", &cases.to_string()]);
    timed(session, &mut command)
}

/// The run that provides the episodes of [`report`].
const BASE_RUN: &str = "base-run";

/// Executes as many episodes as the longest report has. The expert needs only the simulator.
fn execute(session: &BenchSession<'_>) -> Result<()> {
    let few = ["--limit", "10", "--frame-size", "64"];
    let flags = ["--suite", "quick", "--policy", "expert", "--cases", "all", "--max-steps", "8"];
    let size = session.size.pick(&few[..], &["--frame-size", "64"]);
    // A hundred cases (or ten), two starts, six memories, repeated.
    let runs = session.size.pick(1, 8);
    BenchRun::new(32, runs, &[&flags[..], size].concat()).make(session, BASE_RUN)?;
    Ok(())
}

fn report(session: &BenchSession<'_>, episodes: u32) -> Result<f64> {
    let (whole, part) = (session.scratch().join(BASE_RUN), session.scratch().join("part"));
    fs::create_dir_all(&part).context("cannot make a folder")?;
    for file in ["manifest.json", "sessions.jsonl"] {
        copy(&whole, &part, file, None)?;
    }
    for file in ["episodes.jsonl", "timings.jsonl"] {
        copy(&whole, &part, file, Some(episodes as usize))?;
    }
    timed(session, session.memtransfer()?.args(["report", "part"]))
}

/// Copies a file, or its first lines.
fn copy(from: &Path, to: &Path, file: &str, lines: Option<usize>) -> Result<()> {
    let path = from.join(file);
    let text =
        fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let lines = text.lines().take(lines.unwrap_or(usize::MAX));
    let text: String = lines.flat_map(|line| [line, "\n"]).collect();
    fs::write(to.join(file), text).with_context(|| format!("cannot write {}", to.display()))
}

/// Duration of a command in seconds.
fn timed(session: &BenchSession<'_>, command: &mut std::process::Command) -> Result<f64> {
    command.stdout(std::process::Stdio::null());
    let began = Instant::now();
    ended_well(command, &session.scratch().join("timed.log"))?;
    Ok(began.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponent_is_fitted_to_the_right_end() {
        let points: Vec<(f64, f64)> = [1.0_f64, 10.0, 100.0, 1000.0, 10_000.0]
            .iter()
            .map(|x| (*x, 50.0 + x.powi(2)))
            .collect();
        let found = exponent(&points).unwrap();
        assert!((found - 2.0).abs() < 0.01, "{found}");
        assert_eq!(exponent(&[]), None);
        assert_eq!(exponent(&[(1.0, 1.0)]), None);
    }

    #[test]
    fn every_curve_has_enough_ascending_sizes() {
        for MeasuredCurve { xs, tiny, .. } in &CURVES {
            assert!(xs.is_sorted() && xs.len() > FITTED && tiny.len() > 1);
        }
    }
}
