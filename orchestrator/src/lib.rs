//! The program `memtransfer`: cases, conditions, lanes, scoring, logs, command line.
//!
//! - What is asked for: [`names`] and [`conditions`] (the words), [`settings`] (layers, resolved once),
//!   [`plan`] (the episodes that follow).
//! - What is kept: [`log`], the run folder.

pub mod conditions;
pub mod log;
pub mod names;
pub mod plan;
pub mod settings;
