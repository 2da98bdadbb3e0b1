//! Vectors of one dimension, row by row in cache-line-aligned memory.

use std::fmt;

use bytemuck::{Pod, Zeroable};

use crate::pages;

/// Numbers in a cache line.
const LINE_FLOATS: usize = 16;

/// A cache line of numbers.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
pub(crate) struct FloatLine(pub(crate) [f32; LINE_FLOATS]);

impl FloatLine {
    const ZERO: Self = Self([0.0; LINE_FLOATS]);
}

/// A cache line of codes.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
pub(crate) struct CodeLine(pub(crate) [u8; 64]);

/// Vectors, each padded with zeros to whole cache lines. The padding adds exactly zero to a distance.
#[derive(Clone, Default)]
pub(crate) struct Matrix {
    dimension: usize,
    lines: Vec<FloatLine>,
}

impl fmt::Debug for Matrix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Matrix({} x {})", self.len(), self.dimension)
    }
}

impl Matrix {
    /// An empty matrix with room for `rows` vectors of `dimension`.
    pub(crate) fn with_capacity(dimension: usize, rows: usize) -> Self {
        let mut lines = Vec::new();
        lines.reserve_exact(rows * dimension.div_ceil(LINE_FLOATS));
        pages::advise_large(&mut lines);
        Self { dimension, lines }
    }

    /// Appends a vector. The first vector sets the dimension.
    ///
    /// # Panics
    /// When the vector has another dimension than the others.
    pub(crate) fn push(&mut self, vector: &[f32]) {
        if self.lines.is_empty() {
            self.dimension = vector.len();
        }
        assert_eq!(vector.len(), self.dimension, "embeddings of two encoders in one index");
        let end = self.lines.len();
        self.lines.resize(end + self.stride(), FloatLine::ZERO);
        write_padded(vector, &mut self.lines[end..]);
    }

    /// Numbers in a vector.
    pub(crate) fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of vectors.
    pub(crate) fn len(&self) -> usize {
        self.lines.len().checked_div(self.stride()).unwrap_or(0)
    }

    /// Size in memory.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.lines.as_slice())
    }

    /// The cache lines of a range of rows.
    pub(crate) fn lines(&self, rows: std::ops::Range<usize>) -> &[FloatLine] {
        &self.lines[rows.start * self.stride()..rows.end * self.stride()]
    }

    /// The cache lines of one row.
    pub(crate) fn row(&self, row: usize) -> &[FloatLine] {
        self.lines(row..row + 1)
    }

    /// One vector without its padding.
    pub(crate) fn vector(&self, row: usize) -> &[f32] {
        &bytemuck::cast_slice(self.row(row))[..self.dimension]
    }

    /// Cache lines per row.
    fn stride(&self) -> usize {
        self.dimension.div_ceil(LINE_FLOATS)
    }
}

/// A vector as cache lines, padded with zeros.
pub(crate) fn padded(vector: &[f32]) -> Vec<FloatLine> {
    let mut lines = vec![FloatLine::ZERO; vector.len().div_ceil(LINE_FLOATS)];
    write_padded(vector, &mut lines);
    lines
}

fn write_padded(vector: &[f32], lines: &mut [FloatLine]) {
    bytemuck::cast_slice_mut(lines)[..vector.len()].copy_from_slice(vector);
}
