//! The program `memtransfer`: cases, conditions, lanes, scoring, logs, command line.
//!
//! - What is asked for: [`names`] and [`conditions`] (the words), [`settings`] (layers, resolved once),
//!   [`world`] (warehouse and cases), [`plan`] (the episodes that follow).
//! - What is done: [`lanes`] (episodes step by step, pure), [`pipeline`] (through four processes),
//!   [`supervise`] (the processes themselves).
//! - What shows meanwhile: [`progress`]; [`signals`] stop it.
//! - What is kept: [`log`] (the run folder); [`score`] and [`table`] are made from it alone.

pub mod conditions;
pub mod lanes;
pub mod log;
pub mod names;
pub mod pipeline;
pub mod plan;
pub mod progress;
pub mod score;
pub mod settings;
pub mod sibling;
pub mod signals;
pub mod supervise;
pub mod table;
pub mod world;
