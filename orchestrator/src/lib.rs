//! The program `memtransfer`: cases, conditions, lanes, scoring, logs, command line.
//!
//! - What is asked for: [`names`] and [`conditions`] (the words), [`settings`] (layers, resolved once),
//!   [`plan`] (the episodes that follow).
//! - What is done: [`lanes`] (episodes step by step, pure), [`pipeline`] (through four processes),
//!   [`supervise`] (the processes themselves).
//! - What is kept: [`log`], the run folder.

pub mod conditions;
pub mod lanes;
pub mod log;
pub mod names;
pub mod pipeline;
pub mod plan;
pub mod settings;
pub mod supervise;
