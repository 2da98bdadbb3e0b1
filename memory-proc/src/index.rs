//! Exact nearest neighbour among remembered views.
//!
//! The order is total, so the answer never depends on anything but the question: cosine distance, then
//! task stage, then elapsed steps (SPEC section 5), then the first demonstration, then the earliest step.
//! Views of equal content have equal embeddings, hence equal distances to the last bit: those are the ties.

use std::collections::HashMap;

use crate::embedding::{ContentHash, Embedding, distance};

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

/// Remembered views, ready to be searched.
#[derive(Debug, Clone)]
pub struct Index {
    dimension: usize,
    /// Vectors of distinct content, one behind the other.
    vectors: Vec<f32>,
    /// For each of them, the views that show it.
    entries: Vec<Vec<Entry>>,
}

impl Index {
    /// Builds an index of views, each with its content and its embedding; equal content is stored once.
    ///
    /// # Panics
    /// When embeddings differ in dimension.
    pub fn new<'a>(views: impl IntoIterator<Item = (Entry, ContentHash, &'a Embedding)>) -> Self {
        let mut index = Self { dimension: 0, vectors: Vec::new(), entries: Vec::new() };
        let mut rows = HashMap::new();
        for (entry, content, embedding) in views {
            let vector = embedding.as_slice();
            if index.entries.is_empty() {
                index.dimension = vector.len();
            }
            assert_eq!(vector.len(), index.dimension, "embeddings of two encoders in one index");
            let row = *rows.entry(content).or_insert_with(|| {
                index.vectors.extend_from_slice(vector);
                index.entries.push(Vec::new());
                index.entries.len() - 1
            });
            index.entries[row].push(entry);
        }
        index
    }

    /// The nearest view; `None` when there are no views.
    ///
    /// # Panics
    /// When the query's embedding is of another dimension.
    pub fn nearest(&self, query: Query<'_>) -> Option<Nearest> {
        let vector = query.embedding.as_slice();
        assert!(
            self.entries.is_empty() || vector.len() == self.dimension,
            "another encoder's query"
        );
        let mut least = f32::INFINITY;
        let mut tied: Vec<usize> = Vec::new();
        for (row, stored) in self.vectors.chunks_exact(self.dimension.max(1)).enumerate() {
            let distance = distance(vector, stored);
            if distance < least {
                least = distance;
                tied.clear();
            }
            if distance == least {
                tied.push(row);
            }
        }
        let tied = tied.into_iter().flat_map(|row| &self.entries[row]);
        let entry = *tied.min_by_key(|entry| tie_order(entry, &query))?;
        Some(Nearest { entry, distance: least })
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
