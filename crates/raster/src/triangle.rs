//! From three corners to the samples that they cover.
//!
//! Corners are snapped to a grid finer than the samples', and what is inside is decided in whole numbers: an
//! edge that two triangles share belongs to one of them, whatever they are, so no gap opens between them and
//! no sample is drawn twice.

use fearless_simd::{
    Bytes, Select, Simd, SimdBase, SimdMask, f32x4, f32x16, f64x4, i32x16, mask32x16, u32x16, u64x4,
};

use super::canvas::{Block, Canvas, Lanes, SIDE};
use super::corner::{Corner, Grid, Polygon, TO_CUT};
use super::shade::Shader;

/// Where the samples of a pixel lie, in sixteenths of it: Vulkan's standard places.
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

/// Draws a triangle if it shows its front: its corners are counter-clockwise in the picture then.
#[inline(always)]
pub(super) fn draw<V: Simd, const M: usize, H: Shader>(
    simd: V,
    canvas: &mut Canvas<M>,
    grid: &Grid,
    corners: &[Corner; 3],
    shader: &H,
) {
    let [a, b, c] = corners;
    // Wholly beyond one side of the picture, or behind.
    if a.beyond & b.beyond & c.beyond & !TO_CUT != 0 {
        return;
    }
    let polygon;
    let corners = if (a.beyond | b.beyond | c.beyond) & TO_CUT == 0 {
        &corners[..]
    } else {
        polygon = Polygon::inside(corners, grid);
        polygon.corners()
    };
    for i in 2..corners.len() {
        // Rows count downwards, so this way round the doubled area is positive.
        fill(simd, canvas, grid, [&corners[0], &corners[i], &corners[i - 1]], shader);
    }
}

/// The three edges, a fourth that everything is inside of beside them: how far inside a grid point is, times the
/// edge's length. Whole numbers that a float holds.
struct Edges<V: Simd> {
    /// The change a grid step to the right and downwards.
    x: f64x4<V>,
    y: f64x4<V>,
    /// At the picture's top left corner; below 0 is outside.
    start: f64x4<V>,
    /// The most and the least that it changes within a block.
    rise: f64x4<V>,
    fall: f64x4<V>,
    /// 1 / the change a block to the left.
    slant: f64x4<V>,
}

/// In blocks, more than rounding can move the place where an edge crosses a row.
const SLACK: f64 = 1e-3;

/// Added to a whole number, it leaves its lowest bits as those of the sum.
const TO_BITS: f64 = 6_755_399_441_055_744.0;

impl<V: Simd> Edges<V> {
    /// From corner to corner, as often as it takes to come around.
    #[inline(always)]
    fn new(simd: V, [a, b, c]: [[f64; 2]; 3], step: f64) -> Self {
        let x0 = f64x4::load_array(simd, [a[0], b[0], c[0], 0.0]);
        let y0 = f64x4::load_array(simd, [a[1], b[1], c[1], 0.0]);
        let x1 = f64x4::load_array(simd, [b[0], c[0], a[0], 0.0]);
        let y1 = f64x4::load_array(simd, [b[1], c[1], a[1], 0.0]);
        let (x, y) = (y0 - y1, x1 - x0);
        let zero = f64x4::splat(simd, 0.0);
        // A point on an edge belongs to the triangle of which it is a left or top one.
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

    /// The first and the last of the columns from `low` to `high` of the blocks that these edges leave, in a row in
    /// whose first column they are at `inside`. It may be one too many.
    #[inline(always)]
    fn narrow(&self, simd: V, inside: f64x4<V>, low: f64, high: f64) -> [f64; 2] {
        // Half more than a whole number, so that an upright edge has all columns inside, or none.
        let cross = (inside + self.rise + 0.5) * self.slant;
        let zero = f64x4::splat(simd, 0.0);
        let least = self.x.simd_ge(zero).select(cross - SLACK, zero + low).to_array();
        let most = self.x.simd_lt(zero).select(cross + SLACK, zero + high).to_array();
        [
            more(more(least[0], least[1]), more(least[2], low)),
            less(less(most[0], most[1]), less(most[2], high)),
        ]
    }
}

/// The change of an edge to each pixel of a block.
#[inline(always)]
fn edge_lanes<V: Simd>(simd: V, right: i32, down: i32, bits: u32) -> i32x16<V> {
    const COLUMN: Lanes<i32> = [0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3];
    const LINE: Lanes<i32> = [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3];
    i32x16::load_array(simd, COLUMN) * (right << bits)
        + i32x16::load_array(simd, LINE) * (down << bits)
}

/// A whole number of at most 32 bits.
#[inline(always)]
fn to_whole(value: f64) -> u32 {
    (value + TO_BITS).to_bits() as u32
}

/// The greater of two that are numbers.
#[inline(always)]
fn more(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The smaller of two that are numbers.
#[inline(always)]
fn less(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// Twice the area of a triangle, below 0 the other way round.
#[inline(always)]
fn doubled_area([a, b, c]: [[f64; 2]; 3]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Values that are linear in the picture: nearness, and three values over the distance.
pub(super) struct Plane<V: Simd> {
    /// Where they are at `start`, in pixels.
    from: [f64; 2],
    start: f32x4<V>,
    /// The change a pixel, to the right and downwards.
    pub(super) right: f32x4<V>,
    pub(super) down: f32x4<V>,
    /// Nearness alone, finer: of two surfaces that meet, the same one has to be in front however far they reach.
    nearness: [f64; 3],
}

impl<V: Simd> Plane<V> {
    #[inline(always)]
    fn new(simd: V, corners: [&Corner; 3], whole: [[f64; 2]; 3], area: f64, one: f64) -> Self {
        let [a, b, c] = corners;
        let fine = [
            [f64::from(a.fine[0]), f64::from(a.fine[1])],
            [f64::from(b.fine[0]), f64::from(b.fine[1])],
            [f64::from(c.fine[0]), f64::from(c.fine[1])],
        ];
        let fine_area = doubled_area(fine);
        // Between the whole places of corners, a surface seen aslant would be tilted. Of a splinter no more is known.
        let is_splinter = (fine_area - area).abs() > 0.5 * area;
        let ([pa, pb, pc], area) = if is_splinter { (whole, area) } else { (fine, fine_area) };
        let over_area = one / area;
        let ab = [(pb[0] - pa[0]) * over_area, (pb[1] - pa[1]) * over_area];
        let ac = [(pc[0] - pa[0]) * over_area, (pc[1] - pa[1]) * over_area];
        let start = f64::from(a.nearness);
        let (to_b, to_c) = (f64::from(b.nearness) - start, f64::from(c.nearness) - start);
        let nearness = [start, to_b * ac[1] - to_c * ab[1], to_c * ab[0] - to_b * ac[0]];

        let start = f32x4::load_array_ref(simd, &a.values) * a.nearness;
        let to_b = f32x4::load_array_ref(simd, &b.values) * b.nearness - start;
        let to_c = f32x4::load_array_ref(simd, &c.values) * c.nearness - start;
        Self {
            from: [pa[0] / one, pa[1] / one],
            start,
            right: to_b * ac[1] as f32 - to_c * ab[1] as f32,
            down: to_c * ab[0] as f32 - to_b * ac[0] as f32,
            nearness,
        }
    }

    /// Nearness at a place in pixels.
    #[inline(always)]
    pub(super) fn nearness(&self, [x, y]: [f64; 2]) -> f32 {
        let [start, right, down] = self.nearness;
        (start + right * (x - self.from[0]) + down * (y - self.from[1])) as f32
    }

    /// The three values over the distance, after one that is not as fine as [`Self::nearness`].
    #[inline(always)]
    pub(super) fn values(&self, [x, y]: [f64; 2]) -> f32x4<V> {
        let (x, y) = ((x - self.from[0]) as f32, (y - self.from[1]) as f32);
        self.start + self.right * x + self.down * y
    }
}

/// What all blocks of a triangle share.
pub(super) struct Triangle<V: Simd, const M: usize> {
    pub(super) plane: Plane<V>,
    /// The change of the plane's values to each pixel of a block.
    pub(super) slopes: [f32x16<V>; 4],
    /// The change of nearness from the middle of a pixel to its samples.
    depths: [f32; M],
    /// The change of each edge to each pixel of a block, and to the samples of a pixel.
    lanes: [i32x16<V>; 3],
    samples: [[i32; M]; 3],
    /// The least and the most of the corners' values.
    pub(super) least: [f32; 4],
    pub(super) most: [f32; 4],
}

/// How far to the right, and how far down, the pixels of a block lie from the first.
const COLUMN: Lanes<f32> = [0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3., 0., 1., 2., 3.];
const LINE: Lanes<f32> = [0., 0., 0., 0., 1., 1., 1., 1., 2., 2., 2., 2., 3., 3., 3., 3.];

#[inline(always)]
fn fill<V: Simd, const M: usize, H: Shader>(
    simd: V,
    canvas: &mut Canvas<M>,
    grid: &Grid,
    [a, b, c]: [&Corner; 3],
    shader: &H,
) {
    let bits = grid.bits;
    // None, if it lies between all samples.
    let low = [a.at[0].min(b.at[0]).min(c.at[0]), a.at[1].min(b.at[1]).min(c.at[1])];
    let high = [a.at[0].max(b.at[0]).max(c.at[0]), a.at[1].max(b.at[1]).max(c.at[1])];
    if misses_samples::<M>(low[0], high[0], bits) || misses_samples::<M>(low[1], high[1], bits) {
        return;
    }
    // The blocks that it may touch.
    let to_block = bits + SIDE.trailing_zeros();
    let first = [(low[0] >> to_block).max(0), (low[1] >> to_block).max(0)];
    let last = [
        (high[0] >> to_block).min(canvas.columns as i32 - 1),
        (high[1] >> to_block).min(canvas.rows as i32 - 1),
    ];
    if first[0] > last[0] || first[1] > last[1] {
        return;
    }
    let whole = [
        [f64::from(a.at[0]), f64::from(a.at[1])],
        [f64::from(b.at[0]), f64::from(b.at[1])],
        [f64::from(c.at[0]), f64::from(c.at[1])],
    ];
    let area = doubled_area(whole);
    if area <= 0.0 {
        return;
    }

    let one = f64::from(1_u32 << bits);
    let step = SIDE as f64 * one;
    let edges = Edges::new(simd, whole, step);

    let plane = Plane::new(simd, [a, b, c], whole, area, one);
    let [va, vb, vc] = [
        f32x4::load_array_ref(simd, &a.values),
        f32x4::load_array_ref(simd, &b.values),
        f32x4::load_array_ref(simd, &c.values),
    ];

    let (rights, downs) = (plane.right.to_array(), plane.down.to_array());
    let mut slopes = [f32x16::splat(simd, 0.0); 4];
    for i in 0..4 {
        slopes[i] = f32x16::load_array(simd, COLUMN) * rights[i]
            + f32x16::load_array(simd, LINE) * downs[i];
    }
    let (x, y) = (edges.x.to_array(), edges.y.to_array());
    let mut depths = [0.0; M];
    for (depth, [dx, dy]) in depths.iter_mut().zip(samples::<M>()) {
        *depth = (rights[0] * (dx - 8) as f32 + downs[0] * (dy - 8) as f32) / 16.0;
    }
    let mut offsets = [[0; M]; 3];
    let mut lanes = [i32x16::splat(simd, 0); 3];
    for i in 0..3 {
        let (right, down) = (x[i] as i32, y[i] as i32);
        lanes[i] = edge_lanes(simd, right, down, bits);
        for (offset, [dx, dy]) in offsets[i].iter_mut().zip(samples::<M>()) {
            let (dx, dy) = (dx << (bits - 4), dy << (bits - 4));
            *offset = right.wrapping_mul(dx).wrapping_add(down.wrapping_mul(dy));
        }
    }
    let triangle = Triangle {
        plane,
        slopes,
        depths,
        lanes,
        samples: offsets,
        least: va.min(vb).min(vc).to_array(),
        most: va.max(vb).max(vc).to_array(),
    };

    // How much nearer than in the middle of a block's first pixel it can be within the block: at samples up to half a
    // pixel before that, and to the right of it and below; and a little for rounding.
    let nearest = a.nearness.max(b.nearness).max(c.nearness);
    let [right, down] = [rights[0], downs[0]];
    let nearer = SIDE as f32 * (right.max(0.0) + down.max(0.0))
        + 0.5 * (right.abs() + down.abs())
        + nearest * 1e-5;
    for row in first[1]..=last[1] {
        let starts = edges.start + edges.y * (f64::from(row) * step);
        let [low, high] = edges.narrow(simd, starts, f64::from(first[0]), f64::from(last[0]));
        if low > high {
            continue;
        }
        // A crossing within a block leaves it.
        let (begin, end) = (to_whole(low.ceil()) as usize, to_whole(high.floor()) as usize + 1);
        let place = row as usize * canvas.columns;
        let y = (row as usize * SIDE) as f64 + 0.5;
        for number in begin..end {
            let at = [(number * SIDE) as f64 + 0.5, y];
            let nearness = triangle.plane.nearness(at);
            let limit = if nearness + nearer < nearest { nearness + nearer } else { nearest };
            if !canvas.may_show(place + number, limit) {
                continue;
            }
            let here = starts + edges.x * (number as f64 * step);
            // Far inside of an edge, just inside says the same, and fits.
            let here = here.min(-edges.fall) + TO_BITS;
            let inside = here.bitcast::<u64x4<V>>().to_array();
            let inside = [inside[0] as i32, inside[1] as i32, inside[2] as i32];
            let part = Part { simd, triangle: &triangle, at, nearness, inside };
            let (block, farthest) = canvas.block(place + number);
            part.draw(shader, block, farthest);
        }
    }
}

/// The part of a triangle that lies in one block.
pub(super) struct Part<'a, V: Simd, const M: usize> {
    pub(super) simd: V,
    pub(super) triangle: &'a Triangle<V, M>,
    /// The middle of the block's first pixel, in pixels, and the nearness there.
    pub(super) at: [f64; 2],
    pub(super) nearness: f32,
    /// The edges at the block's corner.
    inside: [i32; 3],
}

impl<V: Simd, const M: usize> Part<'_, V, M> {
    /// Draws it where it is nearer than what is there.
    #[inline(always)]
    fn draw(&self, shader: &impl Shader, block: &mut Block<M>, farthest: &mut f32) {
        let simd = self.simd;
        let mut shows = [mask32x16::splat(simd, false); M];
        let mut depths = [f32x16::splat(simd, 0.0); M];
        let mut any = mask32x16::splat(simd, false);
        for s in 0..M {
            depths[s] = self.triangle.slopes[0] + (self.nearness + self.triangle.depths[s]);
            let before = f32x16::load_array_ref(simd, &block.depth[s]);
            shows[s] = self.covered(s) & depths[s].simd_gt(before);
            any |= shows[s];
        }
        if !any.any_true() {
            return;
        }
        let colours = shader.colours(self);
        let mut least = f32x16::splat(simd, f32::INFINITY);
        for s in 0..M {
            let before = f32x16::load_array_ref(simd, &block.depth[s]);
            let depth = shows[s].select(depths[s], before);
            depth.store_array(&mut block.depth[s]);
            least = least.min(depth);
            let before = u32x16::load_array_ref(simd, &block.colour[s]);
            shows[s].select(colours, before).store_array(&mut block.colour[s]);
        }
        *farthest = least.reduce_min();
    }

    /// The pixels whose sample number `sample` it covers.
    #[inline(always)]
    fn covered(&self, sample: usize) -> mask32x16<V> {
        let Triangle { lanes, samples, .. } = self.triangle;
        let mut sign = lanes[0] + self.inside[0].wrapping_add(samples[0][sample]);
        for i in 1..3 {
            sign |= lanes[i] + self.inside[i].wrapping_add(samples[i][sample]);
        }
        sign.simd_ge(0)
    }
}

/// Whether no sample lies between two places along an axis.
#[inline(always)]
fn misses_samples<const M: usize>(low: i32, high: i32, bits: u32) -> bool {
    // One sample in the middle of a pixel; of four, one in the middle of every quarter.
    let spacing = bits - M.trailing_zeros();
    let half = 1 << spacing >> 1;
    (low - half + (1 << spacing) - 1) >> spacing > (high - half) >> spacing
}
