//! Synthetic images of label plates for tests, in front of a mottled background.

use super::read::{Landmark, Sighting};
use crate::{BAND_RGB, BANDS, CENTRE_HEIGHT_M, FACE_OFFSET_M, FRAME_M, FRAME_RGB, Plate, SIZE_M};
use domain::camera::{CAMERA_HEIGHT_M, focal_length_px};
use domain::{Cell, Heading, Pose};

/// A square image of plates.
#[derive(Debug)]
pub struct PlateImage {
    width: u32,
    pixels: Vec<u8>,
}

/// Where the four samples of a pixel lie, as a graphics device places them.
const SAMPLES: [(f32, f32); 4] = [(0.375, 0.125), (0.875, 0.375), (0.125, 0.625), (0.625, 0.875)];

impl PlateImage {
    /// The background, a different one for each `seed`.
    pub fn background(width: u32, seed: u32) -> Self {
        let mottle = |i: u32| {
            let (x, y) = (i % width / 24, i / width / 24);
            let place = (x * 7919 + y).wrapping_mul(104_729);
            let hash = seed.wrapping_mul(1_299_709).wrapping_add(place).wrapping_mul(2_654_435_761);
            90 + (hash >> 27) as u8
        };
        let pixels = (0..width * width).flat_map(|i| {
            let grey = mottle(i);
            [grey, grey, grey.saturating_add(9), 255]
        });
        Self { width, pixels: pixels.collect() }
    }

    /// Adds plates; nearer ones hide those behind.
    pub fn with(mut self, plates: &[Sighting]) -> Self {
        let mut plates = plates.to_vec();
        plates.sort_by_key(|plate| std::cmp::Reverse(plate.ahead));
        for plate in plates {
            self.paint(&plate);
        }
        self
    }

    /// Pixels in a row, and rows.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// RGBA, rows top to bottom.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    fn paint(&mut self, sighting: &Sighting) {
        let across = |x| self.on_plate(sighting, x as f32, 0.0).map_or(-1.0, |(across, _)| across);
        let meets = |x: &u32| {
            let (from, to) = (across(*x), across(*x + 1));
            from.max(to) >= 0.0 && from.min(to) < 1.0
        };
        for x in (0..self.width).filter(meets).collect::<Vec<_>>() {
            for y in 0..self.width / 2 {
                self.paint_pixel(sighting, x, y);
            }
        }
    }

    fn paint_pixel(&mut self, sighting: &Sighting, x: u32, y: u32) {
        let point = |(dx, dy)| self.on_plate(sighting, x as f32 + dx, y as f32 + dy);
        let inside = |&(across, down): &(f32, f32)| {
            (0.0..1.0).contains(&across) && (0.0..1.0).contains(&down)
        };
        let covered = SAMPLES.iter().filter_map(|&sample| point(sample)).filter(inside).count();
        let Some(centre) = point((0.5, 0.5)).filter(|_| covered > 0) else { return };
        let colour = colour_at(sighting.plate, centre);
        let at = 4 * (y * self.width + x) as usize;
        for (pixel, new) in self.pixels[at..at + 3].iter_mut().zip(colour) {
            let mix = usize::from(*pixel) * (4 - covered) + usize::from(new) * covered;
            *pixel = (mix / 4) as u8;
        }
    }

    /// Where the ray through a point of the image meets the plate's plane, in units of the plate's size.
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

/// The colour of a point of a plate, as in the simulator's shader.
fn colour_at(plate: Plate, (across, down): (f32, f32)) -> [u8; 3] {
    let frame = FRAME_M / SIZE_M;
    let inside = |at: f32| (at - frame) / (1.0 - 2.0 * frame);
    let (across, down) = (inside(across), inside(down));
    if !(0.0..1.0).contains(&across) || !(0.0..1.0).contains(&down) {
        return FRAME_RGB;
    }
    BAND_RGB[usize::from(plate.0[(down * BANDS as f32) as usize])]
}

/// A straight aisle two cells wide, x = 10 and 11, running north from y = 10 to 19. Each rack face has a
/// plate with its own type; those on the west side are of category "barrels", on the east side "cones".
#[derive(Debug)]
pub struct PlateAisle {
    /// Every plate in it.
    pub landmarks: Vec<Landmark>,
}

impl PlateAisle {
    /// The aisle.
    #[expect(clippy::new_without_default, reason = "there is one aisle")]
    pub fn new() -> Self {
        let side = |x, face, category| {
            (10..20).map(move |y| Landmark {
                standpoint: Cell::new(x, y),
                face,
                plate: Plate::new(category, &format!("{category} {y}")),
            })
        };
        let west = side(10, Heading::W, "barrels");
        Self { landmarks: west.chain(side(11, Heading::E, "cones")).collect() }
    }

    /// The view from `pose`, five cells far.
    pub fn picture(&self, pose: Pose) -> PlateImage {
        let seen: Vec<_> =
            self.landmarks.iter().filter_map(|landmark| seen(landmark, pose)).collect();
        let Cell { x, y } = pose.cell;
        let seed = (u32::from(x) * 256 + u32::from(y)) * 4 + pose.heading as u32;
        PlateImage::background(448, seed).with(&seen)
    }
}

fn seen(landmark: &Landmark, pose: Pose) -> Option<Sighting> {
    let (ahead, right) = pose.offset_of(landmark.standpoint);
    let face = pose.heading.quarters_to(landmark.face);
    let visible = match face {
        0 => (0..=5).contains(&ahead) && right.abs() <= ahead,
        1 => (1..=5).contains(&ahead) && (0..ahead).contains(&right),
        3 => (1..=5).contains(&ahead) && (0..ahead).contains(&-right),
        _ => false,
    };
    let (ahead, right) = (ahead as i8, right as i8);
    visible.then_some(Sighting { ahead, right, face, plate: landmark.plate })
}
