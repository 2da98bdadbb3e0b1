//! Matrix products on the tile unit of x86-64 processors (AMX), at very nearly the precision of 32-bit floats.
//!
//! The unit multiplies 16-bit floats (bf16, 8 bits of significand) and sums up in 32 bits, many times as fast as
//! vector instructions multiply 32-bit ones. A 32-bit float is taken apart into the 16-bit one nearest to it and
//! the one nearest to what is left: `x = h + l` up to 2^-17 of `x`. Of the product `(h + l) (h' + l')` three
//! parts are computed, and `l l'`, which is as small as what was lost before, is left out. (Henry, Tang and
//! Heinecke, "Leveraging the bfloat16 Artificial Intelligence Datatype For Higher-Precision Computations", 2019.)
//!
//! Sums are formed in one fixed order that depends on the matrices' sizes alone, so equal inputs give equal bits.
//!
//! A tile is 16 rows of 64 bytes: 16 x 32 numbers of the left matrix; of the right one 32 x 16, of which two in a
//! column lie side by side, as the unit wants them; 16 x 16 sums. Tiles are laid out in memory in the order in which
//! they are used.

#![expect(unsafe_code, reason = "the tile unit has no safe interface")]

use std::sync::OnceLock;

/// Numbers in a row of a tile: the least that the inner length of a product can be divided by.
const STEP: usize = 32;

/// Rows of a tile.
const TILE_ROWS: usize = 16;

/// Rows and columns of the result that are computed at a time, as 2 x 2 tiles.
const BLOCK: usize = 2 * TILE_ROWS;

/// Rows of tiles in a step of a block: two tiles of high halves, two of low ones.
const STEP_ROWS: usize = 4 * TILE_ROWS;

/// A row of a tile.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
struct Row([u16; STEP]);

const NOTHING: Row = Row([0; STEP]);

/// That the processor has the unit and the system lets this process use it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TileUnit(());

impl TileUnit {
    /// Asks the system for the unit, once.
    pub(super) fn get() -> Option<Self> {
        static FOUND: OnceLock<Option<TileUnit>> = OnceLock::new();
        *FOUND.get_or_init(|| machine::is_there().then_some(Self(())))
    }
}

/// The right matrix of products, taken apart and laid out.
pub(super) struct Weights {
    /// By column block, then step.
    rows: Vec<Row>,
    inner: usize,
    columns: usize,
}

impl Weights {
    /// Whether a matrix of this shape can be used.
    pub(super) fn fits(inner: usize, columns: usize) -> bool {
        inner > 0 && columns > 0 && inner.is_multiple_of(STEP) && columns.is_multiple_of(BLOCK)
    }

    /// Of a matrix of `inner` rows that follow each other; `None` when it does not fit.
    pub(super) fn new(matrix: &[f32], inner: usize, columns: usize) -> Option<Self> {
        if !Self::fits(inner, columns) || matrix.len() != inner * columns {
            return None;
        }
        let mut rows = vec![NOTHING; inner / STEP * (columns / BLOCK) * STEP_ROWS];
        for (index, &value) in matrix.iter().enumerate() {
            let (row, column) = (index / columns, index % columns);
            let step = column / BLOCK * (inner / STEP) + row / STEP;
            let tile = column % BLOCK / TILE_ROWS;
            let place = step * STEP_ROWS + tile * TILE_ROWS + row % STEP / 2;
            let within = 2 * (column % TILE_ROWS) + row % 2;
            let (high, low) = split(value);
            rows[place].0[within] = high;
            rows[place + 2 * TILE_ROWS].0[within] = low;
        }
        Some(Self { rows, inner, columns })
    }

    /// Numbers in a row of the left matrix.
    pub(super) fn inner(&self) -> usize {
        self.inner
    }

    /// Numbers in a row of the result.
    pub(super) fn columns(&self) -> usize {
        self.columns
    }
}

/// Multiplies, with memory that is used again.
pub(super) struct Multiplier {
    unit: TileUnit,
    left: Vec<Row>,
}

impl Multiplier {
    pub(super) fn new(unit: TileUnit) -> Self {
        Self { unit, left: Vec::new() }
    }

    /// Writes `left` times `weights` to `result`, both as rows that follow each other.
    ///
    /// # Panics
    /// When the lengths are not those of as many rows.
    pub(super) fn multiply(&mut self, left: &[f32], weights: &Weights, result: &mut [f32]) {
        let rows = left.len() / weights.inner;
        assert_eq!(left.len(), rows * weights.inner, "whole rows");
        assert_eq!(result.len(), rows * weights.columns, "as many rows");
        let blocks = rows.div_ceil(BLOCK);
        self.left.resize(blocks * (weights.inner / STEP) * STEP_ROWS, NOTHING);
        machine::lay_out(self.unit, left, weights.inner, &mut self.left);
        machine::multiply(self.unit, &self.left, weights, rows, result);
    }
}

/// The two 16-bit floats that a 32-bit one is taken apart into.
#[inline]
fn split(value: f32) -> (u16, u16) {
    // To the nearest, ties to the even one.
    let rounded = |bits: u32| (bits.wrapping_add(0x7fff + ((bits >> 16) & 1)) >> 16) as u16;
    let high = rounded(value.to_bits());
    (high, rounded((value - f32::from_bits(u32::from(high) << 16)).to_bits()))
}

/// Lays out the left matrix, of `inner` numbers a row, by row block and step. What is missing in the last block is 0.
#[inline]
fn lay_out(left: &[f32], inner: usize, tiles: &mut [Row]) {
    let steps = inner / STEP;
    for (block, tiles) in tiles.chunks_exact_mut(steps * STEP_ROWS).enumerate() {
        for row in 0..BLOCK {
            let source = left.get((block * BLOCK + row) * inner..).unwrap_or_default();
            let source = source.as_chunks::<STEP>().0;
            for (step, tiles) in tiles.chunks_exact_mut(STEP_ROWS).enumerate() {
                let (mut high, mut low) = (NOTHING, NOTHING);
                if let Some(values) = source.get(step) {
                    let halves = high.0.iter_mut().zip(&mut low.0);
                    for (&value, (high, low)) in values.iter().zip(halves) {
                        (*high, *low) = split(value);
                    }
                }
                tiles[row] = high;
                tiles[2 * TILE_ROWS + row] = low;
            }
        }
    }
}

#[cfg(all(target_arch = "x86_64", target_os = "linux"))]
mod machine {
    use std::arch::asm;

    use super::{BLOCK, Row, STEP, STEP_ROWS, TILE_ROWS, TileUnit, Weights};

    /// From the kernel's `asm/prctl.h`: asks that a process may use a part of the processor's state.
    const ARCH_REQ_XCOMP_PERM: libc::c_long = 0x1023;

    /// The tiles' number among those parts.
    const XTILEDATA: libc::c_long = 18;

    /// The unit's settings: 8 tiles of 16 rows of 64 bytes.
    #[repr(C, align(64))]
    struct Settings {
        palette: u8,
        start_row: u8,
        reserved: [u8; 14],
        row_bytes: [u16; 16],
        rows: [u8; 16],
    }

    static SETTINGS: Settings = Settings {
        palette: 1,
        start_row: 0,
        reserved: [0; 14],
        row_bytes: [64, 64, 64, 64, 64, 64, 64, 64, 0, 0, 0, 0, 0, 0, 0, 0],
        rows: [16, 16, 16, 16, 16, 16, 16, 16, 0, 0, 0, 0, 0, 0, 0, 0],
    };

    pub(super) fn is_there() -> bool {
        // The system's word, not the processor's: only it knows what it saves when threads take turns.
        let flags = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let line = flags.lines().find(|line| line.starts_with("flags"));
        let has = |name| line.is_some_and(|line| line.split_whitespace().any(|flag| flag == name));
        let all = has("amx_tile") && has("amx_bf16");
        let vectors = std::is_x86_feature_detected!("avx512f")
            && std::is_x86_feature_detected!("avx512bw")
            && std::is_x86_feature_detected!("avx512vl");
        // SAFETY: the call takes two numbers and no pointer; all it changes is what this process may do.
        all && vectors
            && unsafe { libc::syscall(libc::SYS_arch_prctl, ARCH_REQ_XCOMP_PERM, XTILEDATA) } == 0
    }

    pub(super) fn lay_out(_: TileUnit, left: &[f32], inner: usize, tiles: &mut [Row]) {
        #[target_feature(enable = "avx512f,avx512bw,avx512vl")]
        fn with_vectors(left: &[f32], inner: usize, tiles: &mut [Row]) {
            super::lay_out(left, inner, tiles);
        }
        // SAFETY: who has a TileUnit is on a processor with these instructions, see `is_there`.
        unsafe { with_vectors(left, inner, tiles) }
    }

    pub(super) fn multiply(
        _: TileUnit,
        left: &[Row],
        weights: &Weights,
        rows: usize,
        result: &mut [f32],
    ) {
        let steps = weights.inner / STEP;
        // What the kernel reads and writes has these lengths, or it must not be called.
        assert_eq!(weights.rows.len(), weights.columns / BLOCK * steps * STEP_ROWS);
        assert_eq!(left.len(), rows.div_ceil(BLOCK) * steps * STEP_ROWS);
        assert!(steps > 0 && result.len() == rows * weights.columns);
        // SAFETY: who has a TileUnit may use the unit. The settings are a valid constant, and 64 bytes long.
        unsafe { asm!("ldtilecfg [{}]", in(reg) &raw const SETTINGS, options(nostack, readonly)) };
        let mut last = [0.0_f32; BLOCK * BLOCK];
        for (panel, right) in weights.rows.chunks_exact(steps * STEP_ROWS).enumerate() {
            for (block, left) in left.chunks_exact(steps * STEP_ROWS).enumerate() {
                let (first, here) = (block * BLOCK, (rows - block * BLOCK).min(BLOCK));
                let target = first * weights.columns + panel * BLOCK;
                if here == BLOCK {
                    // SAFETY: the tiles are set up. `left` and `right` are `steps` steps long. The block lies within
                    // the result: BLOCK rows from row `first` on, BLOCK columns of a panel.
                    unsafe {
                        let target = result.as_mut_ptr().add(target);
                        whole_block(left.as_ptr(), right.as_ptr(), steps, target, weights.columns);
                    }
                    continue;
                }
                let (left, right, target_of_last) =
                    (left.as_ptr(), right.as_ptr(), last.as_mut_ptr());
                // SAFETY: as above, and `last` is a whole block.
                unsafe {
                    if here > TILE_ROWS {
                        whole_block(left, right, steps, target_of_last, BLOCK);
                    } else {
                        upper_half(left, right, steps, target_of_last, BLOCK);
                    }
                }
                for (row, sums) in last.chunks_exact(BLOCK).take(here).enumerate() {
                    result[target + row * weights.columns..][..BLOCK].copy_from_slice(sums);
                }
            }
        }
        // SAFETY: nothing in the tiles is needed any more. Without this, every change of threads would save them.
        unsafe { asm!("tilerelease", options(nostack, nomem)) };
    }

    /// 32 x 32 sums. The order is that in which no tile is loaded twice: high by low, high by high, low by high.
    ///
    /// # Safety
    /// The tiles are set up; `left` and `right` point to `steps` steps each, at least one; `sums` to 32 rows of 32
    /// numbers, `columns` numbers apart.
    unsafe fn whole_block(
        left: *const Row,
        right: *const Row,
        steps: usize,
        sums: *mut f32,
        columns: usize,
    ) {
        let between = columns * size_of::<f32>();
        // SAFETY: reads 4096 bytes of `left` and `right` each step and writes 32 rows of 128 bytes, as the caller has
        // promised. No other code of this program uses tiles.
        unsafe {
            asm!(
                "tilezero tmm0",
                "tilezero tmm1",
                "tilezero tmm2",
                "tilezero tmm3",
                "2:",
                "tileloadd tmm4, [{left} + {row}]",
                "tileloadd tmm6, [{right} + {row} + 2048]",
                "tdpbf16ps tmm0, tmm4, tmm6",
                "tileloadd tmm7, [{right} + {row} + 3072]",
                "tdpbf16ps tmm1, tmm4, tmm7",
                "tileloadd tmm5, [{left} + {row} + 1024]",
                "tdpbf16ps tmm2, tmm5, tmm6",
                "tileloadd tmm6, [{right} + {row}]",
                "tdpbf16ps tmm3, tmm5, tmm7",
                "tdpbf16ps tmm0, tmm4, tmm6",
                "tileloadd tmm7, [{right} + {row} + 1024]",
                "tdpbf16ps tmm1, tmm4, tmm7",
                "tileloadd tmm4, [{left} + {row} + 2048]",
                "tdpbf16ps tmm2, tmm5, tmm6",
                "tdpbf16ps tmm3, tmm5, tmm7",
                "tileloadd tmm5, [{left} + {row} + 3072]",
                "tdpbf16ps tmm0, tmm4, tmm6",
                "tdpbf16ps tmm1, tmm4, tmm7",
                "tdpbf16ps tmm2, tmm5, tmm6",
                "tdpbf16ps tmm3, tmm5, tmm7",
                "add {left}, 4096",
                "add {right}, 4096",
                "dec {steps}",
                "jnz 2b",
                "tilestored [{sums} + {between}], tmm0",
                "tilestored [{sums} + {between} + 64], tmm1",
                "add {sums}, {half}",
                "tilestored [{sums} + {between}], tmm2",
                "tilestored [{sums} + {between} + 64], tmm3",
                left = inout(reg) left => _,
                right = inout(reg) right => _,
                steps = inout(reg) steps => _,
                sums = inout(reg) sums => _,
                row = in(reg) size_of::<Row>(),
                between = in(reg) between,
                half = in(reg) TILE_ROWS * between,
                options(nostack),
            );
        }
    }

    /// The first 16 rows of [`whole_block`], bit for bit.
    ///
    /// # Safety
    /// As there.
    unsafe fn upper_half(
        left: *const Row,
        right: *const Row,
        steps: usize,
        sums: *mut f32,
        columns: usize,
    ) {
        // SAFETY: as in `whole_block`.
        unsafe {
            asm!(
                "tilezero tmm0",
                "tilezero tmm1",
                "2:",
                "tileloadd tmm4, [{left} + {row}]",
                "tileloadd tmm6, [{right} + {row} + 2048]",
                "tileloadd tmm7, [{right} + {row} + 3072]",
                "tdpbf16ps tmm0, tmm4, tmm6",
                "tdpbf16ps tmm1, tmm4, tmm7",
                "tileloadd tmm6, [{right} + {row}]",
                "tileloadd tmm7, [{right} + {row} + 1024]",
                "tdpbf16ps tmm0, tmm4, tmm6",
                "tdpbf16ps tmm1, tmm4, tmm7",
                "tileloadd tmm5, [{left} + {row} + 2048]",
                "tdpbf16ps tmm0, tmm5, tmm6",
                "tdpbf16ps tmm1, tmm5, tmm7",
                "add {left}, 4096",
                "add {right}, 4096",
                "dec {steps}",
                "jnz 2b",
                "tilestored [{sums} + {between}], tmm0",
                "tilestored [{sums} + {between} + 64], tmm1",
                left = inout(reg) left => _,
                right = inout(reg) right => _,
                steps = inout(reg) steps => _,
                sums = in(reg) sums,
                row = in(reg) size_of::<Row>(),
                between = in(reg) columns * size_of::<f32>(),
                options(nostack),
            );
        }
    }
}

/// Where there is no such unit, nobody has a [`TileUnit`], and nothing else of this is called.
#[cfg(not(all(target_arch = "x86_64", target_os = "linux")))]
mod machine {
    use super::{Row, TileUnit, Weights};

    pub(super) fn is_there() -> bool {
        false
    }

    pub(super) fn lay_out(_: TileUnit, left: &[f32], inner: usize, tiles: &mut [Row]) {
        super::lay_out(left, inner, tiles);
    }

    pub(super) fn multiply(_: TileUnit, _: &[Row], _: &Weights, _: usize, _: &mut [f32]) {
        unreachable!("there is no tile unit");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_float_is_nearly_the_sum_of_its_halves() {
        for value in [0.0, 1.0, -1.0, 0.1, -1e-3, 12_345.678, 1e20, f32::MIN_POSITIVE] {
            let (high, low) = split(value);
            let whole = |half: u16| f64::from(f32::from_bits(u32::from(half) << 16));
            let lost = (f64::from(value) - whole(high) - whole(low)).abs();
            assert!(lost <= f64::from(value).abs() / f64::from(1 << 16), "{value}: {lost}");
        }
    }

    #[test]
    fn only_what_divides_into_tiles_fits() {
        for (inner, columns, fits) in
            [(32, 32, true), (384, 1536, true), (16, 32, false), (32, 48, false), (0, 32, false)]
        {
            assert_eq!(Weights::fits(inner, columns), fits, "{inner} x {columns}");
            assert_eq!(Weights::new(&vec![1.0; inner * columns], inner, columns).is_some(), fits);
        }
        assert!(Weights::new(&[1.0; 5], 32, 32).is_none());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        /// Where the processor has no tile unit, this says nothing.
        #[test]
        fn a_product_is_that_of_32_bit_floats(
            (rows, steps, panels) in (1_usize..70, 1_usize..4, 1_usize..4),
            seed in any::<u32>(),
        ) {
            let Some(unit) = TileUnit::get() else { return Ok(()) };
            let (inner, columns) = (STEP * steps, BLOCK * panels);
            let mut state = seed;
            let mut number = || {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / (1 << 23) as f32 - 1.0
            };
            let left: Vec<f32> = (0..rows * inner).map(|_| number()).collect();
            let right: Vec<f32> = (0..inner * columns).map(|_| number()).collect();
            let weights = Weights::new(&right, inner, columns).unwrap();
            let mut result = vec![f32::NAN; rows * columns];
            let mut multiplier = Multiplier::new(unit);
            multiplier.multiply(&left, &weights, &mut result);
            for (index, &found) in result.iter().enumerate() {
                let (row, column) = (index / columns, index % columns);
                let pairs = (0..inner).map(|i| (left[row * inner + i], right[i * columns + column]));
                let exact: f64 = pairs.map(|(a, b)| f64::from(a) * f64::from(b)).sum();
                prop_assert!((f64::from(found) - exact).abs() < 1e-5 * (inner as f64).sqrt(), "{row} {column}");
            }
            // A row has the same bits whatever rows come with it.
            let mut alone = vec![0.0; columns];
            for row in [0, rows / 2, rows - 1] {
                multiplier.multiply(&left[row * inner..][..inner], &weights, &mut alone);
                let together = &result[row * columns..][..columns];
                prop_assert!(alone.iter().zip(together).all(|(a, b)| a.to_bits() == b.to_bits()));
            }
        }
    }
}
