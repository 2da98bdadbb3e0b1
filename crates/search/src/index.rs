//! An index of remembered views: which of them is nearest to a query.

use std::collections::HashMap;
use std::num::NonZeroUsize;
use std::sync::OnceLock;

use crate::embedding::{ContentHash, Embedding};
use crate::exact::{self, NearestRows};
use crate::kernels::SimdLevel;
use crate::matrix::Matrix;
use crate::quantized::QuantizedMatrix;

/// A remembered view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ViewEntry {
    /// Position of its demonstration among those of the memory.
    pub demonstration: u16,
    /// Steps that the expert had taken.
    pub step: u16,
    /// Sub-goals that the expert had completed.
    pub stage: u32,
}

/// The current view, as far as it determines what is nearest.
#[derive(Debug, Clone, Copy)]
pub struct SearchQuery<'a> {
    /// Its embedding.
    pub embedding: &'a [f32],
    /// Sub-goals completed so far.
    pub stage: u32,
    /// Steps taken so far.
    pub elapsed: u32,
}

/// A view that a search found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// The view.
    pub entry: ViewEntry,
    /// Its cosine distance from the query.
    pub distance: f32,
}

/// Number of rows from which a single query scans quantized vectors. With fewer, quantizing costs more than an episode
/// saves.
const QUANTIZED_FROM_ROWS: usize = 1000;

/// Number of queries from which quantized vectors are scanned even for few rows.
const QUANTIZED_FROM_QUERIES: usize = 16;

/// Number of bytes that all queries of a search together compare with codes, from which it uses several threads.
const THREADED_FROM_BYTES: usize = 8 << 20;

/// Remembered views, ready to be searched.
#[derive(Debug)]
pub struct Index {
    /// One row for each distinct content.
    rows: Matrix,
    /// For each row, where its views begin in `entries`; then the number of entries.
    first: Vec<u32>,
    entries: Vec<ViewEntry>,
    /// Computed when first needed.
    quantized: OnceLock<QuantizedMatrix>,
    threads: Option<NonZeroUsize>,
}

/// Collects views for an [`Index`].
#[derive(Debug, Default)]
pub struct IndexBuilder {
    rows: Matrix,
    row_of: HashMap<ContentHash, u32>,
    views: Vec<(u32, ViewEntry)>,
}

impl IndexBuilder {
    /// A builder with room for `views` views with embeddings of `dimension`.
    pub fn with_capacity(dimension: usize, views: usize) -> Self {
        let rows = Matrix::with_capacity(dimension, views);
        Self { rows, row_of: HashMap::new(), views: Vec::with_capacity(views) }
    }

    /// Adds a view. Views of equal content share a row.
    ///
    /// # Panics
    /// When embeddings differ in dimension.
    pub fn add(&mut self, entry: ViewEntry, content: ContentHash, embedding: &[f32]) {
        let next = self.rows.len() as u32;
        let row = *self.row_of.entry(content).or_insert(next);
        if row == next {
            self.rows.push(embedding);
        }
        self.views.push((row, entry));
    }

    /// Adds a view whose content no other view has.
    ///
    /// # Panics
    /// When embeddings differ in dimension.
    pub fn add_distinct(&mut self, entry: ViewEntry, embedding: &[f32]) {
        self.views.push((self.rows.len() as u32, entry));
        self.rows.push(embedding);
    }

    /// Builds the index.
    pub fn build(self) -> Index {
        let Self { rows, mut views, .. } = self;
        views.sort_by_key(|view| view.0);
        let mut first = vec![0; rows.len() + 1];
        for &(row, _) in &views {
            first[row as usize + 1] += 1;
        }
        let mut sum = 0;
        for count in &mut first {
            sum += *count;
            *count = sum;
        }
        let entries = views.into_iter().map(|view| view.1).collect();
        Index { rows, first, entries, quantized: OnceLock::new(), threads: None }
    }
}

impl Index {
    /// Builds an index of views.
    ///
    /// # Panics
    /// When embeddings differ in dimension.
    pub fn new<'a>(
        views: impl IntoIterator<Item = (ViewEntry, ContentHash, &'a Embedding)>,
    ) -> Self {
        let mut builder = IndexBuilder::default();
        for (entry, content, embedding) in views {
            builder.add(entry, content, embedding.as_slice());
        }
        builder.build()
    }

    /// Limits the threads of a search [default: the processor's cores]. A search of few views uses one.
    #[must_use]
    pub fn with_threads(self, threads: NonZeroUsize) -> Self {
        Self { threads: Some(threads), ..self }
    }

    /// The nearest view; `None` when the index is empty.
    ///
    /// # Panics
    /// When the query's embedding has another dimension.
    pub fn nearest(&self, query: SearchQuery<'_>) -> Option<Neighbour> {
        let nearest = self.search(&[query.embedding], 1).pop()?;
        self.in_order(nearest, &query, 1).pop()
    }

    /// The `wanted` nearest views of each query, nearest first. Several queries in one call share one pass over
    /// memory.
    ///
    /// # Panics
    /// When a query's embedding has another dimension.
    pub fn nearest_of_many(
        &self,
        queries: &[SearchQuery<'_>],
        wanted: usize,
    ) -> Vec<Vec<Neighbour>> {
        let vectors: Vec<&[f32]> = queries.iter().map(|query| query.embedding).collect();
        let nearest = self.search(&vectors, wanted).into_iter().zip(queries);
        nearest.map(|(nearest, query)| self.in_order(nearest, query, wanted)).collect()
    }

    /// Computes now what the first search would compute.
    pub fn prepare(&self) {
        if self.uses_quantized(1) {
            self.quantized();
        }
    }

    /// Size in memory, including quantized vectors if they have been computed.
    pub fn bytes(&self) -> usize {
        let quantized = self.quantized.get().map_or(0, QuantizedMatrix::bytes);
        self.rows.bytes() + quantized + size_of_val(&*self.first) + size_of_val(&*self.entries)
    }

    /// Bytes that a search of `queries` queries reads from end to end.
    pub fn scanned_bytes(&self, queries: usize) -> usize {
        if self.uses_quantized(queries) { self.quantized().bytes() } else { self.rows.bytes() }
    }

    /// Threads that a search of `queries` queries uses.
    pub fn threads(&self, queries: usize) -> usize {
        if self.uses_quantized(queries) { self.quantized_threads(queries) } else { 1 }
    }

    fn quantized(&self) -> &QuantizedMatrix {
        let quantize =
            || QuantizedMatrix::new(SimdLevel::best(), &self.rows, self.quantized_threads(1));
        self.quantized.get_or_init(quantize)
    }

    fn uses_quantized(&self, queries: usize) -> bool {
        self.rows.len() >= QUANTIZED_FROM_ROWS || queries >= QUANTIZED_FROM_QUERIES
    }

    fn quantized_threads(&self, queries: usize) -> usize {
        if self.rows.len() * self.rows.dimension() * queries < THREADED_FROM_BYTES {
            return 1;
        }
        let cores = || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
        self.threads.unwrap_or_else(cores).get()
    }

    fn search(&self, queries: &[&[f32]], wanted: usize) -> Vec<NearestRows> {
        if self.entries.is_empty() {
            return vec![NearestRows::new(wanted); queries.len()];
        }
        let dimension = self.rows.dimension();
        assert!(queries.iter().all(|query| query.len() == dimension), "another encoder's query");
        let (level, rows) = (SimdLevel::best(), &self.rows);
        if self.uses_quantized(queries.len()) {
            let threads = self.quantized_threads(queries.len());
            return exact::scan_quantized(level, rows, self.quantized(), queries, wanted, threads);
        }
        queries.iter().map(|query| exact::scan(level, rows, query, wanted)).collect()
    }

    /// The first `wanted` views of the nearest rows.
    fn in_order(
        &self,
        nearest: NearestRows,
        query: &SearchQuery<'_>,
        wanted: usize,
    ) -> Vec<Neighbour> {
        let rows = nearest.into_rows();
        let mut views: Vec<Neighbour> = Vec::with_capacity(rows.len());
        for (distance, row) in rows {
            let (first, end) = (self.first[row as usize], self.first[row as usize + 1]);
            let entries = &self.entries[first as usize..end as usize];
            views.extend(entries.iter().map(|&entry| Neighbour { entry, distance }));
        }
        let order = |a: &Neighbour, b: &Neighbour| {
            let ties = || tie_order(&a.entry, query).cmp(&tie_order(&b.entry, query));
            a.distance.total_cmp(&b.distance).then_with(ties)
        };
        if wanted == 1 {
            return views.into_iter().min_by(order).into_iter().collect();
        }
        views.sort_by(order);
        views.truncate(wanted);
        views
    }
}

/// Orders views of equal distance: the least is the nearest.
fn tie_order(entry: &ViewEntry, query: &SearchQuery<'_>) -> (u32, u32, u16, u16) {
    let stages = entry.stage.abs_diff(query.stage);
    let steps = u32::from(entry.step).abs_diff(query.elapsed);
    (stages, steps, entry.demonstration, entry.step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::embedding::distance;
    use proptest::prelude::*;

    /// A palette of few embeddings, so that ties are common.
    fn palette() -> Vec<Embedding> {
        let raw = |a: i16, b: i16| vec![f32::from(a), f32::from(b), 1.0];
        (-1..=1)
            .flat_map(|a| (-1..=1).map(move |b| Embedding::normalised(&raw(a, b)).unwrap()))
            .collect()
    }

    /// Specification, section 5, word for word, one view at a time.
    fn naive(
        views: &[(ViewEntry, usize)],
        palette: &[Embedding],
        query: SearchQuery<'_>,
    ) -> Option<Neighbour> {
        let mut best: Option<Neighbour> = None;
        for &(entry, colour) in views {
            let distance = distance(query.embedding, palette[colour].as_slice());
            let stage = |e: ViewEntry| (i64::from(e.stage) - i64::from(query.stage)).abs();
            let elapsed = |e: ViewEntry| (i64::from(e.step) - i64::from(query.elapsed)).abs();
            let better = best.is_none_or(|best| {
                distance < best.distance
                    || distance == best.distance
                        && (stage(entry) < stage(best.entry)
                            || stage(entry) == stage(best.entry)
                                && (elapsed(entry) < elapsed(best.entry)
                                    || elapsed(entry) == elapsed(best.entry)
                                        && (entry.demonstration, entry.step)
                                            < (best.entry.demonstration, best.entry.step)))
            });
            if better {
                best = Some(Neighbour { entry, distance });
            }
        }
        best
    }

    /// Views in any order; a demonstration has one a step.
    fn views() -> impl Strategy<Value = Vec<(ViewEntry, usize)>> {
        let view = |((demonstration, step), (stage, colour))| {
            (ViewEntry { demonstration, step, stage }, colour)
        };
        prop::collection::btree_map((0..4_u16, 0..12_u16), (0..3_u32, 0..9_usize), 0..48)
            .prop_map(move |views| views.into_iter().map(view).collect::<Vec<_>>())
            .prop_shuffle()
    }

    proptest! {
        #[test]
        fn the_index_finds_what_a_naive_search_finds(
            views in views(),
            raw in prop::collection::vec(-1.0_f32..1.0, 3),
            (on_palette, colour) in (any::<bool>(), 0..9_usize),
            (stage, elapsed) in (0..4_u32, 0..20_u32),
        ) {
            let palette = palette();
            let free = Embedding::normalised(&raw);
            let embedding = if on_palette { Some(&palette[colour]) } else { free.as_ref() };
            let Some(embedding) = embedding else { return Ok(()) };
            let query = SearchQuery { embedding: embedding.as_slice(), stage, elapsed };
            let expected = naive(&views, &palette, query);
            let parts = |&(entry, colour): &(ViewEntry, usize)| (entry, [colour as u8; 16], &palette[colour]);
            prop_assert_eq!(Index::new(views.iter().map(parts)).nearest(query), expected);
        }
    }

    #[test]
    fn ties_are_ordered_by_stage_then_elapsed_steps_then_demonstration() {
        let one = Embedding::normalised(&[1.0, 0.0]).unwrap();
        let entry = |demonstration, step, stage| ViewEntry { demonstration, step, stage };
        let views = [entry(0, 3, 0), entry(0, 9, 1), entry(1, 7, 1), entry(2, 7, 1)];
        let index = Index::new(views.iter().map(|&entry| (entry, [0; 16], &one)));
        let ask = |stage, elapsed| {
            index.nearest(SearchQuery { embedding: one.as_slice(), stage, elapsed }).unwrap().entry
        };
        assert_eq!(ask(0, 9), views[0]);
        assert_eq!(ask(1, 9), views[1]);
        assert_eq!(ask(1, 8), views[1]);
        assert_eq!(ask(1, 7), views[2]);
        assert_eq!(ask(5, 0), views[2]);
    }
}
