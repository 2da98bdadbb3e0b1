//! Asks the world, outside of a run, what the log of an episode leaves out and a page, an export or a check needs.
//!
//! - [`RunWorld`]: the world of a run. [`WorldProgram`], `sim-proc`, answers as a child process.
//! - [`EpisodeTimeline`]: an episode step by step; everything that shows one is a view of it.
//! - [`frames`]: the views of poses.
//! - [`check_run`]: whether every record of a log is what its world makes of the episode.
//! - [`Selection`]: which episodes to take.

mod check;
pub mod frames;
mod program;
mod selection;
mod timeline;
mod world;

pub use check::{Difference, check_run};
pub use program::{Asker, WorldAccess, WorldFiles, WorldProgram};
pub use selection::{FirstEpisodes, Selection};
pub use timeline::{EpisodeEvent, EpisodeTimeline, EventLevel, TimelineStep};
pub use world::{RunWorld, begin_of, facts_of};

use std::path::Path;

use anyhow::Result;
use conditions::Frames;
use run_log::RunLog;
use scores::Successes;

/// What a reader of views must know about a run whose frames were a control.
pub fn control_notice(frames: Frames) -> Option<String> {
    let supplied = match frames {
        Frames::Rendered => return None,
        Frames::Blank | Frames::Swapped => "what memory supplied was left as it is",
        Frames::BlankAll => "those of memory too, and memory supplied no texts",
    };
    Some(format!(
        "The frames of this run are the control `{frames}`: views show what the policy was shown, not what is there; {supplied}."
    ))
}

/// A run, and the worlds that it took place in.
#[derive(Debug)]
pub struct RecordedRun {
    /// The run's log.
    pub log: RunLog,
    /// The run's successes, with which failures are compared, also of those episodes that are then left out of the log.
    pub successes: Successes,
    /// The worlds of its episodes.
    pub world: RunWorld,
    /// How they were found.
    pub access: WorldAccess,
    /// What the user must know about it.
    pub notices: Vec<String>,
}

impl RecordedRun {
    /// Reads the run in the folder `dir`, and asks for its worlds.
    ///
    /// # Errors
    /// When `dir` holds no run, or a file of its world cannot be used.
    pub fn read(dir: &Path, access: &WorldAccess) -> Result<Self> {
        let log = RunLog::read(dir)?;
        let successes = log.episodes.iter().collect();
        Self::of(log, successes, access)
    }

    /// The run `log`, or a part of one, with the successes of all of it.
    ///
    /// # Errors
    /// When a file of its world cannot be used.
    pub fn of(log: RunLog, successes: Successes, access: &WorldAccess) -> Result<Self> {
        let world = RunWorld::new(&log, access)?;
        let notices = control_notice(log.manifest.settings.frames).into_iter().collect();
        let mut run = Self { log, successes, world, access: access.clone(), notices };
        let changed = run.changed_assets().join(", another ");
        if !changed.is_empty() {
            run.notices.push(format!(
                "This program has another {changed} than the run had: maps, views and demonstrations may be others."
            ));
        }
        Ok(run)
    }

    /// The files of the world that are not those that the run had, by the names of their hashes.
    pub fn changed_assets(&self) -> Vec<&'static str> {
        let hashes = &self.world.description().world.hashes;
        let differs = |name: &&str| self.log.manifest.hashes.get(*name) != hashes.get(*name);
        ["layout", "catalogue", "cases"].into_iter().filter(differs).collect()
    }
}
