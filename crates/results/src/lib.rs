//! What a run was asked and what it did: settings, conditions, records, scores, statistics, tables, report.
//!
//! Reads a run folder anywhere. Links no iceoryx2.

pub mod compare;
pub mod conditions;
pub mod latency;
pub mod log;
pub mod names;
pub mod plan;
pub mod prices;
pub mod report;
pub mod score;
pub mod settings;
pub mod shown;
pub mod spending;
pub mod stamps;
pub mod table;
pub mod witness;
