//! Approximate search through a graph of neighbours (HNSW), with the library usearch.
//!
//! The nodes hold quantized vectors, and found views that may be among the nearest are measured exactly. Distances and the
//! order of ties are therefore those of the exact search; what may be missing are views that the search did not
//! visit. Runs use exact search only, because the graph depends on the order in which threads insert nodes.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};

use usearch::{IndexOptions, MetricKind, ScalarKind};

use crate::exact;
use crate::index::{Index, Neighbour, SearchQuery};
use crate::kernels::SimdLevel;
use crate::pages;
use crate::quantized::{QuantizedMatrix, record_distance};

/// How a graph is built and searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GraphOptions {
    /// Neighbours of a node (`M`).
    pub connectivity: usize,
    /// Candidates considered while a node is inserted (`efConstruction`).
    pub building: usize,
    /// Candidates considered by a query (`efSearch`): a larger number finds more and takes longer.
    pub searching: usize,
}

impl Default for GraphOptions {
    fn default() -> Self {
        Self { connectivity: 32, building: 128, searching: 64 }
    }
}

/// The graph could not be built or searched.
#[derive(Debug, thiserror::Error)]
#[error("approximate search failed: {0}")]
pub struct GraphError(String);

fn failed(error: impl std::fmt::Display) -> GraphError {
    GraphError(error.to_string())
}

/// An index with a graph.
pub struct ApproximateIndex<'a> {
    index: &'a Index,
    quantized: &'a QuantizedMatrix,
    /// Reads `stored`, so it is dropped first.
    graph: usearch::Index,
    stored: Vec<u8>,
    threads: usize,
}

impl<'a> ApproximateIndex<'a> {
    /// Builds the graph of an index.
    ///
    /// # Errors
    /// When the library fails, for example for lack of memory.
    pub fn new(
        index: &'a Index,
        options: GraphOptions,
        threads: NonZeroUsize,
    ) -> Result<Self, GraphError> {
        let quantized = index.quantized();
        let mut graph = usearch::Index::new(&IndexOptions {
            dimensions: quantized.record_bytes(),
            // Replaced below.
            metric: MetricKind::L2sq,
            quantization: ScalarKind::U8,
            connectivity: options.connectivity,
            expansion_add: options.building,
            expansion_search: options.searching,
            multi: false,
        })
        .map_err(failed)?;
        measure_records(&mut graph);
        let rows = index.rows().len();
        graph.reserve_capacity_and_threads(rows, threads.get()).map_err(failed)?;
        let next = AtomicUsize::new(0);
        let insert = || -> Result<(), GraphError> {
            let mut record = Vec::new();
            loop {
                let row = next.fetch_add(1, Ordering::Relaxed);
                if row >= rows {
                    return Ok(());
                }
                quantized.record(row, &mut record);
                graph.add(row as u64, &record).map_err(failed)?;
            }
        };
        crate::on_threads(threads.get(), insert).into_iter().collect::<Result<(), _>>()?;
        let stored = store(&mut graph)?;
        Ok(Self { index, quantized, graph, stored, threads: threads.get() })
    }

    /// About the `wanted` nearest views of each query, nearest first.
    ///
    /// # Errors
    /// When the library fails.
    ///
    /// # Panics
    /// When a query's embedding has another dimension.
    pub fn nearest_of_many(
        &self,
        queries: &[SearchQuery<'_>],
        wanted: usize,
    ) -> Result<Vec<Vec<Neighbour>>, GraphError> {
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
        let parts: Result<Vec<_>, GraphError> =
            crate::on_threads(threads, answer).into_iter().collect();
        let mut answers: Vec<_> = parts?.into_iter().flatten().collect();
        answers.sort_unstable_by_key(|answer| answer.0);
        Ok(answers.into_iter().map(|answer| answer.1).collect())
    }

    fn nearest(
        &self,
        query: &SearchQuery<'_>,
        wanted: usize,
    ) -> Result<Vec<Neighbour>, GraphError> {
        let vector = query.embedding;
        let rows = self.index.rows();
        if rows.len() == 0 || wanted == 0 {
            return Ok(Vec::new());
        }
        assert_eq!(vector.len(), rows.dimension(), "another encoder's query");
        // Quantized vectors confuse the order of near candidates, so all that may be among the nearest are measured.
        let candidates = self.graph.expansion_search().max(wanted);
        let quantized = self.quantized.query(vector);
        let found = self.graph.search(&self.quantized.query_record(&quantized), candidates);
        let found = found.map_err(failed)?;
        let found = found.keys.into_iter().map(|key| key as usize).zip(found.distances);
        let bound = |limit| self.quantized.record_limit(&quantized, limit);
        let nearest = exact::scan_some(SimdLevel::best(), rows, found, (vector, wanted), bound);
        Ok(self.index.in_order(nearest, query, wanted))
    }

    /// Size of the graph in memory, without the index.
    pub fn bytes(&self) -> usize {
        self.graph.memory_usage() + self.stored.len()
    }

    /// Sets how many candidates a query considers.
    pub fn set_searching(&mut self, searching: usize) {
        self.graph.change_expansion_search(searching);
    }
}

/// Moves a graph that is complete into one block of large pages, which it reads from then on: most of a search is waiting
/// for nodes at random addresses. The block must outlive the graph.
#[expect(unsafe_code, reason = "the library does not know how long the block lives")]
fn store(graph: &mut usearch::Index) -> Result<Vec<u8>, GraphError> {
    let bytes = graph.serialized_length();
    let mut stored = Vec::with_capacity(bytes);
    pages::advise_large(&mut stored);
    stored.resize(bytes, 0);
    graph.save_to_buffer(&mut stored).map_err(failed)?;
    // SAFETY: `ApproximateIndex` drops the graph before the block, and the block is never written to again.
    unsafe { graph.view_from_buffer(&stored) }.map_err(failed)?;
    measure_records(graph);
    Ok(stored)
}

/// Makes a graph of records measure the distance of the quantized vectors.
#[expect(unsafe_code, reason = "the library hands over two raw pointers")]
fn measure_records(graph: &mut usearch::Index) {
    let (bytes, level) = (graph.dimensions(), SimdLevel::best());
    let metric = move |a: *const u8, b: *const u8| {
        // SAFETY: a graph calls its metric with two of its vectors, or one and a query; each has as many bytes as
        // the graph has dimensions.
        let (a, b) =
            unsafe { (std::slice::from_raw_parts(a, bytes), std::slice::from_raw_parts(b, bytes)) };
        record_distance(level, a, b)
    };
    graph.change_metric::<u8>(Box::new(metric));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::SyntheticVectors;
    use crate::{IndexBuilder, ViewEntry};

    #[test]
    fn most_nearest_views_are_found_with_their_exact_distances() {
        let vectors = SyntheticVectors::new(Vec::new(), 70, 5);
        let mut builder = IndexBuilder::default();
        for number in 0..3000_u16 {
            let entry = ViewEntry { demonstration: 0, step: number, stage: 0 };
            builder.add_distinct(entry, vectors.entry(u32::from(number)).as_slice());
        }
        let index = builder.build();
        let two = NonZeroUsize::new(2).unwrap();
        let graph = ApproximateIndex::new(&index, GraphOptions::default(), two).unwrap();
        assert!(graph.bytes() > 3000 * 70);
        let embeddings: Vec<_> = (0..200).map(|number| vectors.query(number, 3000)).collect();
        let queries: Vec<SearchQuery<'_>> = embeddings
            .iter()
            .map(|of| SearchQuery { embedding: of.as_slice(), stage: 0, elapsed: 0 })
            .collect();
        let exact = index.nearest_of_many(&queries, 10);
        let mostly = graph.nearest_of_many(&queries, 10).unwrap();
        let found = |(exact, mostly): (&Vec<Neighbour>, &Vec<Neighbour>)| {
            assert!(mostly.is_sorted_by(|a, b| a.distance <= b.distance));
            exact.iter().filter(|near| mostly.contains(near)).count()
        };
        let found: usize = exact.iter().zip(&mostly).map(found).sum();
        assert!(found > 1500, "{found} of 2000");
        assert!(graph.nearest_of_many(&queries, 0).unwrap().iter().all(Vec::is_empty));
    }

    #[test]
    fn an_empty_index_finds_nothing() {
        let index = IndexBuilder::default().build();
        let graph =
            ApproximateIndex::new(&index, GraphOptions::default(), NonZeroUsize::MIN).unwrap();
        let vectors = SyntheticVectors::new(Vec::new(), 3, 5);
        let embedding = vectors.entry(0);
        let query = SearchQuery { embedding: embedding.as_slice(), stage: 0, elapsed: 0 };
        assert_eq!(graph.nearest_of_many(&[query], 3).unwrap(), [vec![]]);
    }
}
