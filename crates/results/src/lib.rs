//! Runs as data: settings, records, scores, statistics.
//!
//! Everything about a finished run follows from its folder: read it with [`log::RunLog::read`], score it with
//! [`score::score`]. This works on any machine; the crate starts nothing and links no iceoryx2. The crate `report` prints
//! scores and writes pages.

pub mod compare;
pub mod conditions;
pub mod cost;
pub mod date;
pub use domain::events;
pub mod key;
pub mod latency;
pub mod log;
pub mod policy;
pub mod score;
pub mod settings;
pub mod source;
pub mod step_view;
pub mod usage;
