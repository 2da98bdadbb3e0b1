//! What the log leaves out of an episode and a page or an export needs: the world it took place in ([`RunWorld`]), the
//! views of its poses ([`frames`]), and which episodes to take ([`Selection`]).

mod assets;
mod changes;
pub mod frames;
mod selection;
mod world;

pub use assets::World;
pub use selection::Selection;
pub use world::RunWorld;

use std::path::Path;

use anyhow::Result;
use results::conditions::Frames;
use results::log::RunLog;

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
    /// The worlds of its episodes.
    pub world: RunWorld,
    /// What the user must know about it.
    pub notices: Vec<String>,
}

impl RecordedRun {
    /// Reads the run in the folder `dir`, and its worlds.
    ///
    /// # Errors
    /// When `dir` holds no run, or a file of its world cannot be used.
    pub fn read(dir: &Path) -> Result<Self> {
        let log = RunLog::read(dir)?;
        let World { warehouse, cases, hashes } =
            World::load(log.manifest.settings.assets.as_deref())?;
        let world = RunWorld::new(&log, warehouse, cases)?;
        let differs = |name: &&str| log.manifest.hashes.get(*name) != hashes.get(*name);
        let changed: Vec<&str> =
            ["layout", "catalogue", "cases"].into_iter().filter(differs).collect();
        let mut notices: Vec<String> =
            control_notice(log.manifest.settings.frames).into_iter().collect();
        if !changed.is_empty() {
            notices.push(format!(
                "This program has another {} than the run had: maps, views and demonstrations may be others.",
                changed.join(", another ")
            ));
        }
        Ok(Self { log, world, notices })
    }
}
