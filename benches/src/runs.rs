//! Runs of `memtransfer`, and their speed in steady state.

use std::fs::File;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use domain::cache_folder;
use serde::Deserialize;

use crate::BenchSession;

/// Folders that a run adds to the cache folder; everything else comes from set-up.
const WRITTEN_BY_RUNS: [&str; 4] = ["embeddings", "documents", "responses", "views"];

/// A run to execute.
#[derive(Debug, Clone)]
pub struct BenchRun {
    /// Further flags of `memtransfer run`.
    pub flags: Vec<String>,
    /// Number of lanes.
    pub lanes: u32,
    /// Repetitions of every case.
    pub runs: u32,
    /// Environment variables of the processes.
    pub env: Vec<(String, String)>,
}

impl BenchRun {
    /// A run with these flags.
    pub fn new(lanes: u32, runs: u32, flags: &[&str]) -> Self {
        let flags = flags.iter().map(|flag| (*flag).to_owned()).collect();
        Self { flags, lanes, runs, env: Vec::new() }
    }

    /// Executes the run, with `out` in the session's scratch folder as the run folder, and returns its path.
    ///
    /// # Errors
    /// When it cannot be started or fails; the message quotes its output.
    pub fn execute(&self, session: &BenchSession<'_>, out: &str) -> Result<PathBuf> {
        let mut command = session.run_command()?;
        command
            .args(["--quiet", "--fresh", "--lanes", &self.lanes.to_string()])
            .args(["--runs", &self.runs.to_string(), "--out", out])
            .args(&self.flags)
            .envs(self.env.iter().map(|(name, value)| (name, value)))
            .stdout(Stdio::null());
        run_to_end(&mut command, &session.scratch().join("run.log"))?;
        Ok(session.scratch().join(out))
    }
}

/// Runs a command to its end with its standard error in the file `log`.
///
/// # Errors
/// When it does not start or fails; the message quotes the end of the log.
pub fn run_to_end(command: &mut Command, log: &Path) -> Result<()> {
    let file = File::create(log).with_context(|| format!("cannot create {}", log.display()))?;
    let status = command.stderr(file).status().context("cannot start memtransfer")?;
    if !status.success() {
        let messages = std::fs::read_to_string(log).unwrap_or_default();
        let lines: Vec<&str> = messages.lines().collect();
        bail!(
            "{command:?} failed ({status}):\n{}",
            lines[lines.len().saturating_sub(12)..].join("\n")
        );
    }
    Ok(())
}

/// Creates a cache folder with the files of set-up and none of earlier runs.
///
/// # Errors
/// When it exists or cannot be created.
pub fn new_cache(folder: &Path) -> Result<()> {
    std::fs::create_dir(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let Ok(entries) = std::path::absolute(cache_folder()?)?.read_dir() else { return Ok(()) };
    for entry in entries {
        let entry = entry?;
        if !WRITTEN_BY_RUNS.iter().any(|name| entry.file_name() == *name) {
            symlink(entry.path(), folder.join(entry.file_name()))?;
        }
    }
    Ok(())
}

/// A line of `timings.jsonl`, reduced to what is used here.
#[derive(Debug, Clone, Copy, Deserialize)]
struct TimingLine {
    started_ns: u64,
    ended_ns: u64,
    steps: u32,
}

/// Steps per second of the run in `folder` in its steady state: without its start, when views may be rendered for the
/// first time, and without its end, when lanes become idle.
///
/// # Errors
/// When the folder cannot be read, or the run is too short to have a steady state.
pub fn steady_rate(folder: &Path) -> Result<f64> {
    let path = folder.join("timings.jsonl");
    let text = std::fs::read_to_string(&path)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let timing =
        |line| serde_json::from_str(line).with_context(|| format!("{}: {line}", path.display()));
    rate(&text.lines().map(timing).collect::<Result<Vec<_>>>()?)
        .with_context(|| format!("{} is too short to have a steady state", folder.display()))
}

/// The rate between the start of the episode at the first quartile and the start of the last one. The steps of an
/// episode count as spread evenly over its duration.
fn rate(timings: &[TimingLine]) -> Option<f64> {
    let mut starts: Vec<u64> = timings.iter().map(|timing| timing.started_ns).collect();
    starts.sort_unstable();
    let (from, to) = (*starts.get(starts.len() / 4)?, *starts.last()?);
    if from >= to {
        return None;
    }
    let steps: f64 = timings
        .iter()
        .map(|timing| {
            let inside = timing.ended_ns.min(to).saturating_sub(timing.started_ns.max(from));
            let all = timing.ended_ns.saturating_sub(timing.started_ns).max(1);
            f64::from(timing.steps) * inside as f64 / all as f64
        })
        .sum();
    Some(steps / ((to - from) as f64 / 1e9))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_that_of_the_steady_part() {
        // Two lanes of ten steps per second each, after an idle first second.
        let episode = |started_s: u64, lane_offset: u64| TimingLine {
            started_ns: (started_s * 10 + lane_offset) * 100_000_000,
            ended_ns: (started_s * 10 + 10 + lane_offset) * 100_000_000,
            steps: 10,
        };
        let mut timings: Vec<TimingLine> =
            (1..20).flat_map(|s| [episode(s, 0), episode(s, 5)]).collect();
        timings.push(TimingLine { started_ns: 0, ended_ns: 1_000_000_000, steps: 1 });
        let rate = rate(&timings).unwrap();
        assert!((rate - 20.0).abs() < 0.5, "{rate}");
    }

    #[test]
    fn a_run_of_one_episode_has_none() {
        assert_eq!(rate(&[]), None);
        assert_eq!(rate(&[TimingLine { started_ns: 5, ended_ns: 9, steps: 4 }]), None);
    }
}
