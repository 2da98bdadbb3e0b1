//! The values that every part of the benchmark shares: poses, actions and feedback, the memory representations, the
//! outcomes of a decision, and the files that one process writes and another reads.
//!
//! Links no iceoryx2. What is not here: the map, the tasks, messages, anything that decides.

mod cache;
pub mod camera;
pub mod codes;
pub mod outcome;
pub mod pose;
pub mod prompt_log;
pub mod representation;

pub use cache::{NoCacheFolder, cache_folder};
pub use outcome::{DocumentKind, Outcome, SegmentContent};
pub use pose::{Action, Cell, Feedback, Heading, Pose, UnknownCode};
pub use representation::Representation;
