//! Colour and depth of the image being drawn, in blocks of 4 x 4 pixels. The samples of a block lie side by side, so that a
//! block is a few vector registers and stays in the first-level cache.

use fearless_simd::{Simd, SimdBase, u32x16};

/// Pixels along a side of a block.
pub(super) const SIDE: usize = 4;

/// Pixels of a block, and lanes of a vector.
pub(super) const PIXELS: usize = SIDE * SIDE;

/// A value for every pixel of a block, row by row.
pub(super) type PixelLanes<T> = [T; PIXELS];

/// The depth of blocks that nothing has been drawn into.
const UNTOUCHED: f32 = -1.0;

/// The samples of a block.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct SampleBlock<const M: usize> {
    /// 1 / distance ahead in metres: larger is nearer, 0 is infinitely far away.
    pub(super) depth: [PixelLanes<f32>; M],
    /// RGBA with red in the lowest byte.
    pub(super) colour: [PixelLanes<u32>; M],
}

/// An image with `M` samples per pixel.
pub(super) struct SampledImage<const M: usize> {
    /// Blocks per row, and rows of blocks.
    pub(super) columns: usize,
    pub(super) rows: usize,
    blocks: Vec<SampleBlock<M>>,
    /// The depth of each block's farthest sample. Nothing behind it is visible.
    farthest: Vec<f32>,
    background: u32,
}

impl<const M: usize> SampledImage<M> {
    pub(super) fn new(width_px: u32, height_px: u32) -> Self {
        let columns = (width_px as usize).div_ceil(SIDE);
        let rows = (height_px as usize).div_ceil(SIDE);
        let empty = SampleBlock { depth: [[0.0; PIXELS]; M], colour: [[0; PIXELS]; M] };
        Self {
            columns,
            rows,
            blocks: vec![empty; columns * rows],
            farthest: vec![UNTOUCHED; columns * rows],
            background: 0,
        }
    }

    /// Begins an image that is `background` where nothing is drawn. Blocks are cleared when something is first drawn into
    /// them.
    pub(super) fn clear(&mut self, background: u32) {
        self.farthest.fill(UNTOUCHED);
        self.background = background;
    }

    /// Whether something as near as `nearest` may be visible in block `place`.
    #[inline(always)]
    pub(super) fn may_show(&self, place: usize, nearest: f32) -> bool {
        nearest > self.farthest[place]
    }

    /// Block `place`, to be drawn into, and the depth of its farthest sample, to be updated.
    #[inline(always)]
    pub(super) fn block(&mut self, place: usize) -> (&mut SampleBlock<M>, &mut f32) {
        let (block, farthest) = (&mut self.blocks[place], &mut self.farthest[place]);
        if *farthest == UNTOUCHED {
            *farthest = 0.0;
            for sample in 0..M {
                block.depth[sample] = [0.0; PIXELS];
                block.colour[sample] = [self.background; PIXELS];
            }
        }
        (block, farthest)
    }

    /// Writes the finished image: RGBA in rows from the top, as many as fit into `pixels`.
    #[inline(always)]
    pub(super) fn resolve<V: Simd>(&self, simd: V, pixels: &mut [u8]) {
        let row_bytes = self.columns * SIDE * 4;
        for (row, band) in pixels.chunks_mut(row_bytes * SIDE).enumerate() {
            for column in 0..self.columns {
                let place = row * self.columns + column;
                let mut mixed = [self.background; PIXELS];
                if self.farthest[place] != UNTOUCHED {
                    mix(simd, &self.blocks[place].colour).store_array(&mut mixed);
                }
                let lines = band.chunks_exact_mut(row_bytes);
                for (line, mixed) in lines.zip(mixed.chunks_exact(SIDE)) {
                    line[column * 4 * SIDE..][..4 * SIDE]
                        .copy_from_slice(bytemuck::cast_slice(mixed));
                }
            }
        }
    }
}

/// The mean of the samples, rounded half up; two channels at a time.
#[inline(always)]
fn mix<V: Simd, const M: usize>(simd: V, samples: &[PixelLanes<u32>; M]) -> u32x16<V> {
    const EVERY_OTHER: u32 = 0x00ff_00ff;
    if M == 1 {
        return u32x16::load_array_ref(simd, &samples[0]);
    }
    let half = u32x16::splat(simd, M as u32 / 2 * 0x0001_0001);
    let shift = M.trailing_zeros();
    let (mut even, mut odd) = (half, half);
    for sample in samples {
        let sample = u32x16::load_array_ref(simd, sample);
        even += sample & EVERY_OTHER;
        odd += (sample >> 8) & EVERY_OTHER;
    }
    ((even >> shift) & EVERY_OTHER) | (((odd >> shift) & EVERY_OTHER) << 8)
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;

    fn mixed<const M: usize>(samples: [PixelLanes<u32>; M]) -> PixelLanes<u32> {
        dispatch!(Level::new(), simd => mix(simd, &samples).to_array())
    }

    #[test]
    fn samples_are_averaged_per_channel() {
        let samples = [0xff00_0000, 0xff00_01ff, 0xff00_02ff, 0xff00_03ff].map(|c| [c; PIXELS]);
        // Means 255, 0, 1.5 and 191.25.
        assert_eq!(mixed(samples), [0xff00_02bf; PIXELS]);
        assert_eq!(mixed([[0x1234_5678; PIXELS]]), [0x1234_5678; PIXELS]);
    }

    #[test]
    fn untouched_blocks_show_the_background() {
        let mut canvas = SampledImage::<4>::new(64, 6);
        let mut pixels = vec![0; 64 * 6 * 4];
        for _ in 0..2 {
            canvas.clear(0xff33_2211);
            dispatch!(Level::new(), simd => canvas.resolve(simd, &mut pixels));
            assert!(pixels.chunks_exact(4).all(|pixel| pixel == [0x11, 0x22, 0x33, 0xff]));
            let (block, farthest) = canvas.block(3);
            block.colour = [[0; PIXELS]; 4];
            *farthest = 0.5;
            assert!(canvas.may_show(3, 0.6) && !canvas.may_show(3, 0.5));
        }
    }
}
