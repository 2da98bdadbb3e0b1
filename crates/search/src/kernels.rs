//! The innermost loops, in the widest vector instructions that the processor has.
//!
//! Every kernel gives the same result at every level: the order of the sums of a distance is fixed, and products of
//! codes are whole numbers. Only the comparison in [`candidates`] may differ in its last bit, which the threshold
//! allows for ([`crate::quantized::QuantizedMatrix::threshold`]).

mod portable;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(crate) use portable::CODE_ZERO;

use crate::matrix::{CodeLine, FloatLine};

/// Rows in a block of codes.
///
/// A block is stored by steps of four codes: for each step four cache lines of 16 rows each, four codes of every
/// row side by side. One multiplication then serves 16 rows.
pub(crate) const BLOCK_ROWS: usize = 64;

/// Cache lines of a block for each step of four codes.
const LINES_IN_STEP: usize = BLOCK_ROWS / 16;

/// Queries that are multiplied together: their sums for a block fill half of AVX-512's registers, and each cache line is
/// loaded once for all of them.
pub(crate) const QUERIES_TOGETHER: usize = 4;

/// The figures of a vector that was quantized to `centre + scale * code`.
pub(crate) struct QuantizedVector {
    pub(crate) scale: f32,
    /// Half the squared length of `scale * code`.
    pub(crate) half_norm: f64,
    /// Length of the quantization error.
    pub(crate) error: f64,
    /// Sum of the codes.
    pub(crate) code_sum: i32,
}

/// The codes of a quantized query.
#[derive(Clone, Copy)]
pub(crate) struct QueryCodes<'a> {
    /// The signed codes as bytes, by steps of four; at least as many steps as a block has.
    pub(crate) steps: &'a [[u8; 4]],
    /// What [`CODE_ZERO`] adds to a product with a stored row.
    pub(crate) excess: i32,
}

/// A set of vector instructions that this processor has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct SimdLevel(Instructions);

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Instructions {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl SimdLevel {
    /// The widest level of this processor.
    pub(crate) fn best() -> Self {
        static BEST: std::sync::OnceLock<SimdLevel> = std::sync::OnceLock::new();
        *BEST.get_or_init(|| Self::all().into_iter().max().unwrap_or(Self(Instructions::Portable)))
    }

    /// All levels of this processor. No other function makes a level, so a level proves that its instructions exist.
    pub(crate) fn all() -> Vec<Self> {
        let mut all = vec![Self(Instructions::Portable)];
        #[cfg(target_arch = "x86_64")]
        {
            if x86::has_avx2() {
                all.push(Self(Instructions::Avx2));
            }
            if x86::has_avx512() {
                all.push(Self(Instructions::Avx512));
            }
        }
        all
    }
}

/// Calls the kernel of a level. The arguments are evaluated once.
macro_rules! dispatch {
    ($level:expr, $portable:expr, $avx2:expr, $avx512:expr $(,)?) => {
        match $level.0 {
            Instructions::Portable => $portable,
            #[cfg(target_arch = "x86_64")]
            #[expect(unsafe_code, reason = "calls a function compiled for AVX2")]
            // SAFETY: `Level::all` makes this level only where the processor has AVX2.
            Instructions::Avx2 => unsafe { $avx2 },
            #[cfg(target_arch = "x86_64")]
            #[expect(unsafe_code, reason = "calls a function compiled for AVX-512")]
            // SAFETY: `Level::all` makes this level only where the processor has the AVX-512 subsets used here.
            Instructions::Avx512 => unsafe { $avx512 },
        }
    };
}

/// Writes the distance of `query` to each of the rows.
pub(crate) fn distances(
    level: SimdLevel,
    query: &[FloatLine],
    rows: &[FloatLine],
    distances: &mut [f32],
) {
    dispatch!(
        level,
        portable::distances(query, rows, distances),
        x86::distances_avx2(query, rows, distances),
        x86::distances_avx512(query, rows, distances),
    );
}

/// Quantizes a vector: writes one stored code (the code plus [`CODE_ZERO`]) for each number of it.
pub(crate) fn quantize(
    level: SimdLevel,
    vector: &[f32],
    centre: &[f32],
    codes: &mut [u8],
) -> QuantizedVector {
    dispatch!(
        level,
        portable::quantize(vector, centre, codes),
        x86::quantize_avx2(vector, centre, codes),
        x86::quantize_avx512(vector, centre, codes),
    )
}

/// Writes, for each query, the products of its codes with those of each row of a block.
pub(crate) fn dot_products<const QUERIES: usize>(
    level: SimdLevel,
    block: &[CodeLine],
    queries: [QueryCodes<'_>; QUERIES],
    products: &mut [[i32; BLOCK_ROWS]; QUERIES],
) {
    dispatch!(
        level,
        portable::dot_products(block, queries, products),
        x86::dot_products_avx2(block, queries, products),
        x86::dot_products_avx512(block, queries, products),
    );
}

/// Which rows of a block reach the threshold, one bit each: `product * scale * query_scale + threshold >= half_norm`.
pub(crate) fn candidates(
    level: SimdLevel,
    products: &[i32; BLOCK_ROWS],
    (scales, half_norms): (&[f32; BLOCK_ROWS], &[f32; BLOCK_ROWS]),
    query_scale: f32,
    threshold: f32,
) -> u64 {
    dispatch!(
        level,
        portable::candidates(products, scales, half_norms, query_scale, threshold),
        x86::candidates_avx2(products, scales, half_norms, query_scale, threshold),
        x86::candidates_avx512(products, scales, half_norms, query_scale, threshold),
    )
}
