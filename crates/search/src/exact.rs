//! Exact nearest rows.
//!
//! Few rows are measured one by one. Many rows are compared by their quantized vectors first ([`crate::quantized`]),
//! which reads a quarter of the memory; only rows that the lower bound does not rule out are measured. The
//! answer is the same, on one thread or several.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};

use crate::kernels::{self, BLOCK_ROWS, QUERIES_TOGETHER, SimdLevel};
use crate::matrix::{FloatLine, Matrix, padded};
use crate::quantized::{BlockProducts, QuantizedMatrix, QuantizedQuery, RowBlock};

/// Rows that are measured before their distances are compared.
const ROWS_TOGETHER: usize = 128;

/// Most blocks that a thread takes at a time.
const BLOCKS_TOGETHER: usize = 64;

/// Times that a thread takes blocks, at least, so that all end at about the same time.
const TURNS: usize = 4;

/// Most blocks that are sampled before the scan for a first limit.
const SAMPLED_BLOCKS: usize = 16;

/// One of so many blocks is sampled at most: to choose rows from the sample takes time, too.
const SAMPLED_SHARE: usize = 16;

/// The nearest rows found so far, in order of distance. Rows as far as the last wanted one are all kept.
#[derive(Debug, Clone)]
pub(crate) struct NearestRows {
    wanted: usize,
    found: Vec<(f32, u32)>,
}

impl NearestRows {
    pub(crate) fn new(wanted: usize) -> Self {
        Self { wanted, found: Vec::new() }
    }

    /// The greatest distance of a row that still belongs here.
    fn limit(&self) -> f32 {
        self.wanted.checked_sub(1).map_or(f32::NEG_INFINITY, |last| {
            self.found.get(last).map_or(f32::INFINITY, |found| found.0)
        })
    }

    fn offer(&mut self, distance: f32, row: u32) {
        if distance > self.limit() {
            return;
        }
        let place = self.found.partition_point(|found| found.0 <= distance);
        self.found.insert(place, (distance, row));
        let limit = self.limit();
        let kept = self.found.partition_point(|found| found.0 <= limit);
        self.found.truncate(kept);
    }

    /// Pairs of distance and row.
    pub(crate) fn into_rows(self) -> Vec<(f32, u32)> {
        self.found
    }
}

/// Measures all rows.
pub(crate) fn scan(level: SimdLevel, rows: &Matrix, query: &[f32], wanted: usize) -> NearestRows {
    let query = padded(query);
    let mut nearest = NearestRows::new(wanted);
    let mut distances = [0.0; ROWS_TOGETHER];
    for first in (0..rows.len()).step_by(ROWS_TOGETHER) {
        let end = rows.len().min(first + ROWS_TOGETHER);
        let distances = &mut distances[..end - first];
        kernels::distances(level, &query, rows.lines(first..end), distances);
        for (row, &distance) in (first as u32..).zip(&*distances) {
            nearest.offer(distance, row);
        }
    }
    nearest
}

/// Finds the nearest rows of several queries in one pass over the quantized rows, on `threads` threads.
pub(crate) fn scan_quantized(
    level: SimdLevel,
    rows: &Matrix,
    quantized: &QuantizedMatrix,
    queries: &[&[f32]],
    wanted: usize,
    threads: usize,
) -> Vec<NearestRows> {
    if wanted == 0 {
        return vec![NearestRows::new(0); queries.len()];
    }
    let group = |queries| QueryGroup { queries, prepared: OnceLock::new() };
    let groups = queries.chunks(QUERIES_TOGETHER).map(group).collect();
    let blocks = quantized.blocks();
    let sampled = (blocks / SAMPLED_SHARE).min(SAMPLED_BLOCKS).max(wanted);
    let sample_step = blocks.div_ceil(sampled);
    QuantizedScan { level, rows, quantized, wanted, sample_step, groups }.run(threads)
}

/// A pass over the quantized rows.
struct QuantizedScan<'a> {
    level: SimdLevel,
    rows: &'a Matrix,
    quantized: &'a QuantizedMatrix,
    wanted: usize,
    /// One of so many blocks is sampled, the last: threads come to it when they have prepared the queries, so that none
    /// overtakes another and waits for it.
    sample_step: usize,
    groups: Vec<QueryGroup<'a>>,
}

/// Queries that a block is multiplied by together, at most [`QUERIES_TOGETHER`].
struct QueryGroup<'a> {
    queries: &'a [&'a [f32]],
    /// Filled by the thread that needs it first.
    prepared: OnceLock<PreparedGroup>,
}

struct PreparedGroup {
    queries: Vec<PendingQuery>,
    /// The products with the blocks of the sample, in order.
    sampled: Vec<GroupProducts>,
}

/// The products of a block with each query of a group.
type GroupProducts = [BlockProducts; QUERIES_TOGETHER];

struct PendingQuery {
    lines: Vec<FloatLine>,
    quantized: QuantizedQuery,
    /// A distance that the answer does not exceed, shared by all threads. Bits of non-negative floats have the
    /// floats' order.
    limit: AtomicU32,
}

impl PendingQuery {
    fn limit(&self) -> f32 {
        f32::from_bits(self.limit.load(Ordering::Relaxed))
    }
}

impl QuantizedScan<'_> {
    fn run(&self, threads: usize) -> Vec<NearestRows> {
        let (next_thread, next_block) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let together = (self.quantized.blocks() / (threads * TURNS)).clamp(1, BLOCKS_TOGETHER);
        let scan = || {
            // Every thread begins with other queries, so that no two prepare the same ones.
            let thread = next_thread.fetch_add(1, Ordering::Relaxed);
            let first_group = thread * self.groups.len() / threads;
            self.scan_blocks(&next_block, together, first_group)
        };
        let mut parts = crate::on_threads(threads, scan).into_iter();
        let mut all = parts.next().unwrap_or_default();
        for part in parts {
            for (nearest, part) in all.iter_mut().zip(part) {
                part.found.into_iter().for_each(|(distance, row)| nearest.offer(distance, row));
            }
        }
        all
    }

    /// Takes so many blocks at a time until none is left.
    fn scan_blocks(
        &self,
        next_block: &AtomicUsize,
        together: usize,
        first_group: usize,
    ) -> Vec<NearestRows> {
        let queries = self.groups.iter().map(|group| group.queries.len()).sum();
        let mut nearest = vec![NearestRows::new(self.wanted); queries];
        // Limit and threshold of each query.
        let mut thresholds = vec![(f32::NAN, f32::NAN); queries];
        let mut own_products = [[0; BLOCK_ROWS]; QUERIES_TOGETHER];
        loop {
            let first = next_block.fetch_add(together, Ordering::Relaxed);
            if first >= self.quantized.blocks() {
                return nearest;
            }
            for block in first..self.quantized.blocks().min(first + together) {
                let rows = self.quantized.block(block);
                for group in (first_group..self.groups.len()).chain(0..first_group) {
                    let prepared = self.prepared(group);
                    let products = self.products(prepared, block, &mut own_products);
                    let answers = nearest.iter_mut().zip(&mut thresholds);
                    let answers = answers.skip(group * QUERIES_TOGETHER);
                    for ((query, products), (nearest, known)) in
                        prepared.queries.iter().zip(products).zip(answers)
                    {
                        let limit = query.limit();
                        if limit != known.0 {
                            *known = (limit, self.quantized.threshold(&query.quantized, limit));
                        }
                        let candidates =
                            rows.candidates(self.level, &query.quantized, products, known.1);
                        self.measure(block, candidates, query, nearest);
                    }
                }
            }
        }
    }

    /// The products of a block with a group of queries: those of the sample are known.
    fn products<'a>(
        &self,
        group: &'a PreparedGroup,
        block: usize,
        own: &'a mut GroupProducts,
    ) -> &'a GroupProducts {
        if (block + 1).is_multiple_of(self.sample_step)
            && let Some(known) = group.sampled.get(block / self.sample_step)
        {
            return known;
        }
        self.multiply(self.quantized.block(block), &group.queries, own);
        own
    }

    /// Multiplies a block by a group of queries.
    fn multiply(
        &self,
        block: RowBlock<'_>,
        queries: &[PendingQuery],
        products: &mut GroupProducts,
    ) {
        if let Ok(queries) = <&[PendingQuery; QUERIES_TOGETHER]>::try_from(queries) {
            let queries = queries.each_ref().map(|query| &query.quantized);
            block.multiply(self.level, queries, products);
            return;
        }
        for (query, products) in queries.iter().zip(products) {
            block.multiply(self.level, [&query.quantized], std::array::from_mut(products));
        }
    }

    /// Measures the candidates of a block.
    fn measure(
        &self,
        block: usize,
        candidates: u64,
        query: &PendingQuery,
        nearest: &mut NearestRows,
    ) {
        for place in bits(candidates) {
            let row = block * BLOCK_ROWS + place;
            let distance = self.distance(query, row);
            if distance <= query.limit() {
                nearest.offer(distance, row as u32);
                query.limit.fetch_min(nearest.limit().to_bits(), Ordering::Relaxed);
            }
        }
    }

    fn distance(&self, query: &PendingQuery, row: usize) -> f32 {
        let mut distance = [0.0];
        kernels::distances(self.level, &query.lines, self.rows.row(row), &mut distance);
        distance[0]
    }

    /// The queries of a group, with a first limit each.
    fn prepared(&self, group: usize) -> &PreparedGroup {
        let group = &self.groups[group];
        group.prepared.get_or_init(|| {
            let pending = |query: &&[f32]| PendingQuery {
                lines: padded(query),
                quantized: self.quantized.query(query),
                limit: AtomicU32::new(f32::INFINITY.to_bits()),
            };
            let queries: Vec<PendingQuery> = group.queries.iter().map(pending).collect();
            let sampled = self.sample(&queries);
            PreparedGroup { queries, sampled }
        })
    }

    /// Sets a first limit for each query: measures as many rows as are wanted, those that seem nearest in a sample of
    /// blocks, and takes the farthest of them. Returns the products with the sample, which is empty where there are
    /// fewer blocks than wanted rows.
    fn sample(&self, queries: &[PendingQuery]) -> Vec<GroupProducts> {
        let blocks = self.quantized.blocks();
        if blocks < self.wanted {
            return Vec::new();
        }
        let sample: Vec<usize> = (self.sample_step - 1..blocks).step_by(self.sample_step).collect();
        let mut sampled = vec![[[0; BLOCK_ROWS]; QUERIES_TOGETHER]; sample.len()];
        for (&block, products) in sample.iter().zip(&mut sampled) {
            self.multiply(self.quantized.block(block), queries, products);
        }
        for (at, query) in queries.iter().enumerate() {
            let mut limits = NearestRows::new(self.wanted);
            for part in 0..self.wanted {
                let mut seemingly_nearest = (f32::NEG_INFINITY, None);
                for (&block, products) in
                    sample.iter().zip(&sampled).skip(part).step_by(self.wanted)
                {
                    let rows = self.quantized.block(block);
                    let estimates = rows.estimates(&query.quantized, &products[at]);
                    for (row, estimate) in (block * BLOCK_ROWS..).zip(estimates) {
                        if estimate > seemingly_nearest.0 {
                            seemingly_nearest = (estimate, Some(row));
                        }
                    }
                }
                if let Some(row) = seemingly_nearest.1 {
                    limits.offer(self.distance(query, row), row as u32);
                }
            }
            query.limit.store(limits.limit().to_bits(), Ordering::Relaxed);
        }
        sampled
    }
}

/// The positions of the ones in a number.
fn bits(mut number: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let position = number.trailing_zeros() as usize;
        number &= number.wrapping_sub(1);
        (position < 64).then_some(position)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Embedding;
    use crate::embedding::distance;
    use proptest::prelude::*;

    /// Every row measured by itself, in order of distance; those as far as the last that is wanted.
    fn naive(rows: &[Embedding], query: &Embedding, wanted: usize) -> Vec<(u32, u32)> {
        let measure = |row: &Embedding| distance(query.as_slice(), row.as_slice()).to_bits();
        let mut all: Vec<(u32, u32)> = rows.iter().map(measure).zip(0..).collect();
        all.sort_unstable();
        let Some(last) = all.get(wanted.wrapping_sub(1)).map(|found| found.0) else {
            return if wanted == 0 { Vec::new() } else { all };
        };
        all.into_iter().filter(|found| found.0 <= last).collect()
    }

    fn sorted_bits(best: NearestRows) -> Vec<(u32, u32)> {
        let rows = best.into_rows().into_iter();
        let mut rows: Vec<(u32, u32)> = rows.map(|(far, row)| (far.to_bits(), row)).collect();
        rows.sort_unstable();
        rows
    }

    fn embedding(dimension: usize) -> impl Strategy<Value = Embedding> {
        let raw = prop::collection::vec(-1.0_f32..1.0, dimension);
        raw.prop_filter_map("no direction", |raw| Embedding::normalised(&raw))
    }

    /// Rows of few or many different contents, with a shift in common and at any distance from one another.
    fn rows(dimension: usize) -> impl Strategy<Value = Vec<Embedding>> {
        let close = (-9.0_f32..0.0).prop_map(|power| 10.0_f32.powf(power));
        let palette = prop::collection::vec(embedding(dimension), 1..20);
        let picks = prop::collection::vec((any::<prop::sample::Index>(), any::<bool>()), 0..300);
        (palette, picks, embedding(dimension), close).prop_map(|(palette, picks, shift, close)| {
            let row = |(pick, nudged): (prop::sample::Index, bool)| {
                let colour = palette[pick.index(palette.len())].as_slice();
                let nudge = if nudged { close } else { 0.0 };
                let raw = colour.iter().zip(shift.as_slice()).map(|(x, s)| s + (x + nudge) * close);
                Embedding::normalised(&raw.collect::<Vec<f32>>()).unwrap_or_else(|| shift.clone())
            };
            picks.into_iter().map(row).collect()
        })
    }

    proptest! {
        #[test]
        fn every_path_finds_what_a_naive_search_finds_bit_for_bit(
            (rows, free) in (1_usize..150).prop_flat_map(|dimension| {
                (rows(dimension), prop::collection::vec(embedding(dimension), 1..9))
            }),
            wanted in prop_oneof![Just(1_usize), 0..13_usize],
            threads in 1..3_usize,
        ) {
            // Queries that are rows, too: distance zero.
            let queries: Vec<Embedding> = free.into_iter().chain(rows.iter().take(70).cloned()).collect();
            let mut store = Matrix::default();
            rows.iter().for_each(|row| store.push(row.as_slice()));
            let expected: Vec<_> =
                queries.iter().map(|query| naive(&rows, query, wanted)).collect();
            for level in SimdLevel::all() {
                for (query, expected) in queries.iter().zip(&expected) {
                    let best = scan(level, &store, query.as_slice(), wanted);
                    prop_assert_eq!(&sorted_bits(best), expected, "{:?}, original vectors", level);
                }
                if rows.is_empty() {
                    continue;
                }
                let codes = QuantizedMatrix::new(level, &store, threads);
                for many in [1, queries.len()] {
                    let asked: Vec<&[f32]> =
                        queries.iter().take(many).map(Embedding::as_slice).collect();
                    let best = scan_quantized(level, &store, &codes, &asked, wanted, threads);
                    let found: Vec<_> = best.into_iter().map(sorted_bits).collect();
                    prop_assert_eq!(&found[..], &expected[..many], "{:?}, quantized vectors", level);
                }
            }
        }

        #[test]
        fn estimates_are_the_same_at_every_level(rows in rows(70), query in embedding(70)) {
            prop_assume!(!rows.is_empty());
            let mut store = Matrix::default();
            rows.iter().for_each(|row| store.push(row.as_slice()));
            let estimates = |level: SimdLevel| {
                let quantized = QuantizedMatrix::new(level, &store, 1);
                let query = quantized.query(query.as_slice());
                let blocks = (0..quantized.blocks()).map(|block| quantized.block(block));
                let all = blocks.flat_map(|block| {
                    let mut products = [[0; BLOCK_ROWS]];
                    block.multiply(level, [&query], &mut products);
                    block.estimates(&query, &products[0]).collect::<Vec<_>>()
                });
                all.take(store.len()).map(f32::to_bits).collect::<Vec<_>>()
            };
            let all: Vec<_> = SimdLevel::all().into_iter().map(estimates).collect();
            prop_assert!(all.windows(2).all(|pair| pair[0] == pair[1]));
        }
    }

    #[test]
    fn the_lower_bound_rules_out_most_rows() {
        // Directions drawn evenly: no two are alike, and none is much nearer than the others.
        let mut state = 1_u64;
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f32 / (1 << 24) as f32 - 0.5
        };
        let mut random = || {
            let raw: Vec<f32> = (0..384).map(|_| draw()).collect();
            Embedding::normalised(&raw).unwrap()
        };
        let mut store = Matrix::default();
        (0..4096).for_each(|_| store.push(random().as_slice()));
        let level = SimdLevel::best();
        let quantized = QuantizedMatrix::new(level, &store, 1);
        let query = random();
        let nearest = scan(level, &store, query.as_slice(), 1).limit();
        let query = quantized.query(query.as_slice());
        let threshold = quantized.threshold(&query, nearest);
        let candidates = |block| {
            let block = quantized.block(block);
            let mut products = [[0; BLOCK_ROWS]];
            block.multiply(level, [&query], &mut products);
            block.candidates(level, &query, &products[0], threshold).count_ones()
        };
        let candidates: u32 = (0..quantized.blocks()).map(candidates).sum();
        assert!((1..200).contains(&candidates), "{candidates} of 4096");
    }
}
