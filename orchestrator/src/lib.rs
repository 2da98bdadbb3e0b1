//! Executes runs: plan, lanes, child processes, status.
//!
//! [`run::execute`] executes a [`run_plan::RunPlan`]; the other modules are its parts.
//!
//! - Before a run: [`run_plan`] (settings and episodes), [`invocation`] (what the caller decides), [`books`] (what the
//!   world tells about cases), [`plan`] (episodes and their seeds), [`selection`] (of cases and streams), [`units`] (parts
//!   for other machines) and [`store`] (what they need, by content), [`scratch`] (what killed programs left), [`streams`]
//!   (world states and references), [`documents`] and [`run_documents`] (built where they are missing),
//!   [`external_memory`] (started, and asked for their names), [`launch`] (which processes, with which limits),
//!   [`frame_budget`] (room in shared memory).
//! - During a run: [`lanes`] (episodes step by step, pure), [`pipeline`] (through the processes), `session` (into the run
//!   folder), `budget` (when to stop).
//! - What is shown: `latency` (histograms), [`status`] and `monitor` (the live status), [`progress`], `trace` (for
//!   Perfetto).
//! - Measurements: [`machine`], [`profile`].
//!
//! Settings are resolved in the crate `settings`; records are in `run-log`. The command line is the crate
//! `memtransfer`.

mod answers;
pub mod books;
mod budget;
mod command_files;
pub mod documents;
pub mod external_memory;
pub mod frame_budget;
pub mod invocation;
pub mod lanes;
mod latency;
pub mod launch;
pub mod machine;
mod monitor;
pub mod pipeline;
pub mod plan;
pub mod profile;
pub mod progress;
pub mod run;
pub mod run_documents;
pub mod run_plan;
pub mod scratch;
pub mod selection;
mod session;
pub mod status;
pub mod store;
pub mod streams;
#[cfg(test)]
mod testing;
mod trace;
pub mod units;
