//! The program `memtransfer`: it plans a run, starts the processes, runs the episodes and records them.
//!
//! - Before: [`settings`] (layers, resolved once), [`world`], [`plan`], [`documents`], [`estimate`].
//! - During: [`pipeline`] and [`lanes`], [`session`], [`budget`], [`frame_budget`], [`progress`], [`status`],
//!   [`event_recorder`], [`latency`], [`trace`], [`signals`].
//! - Measuring: [`profile`], [`machine`].
//! - The command line: [`cli`], one file for each verb.
//!
//! Records, scores and reports are the `results` crate's.

pub mod budget;
pub mod cli;
pub mod commit;
pub mod documents;
pub mod estimate;
pub mod event_recorder;
pub mod frame_budget;
pub mod lanes;
pub mod latency;
pub mod machine;
pub mod pipeline;
pub mod plan;
pub mod profile;
pub mod progress;
pub mod session;
pub mod settings;
pub mod signals;
pub mod status;
pub mod trace;
pub mod world;
