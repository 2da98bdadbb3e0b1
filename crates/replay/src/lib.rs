//! What the log leaves out of an episode and a page or an export needs: the world it took place in ([`RunWorld`]), the
//! views of its poses ([`frames`]), and which episodes to take ([`Selection`]).

pub mod frames;
mod selection;
mod world;

pub use selection::Selection;
pub use world::RunWorld;

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
