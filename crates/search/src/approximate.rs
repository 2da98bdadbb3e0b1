//! The nearest rows, mostly: a graph of neighbours that is walked towards the query, by the library usearch.
//!
//! The graph's nodes hold codes, a quarter of the vectors in size; what the walk ends at is measured in full, so
//! distances and the order of ties are those of the exact search, and only what the walk did not come by is
//! missing. A run never uses this: which nodes a walk comes by depends on the order in which threads
//! added them.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};

use usearch::{IndexOptions, MetricKind, ScalarKind};

use super::codes::Codes;
use super::exact::{Best, measured_among};
use super::kernel::{self, Level};
use super::{Index, Nearest, Query};

/// What a graph costs, and what it is worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Neighbours of a node.
    pub connectivity: usize,
    /// Nodes that are kept in sight while a node is added.
    pub building: usize,
    /// Nodes that are kept in sight while a query is answered: more find more, and take longer.
    pub searching: usize,
}

impl Default for Effort {
    fn default() -> Self {
        Self { connectivity: 16, building: 128, searching: 64 }
    }
}

/// The graph could not be built or walked.
#[derive(Debug, thiserror::Error)]
#[error("the graph of an approximate search: {0}")]
pub struct GraphError(String);

fn failed(error: impl std::fmt::Display) -> GraphError {
    GraphError(error.to_string())
}

/// An index with a graph.
pub struct Approximate<'a> {
    index: &'a Index,
    codes: &'a Codes,
    graph: usearch::Index,
    threads: usize,
}

impl<'a> Approximate<'a> {
    /// Builds the graph of an index, by all of its threads.
    ///
    /// # Errors
    /// When the library fails, for want of memory for example.
    pub fn new(
        index: &'a Index,
        effort: Effort,
        threads: NonZeroUsize,
    ) -> Result<Self, GraphError> {
        let codes = index.codes();
        let mut graph = usearch::Index::new(&IndexOptions {
            dimensions: codes.record_bytes(),
            // Replaced by ours.
            metric: MetricKind::L2sq,
            quantization: ScalarKind::U8,
            connectivity: effort.connectivity,
            expansion_add: effort.building,
            expansion_search: effort.searching,
            multi: false,
        })
        .map_err(failed)?;
        kernel::measure_records(Level::best(), &mut graph);
        let rows = index.rows.len();
        graph.reserve_capacity_and_threads(rows, threads.get()).map_err(failed)?;
        let next = AtomicUsize::new(0);
        let add = || -> Result<(), GraphError> {
            let mut record = Vec::new();
            loop {
                let row = next.fetch_add(1, Ordering::Relaxed);
                if row >= rows {
                    return Ok(());
                }
                codes.record(row, &mut record);
                graph.add(row as u64, &record).map_err(failed)?;
            }
        };
        in_threads(threads.get(), add).into_iter().collect::<Result<(), _>>()?;
        Ok(Self { index, codes, graph, threads: threads.get() })
    }

    /// For each query, views that are mostly the `wanted` nearest, nearest first.
    ///
    /// # Errors
    /// When the library fails.
    ///
    /// # Panics
    /// When a query's embedding is of another dimension.
    pub fn nearest_of_many(
        &self,
        queries: &[Query<'_>],
        wanted: usize,
    ) -> Result<Vec<Vec<Nearest>>, GraphError> {
        let threads = if queries.len() < 2 { 1 } else { self.threads };
        let next = AtomicUsize::new(0);
        let answer = || {
            let mut answers = Vec::new();
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                let Some(query) = queries.get(number) else { return Ok(answers) };
                answers.push((number, self.nearest(query, wanted)?));
            }
        };
        let parts: Result<Vec<_>, GraphError> = in_threads(threads, answer).into_iter().collect();
        let mut answers: Vec<_> = parts?.into_iter().flatten().collect();
        answers.sort_unstable_by_key(|answer| answer.0);
        Ok(answers.into_iter().map(|answer| answer.1).collect())
    }

    fn nearest(&self, query: &Query<'_>, wanted: usize) -> Result<Vec<Nearest>, GraphError> {
        let vector = query.embedding.as_slice();
        let rows = &self.index.rows;
        if rows.len() == 0 || wanted == 0 {
            return Ok(Vec::new());
        }
        assert_eq!(vector.len(), rows.dimension(), "another encoder's query");
        // All that is in sight at the end is measured: codes mistake the order of near ones.
        let sight = self.graph.expansion_search().max(wanted);
        let found = self.graph.search(&self.codes.query_record(vector), sight);
        let found = found.map_err(failed)?;
        let found = found.keys.into_iter().map(|key| key as usize);
        let best: Best = measured_among(Level::best(), rows, found, vector, wanted);
        Ok(self.index.in_order(best, query, wanted))
    }

    /// Bytes that the graph takes, without the index.
    pub fn bytes(&self) -> usize {
        self.graph.memory_usage()
    }

    /// How many nodes are kept in sight while a query is answered.
    pub fn set_searching(&mut self, searching: usize) {
        self.graph.change_expansion_search(searching);
    }
}

/// What each of so many threads comes to, this one among them.
fn in_threads<T: Send>(threads: usize, work: impl Fn() -> T + Sync) -> Vec<T> {
    std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(&work)).collect();
        let mut all = vec![work()];
        all.extend(others.into_iter().map(|thread| match thread.join() {
            Ok(part) => part,
            Err(panic) => std::panic::resume_unwind(panic),
        }));
        all
    })
}

#[cfg(test)]
mod tests {
    use super::super::{Builder, Entry};
    use super::*;
    use crate::vectors::Vectors;

    #[test]
    fn most_of_what_an_exact_search_finds_is_found_and_measured_alike() {
        let vectors = Vectors::new(Vec::new(), 70, 5);
        let mut builder = Builder::default();
        for number in 0..3000_u16 {
            let entry = Entry { demonstration: 0, step: number, stage: 0 };
            builder.add_distinct(entry, vectors.entry(u32::from(number)).as_slice());
        }
        let index = builder.build();
        let two = NonZeroUsize::new(2).unwrap();
        let graph = Approximate::new(&index, Effort::default(), two).unwrap();
        assert!(graph.bytes() > 3000 * 70);
        let embeddings: Vec<_> = (0..200).map(|number| vectors.query(number, 3000)).collect();
        let query = |embedding| Query { embedding, stage: 0, elapsed: 0 };
        let queries: Vec<Query<'_>> = embeddings.iter().map(query).collect();
        let exact = index.nearest_of_many(&queries, 10);
        let mostly = graph.nearest_of_many(&queries, 10).unwrap();
        let found = |(exact, mostly): (&Vec<Nearest>, &Vec<Nearest>)| {
            assert!(mostly.is_sorted_by(|a, b| a.distance <= b.distance));
            exact.iter().filter(|near| mostly.contains(near)).count()
        };
        let found: usize = exact.iter().zip(&mostly).map(found).sum();
        assert!(found > 1500, "{found} of 2000");
        assert!(graph.nearest_of_many(&queries, 0).unwrap().iter().all(Vec::is_empty));
    }

    #[test]
    fn nothing_is_found_among_nothing() {
        let index = Builder::default().build();
        let graph = Approximate::new(&index, Effort::default(), NonZeroUsize::MIN).unwrap();
        let vectors = Vectors::new(Vec::new(), 3, 5);
        let embedding = vectors.entry(0);
        let query = Query { embedding: &embedding, stage: 0, elapsed: 0 };
        assert_eq!(graph.nearest_of_many(&[query], 3).unwrap(), [vec![]]);
    }
}
