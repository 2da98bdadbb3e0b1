//! The nearest rows, exactly.
//!
//! Few rows are measured one by one. Many are sifted first, by codes of a quarter of the size
//! ([`super::codes`]), and only those that could be among the nearest are measured: the answer is the same, the
//! memory that is read is not. Where the memory to be read takes longer than waking a thread does, all of the
//! processor's cores take part, which changes nothing about the answer either.

use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};

use super::codes::{Coded, Codes, GROUP, PANEL, Panel};
use super::kernel::{self, Level};
use super::rows::{Line, Rows, pad};

/// Rows that are measured before their distances are looked at.
const BLOCK: usize = 128;

/// Groups that a thread takes at once.
const TAKEN: usize = 64;

/// Groups that are looked at beforehand, so that the first rows of the scan do not all seem near.
const SAMPLED: usize = 16;

/// Queries from which on products of whole tiles pay.
const TILED_FROM: usize = 4;

/// The rows at most as far as the last of those that are wanted: in order of distance, equal ones together.
#[derive(Debug, Clone)]
pub(super) struct Best {
    wanted: usize,
    found: Vec<(f32, u32)>,
}

impl Best {
    pub(super) fn new(wanted: usize) -> Self {
        Self { wanted, found: Vec::new() }
    }

    /// Distance beyond which a row is of no interest.
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

    /// What was found.
    pub(super) fn into_rows(self) -> Vec<(f32, u32)> {
        self.found
    }
}

/// Measures all rows.
pub(super) fn measured(level: Level, rows: &Rows, query: &[f32], wanted: usize) -> Best {
    let query: Vec<Line> = pad(query).collect();
    let mut best = Best::new(wanted);
    let mut distances = [0.0; BLOCK];
    for first in (0..rows.len()).step_by(BLOCK) {
        let end = rows.len().min(first + BLOCK);
        let distances = &mut distances[..end - first];
        kernel::distances(level, &query, rows.lines(first..end), distances);
        for (row, &distance) in (first as u32..).zip(&*distances) {
            best.offer(distance, row);
        }
    }
    best
}

/// Measures some rows.
pub(super) fn measured_among(
    level: Level,
    rows: &Rows,
    among: impl Iterator<Item = usize>,
    query: &[f32],
    wanted: usize,
) -> Best {
    let query: Vec<Line> = pad(query).collect();
    let mut best = Best::new(wanted);
    for row in among {
        let mut distance = [0.0];
        kernel::distances(level, &query, rows.row(row), &mut distance);
        best.offer(distance[0], row as u32);
    }
    best
}

/// A search of many rows for at most [`PANEL`] queries at once.
struct Sifting<'a> {
    level: Level,
    rows: &'a Rows,
    codes: &'a Codes,
    wanted: usize,
    queries: Vec<Asked>,
    /// All queries' codes, where whole tiles are multiplied.
    panel: Option<Panel>,
    /// For each query, a distance that its answer does not exceed, as bits: of numbers that are not negative
    /// these have the same order.
    limits: Vec<AtomicU32>,
}

struct Asked {
    lines: Vec<Line>,
    coded: Coded,
}

/// Sifts all rows by their codes, for any number of queries, by `threads` threads.
pub(super) fn sifted(
    level: Level,
    rows: &Rows,
    codes: &Codes,
    queries: &[&[f32]],
    wanted: usize,
    threads: usize,
) -> Vec<Best> {
    let panels = queries.chunks(PANEL);
    panels
        .flat_map(|queries| Sifting::new(level, rows, codes, queries, wanted).run(threads))
        .collect()
}

impl<'a> Sifting<'a> {
    fn new(
        level: Level,
        rows: &'a Rows,
        codes: &'a Codes,
        queries: &[&[f32]],
        wanted: usize,
    ) -> Self {
        let ask = |query: &&[f32]| Asked { lines: pad(query).collect(), coded: codes.query(query) };
        let queries: Vec<Asked> = queries.iter().map(ask).collect();
        let tiled = level.has_tiles() && queries.len() >= TILED_FROM;
        let panel = tiled.then(|| Panel::of(queries.iter().map(|asked| &asked.coded)));
        let limit = || AtomicU32::new(f32::INFINITY.to_bits());
        let limits = std::iter::repeat_with(limit).take(queries.len()).collect();
        Self { level, rows, codes, wanted, queries, panel, limits }
    }

    fn run(&self, threads: usize) -> Vec<Best> {
        if self.wanted == 0 {
            return vec![Best::new(0); self.queries.len()];
        }
        self.sample();
        let next = AtomicUsize::new(0);
        if threads <= 1 {
            return self.work(&next);
        }
        let parts = std::thread::scope(|scope| {
            let work = || self.work(&next);
            let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
            let mut parts = vec![self.work(&next)];
            parts.extend(others.into_iter().map(|thread| match thread.join() {
                Ok(part) => part,
                Err(panic) => std::panic::resume_unwind(panic),
            }));
            parts
        });
        let mut all = vec![Best::new(self.wanted); self.queries.len()];
        for part in parts {
            for (best, part) in all.iter_mut().zip(part) {
                part.found.into_iter().for_each(|(distance, row)| best.offer(distance, row));
            }
        }
        all
    }

    /// Takes groups until none is left.
    fn work(&self, next: &AtomicUsize) -> Vec<Best> {
        let mut best = vec![Best::new(self.wanted); self.queries.len()];
        let mut bars = [f32::NEG_INFINITY; PANEL];
        let mut limits = [f32::NEG_INFINITY; PANEL];
        loop {
            let first = next.fetch_add(TAKEN, Ordering::Relaxed);
            if first >= self.codes.groups() {
                return best;
            }
            for group in first..self.codes.groups().min(first + TAKEN) {
                for (at, asked) in self.queries.iter().enumerate() {
                    let limit = self.limit(at);
                    if limit != limits[at] {
                        limits[at] = limit;
                        bars[at] = self.codes.bar(&asked.coded, limit);
                    }
                }
                self.group(group, &bars, &mut best);
            }
        }
    }

    /// Sifts a group for all queries, and measures what is left.
    fn group(&self, group: usize, bars: &[f32; PANEL], best: &mut [Best]) {
        let (codes, first) = (self.codes.group(group), group * GROUP);
        if let Some(panel) = &self.panel {
            let mut passing = [0; GROUP];
            kernel::sift_panel(self.level, codes, panel, bars, &mut passing);
            for (row, passing) in passing.into_iter().enumerate() {
                ones(passing).for_each(|query| self.measure(query, first + row, best));
            }
        } else {
            for (query, asked) in self.queries.iter().enumerate() {
                let passing = kernel::sift(self.level, codes, &asked.coded, bars[query]);
                ones(passing).for_each(|row| self.measure(query, first + row, best));
            }
        }
    }

    fn measure(&self, query: usize, row: usize, best: &mut [Best]) {
        let distance = self.distance(query, row);
        let best = &mut best[query];
        if distance <= self.limit(query) {
            best.offer(distance, row as u32);
            self.limits[query].fetch_min(best.limit().to_bits(), Ordering::Relaxed);
        }
    }

    fn distance(&self, query: usize, row: usize) -> f32 {
        let mut distance = [0.0];
        let query = &self.queries[query].lines;
        kernel::distances(self.level, query, self.rows.row(row), &mut distance);
        distance[0]
    }

    fn limit(&self, query: usize) -> f32 {
        f32::from_bits(self.limits[query].load(Ordering::Relaxed))
    }

    /// Looks at some groups, and measures what seems nearest in them, as many rows as are wanted: the last of
    /// those is a first limit.
    fn sample(&self) {
        let groups = self.codes.groups();
        let sampled = SAMPLED.max(self.wanted);
        if groups < self.wanted {
            return;
        }
        let step = groups.div_ceil(sampled);
        let sample: Vec<usize> = (0..groups).step_by(step).collect();
        let mut best = vec![Best::new(self.wanted); self.queries.len()];
        for part in 0..self.wanted {
            let groups = sample.iter().skip(part).step_by(self.wanted);
            let mut nearest = [(f32::NEG_INFINITY, 0); PANEL];
            for &group in groups {
                self.nearest_by_codes(group, &mut nearest);
            }
            for (query, best) in best.iter_mut().enumerate() {
                let (near, row) = nearest[query];
                if near > f32::NEG_INFINITY {
                    best.offer(self.distance(query, row), row as u32);
                }
            }
        }
        for (limit, best) in self.limits.iter().zip(best) {
            limit.store(best.limit().to_bits(), Ordering::Relaxed);
        }
    }

    /// For each query, the row of the group that seems nearest by its code, if it seems nearer than what is
    /// already there.
    fn nearest_by_codes(&self, group: usize, nearest: &mut [(f32, usize); PANEL]) {
        let (codes, first) = (self.codes.group(group), group * GROUP);
        if let Some(panel) = &self.panel {
            kernel::nearest_of_panel(self.level, codes, panel, first, nearest);
            return;
        }
        for (asked, nearest) in self.queries.iter().zip(nearest) {
            let mut products = [0; GROUP];
            kernel::products(self.level, codes, &asked.coded, &mut products);
            let rows = products.into_iter().zip(codes.scales).zip(codes.halves);
            for (row, ((product, &scale), &half)) in (first..).zip(rows) {
                let near = product as f32 * scale * asked.coded.scale - half;
                if near > nearest.0 {
                    *nearest = (near, row);
                }
            }
        }
    }
}

/// The places of the ones in a number.
fn ones(mut bits: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let place = bits.trailing_zeros() as usize;
        bits &= bits.wrapping_sub(1);
        (place < 64).then_some(place)
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

    fn bits(best: Best) -> Vec<(u32, u32)> {
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
            let mut store = Rows::default();
            rows.iter().for_each(|row| store.push(row.as_slice()));
            let expected: Vec<_> =
                queries.iter().map(|query| naive(&rows, query, wanted)).collect();
            for level in Level::all() {
                for (query, expected) in queries.iter().zip(&expected) {
                    let best = measured(level, &store, query.as_slice(), wanted);
                    prop_assert_eq!(&bits(best), expected, "{:?} measured", level);
                }
                if rows.is_empty() {
                    continue;
                }
                let codes = Codes::of(level, &store, threads);
                for many in [1, queries.len()] {
                    let asked: Vec<&[f32]> =
                        queries.iter().take(many).map(Embedding::as_slice).collect();
                    let best = sifted(level, &store, &codes, &asked, wanted, threads);
                    let found: Vec<_> = best.into_iter().map(bits).collect();
                    prop_assert_eq!(&found[..], &expected[..many], "{:?} sifted", level);
                }
            }
        }

        #[test]
        fn products_of_codes_are_the_same_at_every_level(
            rows in rows(70), query in embedding(70)
        ) {
            prop_assume!(!rows.is_empty());
            let mut store = Rows::default();
            rows.iter().for_each(|row| store.push(row.as_slice()));
            let of = |level: Level| {
                let codes = Codes::of(level, &store, 1);
                let coded = codes.query(query.as_slice());
                let products = |group| {
                    let mut products = [0; GROUP];
                    kernel::products(level, codes.group(group), &coded, &mut products);
                    products
                };
                (0..codes.groups()).map(products).collect::<Vec<_>>()
            };
            let all: Vec<_> = Level::all().into_iter().map(of).collect();
            prop_assert!(all.windows(2).all(|pair| pair[0] == pair[1]));
        }
    }

    #[test]
    fn codes_leave_little_to_measure() {
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
        let mut store = Rows::default();
        (0..4096).for_each(|_| store.push(random().as_slice()));
        let level = Level::best();
        let codes = Codes::of(level, &store, 1);
        let query = random();
        let nearest = measured(level, &store, query.as_slice(), 1).limit();
        let coded = codes.query(query.as_slice());
        let bar = codes.bar(&coded, nearest);
        let passing = |group| kernel::sift(level, codes.group(group), &coded, bar).count_ones();
        let passing: u32 = (0..codes.groups()).map(passing).sum();
        assert!((1..200).contains(&passing), "{passing} of 4096");
    }
}
