//! Vectors quantized to one byte per number, and a lower bound on the distance of the original vectors.
//!
//! A vector `x` is stored as `x' = centre + scale * code`. Codes are whole numbers from -127 to 127, every vector has
//! a scale of its own, and all share one centre. The quantization error `e(x) = |x - x'|` is measured for every
//! vector. For a query `q`, quantized in the same way, the triangle inequality gives
//!
//! ```text
//! |q - x| >= |q' - x'| - e(q) - e(x)
//! ```
//!
//! and `|q' - x'|` follows from a product of whole numbers, which is exact. Where this lower bound exceeds the distance
//! of a vector that has been measured, `x` is farther away and its original numbers are not read. The bound holds for
//! any data; the data decides only how many vectors it rules out.

use std::sync::{Mutex, PoisonError};

use crate::kernels::{self, BLOCK_ROWS, CODE_ZERO, QuantizedVector, QueryCodes, SimdLevel};
use crate::matrix::{CodeLine, Matrix};
use crate::pages;

/// Maximum number of rows whose mean is the centre. Any centre is correct; a good one makes errors small.
const CENTRE_SAMPLE: usize = 4096;

/// Quantized rows, in blocks of [`BLOCK_ROWS`].
pub(crate) struct QuantizedMatrix {
    level: SimdLevel,
    centre: Vec<f32>,
    /// Steps of four codes in a row.
    steps: usize,
    lines: Vec<CodeLine>,
    scales: Vec<f32>,
    /// Half the squared length of `scale * code`; NaN past the last row, which no comparison reaches.
    half_norms: Vec<f32>,
    /// The greatest quantization error of a row.
    max_error: f64,
    max_half_norm: f64,
}

/// Rows that are compared with a query together.
#[derive(Clone, Copy)]
pub(crate) struct RowBlock<'a> {
    lines: &'a [CodeLine],
    scales: &'a [f32; BLOCK_ROWS],
    half_norms: &'a [f32; BLOCK_ROWS],
}

/// The product of each row of a block with a query.
pub(crate) type BlockProducts = [i32; BLOCK_ROWS];

/// A quantized query.
pub(crate) struct QuantizedQuery {
    /// Signed codes, as bytes.
    codes: Vec<u8>,
    scale: f32,
    /// What [`CODE_ZERO`] adds to a product with a stored row.
    excess: i32,
    half_norm: f64,
    error: f64,
}

impl QuantizedMatrix {
    /// Quantizes all rows of a matrix, on `threads` threads.
    pub(crate) fn new(level: SimdLevel, rows: &Matrix, threads: usize) -> Self {
        let steps = rows.dimension().div_ceil(4).max(1);
        let blocks = rows.len().div_ceil(BLOCK_ROWS);
        let centre = mean(rows);
        let mut lines = Vec::new();
        lines.reserve_exact(blocks * steps * 4);
        pages::advise_large(&mut lines);
        lines.resize(blocks * steps * 4, CodeLine([CODE_ZERO; 64]));
        let mut scales = vec![0.0; blocks * BLOCK_ROWS];
        let mut half_norms = vec![f32::NAN; blocks * BLOCK_ROWS];

        let share = blocks.div_ceil(threads.max(1)).max(1);
        let parts = lines
            .chunks_mut(share * steps * 4)
            .zip(scales.chunks_mut(share * BLOCK_ROWS))
            .zip(half_norms.chunks_mut(share * BLOCK_ROWS));
        let mut parts: Vec<BlockRange<'_>> = (0..)
            .step_by(share * BLOCK_ROWS)
            .zip(parts)
            .map(|(first_row, ((lines, scales), half_norms))| BlockRange {
                first_row,
                lines,
                scales,
                half_norms,
                max_error: 0.0,
                max_half_norm: 0.0,
            })
            .collect();
        let queue = Mutex::new(parts.iter_mut());
        let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
        crate::on_threads(threads, || {
            while let Some(part) = next() {
                part.fill(level, rows, &centre);
            }
        });
        let max_error = parts.iter().map(|part| part.max_error).fold(0.0, f64::max);
        let max_half_norm = parts.iter().map(|part| part.max_half_norm).fold(0.0, f64::max);
        Self { level, centre, steps, lines, scales, half_norms, max_error, max_half_norm }
    }

    /// Size in memory.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.lines.as_slice())
            + size_of_val(self.scales.as_slice())
            + size_of_val(self.half_norms.as_slice())
    }

    /// Number of blocks.
    pub(crate) fn blocks(&self) -> usize {
        self.scales.len() / BLOCK_ROWS
    }

    /// The rows from `BLOCK_ROWS * block` on.
    pub(crate) fn block(&self, block: usize) -> RowBlock<'_> {
        let lines = self.steps * 4;
        RowBlock {
            lines: &self.lines[block * lines..(block + 1) * lines],
            scales: &self.scales.as_chunks().0[block],
            half_norms: &self.half_norms.as_chunks().0[block],
        }
    }

    /// Quantizes a query.
    pub(crate) fn query(&self, vector: &[f32]) -> QuantizedQuery {
        let mut codes = vec![CODE_ZERO; self.steps * 4];
        let QuantizedVector { scale, half_norm, error, code_sum } =
            kernels::quantize(self.level, vector, &self.centre, &mut codes);
        codes.iter_mut().for_each(|code| *code = code.wrapping_sub(CODE_ZERO));
        QuantizedQuery { codes, scale, excess: i32::from(CODE_ZERO) * code_sum, half_norm, error }
    }

    /// The threshold that rules rows out: no row of original distance `limit` or less, as [`crate::distance`] computes
    /// it, fails the comparison
    ///
    /// ```text
    /// product * scale(x) * scale(q) + threshold >= half_norm(x)
    /// ```
    ///
    /// in single precision and in any order of operations.
    ///
    /// With `reach = sqrt(2 * limit)`, the module's bound rules `x` out when `|q' - x'| > reach + e(q) + e(x)`. Half the
    /// square of the left side is `half_norm(q) + half_norm(x) - scale(q) * scale(x) * product`. Rounding is
    /// allowed for twice. A computed distance of n numbers is off by less than `(n / 16 + 10) * 2^-24` of itself,
    /// since all of its terms are positive: the reach grows by that. The left side of the comparison rounds at most
    /// five times, values no greater than `|q'| * |x'|`, the threshold and `half_norm(x)`: the threshold grows by
    /// 2^-20 of their sum, three times the greatest possible error.
    pub(crate) fn threshold(&self, query: &QuantizedQuery, limit: f32) -> f32 {
        if limit == f32::INFINITY {
            return f32::INFINITY;
        }
        let rounding = (self.centre.len() as f64 / 16.0 + 10.0) * 2.0_f64.powi(-24);
        let half_square = f64::from(limit) / (1.0 - rounding) + f64::from(f32::MIN_POSITIVE);
        let reach = (2.0 * half_square).sqrt() + query.error + self.max_error;
        let threshold = 0.5 * reach * reach - query.half_norm;
        let product = 2.0 * (query.half_norm * self.max_half_norm).sqrt();
        let slack = (product + threshold.abs() + self.max_half_norm) * 2.0_f64.powi(-20);
        ((threshold + slack) as f32).next_up()
    }
}

impl RowBlock<'_> {
    /// Writes the products of all rows with each of several queries.
    pub(crate) fn multiply<const QUERIES: usize>(
        self,
        level: SimdLevel,
        queries: [&QuantizedQuery; QUERIES],
        products: &mut [BlockProducts; QUERIES],
    ) {
        let codes = queries
            .map(|query| QueryCodes { steps: query.codes.as_chunks().0, excess: query.excess });
        kernels::dot_products(level, self.lines, codes, products);
    }

    /// Which rows reach a [threshold](QuantizedMatrix::threshold), one bit each.
    pub(crate) fn candidates(
        self,
        level: SimdLevel,
        query: &QuantizedQuery,
        products: &BlockProducts,
        threshold: f32,
    ) -> u64 {
        kernels::candidates(level, products, (self.scales, self.half_norms), query.scale, threshold)
    }

    /// How near each row seems: the greater, the smaller the distance of the quantized vectors. NaN past the last row.
    pub(crate) fn estimates(
        self,
        query: &QuantizedQuery,
        products: &BlockProducts,
    ) -> impl Iterator<Item = f32> {
        (0..BLOCK_ROWS).map(move |row| {
            products[row] as f32 * self.scales[row] * query.scale - self.half_norms[row]
        })
    }
}

/// The blocks that one thread fills.
struct BlockRange<'a> {
    first_row: usize,
    lines: &'a mut [CodeLine],
    scales: &'a mut [f32],
    half_norms: &'a mut [f32],
    max_error: f64,
    max_half_norm: f64,
}

impl BlockRange<'_> {
    fn fill(&mut self, level: SimdLevel, rows: &Matrix, centre: &[f32]) {
        let lines_per_block = self.lines.len() / (self.scales.len() / BLOCK_ROWS);
        let mut codes = vec![CODE_ZERO; lines_per_block];
        let end = rows.len().min(self.first_row + self.scales.len());
        for (at, row) in (self.first_row..end).enumerate() {
            let quantized = kernels::quantize(level, rows.vector(row), centre, &mut codes);
            let (block, place) = (at / BLOCK_ROWS, at % BLOCK_ROWS);
            let lines = &mut self.lines[block * lines_per_block..][..lines_per_block];
            for (lines, codes) in lines.chunks_exact_mut(4).zip(codes.as_chunks::<4>().0) {
                lines[place / 16].0[place % 16 * 4..][..4].copy_from_slice(codes);
            }
            (self.scales[at], self.half_norms[at]) = (quantized.scale, quantized.half_norm as f32);
            self.max_error = self.max_error.max(quantized.error);
            self.max_half_norm = self.max_half_norm.max(quantized.half_norm);
        }
    }
}

/// The mean of a sample of the rows.
fn mean(rows: &Matrix) -> Vec<f32> {
    let step = rows.len().div_ceil(CENTRE_SAMPLE).max(1);
    let mut sums = vec![0.0_f64; rows.dimension()];
    let sample = (0..rows.len()).step_by(step);
    let count = sample.len().max(1) as f64;
    for row in sample {
        for (sum, &x) in sums.iter_mut().zip(rows.vector(row)) {
            *sum += f64::from(x);
        }
    }
    sums.into_iter().map(|sum| (sum / count) as f32).collect()
}

impl std::fmt::Debug for QuantizedMatrix {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "QuantizedMatrix({} blocks)", self.blocks())
    }
}
