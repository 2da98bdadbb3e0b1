//! The kernels for AVX2 and AVX-512. Those for AVX2 are the portable source, compiled for it.

#![expect(unsafe_code, reason = "vector loads and stores take raw pointers")]

use std::arch::x86_64::*;

use super::{BLOCK_ROWS, QuantizedVector, portable};
use crate::matrix::{CodeLine, FloatLine};

pub(super) fn has_avx2() -> bool {
    is_x86_feature_detected!("avx2")
}

/// Whether the processor has every AVX-512 subset that is enabled below.
pub(super) fn has_avx512() -> bool {
    is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512vnni")
}

#[target_feature(enable = "avx2")]
pub(super) fn distances_avx2(query: &[FloatLine], rows: &[FloatLine], distances: &mut [f32]) {
    portable::distances(query, rows, distances);
}

#[target_feature(enable = "avx2")]
pub(super) fn quantize_avx2(vector: &[f32], centre: &[f32], codes: &mut [u8]) -> QuantizedVector {
    portable::quantize(vector, centre, codes)
}

#[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512vl")]
pub(super) fn quantize_avx512(vector: &[f32], centre: &[f32], codes: &mut [u8]) -> QuantizedVector {
    portable::quantize(vector, centre, codes)
}

#[target_feature(enable = "avx2")]
pub(super) fn dot_product_avx2(a: &[u8], b: &[u8]) -> i32 {
    portable::dot_product(a, b)
}

#[target_feature(enable = "avx2")]
pub(super) fn candidates_avx2(
    products: &[i32; BLOCK_ROWS],
    scales: &[f32; BLOCK_ROWS],
    half_norms: &[f32; BLOCK_ROWS],
    query_scale: f32,
    threshold: f32,
) -> u64 {
    portable::candidates(products, scales, half_norms, query_scale, threshold)
}

/// Rows measured together, so that their sums do not wait for one another.
const ROWS_TOGETHER: usize = 4;

#[target_feature(enable = "avx512f,avx512dq")]
pub(super) fn distances_avx512(query: &[FloatLine], rows: &[FloatLine], distances: &mut [f32]) {
    let stride = query.len();
    let (quads, rest) = distances.as_chunks_mut::<ROWS_TOGETHER>();
    let (rows, rows_rest) = rows.split_at(quads.len() * ROWS_TOGETHER * stride);
    for (distances, rows) in quads.iter_mut().zip(rows.chunks_exact(ROWS_TOGETHER * stride)) {
        let mut sums = [_mm512_setzero_ps(); ROWS_TOGETHER];
        for (at, query) in query.iter().enumerate() {
            let query = load_floats(&query.0);
            for (row, sum) in sums.iter_mut().enumerate() {
                let line = &rows[row * stride + at];
                let ahead = std::ptr::from_ref(line).wrapping_add(ROWS_TOGETHER * stride);
                _mm_prefetch::<_MM_HINT_T0>(ahead.cast());
                let difference = _mm512_sub_ps(query, load_floats(&line.0));
                *sum = _mm512_add_ps(*sum, _mm512_mul_ps(difference, difference));
            }
        }
        for (distance, sum) in distances.iter_mut().zip(sums) {
            *distance = half_total(sum);
        }
    }
    for (distance, row) in rest.iter_mut().zip(rows_rest.chunks_exact(stride)) {
        let mut sum = _mm512_setzero_ps();
        for (query, line) in query.iter().zip(row) {
            let difference = _mm512_sub_ps(load_floats(&query.0), load_floats(&line.0));
            sum = _mm512_add_ps(sum, _mm512_mul_ps(difference, difference));
        }
        *distance = half_total(sum);
    }
}

/// Adds in the order of [`crate::embedding::half_total`].
#[target_feature(enable = "avx512f,avx512dq")]
fn half_total(sums: __m512) -> f32 {
    let eight = _mm256_add_ps(_mm512_castps512_ps256(sums), _mm512_extractf32x8_ps::<1>(sums));
    let four = _mm_add_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
    let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
    let one = _mm_add_ss(two, _mm_shuffle_ps::<1>(two, two));
    0.5 * _mm_cvtss_f32(one)
}

/// How far ahead of its use a block is fetched, in cache lines.
const LINES_AHEAD: usize = 64;

#[target_feature(enable = "avx2")]
pub(super) fn dot_products_avx2(
    block: &[CodeLine],
    query: &[[i8; 4]],
    excess: i32,
    products: &mut [i32; BLOCK_ROWS],
) {
    // Each sum holds two numbers for each of four rows.
    let mut sums = [_mm256_setzero_si256(); BLOCK_ROWS / 4];
    for (lines, query) in block.chunks_exact(4).zip(query) {
        let [a, b, c, d] = query.map(i16::from);
        let query = _mm256_setr_epi16(a, b, c, d, a, b, c, d, a, b, c, d, a, b, c, d);
        for (sums, line) in sums.as_chunks_mut::<4>().0.iter_mut().zip(lines) {
            for (sum, codes) in sums.iter_mut().zip(line.0.as_chunks::<16>().0) {
                // SAFETY: 16 codes are 16 bytes; this load asks for no alignment.
                let codes = unsafe { _mm_loadu_si128(codes.as_ptr().cast()) };
                let widened = _mm256_cvtepu8_epi16(codes);
                *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(widened, query));
            }
        }
    }
    let pairs = products.as_chunks_mut::<8>().0.iter_mut().zip(sums.as_chunks::<2>().0);
    for (products, [low, high]) in pairs {
        // Adds neighbours within halves; the permutation restores the order of rows.
        let added = _mm256_hadd_epi32(*low, *high);
        let ordered = _mm256_permute4x64_epi64::<0b11_01_10_00>(added);
        let ordered = _mm256_sub_epi32(ordered, _mm256_set1_epi32(excess));
        // SAFETY: 8 products are 32 bytes; this store asks for no alignment.
        unsafe { _mm256_storeu_si256(products.as_mut_ptr().cast(), ordered) };
    }
}

#[target_feature(enable = "avx512f,avx512vnni")]
pub(super) fn dot_products_avx512(
    block: &[CodeLine],
    query: &[[i8; 4]],
    excess: i32,
    products: &mut [i32; BLOCK_ROWS],
) {
    // Two sums for each 16 rows, so that a multiplication does not wait for the one before.
    let mut sums = [_mm512_setzero_si512(); 8];
    for (lines, steps) in block.chunks_exact(8).zip(query.as_chunks::<2>().0) {
        for (at, (sum, line)) in sums.iter_mut().zip(lines).enumerate() {
            let query = _mm512_set1_epi32(i32::from_ne_bytes(steps[at / 4].map(|code| code as u8)));
            let ahead = std::ptr::from_ref(line).wrapping_add(LINES_AHEAD);
            _mm_prefetch::<_MM_HINT_T0>(ahead.cast());
            *sum = _mm512_dpbusd_epi32(*sum, load_codes(line), query);
        }
    }
    for (at, products) in products.as_chunks_mut::<16>().0.iter_mut().enumerate() {
        let sum = _mm512_add_epi32(sums[at], sums[4 + at]);
        let sum = _mm512_sub_epi32(sum, _mm512_set1_epi32(excess));
        // SAFETY: 16 products are 64 bytes; this store asks for no alignment.
        unsafe { _mm512_storeu_si512(products.as_mut_ptr().cast(), sum) };
    }
}

#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
pub(super) fn dot_product_avx512(a: &[u8], b: &[u8]) -> i32 {
    let zero = _mm512_set1_epi8(i8::MIN);
    let (mut product, mut excess) = (_mm512_setzero_si512(), _mm512_setzero_si512());
    for (a, b) in a.as_chunks::<64>().0.iter().zip(b.as_chunks::<64>().0) {
        // SAFETY: both are 64 bytes; these loads ask for no alignment.
        let (a, b) = unsafe {
            (_mm512_loadu_si512(a.as_ptr().cast()), _mm512_loadu_si512(b.as_ptr().cast()))
        };
        // One side stays unsigned, which adds 128 times the other side's codes.
        let signed = _mm512_xor_si512(b, zero);
        product = _mm512_dpbusd_epi32(product, a, signed);
        excess = _mm512_dpbusd_epi32(excess, zero, signed);
    }
    _mm512_reduce_add_epi32(_mm512_sub_epi32(product, excess))
}

#[target_feature(enable = "avx512f")]
pub(super) fn candidates_avx512(
    products: &[i32; BLOCK_ROWS],
    scales: &[f32; BLOCK_ROWS],
    half_norms: &[f32; BLOCK_ROWS],
    query_scale: f32,
    threshold: f32,
) -> u64 {
    let (query_scale, threshold) = (_mm512_set1_ps(query_scale), _mm512_set1_ps(threshold));
    let parts = products.as_chunks::<16>().0.iter().zip(scales.as_chunks::<16>().0);
    let parts = parts.zip(half_norms.as_chunks::<16>().0);
    parts.enumerate().fold(0, |found, (part, ((products, scales), half_norms))| {
        // SAFETY: 16 products are 64 bytes; this load asks for no alignment.
        let products = unsafe { _mm512_loadu_si512(products.as_ptr().cast()) };
        let products = _mm512_mul_ps(_mm512_cvtepi32_ps(products), load_floats(scales));
        let near = _mm512_fmadd_ps(products, query_scale, threshold);
        let mask = _mm512_cmp_ps_mask::<_CMP_GE_OQ>(near, load_floats(half_norms));
        found | u64::from(mask) << (16 * part)
    })
}

#[target_feature(enable = "avx512f")]
fn load_codes(line: &CodeLine) -> __m512i {
    // SAFETY: a `CodeLine` is 64 bytes, aligned to 64.
    unsafe { _mm512_load_si512(std::ptr::from_ref(line).cast()) }
}

#[target_feature(enable = "avx512f")]
fn load_floats(floats: &[f32; 16]) -> __m512 {
    // SAFETY: 16 floats are 64 bytes; this load asks for no alignment.
    unsafe { _mm512_loadu_ps(floats.as_ptr()) }
}
