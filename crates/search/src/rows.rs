//! Vectors of one dimension, one behind the other in memory that vector instructions like to read.

use std::fmt;

use bytemuck::{Pod, Zeroable};

/// Numbers in a cache line.
const LANES: usize = 16;

/// A cache line of numbers.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Line(pub(super) [f32; LANES]);

/// Vectors, each padded with zeros to whole cache lines. Zeros in two vectors add nothing to their distance,
/// to the last bit.
#[derive(Clone, Default)]
pub(super) struct Rows {
    dimension: usize,
    lines: Vec<Line>,
}

impl fmt::Debug for Rows {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { dimension, .. } = self;
        write!(f, "Rows({} of {dimension})", self.len())
    }
}

impl Rows {
    /// Room for `rows` vectors of `dimension`.
    pub(super) fn with_capacity(dimension: usize, rows: usize) -> Self {
        let mut lines = Vec::new();
        lines.reserve_exact(rows * dimension.div_ceil(LANES));
        super::kernel::prefer_large_pages(&mut lines);
        Self { dimension, lines }
    }

    /// Adds a vector; the first one decides the dimension where there is none yet.
    ///
    /// # Panics
    /// When it is of another dimension than the others.
    pub(super) fn push(&mut self, vector: &[f32]) {
        if self.lines.is_empty() {
            self.dimension = vector.len();
        }
        assert_eq!(vector.len(), self.dimension, "embeddings of two encoders in one index");
        self.lines.extend(pad(vector));
    }

    /// How many numbers a vector has.
    pub(super) fn dimension(&self) -> usize {
        self.dimension
    }

    /// Cache lines that a vector takes.
    pub(super) fn stride(&self) -> usize {
        self.dimension.div_ceil(LANES)
    }

    /// How many vectors there are.
    pub(super) fn len(&self) -> usize {
        self.lines.len().checked_div(self.stride()).unwrap_or(0)
    }

    /// Bytes that they take.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.lines.as_slice())
    }

    /// The lines of some vectors, one behind the other.
    pub(super) fn lines(&self, rows: std::ops::Range<usize>) -> &[Line] {
        &self.lines[rows.start * self.stride()..rows.end * self.stride()]
    }

    /// The lines of one vector.
    pub(super) fn row(&self, row: usize) -> &[Line] {
        self.lines(row..row + 1)
    }

    /// One vector, as it was added.
    pub(super) fn vector(&self, row: usize) -> &[f32] {
        &bytemuck::cast_slice(self.row(row))[..self.dimension]
    }
}

/// A vector as cache lines.
pub(super) fn pad(vector: &[f32]) -> impl Iterator<Item = Line> {
    vector.chunks(LANES).map(|chunk| {
        let mut line = Line([0.0; LANES]);
        line.0[..chunk.len()].copy_from_slice(chunk);
        line
    })
}
