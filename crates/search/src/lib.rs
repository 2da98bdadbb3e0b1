//! Nearest neighbours among embeddings of remembered views.
//!
//! - [`embedding`]: embeddings and the distance between two of them;
//! - [`Index`]: exact search. Its order is total, so an answer depends on nothing but the query: cosine distance, then
//!   task stage, then elapsed steps (specification, section 5), then demonstration, then step. Views of equal content
//!   have equal embeddings and so equal distances, to the last bit: these are the ties;
//! - [`synthetic`]: vectors to measure a search with.
//!
//! Inside, `index` -> `exact` -> `quantized` -> `kernels` -> `matrix`. Only `kernels` knows vector instructions.

pub mod embedding;
mod exact;
mod index;
mod kernels;
mod matrix;
mod pages;
mod quantized;
pub mod synthetic;

use std::sync::LazyLock;

pub use embedding::{ContentHash, Embedding, distance};
pub use index::{Index, IndexBuilder, Neighbour, SearchQuery, ViewEntry};

/// The threads of [`on_threads`]; `None` where the system starts no more. Then searches take longer.
static THREADS: LazyLock<Option<rayon::ThreadPool>> = LazyLock::new(|| {
    let pool = rayon::ThreadPoolBuilder::new().build();
    pool.inspect_err(|error| {
        tracing::warn!(%error, "searching on one thread: no more can be started (`ulimit -u`)");
    })
    .ok()
});

/// Runs `work` on this thread and up to `threads - 1` others; the results, this thread's first. The others are rayon's: to
/// start new ones takes longer than a small search. `work` shares out what there is to do, so that one thread could do it all.
fn on_threads<T: Send>(threads: usize, work: impl Fn() -> T + Sync) -> Vec<T> {
    let Some(pool) = THREADS.as_ref().filter(|_| threads > 1) else {
        return vec![work()];
    };
    let mut results: Vec<Option<T>> = (0..threads).map(|_| None).collect();
    pool.in_place_scope(|scope| {
        if let Some((own, others)) = results.split_first_mut() {
            for other in others {
                scope.spawn(|_| *other = Some(work()));
            }
            *own = Some(work());
        }
    });
    results.into_iter().flatten().collect()
}
