//! The kernels in portable Rust. The compiler also builds them for wider vector instructions.

use super::{BLOCK_ROWS, LINES_IN_STEP, QuantizedVector, QueryCodes};
use crate::embedding::{add_squares, half_total};
use crate::matrix::{CodeLine, FloatLine};

/// Zero as a stored code: codes are stored with this added, because the instructions that multiply them take one
/// unsigned operand.
pub(crate) const CODE_ZERO: u8 = 128;

/// The largest code.
const CODE_MAX: f64 = 127.0;

/// Writes the distance of `query` to each row of `rows`, in the order of operations of [`crate::distance`].
#[inline(always)]
pub(super) fn distances(query: &[FloatLine], rows: &[FloatLine], distances: &mut [f32]) {
    for (distance, row) in distances.iter_mut().zip(rows.chunks_exact(query.len())) {
        let mut sums = [0.0; 16];
        for (query, row) in query.iter().zip(row) {
            add_squares(&mut sums, &query.0, &row.0);
        }
        *distance = half_total(sums);
    }
}

/// Writes, for each query, the products of its codes with those of each row of a block.
pub(super) fn dot_products<const QUERIES: usize>(
    block: &[CodeLine],
    queries: [QueryCodes<'_>; QUERIES],
    products: &mut [[i32; BLOCK_ROWS]; QUERIES],
) {
    for (query, products) in queries.into_iter().zip(products) {
        *products = [-query.excess; BLOCK_ROWS];
        for (lines, codes) in block.as_chunks::<LINES_IN_STEP>().0.iter().zip(query.steps) {
            let codes = codes.map(|code| i32::from(code as i8));
            for (products, line) in products.as_chunks_mut::<16>().0.iter_mut().zip(lines) {
                for (product, row) in products.iter_mut().zip(line.0.as_chunks::<4>().0) {
                    let row = row.map(i32::from);
                    let sum = row[0] * codes[0]
                        + row[1] * codes[1]
                        + row[2] * codes[2]
                        + row[3] * codes[3];
                    *product = product.wrapping_add(sum);
                }
            }
        }
    }
}

/// Which rows of a block reach the threshold, one bit each.
pub(super) fn candidates(
    products: &[i32; BLOCK_ROWS],
    scales: &[f32; BLOCK_ROWS],
    half_norms: &[f32; BLOCK_ROWS],
    query_scale: f32,
    threshold: f32,
) -> u64 {
    (0..BLOCK_ROWS).fold(0, |found, row| {
        let near = products[row] as f32 * scales[row] * query_scale + threshold;
        found | u64::from(near >= half_norms[row]) << row
    })
}

/// Quantizes a vector: writes one stored code for each number of it.
///
/// Sums are kept in eight parts, so that the compiler can vectorise them.
#[inline(always)]
pub(super) fn quantize(vector: &[f32], centre: &[f32], codes: &mut [u8]) -> QuantizedVector {
    /// Added to a number below 2^22, leaves the nearest whole number in the last bits.
    const ROUND: f32 = 12_582_912.0;
    const PARTS: usize = 8;
    let (codes, _) = codes.split_at_mut(vector.len());
    let scale = (f64::from(greatest_difference(vector, centre)) / CODE_MAX) as f32;
    // With a scale so small that its inverse is not finite, all codes are zero and the error is the whole vector.
    let inverse = Some(1.0 / scale).filter(|inverse| inverse.is_finite()).unwrap_or(0.0);

    let (mut errors, mut squares, mut sums) = ([0.0_f64; PARTS], [0_i32; PARTS], [0_i32; PARTS]);
    let (chunks, rest) = vector.as_chunks::<PARTS>();
    let (centres, centres_rest) = centre.as_chunks::<PARTS>();
    let (places, places_rest) = codes.as_chunks_mut::<PARTS>();
    let mut encode = |x: f32, c: f32, place: &mut u8, part: usize| {
        let code = ((x - c) * inverse + ROUND).to_bits().wrapping_sub(ROUND.to_bits()) as i32;
        let error = f64::from(x) - f64::from(c) - f64::from(scale) * f64::from(code);
        errors[part] += error * error;
        squares[part] = squares[part].wrapping_add(code.wrapping_mul(code));
        sums[part] = sums[part].wrapping_add(code);
        *place = code.wrapping_add(i32::from(CODE_ZERO)) as u8;
    };
    for ((vector, centre), places) in chunks.iter().zip(centres).zip(places) {
        for part in 0..PARTS {
            encode(vector[part], centre[part], &mut places[part], part);
        }
    }
    for ((&x, &c), place) in rest.iter().zip(centres_rest).zip(places_rest) {
        encode(x, c, place, 0);
    }
    let squares: i64 = squares.into_iter().map(i64::from).sum();
    let error: f64 = errors.into_iter().sum();
    QuantizedVector {
        scale,
        half_norm: 0.5 * f64::from(scale) * f64::from(scale) * squares as f64,
        // One part in 10^9 is more than the rounding errors of these sums.
        error: error.sqrt() * (1.0 + 1e-9),
        code_sum: sums.into_iter().sum(),
    }
}

/// The greatest absolute difference between two vectors' numbers.
#[inline(always)]
fn greatest_difference(vector: &[f32], centre: &[f32]) -> f32 {
    const PARTS: usize = 16;
    let mut greatest = [0.0_f32; PARTS];
    let (chunks, rest) = vector.as_chunks::<PARTS>();
    let (centres, centres_rest) = centre.as_chunks::<PARTS>();
    for (vector, centre) in chunks.iter().zip(centres) {
        for part in 0..PARTS {
            let size = (vector[part] - centre[part]).abs();
            greatest[part] = if size > greatest[part] { size } else { greatest[part] };
        }
    }
    for (x, c) in rest.iter().zip(centres_rest) {
        greatest[0] = greatest[0].max((x - c).abs());
    }
    greatest.into_iter().fold(0.0, f32::max)
}
