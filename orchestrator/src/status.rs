//! The live status of a running session: what progress shows and, through a small file in the run's folder,
//! `memtransfer top`.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use domain::{ExternalName, MemoryKind};
use run_log::latency::LatencySummary;
use run_log::policy::PolicyLabel;
use serde::{Deserialize, Serialize};

/// Name of the file in a run's folder.
const STATUS_FILE: &str = "status.json";

/// The live status of a session.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct LiveStatus {
    /// Process id of the orchestrator.
    pub pid: u32,
    /// The policy; absent in the status of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<PolicyLabel>,
    /// What the session does: starting its processes, running episodes, ...
    pub phase: String,
    /// Why the policy waits for its model's server, while it does.
    pub waiting_for_server: Option<String>,
    /// Seconds since the session began.
    pub elapsed_s: f64,
    /// Seconds since its first step.
    pub running_s: f64,
    /// Episodes of the run.
    pub episodes: EpisodeCounts,
    /// Steps of this session.
    pub steps: u64,
    /// Steps per second since the last update.
    pub steps_per_s: f64,
    /// Lanes.
    pub lanes: u32,
    /// How many lanes wait for each process, by its name. The others are free.
    pub waiting: BTreeMap<String, u32>,
    /// What each process reported last, by its name.
    pub processes: BTreeMap<String, ProcessStatus>,
    /// Latencies of the steps since the last update.
    pub stages: Vec<StageLatency>,
    /// The external memories.
    #[serde(default)]
    pub memories: Vec<MemoryStatus>,
}

/// The status of an external memory. Latencies are those since the last update, absent where it was not asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MemoryStatus {
    /// Its name.
    pub name: ExternalName,
    /// Whether it takes part.
    pub state: String,
    /// From the observation to the recall.
    pub recall: Option<LatencySummary>,
    /// What it computed, by its own clock.
    pub method: Option<LatencySummary>,
    /// The messages to it and back.
    pub wire: Option<LatencySummary>,
}

/// Counts of a run's episodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct EpisodeCounts {
    /// All of the run.
    pub planned: u64,
    /// Finished by earlier sessions, and how many of them successfully.
    pub earlier: (u64, u64),
    /// Finished by this session, and how many of them successfully.
    pub finished: (u64, u64),
    /// Given up by this session.
    pub given_up: u64,
}

/// The load of a process.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ProcessStatus {
    /// Views rendered, images embedded, or requests answered.
    pub done: u64,
    /// The same per second.
    pub done_per_s: f64,
    /// Requests that wait for the process.
    pub waiting: u64,
    /// Frames it holds.
    pub held: u64,
    /// Frames it may hold; 0 for no limit.
    pub room: u64,
}

/// The latency of one stage with one memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageLatency {
    /// The memory.
    pub memory: MemoryKind,
    /// The stage, or `step` for all stages together.
    pub stage: String,
    /// The latency.
    #[serde(flatten)]
    pub summary: LatencySummary,
}

impl EpisodeCounts {
    /// Episodes that are over.
    pub const fn done(&self) -> u64 {
        self.earlier.0 + self.finished.0 + self.given_up
    }
}

impl LiveStatus {
    /// The status of the session that runs in the folder `run`; `None` when none does.
    ///
    /// # Errors
    /// When the status file exists and cannot be read.
    pub fn read(run: &Path) -> Result<Option<Self>> {
        let path = run.join(STATUS_FILE);
        let text = match durable::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => {
                return Err(error).with_context(|| format!("cannot read {}", path.display()));
            }
        };
        let status: Self = serde_json::from_slice(&text)
            .with_context(|| format!("{} is not a status file", path.display()))?;
        // A session that was killed leaves its file behind.
        let is_alive = Path::new("/proc").join(status.pid.to_string()).exists();
        Ok(is_alive.then_some(status))
    }

    /// Progress in one line.
    pub fn line(&self) -> String {
        let counts = &self.episodes;
        if self.steps == 0 && self.waiting_for_server.is_none() {
            return self.phase.clone();
        }
        let mut parts = vec![format!("{}/{} episodes", counts.done(), counts.planned)];
        // Over less than a second a rate means nothing.
        if self.running_s >= 1.0 {
            parts.push(format!("{:.0} steps/s", self.steps as f64 / self.running_s));
        }
        let (episodes, successes) =
            (counts.earlier.0 + counts.finished.0, counts.earlier.1 + counts.finished.1);
        if episodes > 0 {
            let role = self.policy.as_ref().and_then(|policy| policy.role);
            let role = role.map_or_else(String::new, |role| format!(" ({role})"));
            parts.push(format!("SR {:.1} %{role}", 100.0 * successes as f64 / episodes as f64));
        }
        if counts.given_up > 0 {
            parts.push(format!("{} given up", counts.given_up));
        }
        if let Some(reason) = &self.waiting_for_server {
            parts.push(format!("waiting for the server: {reason}"));
            return parts.join(", ");
        }
        // The speed of earlier sessions is no measure of this one.
        let now = counts.finished.0 + counts.given_up;
        if now > 0 {
            let left = counts.planned.saturating_sub(counts.done()) as f64;
            // The file may say anything.
            let left = Duration::try_from_secs_f64(left * self.running_s / now as f64);
            parts.extend(left.map(|left| format!("{} left", duration(left))));
        }
        parts.join(", ")
    }
}

/// A duration for people: `48 s`, `3 min 20 s`, `1 h 05 min`.
pub(crate) fn duration(duration: Duration) -> String {
    let s = duration.as_secs_f64().round() as u64;
    match s {
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {:02} s", s / 60, s % 60),
        _ => format!("{} h {:02} min", s / 3600, s / 60 % 60),
    }
}

/// The status file of a run. Errors of writing it are only logged.
#[derive(Debug)]
pub struct StatusFile {
    path: PathBuf,
}

impl StatusFile {
    /// The file in the folder `run`, not written yet.
    pub fn new(run: &Path) -> Self {
        Self { path: run.join(STATUS_FILE) }
    }

    /// Replaces the file's content.
    pub fn write(&self, status: &LiveStatus) {
        let new = self.path.with_extension("json.new");
        let written = serde_json::to_vec(status)
            .map_err(std::io::Error::from)
            // No run is resumed from it, so no drill makes it fail: it is written when real time has passed.
            .and_then(|text| durable::create(&new)?.write_all(&text))
            .and_then(|()| fs::rename(&new, &self.path));
        if let Err(error) = written {
            tracing::debug!(%error, "cannot write the status file");
        }
    }
}

impl Drop for StatusFile {
    fn drop(&mut self) {
        // It may never have been written.
        let _ = fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_status_file_exists_while_the_session_runs() {
        let run = tempfile::tempdir().unwrap();
        assert!(LiveStatus::read(run.path()).unwrap().is_none());
        let file = StatusFile::new(run.path());
        let status = LiveStatus { pid: std::process::id(), steps: 7, ..LiveStatus::default() };
        file.write(&status);
        assert_eq!(LiveStatus::read(run.path()).unwrap(), Some(status.clone()));
        file.write(&LiveStatus { pid: u32::MAX, ..status });
        assert!(LiveStatus::read(run.path()).unwrap().is_none(), "its process is gone");
        fs::write(run.path().join(STATUS_FILE), "{").unwrap();
        assert!(LiveStatus::read(run.path()).is_err());
        drop(file);
        assert!(!run.path().join(STATUS_FILE).exists());
    }

    #[test]
    fn the_line_shows_progress_speed_success_and_the_time_left() {
        let counts = EpisodeCounts { planned: 400, ..EpisodeCounts::default() };
        let after = |episodes, steps, running_s| LiveStatus {
            episodes,
            steps,
            running_s,
            ..LiveStatus::default()
        };
        let starting = LiveStatus { phase: "starting".to_owned(), ..after(counts, 0, 0.0) };
        assert_eq!(starting.line(), "starting");
        assert_eq!(after(counts, 1, 0.0).line(), "0/400 episodes");
        let counts = EpisodeCounts { finished: (50, 20), ..counts };
        insta::assert_snapshot!(after(counts, 1000, 10.0).line(), @"50/400 episodes, 100 steps/s, SR 40.0 %, 1 min 10 s left");
        let policy = Some(rigs::records::manifest().policy_label());
        let marked = LiveStatus { policy, ..after(counts, 1000, 10.0) };
        insta::assert_snapshot!(marked.line(), @"50/400 episodes, 100 steps/s, SR 40.0 % (scripted stand-in), 1 min 10 s left");
        // A resumed run counts all episodes; the time left follows from this session's speed.
        let counts = EpisodeCounts { earlier: (100, 100), given_up: 50, ..counts };
        let status = after(counts, 1000, 10.0);
        insta::assert_snapshot!(status.line(), @"200/400 episodes, 100 steps/s, SR 80.0 %, 50 given up, 20 s left");
        let waiting =
            LiveStatus { waiting_for_server: Some("connection refused".to_owned()), ..status };
        insta::assert_snapshot!(waiting.line(), @"200/400 episodes, 100 steps/s, SR 80.0 %, 50 given up, waiting for the server: connection refused");
    }

    #[test]
    fn durations_are_short() {
        for (seconds, expected) in
            [(0.2, "0 s"), (59.6, "1 min 00 s"), (200.0, "3 min 20 s"), (3900.0, "1 h 05 min")]
        {
            assert_eq!(duration(Duration::from_secs_f64(seconds)), expected);
        }
    }
}
