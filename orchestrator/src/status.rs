//! What a running run is at: a small file in its folder, written anew about twice a second and removed when the
//! session ends. `memtransfer top` shows it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use domain::Representation;
use serde::{Deserialize, Serialize};
use shm_types::message::{Heartbeat, Role};

use crate::lanes::{Owed, Stamps};
use crate::latency::Latency;
use results::latency::LatencySummary;

/// Time between two writings.
const INTERVAL: Duration = Duration::from_millis(500);

pub use results::log::STATUS_FILE;

/// What a running run is at.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Status {
    /// Process id of the orchestrator.
    pub pid: u32,
    /// Seconds since the session began.
    pub elapsed_s: f64,
    /// Episodes of the run, and those that are done.
    pub episodes: (u64, u64),
    /// Steps of this session.
    pub steps: u64,
    /// Steps a second, since the writing before.
    pub steps_per_s: f64,
    /// Lanes of the run, and how many wait for which process; the others are free.
    pub lanes: u32,
    /// By the process's name.
    pub waiting: BTreeMap<String, u32>,
    /// What the processes told last, by their names.
    pub processes: BTreeMap<String, Process>,
    /// The stages of the steps since the writing before.
    pub stages: Vec<Stage>,
}

/// What a process told.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Process {
    /// As [`Heartbeat::done`]: views drawn, images embedded, requests answered.
    pub done: u64,
    /// The same, a second.
    pub done_per_s: f64,
    /// As [`Heartbeat::waiting`].
    pub waiting: u64,
    /// As [`Heartbeat::held`]: frames.
    pub held: u64,
    /// As [`Heartbeat::room`].
    pub room: u64,
}

/// How long a stage took.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// Under which memory.
    pub memory: Representation,
    /// The stage, or `step` for all of them together.
    pub stage: String,
    /// The times.
    #[serde(flatten)]
    pub summary: LatencySummary,
}

impl Status {
    /// What the run in the folder `run` is at; `None` when none is running there.
    ///
    /// # Errors
    /// When the file is there and cannot be read.
    pub fn read(run: &Path) -> Result<Option<Self>> {
        let path = run.join(STATUS_FILE);
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => {
                return Err(error).with_context(|| format!("cannot read {}", path.display()));
            }
        };
        let status: Self = serde_json::from_str(&text)
            .with_context(|| format!("{} is not what a run writes", path.display()))?;
        // One that was killed leaves its file behind.
        let is_alive = Path::new("/proc").join(status.pid.to_string()).exists();
        Ok(is_alive.then_some(status))
    }
}

/// Keeps the file up to date. A file that cannot be written is done without: nothing depends on it.
#[derive(Debug)]
pub struct StatusFile {
    path: PathBuf,
    status: Status,
    latency: Latency,
    heartbeats: BTreeMap<Role, (Instant, Heartbeat)>,
    began: Instant,
    written: (Instant, u64),
}

impl StatusFile {
    /// For the run in the folder `run`, of so many lanes and episodes.
    pub fn new(run: &Path, lanes: u32, episodes: u64) -> Self {
        let now = Instant::now();
        let pid = std::process::id();
        Self {
            path: run.join(STATUS_FILE),
            status: Status { pid, lanes, episodes: (episodes, 0), ..Status::default() },
            latency: Latency::default(),
            heartbeats: BTreeMap::new(),
            began: now,
            written: (now, 0),
        }
    }

    /// A step was taken.
    pub fn stepped(&mut self, stamps: &Stamps) {
        self.status.steps += 1;
        self.latency.record(stamps);
    }

    /// A process told what it is at.
    pub fn heartbeat(&mut self, role: Role, heartbeat: &Heartbeat) {
        let now = Instant::now();
        let Heartbeat { done, waiting, held, room, .. } = *heartbeat;
        let before = self.heartbeats.insert(role, (now, *heartbeat));
        let done_per_s = before.map_or(0.0, |(when, before)| {
            done.saturating_sub(before.done) as f64 / (now - when).as_secs_f64().max(1e-3)
        });
        let process = Process { done, done_per_s, waiting, held, room };
        self.status.processes.insert(role.word().to_owned(), process);
    }

    /// What lanes wait for.
    pub fn waiting(&mut self, owed: &[Owed]) {
        self.status.waiting.clear();
        for owed in owed {
            *self.status.waiting.entry(owed.role.word().to_owned()).or_default() += 1;
        }
    }

    /// Writes the file, if it is time to. So many episodes are done.
    pub fn tick(&mut self, done: u64) {
        let (when, steps) = self.written;
        let passed = when.elapsed();
        if passed < INTERVAL {
            return;
        }
        let status = &mut self.status;
        status.elapsed_s = self.began.elapsed().as_secs_f64();
        status.episodes.1 = done;
        status.steps_per_s = (status.steps - steps) as f64 / passed.as_secs_f64();
        let stages = self.latency.summaries();
        status.stages = stages
            .map(|(memory, stage, summary)| Stage { memory, stage: stage.to_owned(), summary })
            .collect();
        self.latency.clear();
        self.written = (Instant::now(), status.steps);
        if let Err(error) = self.write() {
            tracing::debug!(%error, "the run's status cannot be written");
        }
    }

    fn write(&self) -> Result<()> {
        let new = self.path.with_extension("json.new");
        fs::write(&new, serde_json::to_vec(&self.status)?)?;
        // Whoever reads sees the one or the other, whole.
        Ok(fs::rename(&new, &self.path)?)
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
    fn a_status_is_there_while_the_run_is() {
        let run = tempfile::tempdir().unwrap();
        assert!(Status::read(run.path()).unwrap().is_none());
        let mut file = StatusFile::new(run.path(), 8, 100);
        file.written.0 -= INTERVAL;
        file.stepped(&Stamps::none(1, 0, Representation::Working));
        file.waiting(&[Owed { role: Role::Sim, lane: 3, since_ns: 0, rubbish: 0 }]);
        let heartbeat = Heartbeat { held: 7, room: 9, ..bytemuck::Zeroable::zeroed() };
        file.heartbeat(Role::Sim, &heartbeat);
        file.tick(40);
        let status = Status::read(run.path()).unwrap().unwrap();
        assert_eq!((status.episodes, status.steps, status.lanes), ((100, 40), 1, 8));
        assert_eq!((status.waiting["sim"], status.processes["sim"].held), (1, 7));
        assert_eq!(status.stages.len(), results::log::Stages::NAMES.len() + 1);

        let dead = Status { pid: u32::MAX, ..status };
        fs::write(run.path().join(STATUS_FILE), serde_json::to_string(&dead).unwrap()).unwrap();
        assert!(Status::read(run.path()).unwrap().is_none(), "its process is gone");
        fs::write(run.path().join(STATUS_FILE), "{").unwrap();
        assert!(Status::read(run.path()).is_err());
        drop(file);
        assert!(!run.path().join(STATUS_FILE).exists());
    }
}
