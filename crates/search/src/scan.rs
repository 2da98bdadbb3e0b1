//! Distances in the order of operations of [`crate::distance`], of one vector to many.
//!
//! Zeros at the end of two vectors change nothing: what they add to a partial sum, which is not negative, is zero.
//! The same source is compiled for wider instructions, too. No sum is contracted or reordered, so the bits are
//! the same.

use super::rows::Line;
use crate::embedding::{add_squares, half_total};

/// Writes the distance of `query` to each row of `rows`, which are as long as it is.
#[inline(always)]
pub(super) fn scan(query: &[Line], rows: &[Line], distances: &mut [f32]) {
    for (distance, row) in distances.iter_mut().zip(rows.chunks_exact(query.len())) {
        let mut sums = [0.0; 16];
        for (query, row) in query.iter().zip(row) {
            add_squares(&mut sums, &query.0, &row.0);
        }
        *distance = half_total(sums);
    }
}
