//! The three ways of colouring pixels (lit, label plate, text), as in the shaders of the GPU backend.

use fearless_simd::{
    Bytes, Select, Simd, SimdBase, SimdFloat, SimdInt, SimdMask, f32x4, f32x16, i32x16, u32x4,
    u32x16,
};

use super::canvas::PIXELS;
use super::corner::Corner;
use super::fill::{Quad, QuadPart, Shader};
use super::geometry::Atlas;

const OPAQUE: u32 = 0xff00_0000;

/// Adding this to a float from 0 to 255 leaves the nearest integer in its lowest byte and zeros in the two above.
const TO_WHOLE: f32 = 8_388_608.0;

#[inline(always)]
fn packed<V: Simd>(simd: V, [r, g, b]: [f32x16<V>; 3]) -> u32x16<V> {
    u32x16::splat(simd, OPAQUE) | whole(r) | (whole(g) << 8) | (whole(b) << 16)
}

#[inline(always)]
fn whole<V: Simd>(channel: f32x16<V>) -> u32x16<V> {
    (channel + TO_WHOLE).bitcast::<u32x16<V>>()
}

/// The first `N` values of a quad, interpolated at each pixel of a block.
#[inline(always)]
fn values<V: Simd, const M: usize, const N: usize>(part: &QuadPart<'_, V, M>) -> [f32x16<V>; N] {
    let &QuadPart { simd, quad, at, nearness, .. } = part;
    let start = quad.plane.values(at).to_array();
    let distance = f32x16::splat(simd, 1.0) / (quad.slopes[0] + nearness);
    let mut values = [distance; N];
    for i in 0..N {
        let value = (quad.slopes[1 + i] + start[1 + i]) * distance;
        // Outside the quad, where a pixel's centre may lie, values are clamped to those of the corners.
        values[i] = value.max(quad.least[1 + i]).min(quad.most[1 + i]);
    }
    values
}

/// A surface whose colours differ by no more has one, halfway between.
const UNIFORM: f32 = 2.0;

/// Lit surfaces. The values are colours, 0 to 255.
pub(super) struct LitShader {
    /// The colour of the whole surface, if it has only one.
    uniform: Option<u32>,
}

impl LitShader {
    /// For a surface with these corners.
    #[inline(always)]
    pub(super) fn new<V: Simd>(simd: V, [a, b, c, d]: [&Corner; 4]) -> Self {
        let a = f32x4::load_array_ref(simd, &a.values);
        let b = f32x4::load_array_ref(simd, &b.values);
        let c = f32x4::load_array_ref(simd, &c.values);
        let d = f32x4::load_array_ref(simd, &d.values);
        let (least, most) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
        if (most - least).simd_gt(UNIFORM).any_true() {
            return Self { uniform: None };
        }
        let [_, r, g, b] = ((least + most) * 0.5 + TO_WHOLE).bitcast::<u32x4<V>>().to_array();
        Self { uniform: Some(OPAQUE | r & 0xff | (g & 0xff) << 8 | (b & 0xff) << 16) }
    }
}

impl Shader for LitShader {
    #[inline(always)]
    fn colours<V: Simd, const M: usize>(&self, part: &QuadPart<'_, V, M>) -> u32x16<V> {
        match self.uniform {
            Some(colour) => u32x16::splat(part.simd, colour),
            None => packed(part.simd, values(part)),
        }
    }
}

/// Label plates: exact colours, decided at the centre of a pixel. The values are the position on the plate.
pub(super) struct PlateShader {
    pub(super) code: u32,
}

impl Shader for PlateShader {
    #[inline(always)]
    fn colours<V: Simd, const M: usize>(&self, part: &QuadPart<'_, V, M>) -> u32x16<V> {
        let share = plates::FRAME_M / plates::SIZE_M;
        let simd = part.simd;
        let [x, y] = values(part);
        let x = (x - share) / (1.0 - 2.0 * share);
        let y = (y - share) / (1.0 - 2.0 * share);
        let inside = x.simd_ge(0.0) & x.simd_lt(1.0) & y.simd_ge(0.0) & y.simd_lt(1.0);
        let bands = plates::BANDS as u32;
        let row = (y.max(0.0).min(1.0) * plates::BANDS as f32).to_int::<u32x16<V>>();
        let place = inside.select(row.min(bands - 1), u32x16::splat(simd, bands));
        let bits = u32x16::splat(simd, self.code) >> (place * 3);
        // Bit 0 becomes the lowest byte, and so on.
        let spread = (bits & 1) | ((bits & 2) << 7) | ((bits & 4) << 14);
        (spread * 0xff) | OPAQUE
    }
}

/// The text atlas with four texels per word: a texel, its right neighbour, and the two below.
pub(super) struct Lettering {
    size: [f32; 2],
    levels: Vec<Vec<u32>>,
}

impl Lettering {
    pub(super) fn new(atlas: &Atlas) -> Self {
        let level = |(level, texels): (usize, &Vec<u8>)| {
            let [width, height] = [atlas.width >> level, atlas.height >> level].map(|n| n as usize);
            // The last texels of rows and columns are their own neighbours.
            let row = |y: usize| &texels[y.min(height - 1) * width..][..width];
            let mut quads = Vec::with_capacity(width * height);
            for (row, below) in (0..height).map(|y| (row(y), row(y + 1))) {
                let neighbours = row.array_windows().zip(below.array_windows());
                quads.extend(neighbours.map(|(&[a, b], &[c, d])| u32::from_le_bytes([a, b, c, d])));
                let [a, c] = [row[width - 1], below[width - 1]];
                quads.push(u32::from_le_bytes([a, a, c, c]));
            }
            quads
        };
        Self {
            size: [atlas.width as f32, atlas.height as f32],
            levels: atlas.levels.iter().enumerate().map(level).collect(),
        }
    }
}

/// Text: ink on paper. The values are the position in the atlas.
pub(super) struct TextShader<'a> {
    pub(super) lettering: &'a Lettering,
    pub(super) ink: [u8; 4],
    pub(super) paper: [u8; 4],
}

/// As in `text.wgsl`.
const TAPS: f32 = 3.0;

impl TextShader<'_> {
    /// The coverage, 0 to 255, interpolated between the four nearest texels.
    #[inline(always)]
    fn coverage<V: Simd>(&self, simd: V, level: usize, [u, v]: [f32x16<V>; 2]) -> f32x16<V> {
        let texels = &self.lettering.levels[level];
        let scale = 1.0 / (1_u32 << level) as f32;
        let [width, height] = [self.lettering.size[0] * scale, self.lettering.size[1] * scale];
        let x = (u * width - 0.5).max(0.0).min(width - 1.0);
        let y = (v * height - 0.5).max(0.0).min(height - 1.0);
        let (left, top) = (x.to_int::<i32x16<V>>(), y.to_int::<i32x16<V>>());
        let places = (top * (width as i32) + left).bitcast::<u32x16<V>>().to_array();
        let last = texels.len() - 1;
        let mut quads = [0; PIXELS];
        for lane in 0..PIXELS {
            quads[lane] = texels[last.min(places[lane] as usize)];
        }
        let quads = u32x16::load_array(simd, quads);
        let right = x - left.to_float::<f32x16<V>>();
        let down = y - top.to_float::<f32x16<V>>();
        let (a, b) = (texel(quads), texel(quads >> 8));
        let (c, d) = (texel(quads >> 16), texel(quads >> 24));
        let upper = a + (b - a) * right;
        let lower = c + (d - c) * right;
        upper + (lower - upper) * down
    }
}

/// The texel in the lowest byte.
#[inline(always)]
fn texel<V: Simd>(quads: u32x16<V>) -> f32x16<V> {
    (quads & 0xff).to_float::<f32x16<V>>()
}

/// The level of detail whose texels are nearest in size to `texels` texels of the finest level.
fn level(texels: f32, levels: usize) -> usize {
    // Texels of level n are 2^n wide. The geometric mean with the next level is 2^(n + 1/2).
    let squared = texels * texels;
    let finer = (0..levels - 1).take_while(|&n| squared >= (2_u32 << (2 * n)) as f32);
    finer.count()
}

/// The change of a quad's first two values per pixel, to the right and downwards.
#[inline(always)]
fn changes<V: Simd, const M: usize>(quad: &Quad<V, M>, at: [f64; 2]) -> [[f32; 2]; 2] {
    let plane = &quad.plane;
    let distance = 1.0 / plane.nearness(at);
    let values = plane.values(at) * distance;
    let right = ((plane.right - values * plane.right.to_array()[0]) * distance).to_array();
    let down = ((plane.down - values * plane.down.to_array()[0]) * distance).to_array();
    [[right[1], right[2]], [down[1], down[2]]]
}

impl Shader for TextShader<'_> {
    #[inline(always)]
    fn colours<V: Simd, const M: usize>(&self, part: &QuadPart<'_, V, M>) -> u32x16<V> {
        let &QuadPart { simd, quad, at, .. } = part;
        let [u, v] = values(part);
        // One level of detail for the whole block, computed at its centre.
        let changes = changes(quad, [at[0] + 1.5, at[1] + 1.5]);
        let size = self.lettering.size;
        let mut lengths = [0.0; 2];
        for i in 0..2 {
            let (x, y) = (changes[i][0] * size[0], changes[i][1] * size[1]);
            lengths[i] = (x * x + y * y).sqrt();
        }
        let stretch = changes[usize::from(lengths[0] <= lengths[1])];
        let [du, dv] = [stretch[0] / TAPS, stretch[1] / TAPS];
        let longest = lengths[0].max(lengths[1]);
        let shortest = lengths[0].min(lengths[1]);
        let level = level(shortest.max(longest / TAPS), self.lettering.levels.len());
        let coverage = self.coverage(simd, level, [u - du, v - dv])
            + self.coverage(simd, level, [u, v])
            + self.coverage(simd, level, [u + du, v + dv]);
        let coverage = coverage / (TAPS * 255.0);
        let mut channels = [coverage; 3];
        for (channel, (ink, paper)) in channels.iter_mut().zip(self.ink.into_iter().zip(self.paper))
        {
            let (ink, paper) = (f32::from(ink), f32::from(paper));
            *channel = coverage * (ink - paper) + paper;
        }
        packed(simd, channels)
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;

    #[test]
    fn levels_change_at_the_geometric_mean() {
        let at = |texels| level(texels, 6);
        assert_eq!([0.3, 1.0, 1.41, 1.42, 2.0, 2.82, 2.83].map(at), [0, 0, 0, 1, 1, 1, 2]);
        assert_eq!((at(1e9), at(f32::NAN)), (5, 0));
    }

    #[test]
    fn colours_are_rounded_to_the_nearest_byte() {
        let rgba = dispatch!(Level::new(), simd => {
            let channel = |value: f32| f32x16::splat(simd, value);
            packed(simd, [channel(0.0), channel(254.6), channel(10.4)]).to_array()
        });
        assert_eq!(rgba, [0xff0a_ff00; PIXELS]);
    }
}
