//! A painter of label plates for tests: racks without anything else in front of a mottled background.

use shm_types::camera::{CAMERA_HEIGHT_M, focal_length_px};
use shm_types::plate::{
    BAND_RGB, BANDS, CENTRE_HEIGHT_M, FACE_OFFSET_M, FRAME_M, FRAME_RGB, Plate, SIZE_M,
};

use super::plates::Sighting;
use crate::FrameView;

/// A picture that owns its pixels.
pub(super) struct Picture {
    width: u32,
    pixels: Vec<u8>,
}

/// Where the four samples of a pixel lie, as a graphics device places them.
const SAMPLES: [(f32, f32); 4] = [(0.375, 0.125), (0.875, 0.375), (0.125, 0.625), (0.625, 0.875)];

impl Picture {
    /// A square picture of the background alone, a different one for each `seed`.
    pub(super) fn background(width: u32, seed: u32) -> Self {
        let mottle = |i: u32| {
            let (x, y) = (i % width / 24, i / width / 24);
            let hash = (x * 7919 + y * 104_729 + seed * 1_299_709).wrapping_mul(2_654_435_761);
            90 + (hash >> 27) as u8
        };
        let pixels = (0..width * width).flat_map(|i| {
            let grey = mottle(i);
            [grey, grey, grey.saturating_add(9), 255]
        });
        Self { width, pixels: pixels.collect() }
    }

    /// Adds plates; of two that overlap, the nearer one is seen.
    pub(super) fn with(mut self, plates: &[Sighting]) -> Self {
        let mut plates = plates.to_vec();
        plates.sort_by_key(|plate| std::cmp::Reverse(plate.ahead));
        for plate in plates {
            self.paint(&plate);
        }
        self
    }

    pub(super) fn view(&self, id: u64) -> FrameView<'_> {
        FrameView { id, width: self.width, height: self.width, pixels: &self.pixels }
    }

    fn paint(&mut self, sighting: &Sighting) {
        for y in 0..self.width / 2 {
            for x in 0..self.width {
                let point = |(dx, dy)| self.on_plate(sighting, x as f32 + dx, y as f32 + dy);
                let inside = |&(across, down): &(f32, f32)| {
                    (0.0..1.0).contains(&across) && (0.0..1.0).contains(&down)
                };
                let covered = SAMPLES.iter().filter_map(|&s| point(s)).filter(inside).count();
                let Some(centre) = point((0.5, 0.5)).filter(|_| covered > 0) else { continue };
                let colour = colour_at(sighting.plate, centre);
                let at = 4 * (y * self.width + x) as usize;
                for (pixel, new) in self.pixels[at..at + 3].iter_mut().zip(colour) {
                    let mix = usize::from(*pixel) * (4 - covered) + usize::from(new) * covered;
                    *pixel = (mix / 4) as u8;
                }
            }
        }
    }

    /// Where the line of sight through a point of the picture meets the plate's plane, as shares of the
    /// plate's width and height.
    fn on_plate(&self, sighting: &Sighting, x: f32, y: f32) -> Option<(f32, f32)> {
        let focal = focal_length_px(self.width);
        let centre = self.width as f32 / 2.0;
        let (right, up) = ((x - centre) / focal, (centre - y) / focal);
        let face_m = 0.5 - FACE_OFFSET_M;
        let (ahead, across) = match sighting.face {
            0 => {
                let ahead = f32::from(sighting.ahead) + face_m;
                (ahead, right * ahead - f32::from(sighting.right))
            }
            1 => {
                let ahead = (f32::from(sighting.right) + face_m) / right;
                (ahead, f32::from(sighting.ahead) - ahead)
            }
            _ => {
                let ahead = (f32::from(sighting.right) - face_m) / right;
                (ahead, ahead - f32::from(sighting.ahead))
            }
        };
        let down = CENTRE_HEIGHT_M - CAMERA_HEIGHT_M - up * ahead;
        (ahead > 0.0).then_some((across / SIZE_M + 0.5, down / SIZE_M + 0.5))
    }
}

/// The colour the simulator's shader gives a point of a plate.
fn colour_at(plate: Plate, (across, down): (f32, f32)) -> [u8; 3] {
    let frame = FRAME_M / SIZE_M;
    let inside = |at: f32| (at - frame) / (1.0 - 2.0 * frame);
    let (across, down) = (inside(across), inside(down));
    if !(0.0..1.0).contains(&across) || !(0.0..1.0).contains(&down) {
        return FRAME_RGB;
    }
    BAND_RGB[usize::from(plate.0[(down * BANDS as f32) as usize])]
}
