//! Keeps the [`LiveStatus`] of a session up to date and shows it: as progress on stderr, and in the status file.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use domain::ExternalName;
use run_log::policy::PolicyLabel;
use shm_types::message::Heartbeat;

use crate::lanes::Stamps;
use crate::latency::{RecallLatencies, StepLatencies};
use crate::pipeline::{MemoryState, Participant};
use crate::progress::ProgressDisplay;
use crate::status::{EpisodeCounts, LiveStatus, ProcessStatus, StageLatency, StatusFile};

/// Time between two updates of the status file.
const INTERVAL: Duration = Duration::from_millis(500);

/// The phase in which episodes run.
const RUNNING: &str = "running episodes";

/// Keeps and shows a live status.
#[derive(Debug)]
pub(crate) struct Monitor {
    status: LiveStatus,
    progress: ProgressDisplay,
    file: StatusFile,
    /// Of the steps since the last update.
    recent: StepLatencies,
    /// Of all steps before.
    latency: StepLatencies,
    heartbeats: BTreeMap<Participant, (Instant, Heartbeat)>,
    /// Of the external memories: whether they take part.
    memories: BTreeMap<ExternalName, String>,
    /// Their recalls since the last update.
    recalls: RecallLatencies,
    began: Instant,
    /// When the first step was taken.
    running_since: Option<Instant>,
    /// When the file was last updated, and the steps until then.
    updated: (Instant, u64),
}

impl Monitor {
    /// The monitor of a session with this policy in the folder `run`.
    pub(crate) fn new(
        run: &Path,
        policy: PolicyLabel,
        lanes: u32,
        episodes: EpisodeCounts,
        progress: ProgressDisplay,
    ) -> Self {
        let now = Instant::now();
        let pid = std::process::id();
        Self {
            status: LiveStatus {
                pid,
                policy: Some(policy),
                lanes,
                episodes,
                ..LiveStatus::default()
            },
            progress,
            file: StatusFile::new(run),
            recent: StepLatencies::default(),
            latency: StepLatencies::default(),
            heartbeats: BTreeMap::new(),
            memories: BTreeMap::new(),
            recalls: RecallLatencies::default(),
            began: now,
            running_since: None,
            updated: (now, 0),
        }
    }

    /// The session enters a phase before its first step.
    pub(crate) fn phase(&mut self, phase: &str) {
        phase.clone_into(&mut self.status.phase);
        self.show();
    }

    /// A step was taken.
    pub(crate) fn stepped(&mut self, stamps: &Stamps) {
        if self.running_since.is_none() {
            self.running_since = Some(Instant::now());
            RUNNING.clone_into(&mut self.status.phase);
        }
        self.status.steps += 1;
        self.recent.record(stamps);
        self.recalls.record(stamps);
    }

    /// Something happened to an external memory.
    pub(crate) fn memory_state(&mut self, name: ExternalName, state: &MemoryState) {
        let state = match state {
            MemoryState::Ready => "ready".to_owned(),
            MemoryState::Failed(1) => "failed once, started again".to_owned(),
            MemoryState::Failed(count) => format!("failed {count} times, started again"),
            MemoryState::Excluded(_) => "left out".to_owned(),
        };
        self.memories.insert(name, state);
    }

    /// An episode was finished.
    pub(crate) fn finished(&mut self, is_success: bool) {
        let (finished, successes) = &mut self.status.episodes.finished;
        *finished += 1;
        *successes += u64::from(is_success);
    }

    /// An episode was given up.
    pub(crate) fn gave_up(&mut self) {
        self.status.episodes.given_up += 1;
    }

    /// The policy waits for its model's server, or no longer.
    pub(crate) fn waiting_for_server(&mut self, reason: Option<&str>) {
        self.status.waiting_for_server = reason.map(str::to_owned);
        self.show();
    }

    /// A process reported its load.
    pub(crate) fn heartbeat(&mut self, sender: Participant, heartbeat: &Heartbeat) {
        let now = Instant::now();
        let Heartbeat { done, waiting, held, room, .. } = *heartbeat;
        let before = self.heartbeats.insert(sender, (now, *heartbeat));
        let done_per_s = before.map_or(0.0, |(when, before)| {
            done.saturating_sub(before.done) as f64 / (now - when).as_secs_f64().max(1e-3)
        });
        let process = ProcessStatus { done, done_per_s, waiting, held, room };
        self.status.processes.insert(sender.to_string(), process);
    }

    /// The processes that lanes wait for.
    pub(crate) fn pending(&mut self, awaited: &[Participant]) {
        self.status.waiting.clear();
        for process in awaited {
            *self.status.waiting.entry(process.to_string()).or_default() += 1;
        }
    }

    /// Updates what is shown, if it is time to.
    pub(crate) fn tick(&mut self) {
        let (when, steps) = self.updated;
        let passed = when.elapsed();
        if passed >= INTERVAL {
            let status = &mut self.status;
            status.elapsed_s = self.began.elapsed().as_secs_f64();
            status.steps_per_s = (status.steps - steps) as f64 / passed.as_secs_f64();
            let stages = self.recent.summaries();
            let stages = stages.map(|(memory, stage, summary)| StageLatency {
                memory,
                stage: stage.to_owned(),
                summary,
            });
            status.stages = stages.collect();
            let memories = self.memories.iter();
            status.memories =
                memories.map(|(name, state)| self.recalls.status(*name, state)).collect();
            self.recalls.clear();
            self.latency.add(&self.recent);
            self.recent.clear();
            self.updated = (Instant::now(), status.steps);
            self.file.write(&self.status);
        }
        self.show();
    }

    /// Prints a message that stays.
    pub(crate) fn note(&mut self, note: &str) {
        self.progress.note(note);
    }

    /// Ends the display. Returns the latencies of all steps.
    pub(crate) fn close(mut self) -> StepLatencies {
        self.latency.add(&self.recent);
        self.update_running();
        let line = self.status.line();
        self.progress.close(|| line);
        self.latency
    }

    fn show(&mut self) {
        self.update_running();
        let Self { status, progress, .. } = self;
        let counts = &status.episodes;
        // Waiting for the server is a phase of its own.
        let phase = match &status.waiting_for_server {
            Some(_) => "waiting for the server",
            None => &status.phase,
        };
        progress.show(phase, (counts.done(), counts.planned), || status.line());
    }

    fn update_running(&mut self) {
        self.status.running_s = self.running_since.map_or(0.0, |at| at.elapsed().as_secs_f64());
    }
}

#[cfg(test)]
mod tests {
    use domain::{MemoryKind, Representation};
    use shm_types::message::Role;

    use super::*;
    use crate::progress::Verbosity;

    #[test]
    fn the_status_file_contains_steps_lanes_and_loads() {
        let run = tempfile::tempdir().unwrap();
        let episodes = EpisodeCounts { planned: 100, earlier: (40, 1), ..EpisodeCounts::default() };
        let policy = rigs::records::manifest().policy_label();
        let mut monitor =
            Monitor::new(run.path(), policy, 8, episodes, ProgressDisplay::new(Verbosity::Notes));
        monitor.updated.0 -= INTERVAL;
        monitor.stepped(&Stamps::new(1, 0, Representation::Working.into()));
        monitor.pending(&[Participant::world(0), Participant::world(1), Participant::world(1)]);
        monitor.heartbeat(Role::Sim.into(), &Heartbeat { held: 7, ..bytemuck::Zeroable::zeroed() });
        let name: ExternalName = "top-3".parse().unwrap();
        monitor.memory_state(name, &MemoryState::Failed(2));
        let mut stamps = Stamps::new(2, 1, MemoryKind::External(name));
        (stamps.received_ns, stamps.embedded_ns) = (1_000, 2_000);
        (stamps.searched_ns, stamps.method_ns, stamps.recalled_ns) = (52_000, 30_000, 61_000);
        monitor.stepped(&stamps);
        monitor.finished(true);
        monitor.waiting_for_server(Some("connection refused"));
        monitor.tick();
        let status = LiveStatus::read(run.path()).unwrap().unwrap();
        assert_eq!((status.episodes.done(), status.steps, status.lanes), (41, 2, 8));
        assert_eq!((status.waiting["sim"], status.processes["sim"].held), (1, 7));
        assert_eq!(status.waiting["sim 1"], 2);
        assert_eq!(status.stages.len(), 2 * (run_log::Stages::NAMES.len() + 1));
        let memory = &status.memories[0];
        assert_eq!((memory.name, memory.state.as_str()), (name, "failed 2 times, started again"));
        let p50 = |latency: &Option<run_log::latency::LatencySummary>| {
            latency.as_ref().map(|latency| latency.p50_us.round())
        };
        assert_eq!(
            (p50(&memory.recall), p50(&memory.method), p50(&memory.wire)),
            (Some(60.0), Some(30.0), Some(20.0))
        );
        assert_eq!(status.waiting_for_server.as_deref(), Some("connection refused"));
        assert_eq!(monitor.close().records(1).count(), status.stages.len());
    }
}
