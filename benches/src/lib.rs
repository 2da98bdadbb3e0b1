//! Measurements of this project beside other programs, the baselines, alternating on one machine.
//!
//! - Each bench is a module with a [`Bench`]. It knows its baseline and nothing of how results are presented.
//! - A bench uses [`session`] (size, rounds, scratch folder, programs), [`baselines`] (Python programs),
//!   [`processes`] (helper processes), [`runs`] (of `memtransfer`) and [`bare_chain`] (processes that only pass
//!   messages).
//! - It returns [`figure`]s, which are stored as [`results`] with the [`machine`](orchestrator::machine).
//! - Results are compared with earlier ones ([`compare`]) and rendered ([`markdown`]).
//!
//! Every bench also runs at [`Size::Tiny`](session::Size) under `cargo test -p benches`. No test asserts a time.

pub mod bare_chain;
pub mod baselines;
pub mod compare;
pub mod figure;
pub mod markdown;
pub mod processes;
pub mod results;
pub mod runs;
pub mod session;

pub mod chain;
pub mod curves;
pub mod embed;
pub mod growth;
pub mod hop;
pub mod overlap;
pub mod render;
pub mod search;
pub mod suite;

pub use baselines::Baseline;
pub use figure::{Better, Measurement};
pub use session::{BenchSession, Hardware, Size};

/// One group of measurements.
#[derive(Debug, Clone, Copy)]
pub struct Bench {
    /// Unique name on the command line.
    pub name: &'static str,
    /// What it measures, in one line.
    pub about: &'static str,
    /// Runs the measurement.
    pub run: fn(&mut BenchSession<'_>) -> anyhow::Result<Vec<Measurement>>,
}

/// Every bench, in execution order.
pub const BENCHES: &[Bench] = &[
    hop::BENCH,
    chain::BENCH,
    render::BENCH,
    embed::BENCH,
    overlap::BENCH,
    search::BENCH,
    growth::BENCH,
    curves::BENCH,
    suite::BENCH,
];
