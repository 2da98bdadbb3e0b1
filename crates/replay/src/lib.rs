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
use results::log::RunLog;
use warehouse::{CaseSet, Warehouse};

/// A run, and what is needed to render its views.
#[derive(Debug)]
pub struct RecordedRun {
    /// The run's log.
    pub log: RunLog,
    /// The warehouse that it took place in.
    pub warehouse: Warehouse,
    /// Its cases.
    pub cases: CaseSet,
    /// What the user must know about it.
    pub notices: Vec<String>,
}

impl RecordedRun {
    /// Reads the run in the folder `dir`, and the world that it took place in.
    ///
    /// # Errors
    /// When `dir` holds no run, or a file of its world cannot be used.
    pub fn read(dir: &Path) -> Result<Self> {
        let log = RunLog::read(dir)?;
        let World { warehouse, cases, hashes } =
            World::load(log.manifest.settings.assets.as_deref())?;
        let differs = |name: &&str| log.manifest.hashes.get(*name) != hashes.get(*name);
        let changed: Vec<&str> =
            ["layout", "catalogue", "cases"].into_iter().filter(differs).collect();
        let mut notices = Vec::new();
        if !changed.is_empty() {
            notices.push(format!(
                "This program has another {} than the run had: maps, views and demonstrations may be others.",
                changed.join(", another ")
            ));
        }
        Ok(Self { log, warehouse, cases, notices })
    }
}
