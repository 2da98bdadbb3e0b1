//! Colour and depth of the image being drawn, in blocks of 4 x 4 pixels. The samples of a block lie side by side, so that a
//! block is a few vector registers and stays in the first-level cache.

use std::ops::Range;

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

/// What is known about a block without reading its samples.
pub(super) struct BlockState<'a> {
    /// The depth of the farthest sample. Nothing behind it is visible.
    pub(super) farthest: &'a mut f32,
    /// Whether the samples of each pixel have one colour: then the first sample's is theirs, and the others' are not
    /// stored.
    pub(super) is_flat: &'a mut bool,
}

impl BlockState<'_> {
    /// Whether something as near as `nearest` may be visible.
    #[inline(always)]
    pub(super) fn may_show(&self, nearest: f32) -> bool {
        nearest > *self.farthest
    }

    /// Whether nothing has been drawn into the block: its samples are not stored either.
    #[inline(always)]
    pub(super) fn is_untouched(&self) -> bool {
        *self.farthest == UNTOUCHED
    }
}

/// An image with `M` samples per pixel.
pub(super) struct SampledImage<const M: usize> {
    /// Blocks per row, and rows of blocks.
    pub(super) columns: usize,
    pub(super) rows: usize,
    blocks: Vec<SampleBlock<M>>,
    /// The fields of [`BlockState`] lie apart, because depth is read far more often.
    farthest: Vec<f32>,
    is_flat: Vec<bool>,
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
            is_flat: vec![true; columns * rows],
            background: 0,
        }
    }

    /// Begins an image that is `background` where nothing is drawn.
    pub(super) fn clear(&mut self, background: u32) {
        self.farthest.fill(UNTOUCHED);
        self.is_flat.fill(true);
        self.background = background;
    }

    /// Some blocks of a row, whose samples may be all overwritten, and their states, to be updated. An untouched block has
    /// any samples.
    #[inline(always)]
    pub(super) fn blocks(
        &mut self,
        row: usize,
        columns: Range<usize>,
    ) -> impl Iterator<Item = (&mut SampleBlock<M>, BlockState<'_>)> {
        let start = row * self.columns;
        let places = start + columns.start..start + columns.end;
        let states =
            self.farthest[places.clone()].iter_mut().zip(&mut self.is_flat[places.clone()]);
        let states = states.map(|(farthest, is_flat)| BlockState { farthest, is_flat });
        self.blocks[places].iter_mut().zip(states)
    }

    /// The colour where nothing is drawn.
    #[inline(always)]
    pub(super) fn background(&self) -> u32 {
        self.background
    }

    /// Finishes the image and writes it: RGBA in rows from the top, as many as fit into `pixels`.
    #[inline(always)]
    pub(super) fn resolve<V: Simd>(&mut self, simd: V, pixels: &mut [u8]) {
        const BLOCK_LINE: usize = 4 * SIDE;
        let Self { columns, background, .. } = *self;
        let row_bytes = columns * BLOCK_LINE;
        let states = self.farthest.chunks_exact(columns).zip(self.is_flat.chunks_exact(columns));
        let rows = self.blocks.chunks_exact_mut(columns).zip(states);
        for (band, (blocks, (farthest, is_flat))) in pixels.chunks_mut(row_bytes * SIDE).zip(rows) {
            for ((block, &farthest), &is_flat) in blocks.iter_mut().zip(farthest).zip(is_flat) {
                if farthest == UNTOUCHED {
                    block.colour[0] = [background; PIXELS];
                } else if M > 1 && !is_flat {
                    block.colour[0] = mix(simd, &block.colour).to_array();
                }
            }
            for (line, pixels) in band.chunks_exact_mut(row_bytes).enumerate() {
                let places = pixels.as_chunks_mut::<BLOCK_LINE>().0;
                for (block, place) in blocks.iter().zip(places) {
                    let colours = block.colour[0].as_chunks::<SIDE>().0[line];
                    *place = bytemuck::cast(colours);
                }
            }
        }
    }
}

/// The mean of the samples, rounded half up; two channels at a time.
#[inline(always)]
fn mix<V: Simd, const M: usize>(simd: V, samples: &[PixelLanes<u32>; M]) -> u32x16<V> {
    const EVERY_OTHER: u32 = 0x00ff_00ff;
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
    fn flat_blocks_show_their_first_sample() {
        let mut canvas = SampledImage::<4>::new(64, 4);
        let mut pixels = vec![0; 64 * 4 * 4];
        canvas.clear(0);
        let (block, state) = canvas.blocks(0, 15..16).next().expect("a block");
        block.colour = [1, 2, 3, 4].map(|sample| [sample << 4; PIXELS]);
        *state.farthest = 0.5;
        for (is_flat, expected) in [(true, 0x10), (false, 0x28)] {
            let (_, state) = canvas.blocks(0, 15..16).next().expect("a block");
            *state.is_flat = is_flat;
            dispatch!(Level::new(), simd => canvas.resolve(simd, &mut pixels));
            let last = pixels.as_chunks::<4>().0.last();
            assert_eq!(last, Some(&[expected, 0, 0, 0]));
        }
    }

    #[test]
    fn untouched_blocks_show_the_background() {
        let mut canvas = SampledImage::<4>::new(64, 6);
        let mut pixels = vec![0; 64 * 6 * 4];
        for _ in 0..2 {
            canvas.clear(0xff33_2211);
            dispatch!(Level::new(), simd => canvas.resolve(simd, &mut pixels));
            assert!(pixels.chunks_exact(4).all(|pixel| pixel == [0x11, 0x22, 0x33, 0xff]));
            let (block, state) = canvas.blocks(0, 3..4).next().expect("a block");
            block.colour = [[0; PIXELS]; 4];
            *state.farthest = 0.5;
            assert!(state.may_show(0.6) && !state.may_show(0.5));
        }
    }
}
