//! Vectors at a byte a number, and how far at most that is from the truth.
//!
//! A vector `x` is stored as `centre + scale * code`: the codes are whole numbers from -127 to 127, the scale is the
//! vector's own, the centre is one point for all. What is lost, `|x - (centre + scale * code)|`, is measured
//! for every vector when it is coded. Write `x'` for what a code stands for, `e` for what was lost. For a query `q` and
//! any stored `x`, by the triangle inequality,
//!
//! ```text
//! |q - x| >= |q' - x'| - e(q) - e(x)
//! ```
//!
//! and `|q' - x'|` is known from a product of whole numbers, which has no rounding. So where the right-hand side
//! exceeds the distance of a vector that was already found, `x` is farther than it, and needs no look at
//! its numbers in full. Nothing is assumed about the data: where the bound is of no use, everything is looked at.

use bytemuck::{Pod, Zeroable};

use super::kernel::{self, Level};
use super::rows::Rows;

/// Codes in a cache line.
pub(super) const CODES: usize = 64;

/// Rows that are sifted together.
pub(super) const GROUP: usize = 64;

/// Added to a row's codes, for the instructions that multiply codes want one side without a sign.
const BIAS: i32 = 128;

/// Greatest code.
const MOST: f64 = 127.0;

/// The centre is the mean of at most so many rows. Any point will do.
const SAMPLED: usize = 4096;

/// Bytes behind the codes of a record.
pub(super) const RECORD_TAIL: usize = 8;

/// A cache line of codes.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct CodeLine(pub(super) [u8; CODES]);

/// Rows as codes.
pub(super) struct Codes {
    level: Level,
    centre: Vec<f32>,
    /// Cache lines that a row takes.
    stride: usize,
    lines: Vec<CodeLine>,
    scales: Vec<f32>,
    /// Half the squared length of what each row's code stands for, less the centre; no number where a last
    /// group has no row.
    halves: Vec<f32>,
    /// The most that was lost of a row.
    loss: f64,
    /// The greatest of `halves`.
    half: f64,
}

/// Some rows that are sifted together.
#[derive(Clone, Copy)]
pub(super) struct Group<'a> {
    /// Their codes, plus 128.
    pub(super) lines: &'a [CodeLine],
    pub(super) scales: &'a [f32; GROUP],
    pub(super) halves: &'a [f32; GROUP],
}

/// A query as codes.
pub(super) struct Coded {
    /// Signed codes.
    pub(super) lines: Vec<CodeLine>,
    pub(super) scale: f32,
    /// To be taken from a product of its codes with a row's, since the row's are biased.
    pub(super) bias: i32,
    half: f64,
    loss: f64,
}

/// Queries whose codes are multiplied together.
pub(super) const PANEL: usize = 64;

/// Several queries' codes as the instructions want them that multiply tiles. Where there are fewer than
/// [`PANEL`], the rest is zero.
pub(super) struct Panel {
    /// For each cache line of a query, for each 16 queries, 16 lines: four codes of each of the 16.
    pub(super) lines: Vec<CodeLine>,
    pub(super) scales: [f32; PANEL],
    pub(super) biases: [i32; PANEL],
}

impl Panel {
    /// Of at most [`PANEL`] queries.
    pub(super) fn of<'a>(queries: impl Iterator<Item = &'a Coded> + Clone) -> Self {
        let stride = queries.clone().next().map_or(0, |query| query.lines.len());
        let mut lines = vec![CodeLine([0; CODES]); stride * PANEL];
        let (mut scales, mut biases) = ([0.0; PANEL], [0; PANEL]);
        for (at, query) in queries.take(PANEL).enumerate() {
            (scales[at], biases[at]) = (query.scale, query.bias);
            for (step, line) in query.lines.iter().enumerate() {
                let tile = &mut lines[step * PANEL + at / 16 * 16..][..16];
                for (tile, codes) in tile.iter_mut().zip(line.0.as_chunks::<4>().0) {
                    tile.0[at % 16 * 4..][..4].copy_from_slice(codes);
                }
            }
        }
        Self { lines, scales, biases }
    }
}

/// What belongs to a vector's codes.
pub(super) struct Code {
    scale: f32,
    /// Half the squared length of what the code stands for.
    half: f64,
    /// The length of what was lost.
    loss: f64,
    /// Sum of the codes.
    sum: i32,
}

impl Codes {
    /// Codes of all `rows`, made by `threads` threads.
    pub(super) fn of(level: Level, rows: &Rows, threads: usize) -> Self {
        let stride = rows.dimension().div_ceil(CODES).max(1);
        let groups = rows.len().div_ceil(GROUP);
        let centre = centre(rows);
        let mut codes = Self {
            level,
            centre,
            stride,
            lines: Vec::new(),
            scales: vec![0.0; groups * GROUP],
            halves: vec![f32::NAN; groups * GROUP],
            loss: 0.0,
            half: 0.0,
        };
        codes.lines.reserve_exact(groups * GROUP * stride);
        kernel::prefer_large_pages(&mut codes.lines);
        codes.lines.resize(groups * GROUP * stride, CodeLine([BIAS as u8; CODES]));

        let share = groups.div_ceil(threads.max(1)).max(1) * GROUP;
        let parts = codes.lines.chunks_mut(share * stride);
        let parts = parts.zip(codes.scales.chunks_mut(share)).zip(codes.halves.chunks_mut(share));
        let parts = (0..).step_by(share).zip(parts);
        let centre = &codes.centre;
        let work = |(first, ((lines, scales), halves)): (usize, _)| {
            pack(level, rows, first, centre, lines, scales, halves)
        };
        let extremes = if threads <= 1 || groups <= 1 {
            parts.map(work).collect()
        } else {
            std::thread::scope(|scope| {
                let threads: Vec<_> = parts.map(|part| scope.spawn(move || work(part))).collect();
                let join = |thread: std::thread::ScopedJoinHandle<'_, _>| match thread.join() {
                    Ok(extremes) => extremes,
                    Err(panic) => std::panic::resume_unwind(panic),
                };
                threads.into_iter().map(join).collect::<Vec<_>>()
            })
        };
        for (loss, half) in extremes {
            codes.loss = codes.loss.max(loss);
            codes.half = codes.half.max(half);
        }
        codes
    }

    /// Bytes that they take.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.lines.as_slice())
            + size_of_val(self.scales.as_slice())
            + size_of_val(self.halves.as_slice())
    }

    /// How many groups there are.
    pub(super) fn groups(&self) -> usize {
        self.scales.len() / GROUP
    }

    /// The rows from `64 * group` on.
    pub(super) fn group(&self, group: usize) -> Group<'_> {
        let lines = self.stride * GROUP;
        Group {
            lines: &self.lines[group * lines..(group + 1) * lines],
            scales: &self.scales.as_chunks().0[group],
            halves: &self.halves.as_chunks().0[group],
        }
    }

    /// A query's codes.
    pub(super) fn query(&self, vector: &[f32]) -> Coded {
        let mut lines = vec![CodeLine([BIAS as u8; CODES]); self.stride];
        let bytes = bytemuck::cast_slice_mut(&mut lines);
        let Code { scale, half, loss, sum } = kernel::code(self.level, vector, &self.centre, bytes);
        // From codes plus 128 to codes with a sign.
        bytes.iter_mut().for_each(|byte| *byte ^= BIAS as u8);
        Coded { lines, scale, bias: BIAS * sum, half, loss }
    }

    /// Bytes of a [record](Self::record).
    pub(super) fn record_bytes(&self) -> usize {
        self.stride * CODES + RECORD_TAIL
    }

    /// A row's codes plus 128, then its scale and half squared length.
    pub(super) fn record(&self, row: usize, record: &mut Vec<u8>) {
        record.clear();
        record.extend_from_slice(bytemuck::cast_slice(
            &self.lines[row * self.stride..][..self.stride],
        ));
        record.extend(self.scales[row].to_ne_bytes());
        record.extend(self.halves[row].to_ne_bytes());
    }

    /// The same of a query.
    pub(super) fn query_record(&self, vector: &[f32]) -> Vec<u8> {
        let mut record = vec![BIAS as u8; self.record_bytes()];
        let (codes, tail) = record.split_at_mut(self.stride * CODES);
        let Code { scale, half, .. } = kernel::code(self.level, vector, &self.centre, codes);
        tail[..4].copy_from_slice(&scale.to_ne_bytes());
        tail[4..].copy_from_slice(&(half as f32).to_ne_bytes());
        record
    }

    /// What decides whether a row could be as near to `query` as `limit`, a distance as
    /// [`crate::distance`] computes it: it cannot be unless
    ///
    /// ```text
    /// scale(x) * (product of the codes) * scale(q) + bar >= half(x)
    /// ```
    ///
    /// computed in single precision, in any order.
    ///
    /// From the bound above, with `reach = sqrt(2 * limit)`: `x` is out when `|q' - x'| > reach + e(q) + e(x)`. Half the square of the
    /// left side is `half(q) + half(x) - scale(q) * scale(x) * product`. Two roundings are paid for. A distance
    /// that is computed from n numbers is off by less than `(n / 16 + 10) * 2^-24` of itself, all of its terms being
    /// positive: the reach grows by that. The left side of the test makes at most five roundings of values no
    /// greater than `|q'| * |x'|`, `bar` and `half(x)`: the bar grows by 2^-20 of their sum, three times
    /// what they can amount to.
    pub(super) fn bar(&self, query: &Coded, limit: f32) -> f32 {
        if limit == f32::INFINITY {
            return f32::INFINITY;
        }
        let rounding = (self.centre.len() as f64 / 16.0 + 10.0) * 2.0_f64.powi(-24);
        let half_square = f64::from(limit) / (1.0 - rounding) + f64::from(f32::MIN_POSITIVE);
        let reach = (2.0 * half_square).sqrt() + query.loss + self.loss;
        let bar = 0.5 * reach * reach - query.half;
        let product = 2.0 * (query.half * self.half).sqrt();
        let slack = (product + bar.abs() + self.half) * 2.0_f64.powi(-20);
        ((bar + slack) as f32).next_up()
    }
}

/// The mean of a sample of the rows.
fn centre(rows: &Rows) -> Vec<f32> {
    let step = rows.len().div_ceil(SAMPLED).max(1);
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

/// Codes the rows from `first` on that the slices have room for. Returns the greatest loss and the greatest half
/// squared length.
fn pack(
    level: Level,
    rows: &Rows,
    first: usize,
    centre: &[f32],
    lines: &mut [CodeLine],
    scales: &mut [f32],
    halves: &mut [f32],
) -> (f64, f64) {
    let stride = centre.len().div_ceil(CODES).max(1);
    let mut most = (0.0_f64, 0.0_f64);
    let slots = lines.chunks_exact_mut(stride).zip(scales).zip(halves);
    for (row, ((lines, scale), half)) in (first..rows.len()).zip(slots) {
        let bytes = bytemuck::cast_slice_mut(lines);
        let code = kernel::code(level, rows.vector(row), centre, bytes);
        (*scale, *half) = (code.scale, code.half as f32);
        most = (most.0.max(code.loss), most.1.max(code.half));
    }
    most
}

/// Writes the codes of a vector, plus 128; the rest of `codes` is for zeros.
///
/// The sums are kept in eight parts, so that vector instructions can make them.
#[inline(always)]
pub(super) fn code(vector: &[f32], centre: &[f32], codes: &mut [u8]) -> Code {
    /// Added to a number below 2^22, leaves its nearest whole number in the last bits.
    const ROUND: f32 = 12_582_912.0;
    const PARTS: usize = 8;
    let (codes, _) = codes.split_at_mut(vector.len());
    let mut greatest = [0.0_f32; 2 * PARTS];
    let (chunks, rest) = vector.as_chunks::<{ 2 * PARTS }>();
    let (centres, centres_rest) = centre.as_chunks::<{ 2 * PARTS }>();
    for (vector, centre) in chunks.iter().zip(centres) {
        for part in 0..2 * PARTS {
            let size = (vector[part] - centre[part]).abs();
            greatest[part] = if size > greatest[part] { size } else { greatest[part] };
        }
    }
    for (x, c) in rest.iter().zip(centres_rest) {
        greatest[0] = greatest[0].max((x - c).abs());
    }
    let greatest = greatest.into_iter().fold(0.0, f32::max);
    let scale = (f64::from(greatest) / MOST) as f32;
    // A scale so small that its inverse is not finite: what is lost is the whole, and is measured as that.
    let inverse = Some(1.0 / scale).filter(|inverse| inverse.is_finite()).unwrap_or(0.0);

    let mut sums = Sums { lost: [0.0; PARTS], squares: [0; PARTS], sum: [0; PARTS] };
    let (chunks, rest) = vector.as_chunks::<PARTS>();
    let (centres, centres_rest) = centre.as_chunks::<PARTS>();
    let (places, places_rest) = codes.as_chunks_mut::<PARTS>();
    let mut each = |x: f32, c: f32, place: &mut u8, part: usize| {
        let code = ((x - c) * inverse + ROUND).to_bits().wrapping_sub(ROUND.to_bits()) as i32;
        let missing = f64::from(x) - f64::from(c) - f64::from(scale) * f64::from(code);
        sums.lost[part] += missing * missing;
        sums.squares[part] = sums.squares[part].wrapping_add(code.wrapping_mul(code));
        sums.sum[part] = sums.sum[part].wrapping_add(code);
        *place = code.wrapping_add(BIAS) as u8;
    };
    for ((vector, centre), places) in chunks.iter().zip(centres).zip(places) {
        for part in 0..PARTS {
            each(vector[part], centre[part], &mut places[part], part);
        }
    }
    for ((&x, &c), place) in rest.iter().zip(centres_rest).zip(places_rest) {
        each(x, c, place, 0);
    }
    let squares: i64 = sums.squares.into_iter().map(i64::from).sum();
    let half = 0.5 * f64::from(scale) * f64::from(scale) * squares as f64;
    let lost: f64 = sums.lost.into_iter().sum();
    // A part in 10^9 is more than the roundings of these sums amount to.
    let loss = lost.sqrt() * (1.0 + 1e-9);
    Code { scale, half, loss, sum: sums.sum.into_iter().sum() }
}

/// Sums over a vector's codes, in parts.
struct Sums<const PARTS: usize> {
    lost: [f64; PARTS],
    squares: [i32; PARTS],
    sum: [i32; PARTS],
}

impl std::fmt::Debug for Codes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Codes({} groups)", self.groups())
    }
}
