//! The kernels for AVX2 and AVX-512. Some are the portable source, compiled for them.

#![expect(unsafe_code, reason = "vector loads and stores take raw pointers")]

use std::arch::x86_64::*;

use super::{BLOCK_ROWS, LINES_IN_STEP, QuantizedVector, QueryCodes, portable};
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
pub(super) fn quantize_avx2(vector: &[f32], centre: &[f32], codes: &mut [u8]) -> QuantizedVector {
    portable::quantize(vector, centre, codes)
}

#[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512vl")]
pub(super) fn quantize_avx512(vector: &[f32], centre: &[f32], codes: &mut [u8]) -> QuantizedVector {
    portable::quantize(vector, centre, codes)
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

#[target_feature(enable = "avx2")]
pub(super) fn distances_avx2(query: &[FloatLine], rows: &[FloatLine], distances: &mut [f32]) {
    let some = |rows: &_| distances_of_some_avx2(query, rows);
    in_groups(query.len(), rows, distances, some, |row| distances_of_some_avx2(query, row));
}

#[target_feature(enable = "avx2")]
fn distances_of_some_avx2<const ROWS: usize>(
    query: &[FloatLine],
    rows: &[FloatLine],
) -> [f32; ROWS] {
    let mut sums = [[_mm256_setzero_ps(); 2]; ROWS];
    for (at, query_line) in query.iter().enumerate() {
        let query_line = load_halves(&query_line.0);
        for (row, [low, high]) in sums.iter_mut().enumerate() {
            let row_line = load_halves(&rows[row * query.len() + at].0);
            let (a, b) = (
                _mm256_sub_ps(query_line[0], row_line[0]),
                _mm256_sub_ps(query_line[1], row_line[1]),
            );
            *low = _mm256_add_ps(*low, _mm256_mul_ps(a, a));
            *high = _mm256_add_ps(*high, _mm256_mul_ps(b, b));
        }
    }
    sums.map(|[low, high]| half_total(_mm256_add_ps(low, high)))
}

#[target_feature(enable = "avx512f,avx512dq")]
pub(super) fn distances_avx512(query: &[FloatLine], rows: &[FloatLine], distances: &mut [f32]) {
    let some = |rows: &_| distances_of_some_avx512(query, rows);
    in_groups(query.len(), rows, distances, some, |row| distances_of_some_avx512(query, row));
}

#[target_feature(enable = "avx512f,avx512dq")]
fn distances_of_some_avx512<const ROWS: usize>(
    query: &[FloatLine],
    rows: &[FloatLine],
) -> [f32; ROWS] {
    let mut sums = [_mm512_setzero_ps(); ROWS];
    for (at, query_line) in query.iter().enumerate() {
        let query_line = load_floats(&query_line.0);
        for (row, sum) in sums.iter_mut().enumerate() {
            let line = &rows[row * query.len() + at];
            let ahead = std::ptr::from_ref(line).wrapping_add(ROWS * query.len());
            _mm_prefetch::<_MM_HINT_T0>(ahead.cast());
            let difference = _mm512_sub_ps(query_line, load_floats(&line.0));
            *sum = _mm512_add_ps(*sum, _mm512_mul_ps(difference, difference));
        }
    }
    sums.map(|sum| {
        let (low, high) = (_mm512_castps512_ps256(sum), _mm512_extractf32x8_ps::<1>(sum));
        half_total(_mm256_add_ps(low, high))
    })
}

/// Measures [`ROWS_TOGETHER`] rows at a time with `some`, and those that are left with `one`. A row has `stride` lines.
#[inline(always)]
fn in_groups(
    stride: usize,
    rows: &[FloatLine],
    distances: &mut [f32],
    some: impl Fn(&[FloatLine]) -> [f32; ROWS_TOGETHER],
    one: impl Fn(&[FloatLine]) -> [f32; 1],
) {
    let (groups, rest) = distances.as_chunks_mut::<ROWS_TOGETHER>();
    let (rows, rows_rest) = rows.split_at(groups.len() * ROWS_TOGETHER * stride);
    for (distances, rows) in groups.iter_mut().zip(rows.chunks_exact(ROWS_TOGETHER * stride)) {
        *distances = some(rows);
    }
    for (distance, row) in rest.iter_mut().zip(rows_rest.chunks_exact(stride)) {
        [*distance] = one(row);
    }
}

/// Adds eight sums in the order of [`crate::embedding::half_total`].
#[target_feature(enable = "avx2")]
fn half_total(eight: __m256) -> f32 {
    let four = _mm_add_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
    let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
    let one = _mm_add_ss(two, _mm_shuffle_ps::<1>(two, two));
    0.5 * _mm_cvtss_f32(one)
}

#[target_feature(enable = "avx2")]
fn load_halves(floats: &[f32; 16]) -> [__m256; 2] {
    // SAFETY: 16 floats are 64 bytes, and these loads of 32 bytes ask for no alignment.
    unsafe { [_mm256_loadu_ps(floats.as_ptr()), _mm256_loadu_ps(floats[8..].as_ptr())] }
}

/// How far ahead of its use a block is fetched, in cache lines.
const LINES_AHEAD: usize = 64;

/// Fetches the line that is needed [`LINES_AHEAD`] lines after this one.
#[inline(always)]
fn prefetch_ahead(line: &CodeLine) {
    let ahead = std::ptr::from_ref(line).wrapping_add(LINES_AHEAD);
    // SAFETY: every x86-64 processor has this instruction, and it faults at no address.
    unsafe { _mm_prefetch::<_MM_HINT_T0>(ahead.cast()) };
}

/// Queries whose sums fit into AVX2's sixteen registers together.
const QUERIES_AVX2: usize = 2;

#[target_feature(enable = "avx2")]
pub(super) fn dot_products_avx2<const QUERIES: usize>(
    block: &[CodeLine],
    queries: [QueryCodes<'_>; QUERIES],
    products: &mut [[i32; BLOCK_ROWS]; QUERIES],
) {
    let (pairs, rest) = queries.as_chunks::<QUERIES_AVX2>();
    let (products, products_rest) = products.as_chunks_mut::<QUERIES_AVX2>();
    for (queries, products) in pairs.iter().zip(products) {
        dot_products_of_some_avx2(block, queries, products);
    }
    for (query, products) in rest.iter().zip(products_rest) {
        dot_products_of_some_avx2(
            block,
            std::array::from_ref(query),
            std::array::from_mut(products),
        );
    }
}

/// Steps of a block that are multiplied before their next 16 rows are: they stay in the first cache meanwhile.
const STEPS_TOGETHER: usize = 4;

/// Multiplies as many queries as [`QUERIES_AVX2`] at most, by 16 rows at a time.
#[target_feature(enable = "avx2")]
fn dot_products_of_some_avx2<const QUERIES: usize>(
    block: &[CodeLine],
    queries: &[QueryCodes<'_>; QUERIES],
    products: &mut [[i32; BLOCK_ROWS]; QUERIES],
) {
    // Each sum holds two numbers for each of four rows.
    let mut all_sums = [[[_mm256_setzero_si256(); 4]; QUERIES]; LINES_IN_STEP];
    let mut widened = [[_mm256_setzero_si256(); QUERIES]; STEPS_TOGETHER];
    let steps = block.as_chunks::<LINES_IN_STEP>().0;
    for (part, steps) in steps.chunks(STEPS_TOGETHER).enumerate() {
        for (at, widened) in widened.iter_mut().take(steps.len()).enumerate() {
            *widened = queries.map(|query| widen(query.steps[part * STEPS_TOGETHER + at]));
        }
        for (column, all_sums) in all_sums.iter_mut().enumerate() {
            let mut sums = *all_sums;
            for (lines, query_codes) in steps.iter().zip(&widened) {
                for (part, codes) in lines[column].0.as_chunks::<16>().0.iter().enumerate() {
                    // SAFETY: 16 codes are 16 bytes; this load asks for no alignment.
                    let codes = unsafe { _mm_loadu_si128(codes.as_ptr().cast()) };
                    let codes = _mm256_cvtepu8_epi16(codes);
                    for (sums, query) in sums.iter_mut().zip(query_codes) {
                        sums[part] = _mm256_add_epi32(sums[part], _mm256_madd_epi16(codes, *query));
                    }
                }
            }
            *all_sums = sums;
        }
    }
    for (at, (products, query)) in products.iter_mut().zip(queries).enumerate() {
        let excess = _mm256_set1_epi32(query.excess);
        let sums = all_sums.iter().flat_map(|sums| sums[at].as_chunks::<2>().0);
        for (products, [low, high]) in products.as_chunks_mut::<8>().0.iter_mut().zip(sums) {
            // Adds neighbours within halves; the permutation restores the order of rows.
            let added = _mm256_hadd_epi32(*low, *high);
            let ordered = _mm256_permute4x64_epi64::<0b11_01_10_00>(added);
            let ordered = _mm256_sub_epi32(ordered, excess);
            // SAFETY: 8 products are 32 bytes; this store asks for no alignment.
            unsafe { _mm256_storeu_si256(products.as_mut_ptr().cast(), ordered) };
        }
    }
}

/// Four codes as 16-bit numbers, four times.
#[target_feature(enable = "avx2")]
fn widen(codes: [u8; 4]) -> __m256i {
    let codes = _mm_cvtsi32_si128(i32::from_ne_bytes(codes));
    _mm256_broadcastq_epi64(_mm_cvtepi8_epi16(codes))
}

#[target_feature(enable = "avx512f,avx512vnni")]
pub(super) fn dot_products_avx512<const QUERIES: usize>(
    block: &[CodeLine],
    queries: [QueryCodes<'_>; QUERIES],
    products: &mut [[i32; BLOCK_ROWS]; QUERIES],
) {
    let steps = block.as_chunks::<LINES_IN_STEP>().0;
    let queries = queries.map(|query| QueryCodes { steps: &query.steps[..steps.len()], ..query });
    let mut sums = [[_mm512_setzero_si512(); LINES_IN_STEP]; QUERIES];
    for (at, lines) in steps.iter().enumerate() {
        lines.iter().for_each(prefetch_ahead);
        let rows = [0, 1, 2, 3].map(|line: usize| load_codes(&lines[line]));
        for (sums, query) in sums.iter_mut().zip(queries) {
            let codes = _mm512_set1_epi32(i32::from_ne_bytes(query.steps[at]));
            for (sum, rows) in sums.iter_mut().zip(rows) {
                *sum = _mm512_dpbusd_epi32(*sum, rows, codes);
            }
        }
    }
    for ((products, sums), query) in products.iter_mut().zip(sums).zip(queries) {
        let excess = _mm512_set1_epi32(query.excess);
        for (products, sum) in products.as_chunks_mut::<16>().0.iter_mut().zip(sums) {
            let sum = _mm512_sub_epi32(sum, excess);
            // SAFETY: 16 products are 64 bytes; this store asks for no alignment.
            unsafe { _mm512_storeu_si512(products.as_mut_ptr().cast(), sum) };
        }
    }
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
