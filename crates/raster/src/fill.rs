//! Finds the samples that a quad covers. A triangle is a quad with a corner that comes twice.
//!
//! Corners are snapped to a sub-pixel grid and coverage is decided in integers. A sample on an edge that two quads share
//! belongs to exactly one of them, so no gap opens between them and no sample is drawn twice.

use std::ops::Range;

use fearless_simd::{
    Bytes, Select, Simd, SimdBase, SimdMask, f32x4, f32x16, f64x4, i32x16, mask32x16, u32x16, u64x4,
};

use super::canvas::{BlockState, PIXELS, PixelLanes, SIDE, SampleBlock, SampledImage};
use super::corner::{Corner, Grid, Polygon, TO_CUT};

/// Sample positions in sixteenths of a pixel: Vulkan's standard positions.
const fn samples<const M: usize>() -> [[i32; 2]; M] {
    let mut places = [[8, 8]; M];
    if M == 4 {
        let four = [[6, 2], [14, 6], [2, 10], [10, 14]];
        let mut i = 0;
        while i < M {
            places[i] = four[i];
            i += 1;
        }
    }
    places
}

/// Draws a quad if it shows its front, that is if its corners are counter-clockwise in the image.
#[inline(always)]
pub(super) fn draw<V: Simd, const M: usize, H: Shader>(
    simd: V,
    canvas: &mut SampledImage<M>,
    grid: &Grid,
    corners: [&Corner; 4],
    shader: &H,
) {
    let [a, b, c, d] = corners;
    // Entirely beyond one side of the image, or behind the camera.
    if a.beyond & b.beyond & c.beyond & d.beyond & !TO_CUT != 0 {
        return;
    }
    let is_cut = (a.beyond | b.beyond | c.beyond | d.beyond) & TO_CUT != 0;
    let [wa, wb, wc, wd] = [a.whole(), b.whole(), c.whole(), d.whole()];
    let turns = [
        doubled_area([wa, wd, wc]),
        doubled_area([wd, wc, wb]),
        doubled_area([wc, wb, wa]),
        doubled_area([wb, wa, wd]),
    ];
    let least = less(less(turns[0], turns[1]), less(turns[2], turns[3]));
    let most = more(more(turns[0], turns[1]), more(turns[2], turns[3]));
    if most <= 0.0 && !is_cut {
        return;
    }
    // Rounding may have dented it.
    let is_dented = least < 0.0;
    let polygon = (is_cut || is_dented).then(|| Polygon::inside(corners, grid));
    let polygon = polygon.as_ref().map(Polygon::corners);
    for i in 2..polygon.map_or(3, <[Corner]>::len) {
        // Rows count downwards, so this way round the doubled area is positive.
        let quad = match polygon {
            None => [a, d, c, b],
            Some(corners) => [&corners[0], &corners[i], &corners[i - 1], &corners[i - 1]],
        };
        fill(simd, canvas, grid, quad, shader);
    }
}

/// The edge functions of the edges: the distance of a grid point inside the edge, times the length of the edge; nowhere
/// negative for an edge without length. Integers that a float represents exactly.
struct Edges<V: Simd> {
    /// The change per grid step, to the right and downwards.
    x: f64x4<V>,
    y: f64x4<V>,
    /// The value at the image's top left corner; negative is outside.
    start: f64x4<V>,
    /// The largest and smallest change within a block.
    rise: f64x4<V>,
    fall: f64x4<V>,
    /// 1 / the change per block to the left.
    slant: f64x4<V>,
}

/// More than rounding can move the point where an edge crosses a row, in blocks.
const SLACK: f64 = 1e-3;

/// Quads at most this many blocks wide are drawn without narrowing each row.
const SLIM: i32 = 3;

/// Adding this to an integer leaves its lowest bits as those of the sum.
const TO_BITS: f64 = 6_755_399_441_055_744.0;

impl<V: Simd> Edges<V> {
    /// The edges from each corner to the next.
    #[inline(always)]
    fn new(simd: V, [a, b, c, d]: [[f64; 2]; 4], step: f64) -> Self {
        let x0 = f64x4::load_array(simd, [a[0], b[0], c[0], d[0]]);
        let y0 = f64x4::load_array(simd, [a[1], b[1], c[1], d[1]]);
        let x1 = f64x4::load_array(simd, [b[0], c[0], d[0], a[0]]);
        let y1 = f64x4::load_array(simd, [b[1], c[1], d[1], a[1]]);
        let (x, y) = (y0 - y1, x1 - x0);
        let zero = f64x4::splat(simd, 0.0);
        // A point on an edge belongs to the quad whose left or top edge it is.
        let is_owned = x.simd_gt(zero) | (x.simd_eq(zero) & y.simd_ge(zero));
        let start = -(x * x0 + y * y0) - is_owned.select(zero, zero + 1.0);
        let reach = step - 1.0;
        Self {
            x,
            y,
            start,
            rise: (x.max(zero) + y.max(zero)) * reach,
            fall: (x.min(zero) + y.min(zero)) * reach,
            slant: f64x4::splat(simd, -1.0) / (x * step),
        }
    }

    /// The first and last block between columns `low` and `high` that the edges may cover, in a row in whose first column the
    /// edge functions are `inside`. May include one block too many.
    #[inline(always)]
    fn narrow(&self, simd: V, inside: f64x4<V>, low: f64, high: f64) -> [f64; 2] {
        // Half more than an integer, so that a vertical edge has all columns inside, or none.
        let cross = (inside + self.rise + 0.5) * self.slant;
        let zero = f64x4::splat(simd, 0.0);
        let least = self.x.simd_ge(zero).select(cross - SLACK, zero + low).to_array();
        let most = self.x.simd_lt(zero).select(cross + SLACK, zero + high).to_array();
        [
            more(more(more(least[0], least[1]), more(least[2], least[3])), low),
            less(less(less(most[0], most[1]), less(most[2], most[3])), high),
        ]
    }
}

/// The change of an edge function to each pixel of a block.
#[inline(always)]
fn edge_lanes<V: Simd>(simd: V, right: i32, down: i32, bits: u32) -> i32x16<V> {
    const COLUMN: PixelLanes<i32> = [0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3];
    const LINE: PixelLanes<i32> = [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3];
    i32x16::load_array(simd, COLUMN) * (right << bits)
        + i32x16::load_array(simd, LINE) * (down << bits)
}

/// Converts an integer of at most 32 bits.
#[inline(always)]
fn to_whole(value: f64) -> u32 {
    (value + TO_BITS).to_bits() as u32
}

/// The larger of two numbers that are not NaN.
#[inline(always)]
fn more(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The smaller of two numbers that are not NaN.
#[inline(always)]
fn less(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// As [`more`].
#[inline(always)]
fn more_f32(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// As [`less`].
#[inline(always)]
fn less_f32(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Twice the area of a triangle; negative if it shows its back.
#[inline(always)]
fn doubled_area([a, b, c]: [[f64; 2]; 3]) -> f64 {
    cross(between(a, b), between(a, c))
}

/// Twice the area of a quad; negative if it shows its back.
#[inline(always)]
fn doubled_quad_area([a, b, c, d]: [[f64; 2]; 4]) -> f64 {
    cross(between(a, c), between(b, d))
}

#[inline(always)]
fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

#[inline(always)]
fn between(from: [f64; 2], to: [f64; 2]) -> [f64; 2] {
    [to[0] - from[0], to[1] - from[1]]
}

/// The values of a corner that are interpolated.
#[inline(always)]
fn values<V: Simd>(simd: V, corner: &Corner) -> f32x4<V> {
    f32x4::load_array_ref(simd, &corner.values)
}

/// Values that are linear in the image: nearness, and three values divided by distance.
pub(super) struct Plane<V: Simd> {
    /// The position of `start`, in pixels.
    from: [f64; 2],
    start: f32x4<V>,
    /// The change per pixel, to the right and downwards.
    pub(super) right: f32x4<V>,
    pub(super) down: f32x4<V>,
    /// Nearness with higher precision: of two surfaces that meet, the same one must be in front everywhere.
    nearness: [f64; 3],
}

impl<V: Simd> Plane<V> {
    #[inline(always)]
    fn new(
        simd: V,
        corners: [&Corner; 4],
        whole: [[f64; 2]; 4],
        area: f64,
        steps_per_pixel: f64,
    ) -> Self {
        let [a, b, c, d] = corners;
        let fine = [a.fine(), b.fine(), c.fine(), d.fine()];
        let fine_area = doubled_quad_area(fine);
        // Interpolating between rounded corners would tilt a surface seen at an angle. For a sliver they must do.
        let is_sliver = (fine_area - area).abs() > 0.5 * area;
        let ([pa, pb, pc, pd], area) = if is_sliver { (whole, area) } else { (fine, fine_area) };
        // What changes along the diagonals determines the plane, and it passes through the mean of the corners.
        let over_area = steps_per_pixel / area;
        let (ac, bd) = (between(pa, pc), between(pb, pd));
        let ac = [ac[0] * over_area, ac[1] * over_area];
        let bd = [bd[0] * over_area, bd[1] * over_area];
        let quarter = 0.25 / steps_per_pixel;
        let from =
            [(pa[0] + pb[0] + pc[0] + pd[0]) * quarter, (pa[1] + pb[1] + pc[1] + pd[1]) * quarter];
        let (na, nb) = (f64::from(a.nearness), f64::from(b.nearness));
        let (nc, nd) = (f64::from(c.nearness), f64::from(d.nearness));
        let (to_c, to_d) = (nc - na, nd - nb);
        let nearness =
            [(na + nb + nc + nd) * 0.25, to_c * bd[1] - to_d * ac[1], to_d * ac[0] - to_c * bd[0]];
        let va = values(simd, a) * a.nearness;
        let vb = values(simd, b) * b.nearness;
        let vc = values(simd, c) * c.nearness;
        let vd = values(simd, d) * d.nearness;
        let (to_c, to_d) = (vc - va, vd - vb);
        Self {
            from,
            start: ((va + vc) + (vb + vd)) * 0.25,
            right: to_c * bd[1] as f32 - to_d * ac[1] as f32,
            down: to_d * ac[0] as f32 - to_c * bd[0] as f32,
            nearness,
        }
    }

    /// Nearness at a position in pixels.
    #[inline(always)]
    pub(super) fn nearness(&self, [x, y]: [f64; 2]) -> f32 {
        let [start, right, down] = self.nearness;
        (start + right * (x - self.from[0]) + down * (y - self.from[1])) as f32
    }

    /// Nearness, less precise than [`Self::nearness`], and the three values divided by distance.
    #[inline(always)]
    pub(super) fn values(&self, [x, y]: [f64; 2]) -> f32x4<V> {
        let (x, y) = ((x - self.from[0]) as f32, (y - self.from[1]) as f32);
        self.start + self.right * x + self.down * y
    }
}

/// What is the same for all blocks of a quad.
pub(super) struct Quad<V: Simd, const M: usize> {
    pub(super) plane: Plane<V>,
    /// The change of the plane's values to each pixel of a block.
    pub(super) slopes: [f32x16<V>; 4],
    /// The change of nearness from the centre of a pixel to its samples.
    depths: [f32; M],
    /// To the farthest and to the nearest sample of a block.
    deepest: DepthOffset,
    shallowest: DepthOffset,
    /// The nearness of the nearest corner.
    nearest: f32,
    /// The change of each edge function to each pixel of a block, and to the samples of a pixel.
    lanes: [i32x16<V>; 4],
    samples: [[i32; M]; 4],
    /// Minimum and maximum of the corners' values.
    pub(super) least: [f32; 4],
    pub(super) most: [f32; 4],
}

/// The change of nearness from the centre of a block's first pixel to a sample: to the sample's pixel, and within it.
#[derive(Clone, Copy)]
struct DepthOffset {
    pixel: f32,
    sample: f32,
}

impl DepthOffset {
    /// The nearness there, rounded as for the samples of a block.
    #[inline(always)]
    fn from(self, nearness: f32) -> f32 {
        self.pixel + (nearness + self.sample)
    }
}

/// Offsets of the pixels of a block from the first, to the right and downwards.
const COLUMN: PixelLanes<f32> = [0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3.];
const LINE: PixelLanes<f32> = [0., 0., 0., 0., 1., 1., 1., 1., 2., 2., 2., 2., 3., 3., 3., 3.];

impl<V: Simd, const M: usize> Quad<V, M> {
    /// The quad with these corners, which are at `whole` on the grid and enclose half of `area`; not 0.
    #[inline(always)]
    fn new(
        simd: V,
        corners: [&Corner; 4],
        whole: [[f64; 2]; 4],
        area: f64,
        edges: &Edges<V>,
        bits: u32,
    ) -> Self {
        let steps_per_pixel = f64::from(1_u32 << bits);
        let plane = Plane::new(simd, corners, whole, area, steps_per_pixel);
        let (rights, downs) = (plane.right.to_array(), plane.down.to_array());
        let mut slopes = [f32x16::splat(simd, 0.0); 4];
        for value in 0..4 {
            slopes[value] = f32x16::load_array(simd, COLUMN) * rights[value]
                + f32x16::load_array(simd, LINE) * downs[value];
        }
        let mut depths = [0.0; M];
        for (depth, [x, y]) in depths.iter_mut().zip(samples::<M>()) {
            *depth = (rights[0] * (x - 8) as f32 + downs[0] * (y - 8) as f32) / 16.0;
        }
        // Rounding keeps order, so these are the extremes of what is computed for the lanes.
        let [across, along] = [rights[0], downs[0]].map(|change| change * (SIDE - 1) as f32);
        let deepest = DepthOffset {
            pixel: less_f32(across, 0.0) + less_f32(along, 0.0),
            sample: depths.into_iter().fold(f32::INFINITY, less_f32),
        };
        let shallowest = DepthOffset {
            pixel: more_f32(across, 0.0) + more_f32(along, 0.0),
            sample: depths.into_iter().fold(f32::NEG_INFINITY, more_f32),
        };

        let edge_rights = (edges.x + TO_BITS).bitcast::<u64x4<V>>().to_array();
        let edge_downs = (edges.y + TO_BITS).bitcast::<u64x4<V>>().to_array();
        let mut lanes = [i32x16::splat(simd, 0); 4];
        let mut sample_offsets = [[0; M]; 4];
        for edge in 0..4 {
            let (right, down) = (edge_rights[edge] as i32, edge_downs[edge] as i32);
            lanes[edge] = edge_lanes(simd, right, down, bits);
            for (offset, [x, y]) in sample_offsets[edge].iter_mut().zip(samples::<M>()) {
                let (x, y) = (x << (bits - 4), y << (bits - 4));
                *offset = right.wrapping_mul(x).wrapping_add(down.wrapping_mul(y));
            }
        }

        let [a, b, c, d] = corners;
        let (a_values, b_values) = (values(simd, a), values(simd, b));
        let (c_values, d_values) = (values(simd, c), values(simd, d));
        Self {
            plane,
            slopes,
            depths,
            deepest,
            shallowest,
            nearest: more_f32(more_f32(a.nearness, b.nearness), more_f32(c.nearness, d.nearness)),
            lanes,
            samples: sample_offsets,
            least: a_values.min(b_values).min(c_values.min(d_values)).to_array(),
            most: a_values.max(b_values).max(c_values.max(d_values)).to_array(),
        }
    }
}

/// The blocks of a quad's bounding box: first and last column and row.
struct BlockRange {
    first: [i32; 2],
    last: [i32; 2],
}

impl BlockRange {
    /// The blocks around these corners. `None` if no sample lies in the box.
    #[inline(always)]
    fn around<const M: usize>(
        [a, b, c, d]: [&Corner; 4],
        bits: u32,
        canvas: &SampledImage<M>,
    ) -> Option<Self> {
        let low = [
            a.at[0].min(b.at[0]).min(c.at[0].min(d.at[0])),
            a.at[1].min(b.at[1]).min(c.at[1].min(d.at[1])),
        ];
        let high = [
            a.at[0].max(b.at[0]).max(c.at[0].max(d.at[0])),
            a.at[1].max(b.at[1]).max(c.at[1].max(d.at[1])),
        ];
        if misses_samples::<M>(low[0], high[0], bits) || misses_samples::<M>(low[1], high[1], bits)
        {
            return None;
        }
        let to_block = bits + SIDE.trailing_zeros();
        let first = [(low[0] >> to_block).max(0), (low[1] >> to_block).max(0)];
        let last = [
            (high[0] >> to_block).min(canvas.columns as i32 - 1),
            (high[1] >> to_block).min(canvas.rows as i32 - 1),
        ];
        (first[0] <= last[0] && first[1] <= last[1]).then_some(Self { first, last })
    }

    /// The columns of blocks that the edges may cover in a row in whose first column the edge functions are `row_start`.
    #[inline(always)]
    fn columns<V: Simd>(&self, simd: V, edges: &Edges<V>, row_start: f64x4<V>) -> Range<usize> {
        let (first, last) = (self.first[0], self.last[0]);
        if last - first < SLIM {
            return first as usize..last as usize + 1;
        }
        let [low, high] = edges.narrow(simd, row_start, f64::from(first), f64::from(last));
        if low > high {
            return 0..0;
        }
        // A block that an edge crosses is kept.
        to_whole(low.ceil()) as usize..to_whole(high.floor()) as usize + 1
    }
}

/// Draws a quad whose corners are clockwise in the image's coordinates, whose rows count downwards.
#[inline(always)]
fn fill<V: Simd, const M: usize, H: Shader>(
    simd: V,
    canvas: &mut SampledImage<M>,
    grid: &Grid,
    corners: [&Corner; 4],
    shader: &H,
) {
    let Some(range) = BlockRange::around(corners, grid.bits, canvas) else { return };
    let [a, b, c, d] = corners;
    let whole = [a.whole(), b.whole(), c.whole(), d.whole()];
    let area = doubled_quad_area(whole);
    if area <= 0.0 {
        return;
    }
    let steps_per_block = SIDE as f64 * f64::from(1_u32 << grid.bits);
    let edges = Edges::new(simd, whole, steps_per_block);
    let quad = Quad::new(simd, corners, whole, area, &edges, grid.bits);
    let background = canvas.background();
    for row in range.first[1]..=range.last[1] {
        let row_start = edges.start + edges.y * (f64::from(row) * steps_per_block);
        let columns = range.columns(simd, &edges, row_start);
        let y = f64::from(row) * SIDE as f64 + 0.5;
        let mut column = columns.start as f64 - 1.0;
        for (block, state) in canvas.blocks(row as usize, columns) {
            column += 1.0;
            let at = [column * SIDE as f64 + 0.5, y];
            let nearness = quad.plane.nearness(at);
            if !state.may_show(less_f32(quad.shallowest.from(nearness), quad.nearest)) {
                continue;
            }
            let block_start = row_start + edges.x * (column * steps_per_block);
            if block_start.simd_lt(-edges.rise).any_true() {
                continue;
            }
            let crossing = block_start.simd_lt(-edges.fall).to_bitmask();
            // Far inside an edge the value is clamped to one that fits into 32 bits.
            let inside = block_start.min(-edges.fall) + TO_BITS;
            let inside = inside.bitcast::<u64x4<V>>().to_array();
            let inside = [inside[0] as i32, inside[1] as i32, inside[2] as i32, inside[3] as i32];
            let part = QuadPart { simd, quad: &quad, at, nearness, inside, crossing };
            part.draw(shader, block, state, background);
        }
    }
}

/// Computes the colours of a block.
pub(super) trait Shader {
    /// RGBA with red in the lowest byte, for each pixel of the block.
    fn colours<V: Simd, const M: usize>(&self, part: &QuadPart<'_, V, M>) -> u32x16<V>;
}

/// The part of a quad that lies in one block.
pub(super) struct QuadPart<'a, V: Simd, const M: usize> {
    pub(super) simd: V,
    pub(super) quad: &'a Quad<V, M>,
    /// The centre of the block's first pixel, in pixels, and the nearness there.
    pub(super) at: [f64; 2],
    pub(super) nearness: f32,
    /// The edge functions at the block's corner.
    inside: [i32; 4],
    /// One bit for each edge that crosses the block.
    crossing: u64,
}

impl<V: Simd, const M: usize> QuadPart<'_, V, M> {
    /// Draws the samples that are nearer than those already there.
    #[inline(always)]
    fn draw(
        &self,
        shader: &impl Shader,
        block: &mut SampleBlock<M>,
        state: BlockState<'_>,
        background: u32,
    ) {
        let simd = self.simd;
        let mut depths = [f32x16::splat(simd, 0.0); M];
        for (depth, offset) in depths.iter_mut().zip(self.quad.depths) {
            *depth = self.quad.slopes[0] + (self.nearness + offset);
        }
        let mut shows = [mask32x16::splat(simd, true); M];
        let is_inside = self.crossing == 0;
        let mut shows_all = is_inside && state.is_untouched();
        if !shows_all {
            if state.is_untouched() {
                block.depth = [[0.0; PIXELS]; M];
                block.colour[0] = [background; PIXELS];
                *state.farthest = 0.0;
            }
            let mut any = mask32x16::splat(simd, false);
            let mut all = mask32x16::splat(simd, true);
            let outside = self.outside();
            for s in 0..M {
                let before = f32x16::load_array_ref(simd, &block.depth[s]);
                if !is_inside {
                    // What the quad does not cover is behind everything.
                    let nothing = f32x16::splat(simd, -1.0);
                    depths[s] = outside[s].simd_ge(0).select(depths[s], nothing);
                }
                shows[s] = depths[s].simd_gt(before);
                any |= shows[s];
                all &= shows[s];
            }
            if !any.any_true() {
                return;
            }
            shows_all = all.all_true();
        }
        let colours = shader.colours(self);
        if shows_all {
            for (depth, place) in depths.into_iter().zip(&mut block.depth) {
                depth.store_array(place);
            }
            colours.store_array(&mut block.colour[0]);
            *state.farthest = self.quad.deepest.from(self.nearness);
            *state.is_flat = true;
            return;
        }
        let mut least = f32x16::splat(simd, f32::INFINITY);
        // The first sample last: in a flat block it has the colours of all.
        for s in (0..M).rev() {
            let before = f32x16::load_array_ref(simd, &block.depth[s]);
            // Selecting by `shows` gives the same, but as a masked store, which is slow on AMD's processors without AVX-512.
            let depth = depths[s].max(before);
            depth.store_array(&mut block.depth[s]);
            least = least.min(depth);
            let before = &block.colour[if *state.is_flat { 0 } else { s }];
            let before = u32x16::load_array_ref(simd, before);
            shows[s].select(colours, before).store_array(&mut block.colour[s]);
        }
        *state.farthest = least.reduce_min();
        *state.is_flat = M == 1;
    }

    /// For each sample of each pixel, a negative number if it is not covered.
    #[inline(always)]
    fn outside(&self) -> [i32x16<V>; M] {
        let Quad { lanes, samples, .. } = self.quad;
        let mut signs = [i32x16::splat(self.simd, 0); M];
        for i in 0..4 {
            // With one sample there is less to save than it costs to ask.
            if M == 1 || self.crossing & 1 << i != 0 {
                for s in 0..M {
                    signs[s] |= lanes[i] + self.inside[i].wrapping_add(samples[i][s]);
                }
            }
        }
        signs
    }
}

/// Whether no sample lies between two positions along an axis.
#[inline(always)]
fn misses_samples<const M: usize>(low: i32, high: i32, bits: u32) -> bool {
    // One sample is at the centre of the pixel; four are at the centres of its quarters along each axis.
    let spacing = bits - M.trailing_zeros();
    let half = 1 << spacing >> 1;
    (low - half + (1 << spacing) - 1) >> spacing > (high - half) >> spacing
}
