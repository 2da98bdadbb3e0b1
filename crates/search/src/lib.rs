//! Exact nearest neighbour among remembered views.
//!
//! The order is total, so the answer never depends on anything but the question: cosine distance, then
//! task stage, then elapsed steps (SPEC section 5), then the first demonstration, then the earliest step.
//! Views of equal content have equal embeddings, hence equal distances to the last bit: those are the ties.

mod approximate;
mod codes;
pub mod embedding;
mod exact;
mod kernel;
mod rows;
mod scan;
pub mod vectors;

use std::collections::HashMap;
use std::num::NonZeroUsize;
use std::sync::OnceLock;

pub use self::approximate::{Approximate, Effort, GraphError};
use self::codes::Codes;
pub use self::embedding::{ContentHash, Embedding};
use self::exact::Best;
use self::kernel::Level;
use self::rows::Rows;

/// One remembered view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// Position of its demonstration among those of the memory.
    pub demonstration: u16,
    /// Steps the expert had taken.
    pub step: u16,
    /// Sub-goals the expert had completed.
    pub stage: u32,
}

/// The view from which one asks.
#[derive(Debug, Clone, Copy)]
pub struct Query<'a> {
    /// Its embedding.
    pub embedding: &'a Embedding,
    /// Sub-goals completed so far.
    pub stage: u32,
    /// Steps taken so far.
    pub elapsed: u32,
}

/// The nearest view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// The view.
    pub entry: Entry,
    /// Its cosine distance.
    pub distance: f32,
}

/// Views from which on a single question is answered by codes first. Below, coding them costs more than it saves
/// in an episode.
const CODED_FROM: usize = 1000;

/// Bytes of codes from which on all cores take part in a search.
const SHARED_FROM: usize = 8 << 20;

/// Questions from which on codes are made even of few views.
const MANY: usize = 16;

/// Remembered views, ready to be searched.
#[derive(Debug)]
pub struct Index {
    /// Vectors of distinct content.
    rows: Rows,
    /// For each of them, where its views begin in `entries`; at the end, how many there are.
    first: Vec<u32>,
    entries: Vec<Entry>,
    /// Made when they are first of use.
    codes: OnceLock<Codes>,
    threads: Option<NonZeroUsize>,
}

/// Views that become an [`Index`].
#[derive(Debug, Default)]
pub struct Builder {
    rows: Rows,
    contents: HashMap<ContentHash, u32>,
    views: Vec<(u32, Entry)>,
}

impl Builder {
    /// For about `views` views whose embeddings are of `dimension`.
    pub fn with_capacity(dimension: usize, views: usize) -> Self {
        let rows = Rows::with_capacity(dimension, views);
        Self { rows, contents: HashMap::new(), views: Vec::with_capacity(views) }
    }

    /// Adds a view, its content and its embedding; equal content is stored once.
    ///
    /// # Panics
    /// When embeddings differ in dimension.
    pub fn add(&mut self, entry: Entry, content: ContentHash, embedding: &[f32]) {
        let next = self.rows.len() as u32;
        let row = *self.contents.entry(content).or_insert(next);
        if row == next {
            self.rows.push(embedding);
        }
        self.views.push((row, entry));
    }

    /// Adds a view whose content is no other's.
    ///
    /// # Panics
    /// When embeddings differ in dimension.
    pub fn add_distinct(&mut self, entry: Entry, embedding: &[f32]) {
        self.views.push((self.rows.len() as u32, entry));
        self.rows.push(embedding);
    }

    /// The index.
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
        Index { rows, first, entries, codes: OnceLock::new(), threads: None }
    }
}

impl Index {
    /// Builds an index of views, each with its content and its embedding; equal content is stored once.
    ///
    /// # Panics
    /// When embeddings differ in dimension.
    pub fn new<'a>(views: impl IntoIterator<Item = (Entry, ContentHash, &'a Embedding)>) -> Self {
        let mut builder = Builder::default();
        for (entry, content, embedding) in views {
            builder.add(entry, content, embedding.as_slice());
        }
        builder.build()
    }

    /// Most threads that a search uses [default: the processor's cores]. A search of few views uses one.
    #[must_use]
    pub fn with_threads(self, threads: NonZeroUsize) -> Self {
        Self { threads: Some(threads), ..self }
    }

    /// The nearest view; `None` when there are no views.
    ///
    /// # Panics
    /// When the query's embedding is of another dimension.
    pub fn nearest(&self, query: Query<'_>) -> Option<Nearest> {
        let best = self.search(&[query.embedding.as_slice()], 1).pop()?;
        self.in_order(best, &query, 1).pop()
    }

    /// For each query, the `wanted` nearest views, nearest first; fewer where there are fewer. Many queries at
    /// once cost less than one after the other.
    ///
    /// # Panics
    /// When a query's embedding is of another dimension.
    pub fn nearest_of_many(&self, queries: &[Query<'_>], wanted: usize) -> Vec<Vec<Nearest>> {
        let vectors: Vec<&[f32]> = queries.iter().map(|query| query.embedding.as_slice()).collect();
        let best = self.search(&vectors, wanted);
        best.into_iter()
            .zip(queries)
            .map(|(best, query)| self.in_order(best, query, wanted))
            .collect()
    }

    /// Makes what a search needs, where it would otherwise be made by the first.
    pub fn prepare(&self) {
        if self.by_codes(1) {
            self.codes();
        }
    }

    /// Bytes that the views take, codes included where they were made.
    pub fn bytes(&self) -> usize {
        let codes = self.codes.get().map_or(0, Codes::bytes);
        self.rows.bytes() + codes + size_of_val(&*self.first) + size_of_val(&*self.entries)
    }

    /// Bytes that a search of `queries` queries at once reads from end to end.
    pub fn scanned_bytes(&self, queries: usize) -> usize {
        if self.by_codes(queries) { self.codes().bytes() } else { self.rows.bytes() }
    }

    /// Threads that a search of `queries` queries at once uses.
    pub fn threads(&self, queries: usize) -> usize {
        if self.by_codes(queries) { self.threads_for_codes() } else { 1 }
    }

    fn by_codes(&self, queries: usize) -> bool {
        self.rows.len() >= CODED_FROM || queries >= MANY
    }

    fn search(&self, queries: &[&[f32]], wanted: usize) -> Vec<Best> {
        if self.entries.is_empty() {
            return vec![Best::new(wanted); queries.len()];
        }
        let dimension = self.rows.dimension();
        assert!(queries.iter().all(|query| query.len() == dimension), "another encoder's query");
        let level = Level::best();
        if self.by_codes(queries.len()) {
            let codes = self.codes();
            return exact::sifted(
                level,
                &self.rows,
                codes,
                queries,
                wanted,
                self.threads_for_codes(),
            );
        }
        let measured = |query: &&[f32]| exact::measured(level, &self.rows, query, wanted);
        queries.iter().map(measured).collect()
    }

    fn codes(&self) -> &Codes {
        self.codes.get_or_init(|| Codes::of(Level::best(), &self.rows, self.threads_for_codes()))
    }

    fn threads_for_codes(&self) -> usize {
        if self.rows.len() * self.rows.dimension() < SHARED_FROM {
            return 1;
        }
        let cores = || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
        self.threads.unwrap_or_else(cores).get()
    }

    /// The first `wanted` views of the nearest rows.
    fn in_order(&self, best: Best, query: &Query<'_>, wanted: usize) -> Vec<Nearest> {
        let rows = best.into_rows();
        let mut views: Vec<Nearest> = Vec::with_capacity(rows.len());
        for (distance, row) in rows {
            let (first, end) = (self.first[row as usize], self.first[row as usize + 1]);
            let entries = &self.entries[first as usize..end as usize];
            views.extend(entries.iter().map(|&entry| Nearest { entry, distance }));
        }
        let order = |a: &Nearest, b: &Nearest| {
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

/// What decides between views of equal distance; the least wins.
fn tie_order(entry: &Entry, query: &Query<'_>) -> (u32, u32, u16, u16) {
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

    /// SPEC section 5 word for word, one view at a time.
    fn naive(views: &[(Entry, usize)], palette: &[Embedding], query: Query<'_>) -> Option<Nearest> {
        let mut best: Option<Nearest> = None;
        for &(entry, colour) in views {
            let distance = distance(query.embedding.as_slice(), palette[colour].as_slice());
            let stage = |e: Entry| (i64::from(e.stage) - i64::from(query.stage)).abs();
            let elapsed = |e: Entry| (i64::from(e.step) - i64::from(query.elapsed)).abs();
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
                best = Some(Nearest { entry, distance });
            }
        }
        best
    }

    /// Views in any order; a demonstration has one a step.
    fn views() -> impl Strategy<Value = Vec<(Entry, usize)>> {
        let view = |((demonstration, step), (stage, colour))| {
            (Entry { demonstration, step, stage }, colour)
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
            let query = Query { embedding, stage, elapsed };
            let expected = naive(&views, &palette, query);
            let parts = |&(entry, colour): &(Entry, usize)| (entry, [colour as u8; 16], &palette[colour]);
            prop_assert_eq!(Index::new(views.iter().map(parts)).nearest(query), expected);
        }
    }

    #[test]
    fn ties_go_by_stage_then_elapsed_steps_then_demonstration() {
        let one = Embedding::normalised(&[1.0, 0.0]).unwrap();
        let entry = |demonstration, step, stage| Entry { demonstration, step, stage };
        let views = [entry(0, 3, 0), entry(0, 9, 1), entry(1, 7, 1), entry(2, 7, 1)];
        let index = Index::new(views.iter().map(|&entry| (entry, [0; 16], &one)));
        let ask = |stage, elapsed| {
            index.nearest(Query { embedding: &one, stage, elapsed }).unwrap().entry
        };
        assert_eq!(ask(0, 9), views[0]);
        assert_eq!(ask(1, 9), views[1]);
        assert_eq!(ask(1, 8), views[1]);
        assert_eq!(ask(1, 7), views[2]);
        assert_eq!(ask(5, 0), views[2]);
    }
}
