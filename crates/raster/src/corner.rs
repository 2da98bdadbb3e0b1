//! Transforms vertices to positions in the image, sixteen at a time.

use bytemuck::Zeroable;
use fearless_simd::{Select, Simd, SimdBase, SimdFloat, f32x16, i32x16};

use super::canvas::{PIXELS, PixelLanes};
use super::geometry::{FOG_PER_M, FOG_RGB, NEAR_M, Placement};

/// Quads are clipped this far outside of the image, so that numbers stay small.
const GUARD: f32 = 2.0;

/// Sub-pixel bits of images with sides of up to 1024 pixels. Larger images have fewer.
const SUBPIXEL_BITS: u32 = 8;

/// The bit in [`Corner::beyond`] of corners whose quads must be clipped.
pub(super) const TO_CUT: i32 = 1 << 5;

/// A vertex in the image.
#[derive(Debug, Clone, Copy, PartialEq, Zeroable)]
#[repr(C, align(16))]
pub(super) struct Corner {
    /// 1 and the values to be interpolated.
    pub(super) values: [f32; 4],
    /// Clip space: x and y divided by `ahead` are the position in the image, -1 to 1.
    pub(super) x: f32,
    pub(super) y: f32,
    /// Metres along the optical axis.
    pub(super) ahead: f32,
    pub(super) nearness: f32,
    /// The position in grid steps from the top left corner, exact and rounded.
    pub(super) fine: [f32; 2],
    pub(super) at: [i32; 2],
    /// One bit for each side of the image that it lies beyond (right, left, above, below), one if it is behind the camera, and
    /// one if its quads must be clipped.
    pub(super) beyond: i32,
}

impl Corner {
    /// The exact position.
    #[inline(always)]
    pub(super) fn fine(&self) -> [f64; 2] {
        [f64::from(self.fine[0]), f64::from(self.fine[1])]
    }

    /// The rounded position.
    #[inline(always)]
    pub(super) fn whole(&self) -> [f64; 2] {
        [f64::from(self.at[0]), f64::from(self.at[1])]
    }
}

/// The sub-pixel grid that vertices are snapped to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    /// A pixel is 2^bits steps wide.
    pub(super) bits: u32,
    /// Half the width and height of the image, in steps.
    half: [f32; 2],
}

impl Grid {
    pub(super) fn new(width_px: u32, height_px: u32) -> Self {
        let larger = width_px.max(height_px).div_ceil(1024).next_power_of_two().trailing_zeros();
        let bits = SUBPIXEL_BITS - larger.min(4);
        let half = [width_px, height_px].map(|side| 0.5 * (side << bits) as f32);
        Self { bits, half }
    }
}

/// Moves vertices of a mesh to their places in the image.
pub(super) struct Transform<'a> {
    grid: &'a Grid,
    /// Column by column.
    clip_from_world: [[f32; 4]; 4],
    placement: Placement,
}

impl<'a> Transform<'a> {
    /// Leaves meshes where their vertices say.
    pub(super) fn new(grid: &'a Grid, clip_from_world: [[f32; 4]; 4]) -> Self {
        Self { grid, clip_from_world, placement: Placement::IDENTITY }
    }

    /// The same with meshes moved to `placement`.
    pub(super) fn at(&self, placement: Placement) -> Self {
        Self { placement, ..*self }
    }

    /// Transforms sixteen vertices, as the shaders do.
    #[inline(always)]
    fn place<V: Simd>(&self, simd: V, sixteen: &Sixteen, corners: &mut [Corner; PIXELS]) {
        let mut components = [f32x16::splat(simd, 0.0); COMPONENTS];
        for (component, lanes) in components.iter_mut().zip(&sixteen.0) {
            *component = f32x16::load_array_ref(simd, lanes);
        }
        let [x, y, z, takes_fog, values @ ..] = components;
        let Placement { at, turn } = self.placement;
        let east = x * turn[0] - y * turn[1] + at[0];
        let north = x * turn[1] + y * turn[0] + at[1];
        let m = &self.clip_from_world;
        let x = east * m[0][0] + north * m[1][0] + z * m[2][0] + m[3][0];
        let y = east * m[0][1] + north * m[1][1] + z * m[2][1] + m[3][1];
        let ahead = east * m[0][3] + north * m[1][3] + z * m[2][3] + m[3][3];
        let nearness = f32x16::splat(simd, 1.0) / ahead;
        let [half_width, half_height] = self.grid.half;
        let right = x * nearness * half_width + half_width;
        let down = y * nearness * -half_height + half_height;

        let guard = ahead * GUARD;
        let is_kept = ahead.simd_ge(NEAR_M) & x.abs().simd_le(guard) & y.abs().simd_le(guard);
        let outside = [
            x.simd_gt(ahead),
            x.simd_lt(-ahead),
            y.simd_gt(ahead),
            y.simd_lt(-ahead),
            ahead.simd_lt(NEAR_M),
            !is_kept,
        ];
        let mut beyond = i32x16::splat(simd, 0);
        for (bit, outside) in outside.into_iter().enumerate() {
            beyond |= outside.select(i32x16::splat(simd, 1 << bit), i32x16::splat(simd, 0));
        }

        let fog = (ahead * FOG_PER_M).max(0.0).min(1.0) * takes_fog;
        let mut shaded = [[0.0; PIXELS]; 3];
        for i in 0..3 {
            let value = values[i];
            shaded[i] = (value + (-value + FOG_RGB[i] * 255.0) * fog).to_array();
        }
        let (x, y) = (x.to_array(), y.to_array());
        let (ahead, nearness) = (ahead.to_array(), nearness.to_array());
        // The grid position of a corner that has to be clipped is never used.
        let whole_right = (right + 0.5).floor().to_int::<i32x16<V>>().to_array();
        let whole_down = (down + 0.5).floor().to_int::<i32x16<V>>().to_array();
        let (right, down) = (right.to_array(), down.to_array());
        let beyond = beyond.to_array();
        for lane in 0..PIXELS {
            corners[lane] = Corner {
                values: [1.0, shaded[0][lane], shaded[1][lane], shaded[2][lane]],
                x: x[lane],
                y: y[lane],
                ahead: ahead[lane],
                nearness: nearness[lane],
                fine: [right[lane], down[lane]],
                at: [whole_right[lane], whole_down[lane]],
                beyond: beyond[lane],
            };
        }
    }
}

/// x, y, z in metres, the share of fog, and three values.
const COMPONENTS: usize = 7;

/// Sixteen vertices, component by component.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Sixteen([PixelLanes<f32>; COMPONENTS]);

/// The vertices of a layer.
pub(super) struct Vertices(Vec<Sixteen>);

impl Vertices {
    /// From positions, shares of fog, and values.
    pub(super) fn new(vertices: impl ExactSizeIterator<Item = ([f32; 3], f32, [f32; 3])>) -> Self {
        let mut packed = Vec::with_capacity(vertices.len().div_ceil(PIXELS));
        for (number, ([x, y, z], fog, [a, b, c])) in vertices.enumerate() {
            if number % PIXELS == 0 {
                packed.push(Sixteen([[0.0; PIXELS]; COMPONENTS]));
            }
            if let Some(Sixteen(components)) = packed.last_mut() {
                for (component, value) in components.iter_mut().zip([x, y, z, fog, a, b, c]) {
                    component[number % PIXELS] = value;
                }
            }
        }
        Self(packed)
    }
}

/// A cache of the vertices of a layer that have been transformed for the current view.
pub(super) struct Corners {
    placed: Vec<[Corner; PIXELS]>,
    /// The value of `now` when each sixteen were transformed.
    stamps: Vec<u32>,
    now: u32,
}

impl Corners {
    /// An empty cache.
    pub(super) fn new(vertices: &Vertices) -> Self {
        let sixteens = vertices.0.len();
        Self { placed: bytemuck::zeroed_vec(sixteens), stamps: vec![0; sixteens], now: 0 }
    }

    /// Empties the cache.
    pub(super) fn forget(&mut self) {
        self.now = self.now.wrapping_add(1);
        if self.now == 0 {
            self.stamps.fill(0);
            self.now = 1;
        }
    }

    /// The corners of a quad.
    #[inline(always)]
    pub(super) fn quad<V: Simd>(
        &mut self,
        simd: V,
        transform: &Transform<'_>,
        vertices: &Vertices,
        indices: [u32; 4],
    ) -> [&Corner; 4] {
        for index in indices {
            let sixteen = index as usize / PIXELS;
            if self.stamps[sixteen] != self.now {
                self.stamps[sixteen] = self.now;
                transform.place(simd, &vertices.0[sixteen], &mut self.placed[sixteen]);
            }
        }
        let at =
            |i: usize| &self.placed[indices[i] as usize / PIXELS][indices[i] as usize % PIXELS];
        [at(0), at(1), at(2), at(3)]
    }
}

const PLANES: usize = 5;

/// The distance of a corner inside each clipping plane.
fn planes(corner: &Corner) -> [f32; PLANES] {
    let Corner { x, y, ahead, .. } = *corner;
    let guard = GUARD * ahead;
    [ahead - NEAR_M, guard - x, guard + x, guard - y, guard + y]
}

/// A clipped quad. Every plane adds at most one corner.
pub(super) struct Polygon {
    corners: [Corner; 4 + PLANES],
    len: usize,
}

impl Polygon {
    /// Clips a quad at every plane.
    #[inline(never)]
    pub(super) fn inside(corners: [&Corner; 4], grid: &Grid) -> Self {
        let mut polygon = Self { corners: [Corner::zeroed(); 4 + PLANES], len: 4 };
        for (place, corner) in polygon.corners.iter_mut().zip(corners) {
            *place = *corner;
        }
        for plane in 0..PLANES {
            polygon.cut(plane);
        }
        let [half_width, half_height] = grid.half;
        for corner in &mut polygon.corners[..polygon.len] {
            let nearness = 1.0 / corner.ahead;
            let right = corner.x * nearness * half_width + half_width;
            let down = corner.y * nearness * -half_height + half_height;
            corner.nearness = nearness;
            corner.fine = [right, down];
            corner.at = [(right + 0.5).floor() as i32, (down + 0.5).floor() as i32];
        }
        polygon
    }

    pub(super) fn corners(&self) -> &[Corner] {
        &self.corners[..self.len]
    }

    /// Clips at plane number `plane`.
    fn cut(&mut self, plane: usize) {
        let before = self.corners;
        let len = std::mem::take(&mut self.len);
        for i in 0..len {
            let (this, next) = (before[i], before[(i + 1) % len]);
            let (here, there) = (planes(&this)[plane], planes(&next)[plane]);
            if here >= 0.0 {
                self.push(this);
            }
            // Always from the inside out, so that neighbours are clipped at the same point.
            if here >= 0.0 && there < 0.0 {
                self.push(between(&this, &next, here / (here - there)));
            } else if here < 0.0 && there >= 0.0 {
                self.push(between(&next, &this, there / (there - here)));
            }
        }
    }

    fn push(&mut self, corner: Corner) {
        if let Some(place) = self.corners.get_mut(self.len) {
            *place = corner;
            self.len += 1;
        }
    }
}

/// The corner at this share of the way. Its position in the image is computed later.
fn between(from: &Corner, to: &Corner, share: f32) -> Corner {
    let mix = |a: f32, b: f32| a + (b - a) * share;
    Corner {
        values: std::array::from_fn(|i| mix(from.values[i], to.values[i])),
        x: mix(from.x, to.x),
        y: mix(from.y, to.y),
        ahead: mix(from.ahead, to.ahead),
        ..*from
    }
}
