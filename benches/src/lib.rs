//! Measurements of this project beside other programs, the baselines, in turns on one machine.
//!
//! - Each bench is a module with a [`Bench`]. It knows its baseline and nothing of how results are presented.
//! - A bench uses [`session`] (size, rounds, scratch folder, programs), [`baselines`] (Python programs),
//!   [`processes`] (helper processes, which do what [`helpers`] lists), [`runs`] (of `memtransfer`) and [`bare_chain`] (processes that only pass
//!   messages).
//! - It returns [`Measurement`]s; [`results`] prints and stores them.
//!
//! Every bench also runs at [`Size::Tiny`] under `cargo test -p benches`. No test asserts a time.

pub mod bare_chain;
pub mod baselines;
pub mod helpers;
pub mod processes;
pub mod results;
pub mod runs;
pub mod session;

pub mod chain;
pub mod embed;
pub mod hop;
pub mod render;
pub mod search;
pub mod suite;

pub use baselines::Baseline;
pub use results::{Measurement, Target};
pub use session::{BenchSession, Hardware, Size};

/// One group of measurements.
#[derive(Debug, Clone, Copy)]
pub struct Bench {
    /// Unique name on the command line.
    pub name: &'static str,
    /// What it measures, in one line.
    pub about: &'static str,
    /// Runs the measurement.
    pub run: fn(&BenchSession<'_>) -> anyhow::Result<Vec<Measurement>>,
}

/// Every bench, in execution order.
pub const BENCHES: &[Bench] =
    &[hop::BENCH, chain::BENCH, render::BENCH, embed::BENCH, search::BENCH, suite::BENCH];
