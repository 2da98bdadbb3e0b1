//! The program `memtransfer`: cases, conditions, lanes, scoring, logs, command line.
//!
//! - What is asked for: [`names`] and [`conditions`] (the words), [`settings`] (layers, resolved once),
//!   [`world`] (warehouse and cases), [`plan`] (the episodes that follow).
//! - What is done: [`lanes`] (episodes step by step, pure; [`witness`] notes what failures are sorted by),
//!   [`pipeline`] (through four processes), [`supervise`] (the processes themselves).
//! - What is made before: [`documents`]. What tests somebody else's policy: [`conformance`].
//! - How much of shared memory it takes: [`frame_budget`]; of tokens and money: [`spending`], [`prices`],
//!   [`estimate`] (before), [`budget`] (when to stop).
//! - What shows meanwhile: [`session`], [`progress`]; [`status`] for others to look at; [`signals`] stop it.
//! - Where the time went: [`latency`] (percentiles of stages), [`trace`] (for Perfetto).
//! - What is kept: [`log`] (the run folder). From it alone are made: [`score`], [`compare`], [`table`] (a
//!   terminal), [`report`] (pages and data files), [`shown`] (one step).
//! - What it runs on, and what that can do at best: [`machine`].
//! - How long an access to memory takes: [`profile`].
//! - What people type: [`cli`], one file for each verb.

pub mod budget;
pub mod cli;
pub mod documents;
pub mod estimate;
pub mod frame_budget;
pub mod lanes;
pub mod machine;
pub mod pipeline;
pub mod profile;
pub mod progress;
pub mod session;
pub mod signals;
pub mod status;
pub mod trace;
pub mod world;

pub use results::{
    compare, conditions, latency, log, names, plan, prices, report, score, settings, shown,
    spending, table, witness,
};
