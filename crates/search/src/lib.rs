//! Nearest neighbours among embeddings of remembered views.
//!
//! - [`embedding`]: embeddings and the distance between two of them;
//! - [`Index`]: exact search. Its order is total, so an answer depends on nothing but the query: cosine distance, then
//!   task stage, then elapsed steps (specification, section 5), then demonstration, then step. Views of equal content
//!   have equal embeddings and so equal distances, to the last bit: these are the ties;
//! - [`ApproximateIndex`]: search through a graph, which runs do not use;
//! - [`synthetic`]: vectors to measure a search with.
//!
//! Inside, `index` -> `exact` -> `quantized` -> `kernels` -> `matrix`. Only `kernels` knows vector instructions.

mod approximate;
pub mod embedding;
mod exact;
mod index;
mod kernels;
mod matrix;
mod pages;
mod quantized;
pub mod synthetic;

pub use approximate::{ApproximateIndex, GraphError, GraphOptions};
pub use embedding::{ContentHash, Embedding, distance};
pub use index::{Index, IndexBuilder, Neighbour, SearchQuery, ViewEntry};

/// Runs `work` on this thread and `threads - 1` others; the results, this thread's first.
fn on_threads<T: Send>(threads: usize, work: impl Fn() -> T + Sync) -> Vec<T> {
    std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(&work)).collect();
        let mut results = vec![work()];
        results.extend(others.into_iter().map(|thread| match thread.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        }));
        results
    })
}
