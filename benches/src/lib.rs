//! Side-by-side measurements: what this project does, beside what somebody else's program does, in the same rounds
//! on the same machine.
//!
//! - What is measured: one module a [`Bench`]. A bench knows its peer and nothing of how results are shown.
//! - What it is given: [`session`] (size, rounds, scratch folder, programs), [`peers`] (Python programs of others),
//!   [`parts`] (processes that play a part in a bench), [`runs`] (of `memtransfer`), [`bare`] (a chain of processes
//!   that do nothing).
//! - What it gives: [`figure`]; kept as [`results`] with the [`machine`](orchestrator::machine) they were made on.
//! - What is made of results: [`compare`] (with an earlier file), [`table`] (the table of docs/performance.md),
//!   [`markdown`] and [`page`]. Of a trace: [`timeline`].
//!
//! Every bench also runs [`Size::Tiny`](session::Size) under `cargo test -p benches`, so that it cannot rot; no test
//! asserts a time.

pub mod bare;
pub mod compare;
pub mod figure;
pub mod markdown;
pub mod page;
pub mod parts;
pub mod peers;
pub mod results;
pub mod runs;
pub mod session;
pub mod table;
pub mod timeline;

pub mod approximate;
pub mod chain;
pub mod curves;
pub mod embed;
pub mod growth;
pub mod hop;
pub mod overlap;
pub mod render;
pub mod search;
pub mod suite;

pub use figure::{Better, Figure};
pub use peers::{Peer, Peers};
pub use session::{Session, Size};

/// Something that can be measured.
#[derive(Debug, Clone, Copy)]
pub struct Bench {
    /// Its name on the command line; unique.
    pub name: &'static str,
    /// What it measures, in a line.
    pub about: &'static str,
    /// Measures it.
    pub run: fn(&mut Session<'_>) -> anyhow::Result<Vec<Figure>>,
}

/// Every bench, in the order in which they run.
pub const BENCHES: &[Bench] = &[
    hop::BENCH,
    chain::BENCH,
    render::BENCH,
    embed::BENCH,
    overlap::BENCH,
    search::BENCH,
    approximate::BENCH,
    growth::BENCH,
    curves::BENCH,
    suite::BENCH,
];
