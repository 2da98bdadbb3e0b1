//! The innermost loops, for the vector instructions that the processor turns out to have.
//!
//! Everything here has a portable form that gives the same result to the last bit: distances because the order of
//! their sums is fixed, products of codes because they are whole numbers. What is sifted out may differ in
//! the last bit of a comparison, which the bar allows for ([`super::codes::Codes::bar`]).

#![expect(unsafe_code, reason = "vector instructions and the advice on pages have no safe form")]

use super::codes::{self, Code, Coded, GROUP, Group, PANEL, Panel};
use super::rows::Line;
use super::scan::scan;

/// What the processor can do. Only [`Level::all`] makes one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Level(Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    /// Whatever the program is compiled for.
    Portable,
    /// 256 bits at once.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// 512 bits at once, and products of codes.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// As before, and products of tiles of codes.
    #[cfg(target_arch = "x86_64")]
    Amx,
}

impl Level {
    /// The most that this processor can do.
    pub(super) fn best() -> Self {
        static BEST: std::sync::OnceLock<Level> = std::sync::OnceLock::new();
        *BEST.get_or_init(|| Self::all().into_iter().max().unwrap_or(Self(Kind::Portable)))
    }

    /// Whether tiles of codes are multiplied.
    pub(super) fn has_tiles(self) -> bool {
        #[cfg(target_arch = "x86_64")]
        return self.0 == Kind::Amx;
        #[cfg(not(target_arch = "x86_64"))]
        return false;
    }

    /// All that this processor can do.
    #[cfg(not(target_arch = "x86_64"))]
    pub(super) fn all() -> Vec<Self> {
        vec![Self(Kind::Portable)]
    }

    /// All that this processor can do.
    #[cfg(target_arch = "x86_64")]
    pub(super) fn all() -> Vec<Self> {
        let mut all = vec![Self(Kind::Portable)];
        if is_x86_feature_detected!("avx2") {
            all.push(Self(Kind::Avx2));
            let has_512 = is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512vnni");
            if has_512 {
                all.push(Self(Kind::Avx512));
                if x86::tiles() {
                    all.push(Self(Kind::Amx));
                }
            }
        }
        all
    }
}

/// Writes the distance of `query` to each of the rows.
pub(super) fn distances(level: Level, query: &[Line], rows: &[Line], distances: &mut [f32]) {
    match level.0 {
        Kind::Portable => scan(query, rows, distances),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: a level is only handed out by `Level::all`, where the processor has it.
        Kind::Avx2 => unsafe { x86::scan_avx2(query, rows, distances) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Kind::Avx512 | Kind::Amx => unsafe { x86::scan_avx512(query, rows, distances) },
    }
}

/// A vector's codes.
pub(super) fn code(level: Level, vector: &[f32], centre: &[f32], codes: &mut [u8]) -> Code {
    match level.0 {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Kind::Avx512 | Kind::Amx => unsafe { x86::code_avx512(vector, centre, codes) },
        _ => codes::code(vector, centre, codes),
    }
}

/// The products of a query's codes with those of a group of rows.
pub(super) fn products(level: Level, group: Group<'_>, query: &Coded, products: &mut [i32; GROUP]) {
    match level.0 {
        Kind::Portable => products_portable(group, query, products),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: a level is only handed out by `Level::all`, where the processor has it.
        Kind::Avx2 => unsafe { x86::products_avx2(group, query, products) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Kind::Avx512 | Kind::Amx => unsafe { x86::products_avx512(group, query, products) },
    }
}

/// Which rows of a group pass the bar, a bit each.
pub(super) fn sift(level: Level, group: Group<'_>, query: &Coded, bar: f32) -> u64 {
    let mut found = [0; GROUP];
    products(level, group, query, &mut found);
    match level.0 {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: a level is only handed out by `Level::all`, where the processor has it.
        Kind::Avx512 | Kind::Amx => unsafe { x86::passing_avx512(group, query, &found, bar) },
        _ => (0..GROUP).fold(0, |passing, row| {
            let near = found[row] as f32 * group.scales[row] * query.scale + bar;
            passing | u64::from(near >= group.halves[row]) << row
        }),
    }
}

/// For each row of a group, which queries it passes the bar of, a bit each. A query that the panel does not have has
/// a bar of minus infinity.
///
/// # Panics
/// When the level has no tiles.
pub(super) fn sift_panel(
    level: Level,
    group: Group<'_>,
    panel: &Panel,
    bars: &[f32; PANEL],
    passing: &mut [u64; GROUP],
) {
    assert!(level.has_tiles(), "tiles are multiplied only where the processor does it");
    #[cfg(target_arch = "x86_64")]
    // SAFETY: the level says that the processor has these instructions, and that the system lets us.
    unsafe {
        x86::sift_panel(group, panel, bars, passing);
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (group, panel, bars, passing);
}

/// For each query of a panel, the row of a group that seems nearest by its code, if it seems nearer than what is
/// already there. The group's first row is number `first`.
///
/// # Panics
/// When the level has no tiles.
pub(super) fn nearest_of_panel(
    level: Level,
    group: Group<'_>,
    panel: &Panel,
    first: usize,
    nearest: &mut [(f32, usize); PANEL],
) {
    assert!(level.has_tiles(), "tiles are multiplied only where the processor does it");
    #[cfg(target_arch = "x86_64")]
    // SAFETY: as above.
    unsafe {
        x86::nearest_of_panel(group, panel, first, nearest);
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (group, panel, first, nearest);
}

#[inline(always)]
fn products_portable(group: Group<'_>, query: &Coded, products: &mut [i32; GROUP]) {
    let rows = group.lines.chunks_exact(query.lines.len());
    for (product, row) in products.iter_mut().zip(rows) {
        let mut sum = 0_i32;
        for (row, query) in row.iter().zip(&query.lines) {
            for (&row, &query) in row.0.iter().zip(&query.0) {
                sum = sum.wrapping_add(i32::from(row) * i32::from(query as i8));
            }
        }
        *product = sum.wrapping_sub(query.bias);
    }
}

/// Has a graph of records ([`codes::Codes::record`]) measure half the squared distance of what their codes stand
/// for.
pub(super) fn measure_records(level: Level, graph: &mut usearch::Index) {
    let bytes = graph.dimensions();
    let metric = move |a: *const u8, b: *const u8| {
        // SAFETY: a graph calls its metric with two of its vectors, or one and a query, and all of them have as many
        // bytes as it has dimensions.
        let (a, b) =
            unsafe { (std::slice::from_raw_parts(a, bytes), std::slice::from_raw_parts(b, bytes)) };
        let ((a, a_tail), (b, b_tail)) =
            (a.split_at(bytes - codes::RECORD_TAIL), b.split_at(bytes - codes::RECORD_TAIL));
        let product = match level.0 {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: a level is only handed out by `Level::all`, where the processor has it.
            Kind::Avx512 | Kind::Amx => unsafe { x86::product_avx512(a, b) },
            _ => product_portable(a, b),
        };
        let number = |tail: &[u8], at: usize| {
            f32::from_ne_bytes([tail[at], tail[at + 1], tail[at + 2], tail[at + 3]])
        };
        let halves = number(a_tail, 4) + number(b_tail, 4);
        halves - number(a_tail, 0) * number(b_tail, 0) * product as f32
    };
    graph.change_metric::<u8>(Box::new(metric));
}

/// The product of two records' codes.
fn product_portable(a: &[u8], b: &[u8]) -> i32 {
    let products = a.iter().zip(b).map(|(&a, &b)| (i32::from(a) - 128) * (i32::from(b) - 128));
    products.fold(0, i32::wrapping_add)
}

/// Asks for large pages under memory that is reserved and not yet written: a scan of many gigabytes then spends
/// no time on looking up addresses.
pub(super) fn prefer_large_pages<T>(reserved: &mut Vec<T>) {
    const LARGE: usize = 2 << 20;
    let spare = reserved.spare_capacity_mut();
    let bytes = size_of_val(spare);
    let start = spare.as_mut_ptr() as usize;
    let first = start.next_multiple_of(LARGE);
    let end = (start + bytes) / LARGE * LARGE;
    if end > first {
        // SAFETY: the range lies within memory that this vector has reserved, and the advice changes
        // nothing of its content. That it may be refused changes nothing either.
        unsafe { libc::madvise(first as *mut libc::c_void, end - first, libc::MADV_HUGEPAGE) };
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::super::codes::{Code, CodeLine, Coded, GROUP, Group, PANEL, Panel, code};
    use super::super::rows::Line;
    use super::super::scan::scan;
    use super::products_portable;

    #[target_feature(enable = "avx2")]
    pub(super) fn scan_avx2(query: &[Line], rows: &[Line], distances: &mut [f32]) {
        scan(query, rows, distances);
    }

    /// Rows that are measured together: their sums do not wait for one another.
    const TOGETHER: usize = 4;

    #[target_feature(enable = "avx512f,avx512dq")]
    pub(super) fn scan_avx512(query: &[Line], rows: &[Line], distances: &mut [f32]) {
        let stride = query.len();
        let (quads, rest) = distances.as_chunks_mut::<TOGETHER>();
        let (rows, rows_rest) = rows.split_at(quads.len() * TOGETHER * stride);
        for (distances, rows) in quads.iter_mut().zip(rows.chunks_exact(TOGETHER * stride)) {
            let mut sums = [_mm512_setzero_ps(); TOGETHER];
            for (at, query) in query.iter().enumerate() {
                let query = numbers(&query.0);
                for (row, sum) in sums.iter_mut().enumerate() {
                    let line = &rows[row * stride + at];
                    let ahead = std::ptr::from_ref(line).wrapping_add(TOGETHER * stride);
                    _mm_prefetch::<_MM_HINT_T0>(ahead.cast());
                    let difference = _mm512_sub_ps(query, numbers(&line.0));
                    *sum = _mm512_add_ps(*sum, _mm512_mul_ps(difference, difference));
                }
            }
            for (distance, sum) in distances.iter_mut().zip(sums) {
                *distance = half_total_avx512(sum);
            }
        }
        for (distance, row) in rest.iter_mut().zip(rows_rest.chunks_exact(stride)) {
            let mut sum = _mm512_setzero_ps();
            for (query, line) in query.iter().zip(row) {
                let difference = _mm512_sub_ps(numbers(&query.0), numbers(&line.0));
                sum = _mm512_add_ps(sum, _mm512_mul_ps(difference, difference));
            }
            *distance = half_total_avx512(sum);
        }
    }

    /// As [`crate::half_total`].
    #[target_feature(enable = "avx512f,avx512dq")]
    fn half_total_avx512(sums: __m512) -> f32 {
        let eight = _mm256_add_ps(_mm512_castps512_ps256(sums), _mm512_extractf32x8_ps::<1>(sums));
        let four = _mm_add_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
        let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
        let one = _mm_add_ss(two, _mm_shuffle_ps::<1>(two, two));
        0.5 * _mm_cvtss_f32(one)
    }

    #[target_feature(enable = "avx2")]
    pub(super) fn products_avx2(group: Group<'_>, query: &Coded, products: &mut [i32; GROUP]) {
        products_portable(group, query, products);
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512vl")]
    pub(super) fn code_avx512(vector: &[f32], centre: &[f32], codes: &mut [u8]) -> Code {
        code(vector, centre, codes)
    }

    #[target_feature(enable = "avx512f")]
    fn load(line: &CodeLine) -> __m512i {
        // SAFETY: a `CodeLine` is 64 bytes on a boundary of 64.
        unsafe { _mm512_load_si512(std::ptr::from_ref(line).cast()) }
    }

    #[target_feature(enable = "avx512f")]
    fn numbers(numbers: &[f32; 16]) -> __m512 {
        // SAFETY: 16 numbers are 64 bytes; this load asks for no alignment.
        unsafe { _mm512_loadu_ps(numbers.as_ptr()) }
    }

    #[target_feature(enable = "avx512f")]
    fn wholes(numbers: &[i32; 16]) -> __m512i {
        // SAFETY: as above.
        unsafe { _mm512_loadu_si512(numbers.as_ptr().cast()) }
    }

    /// How far ahead of its use a row is asked for, in cache lines.
    const AHEAD: usize = 384;

    #[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
    pub(super) fn products_avx512(group: Group<'_>, query: &Coded, products: &mut [i32; GROUP]) {
        let stride = query.lines.len();
        let bias = _mm512_set1_epi32(query.bias);
        let sixteens = group.lines.chunks_exact(16 * stride);
        for (products, rows) in products.as_chunks_mut::<16>().0.iter_mut().zip(sixteens) {
            let mut sums = [_mm512_setzero_si512(); 16];
            for (at, line) in query.lines.iter().enumerate() {
                let query = load(line);
                for (row, sum) in sums.iter_mut().enumerate() {
                    let line = &rows[row * stride + at];
                    let ahead = std::ptr::from_ref(line).wrapping_add(AHEAD);
                    _mm_prefetch::<_MM_HINT_T0>(ahead.cast());
                    *sum = _mm512_dpbusd_epi32(*sum, load(line), query);
                }
            }
            let total = _mm512_sub_epi32(totals(sums), bias);
            // SAFETY: 16 whole numbers are 64 bytes; this store asks for no alignment.
            unsafe { _mm512_storeu_si512(products.as_mut_ptr().cast(), total) };
        }
    }

    /// As [`super::product_portable`], of a multiple of 64 codes.
    #[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
    pub(super) fn product_avx512(a: &[u8], b: &[u8]) -> i32 {
        let bias = _mm512_set1_epi8(i8::MIN);
        let (mut product, mut excess) = (_mm512_setzero_si512(), _mm512_setzero_si512());
        for (a, b) in a.as_chunks::<64>().0.iter().zip(b.as_chunks::<64>().0) {
            // SAFETY: both are 64 bytes; these loads ask for no alignment.
            let (a, b) = unsafe {
                (_mm512_loadu_si512(a.as_ptr().cast()), _mm512_loadu_si512(b.as_ptr().cast()))
            };
            // One side keeps its bias, which comes to 128 times the other side's codes.
            let signed = _mm512_xor_si512(b, bias);
            product = _mm512_dpbusd_epi32(product, a, signed);
            excess = _mm512_dpbusd_epi32(excess, bias, signed);
        }
        _mm512_reduce_add_epi32(_mm512_sub_epi32(product, excess))
    }

    /// The sum of each of 16 vectors, in their order.
    #[target_feature(enable = "avx512f")]
    fn totals(v: [__m512i; 16]) -> __m512i {
        // Sums of neighbours, twice: afterwards each 128 bits hold one number of four vectors each.
        let pair =
            |a, b| _mm512_add_epi32(_mm512_unpacklo_epi32(a, b), _mm512_unpackhi_epi32(a, b));
        let four =
            |a, b| _mm512_add_epi32(_mm512_unpacklo_epi64(a, b), _mm512_unpackhi_epi64(a, b));
        let quad = |at: usize| four(pair(v[at], v[at + 1]), pair(v[at + 2], v[at + 3]));
        let (a, b, c, d) = (quad(0), quad(4), quad(8), quad(12));
        // Then the four quarters of each of the four.
        let ab = _mm512_add_epi32(
            _mm512_shuffle_i32x4::<0b01_00_01_00>(a, b),
            _mm512_shuffle_i32x4::<0b11_10_11_10>(a, b),
        );
        let cd = _mm512_add_epi32(
            _mm512_shuffle_i32x4::<0b01_00_01_00>(c, d),
            _mm512_shuffle_i32x4::<0b11_10_11_10>(c, d),
        );
        _mm512_add_epi32(
            _mm512_shuffle_i32x4::<0b10_00_10_00>(ab, cd),
            _mm512_shuffle_i32x4::<0b11_01_11_01>(ab, cd),
        )
    }

    #[target_feature(enable = "avx512f")]
    pub(super) fn passing_avx512(
        group: Group<'_>,
        query: &Coded,
        products: &[i32; GROUP],
        bar: f32,
    ) -> u64 {
        let (scale, bar) = (_mm512_set1_ps(query.scale), _mm512_set1_ps(bar));
        let scales = group.scales.as_chunks::<16>().0;
        let halves = group.halves.as_chunks::<16>().0;
        let parts = products.as_chunks::<16>().0.iter().zip(scales).zip(halves);
        parts.enumerate().fold(0, |passing, (part, ((products, scales), halves))| {
            let products = _mm512_cvtepi32_ps(wholes(products));
            let products = _mm512_mul_ps(products, numbers(scales));
            let near = _mm512_fmadd_ps(products, scale, bar);
            let mask = _mm512_cmp_ps_mask::<_CMP_GE_OQ>(near, numbers(halves));
            passing | u64::from(mask) << (16 * part)
        })
    }

    /// Shape of tiles: palette 1, and for each of 8 tiles 16 rows of 64 bytes.
    const TILES: CodeLine = {
        let mut config = [0; 64];
        config[0] = 1;
        let mut tile = 0;
        while tile < 8 {
            config[16 + 2 * tile] = 64;
            config[48 + tile] = 16;
            tile += 1;
        }
        CodeLine(config)
    };

    /// How far ahead of its use a row is asked for, in 16 rows.
    const TILES_AHEAD: usize = 4;

    /// Products of 16 rows with a panel, not yet less the bias.
    #[repr(align(64))]
    struct Products([[i32; PANEL]; 16]);

    /// Fills `products` for the 16 rows in `rows`.
    fn multiply(rows: &[CodeLine], panel: &Panel, products: &mut Products) {
        let stride = rows.len() / 16;
        assert!(rows.len() == 16 * stride && panel.lines.len() == stride * PANEL && stride > 0);
        // SAFETY: whoever calls has seen to it that the processor multiplies tiles. Tile 4 reads 64 bytes of each of
        // 16 rows at every step, tiles 5 to 7 a panel's lines in order: both end where the slices do, which
        // was asserted. What is stored are 16 rows of 256 bytes, which is what `products` has. The tiles are released at the
        // end, so nothing is left in them for anybody.
        unsafe {
            std::arch::asm!(
                "ldtilecfg [{config}]",
                "tilezero tmm0",
                "tilezero tmm1",
                "tilezero tmm2",
                "tilezero tmm3",
                "2:",
                "tileloadd tmm4, [{rows} + {row_bytes}]",
                "tileloadd tmm5, [{panel} + {line}]",
                "tdpbusd tmm0, tmm4, tmm5",
                "tileloadd tmm6, [{panel} + {line} + 1024]",
                "tdpbusd tmm1, tmm4, tmm6",
                "tileloadd tmm7, [{panel} + {line} + 2048]",
                "tdpbusd tmm2, tmm4, tmm7",
                "tileloadd tmm5, [{panel} + {line} + 3072]",
                "tdpbusd tmm3, tmm4, tmm5",
                "prefetcht0 [{ahead}]",
                "prefetcht0 [{ahead} + 64]",
                "prefetcht0 [{ahead} + 128]",
                "prefetcht0 [{ahead} + 192]",
                "prefetcht0 [{ahead} + 256]",
                "prefetcht0 [{ahead} + 320]",
                "prefetcht0 [{ahead} + 384]",
                "prefetcht0 [{ahead} + 448]",
                "prefetcht0 [{ahead} + 512]",
                "prefetcht0 [{ahead} + 576]",
                "prefetcht0 [{ahead} + 640]",
                "prefetcht0 [{ahead} + 704]",
                "prefetcht0 [{ahead} + 768]",
                "prefetcht0 [{ahead} + 832]",
                "prefetcht0 [{ahead} + 896]",
                "prefetcht0 [{ahead} + 960]",
                "add {ahead}, 1024",
                "add {rows}, 64",
                "add {panel}, 4096",
                "dec {steps}",
                "jnz 2b",
                "tilestored [{products} + {product_bytes}], tmm0",
                "tilestored [{products} + {product_bytes} + 64], tmm1",
                "tilestored [{products} + {product_bytes} + 128], tmm2",
                "tilestored [{products} + {product_bytes} + 192], tmm3",
                "tilerelease",
                config = in(reg) TILES.0.as_ptr(),
                rows = inout(reg) rows.as_ptr() => _,
                ahead = inout(reg) rows.as_ptr().wrapping_add(TILES_AHEAD * rows.len()) => _,
                panel = inout(reg) panel.lines.as_ptr() => _,
                products = in(reg) products.0.as_mut_ptr(),
                row_bytes = in(reg) stride * 64,
                line = in(reg) 64_usize,
                product_bytes = in(reg) 256_usize,
                steps = inout(reg) stride => _,
                out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                options(nostack),
            );
        }
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
    pub(super) fn sift_panel(
        group: Group<'_>,
        panel: &Panel,
        bars: &[f32; PANEL],
        passing: &mut [u64; GROUP],
    ) {
        let stride = group.lines.len() / GROUP;
        let mut products = Products([[0; PANEL]; 16]);
        for first in (0..GROUP).step_by(16) {
            multiply(&group.lines[first * stride..][..16 * stride], panel, &mut products);
            for (row, products) in (first..).zip(&products.0) {
                let (scale, half) =
                    (_mm512_set1_ps(group.scales[row]), _mm512_set1_ps(group.halves[row]));
                passing[row] = 0;
                for part in 0..4 {
                    let query_scales = numbers(&panel.scales.as_chunks().0[part]);
                    let products = less_bias(products, panel, part);
                    let products = _mm512_mul_ps(products, scale);
                    let bars = numbers(&bars.as_chunks().0[part]);
                    let near = _mm512_fmadd_ps(products, query_scales, bars);
                    let mask = _mm512_cmp_ps_mask::<_CMP_GE_OQ>(near, half);
                    passing[row] |= u64::from(mask) << (16 * part);
                }
            }
        }
    }

    #[target_feature(enable = "avx512f")]
    fn less_bias(products: &[i32; PANEL], panel: &Panel, part: usize) -> __m512 {
        let products = wholes(&products.as_chunks().0[part]);
        let biases = wholes(&panel.biases.as_chunks().0[part]);
        _mm512_cvtepi32_ps(_mm512_sub_epi32(products, biases))
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
    pub(super) fn nearest_of_panel(
        group: Group<'_>,
        panel: &Panel,
        first_row: usize,
        nearest: &mut [(f32, usize); PANEL],
    ) {
        let stride = group.lines.len() / GROUP;
        let mut products = Products([[0; PANEL]; 16]);
        let mut near = [f32::NEG_INFINITY; PANEL];
        let mut at = [0_u32; PANEL];
        for first in (0..GROUP).step_by(16) {
            multiply(&group.lines[first * stride..][..16 * stride], panel, &mut products);
            for (row, products) in (first..).zip(&products.0) {
                let (scale, half) = (group.scales[row], group.halves[row]);
                for query in 0..PANEL {
                    let product = products[query].wrapping_sub(panel.biases[query]) as f32;
                    let seems = product * scale * panel.scales[query] - half;
                    let nearer = seems > near[query];
                    near[query] = if nearer { seems } else { near[query] };
                    at[query] = if nearer { row as u32 } else { at[query] };
                }
            }
        }
        for (query, nearest) in nearest.iter_mut().enumerate() {
            if near[query] > nearest.0 {
                *nearest = (near[query], first_row + at[query] as usize);
            }
        }
    }

    /// Whether the processor multiplies tiles of codes, and the system lets this process.
    pub(super) fn tiles() -> bool {
        const AMX_TILE: u32 = 1 << 24;
        const AMX_INT8: u32 = 1 << 25;
        const TILE_DATA: libc::c_ulong = 18;
        const ARCH_REQ_XCOMP_PERM: libc::c_int = 0x1023;
        let leaf = __cpuid_count(7, 0);
        if leaf.edx & AMX_TILE == 0 || leaf.edx & AMX_INT8 == 0 {
            return false;
        }
        // SAFETY: this call takes two numbers and touches no memory of ours.
        unsafe { libc::syscall(libc::SYS_arch_prctl, ARCH_REQ_XCOMP_PERM, TILE_DATA) == 0 }
    }
}
