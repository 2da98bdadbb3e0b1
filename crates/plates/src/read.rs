//! Reads label plates in an image: their content and position relative to the camera.
//!
//! The camera is level, so all of a plate in one pixel column has the same distance. The plate's known height then fixes
//! where its frame and bands are in the column. A column reading is a run of pixels with magenta at both ends and a band
//! colour at each of the six places between. Columns vote for a plate; plates are centred on bays, so rounding gives their
//! position.
//!
//! Plates that are hidden, cut off or too far away are not found.

use crate::{BAND_RGB, BANDS, CENTRE_HEIGHT_M, FACE_OFFSET_M, FRAME_M, FRAME_RGB, Plate, SIZE_M};
use domain::camera::{CAMERA_HEIGHT_M, focal_length_px};
use domain::{Cell, Heading, Pose};

/// How far above the camera a plate's lower edge is, in metres.
const BOTTOM_M: f32 = CENTRE_HEIGHT_M - CAMERA_HEIGHT_M - SIZE_M / 2.0;

/// Height of one band, in metres.
const BAND_M: f32 = (SIZE_M - 2.0 * FRAME_M) / BANDS as f32;

/// Distance between a cell's centre and a plate on the face of the rack beside it, in metres.
const PLATE_M: f32 = 0.5 - FACE_OFFSET_M;

/// Minimum number of pixels per metre: the bands are 1.4 pixels high then.
const LEAST_SCALE: f32 = 28.0;

/// Largest difference to the exact channel values of a band.
const TOLERANCE: u8 = 48;

/// Largest deviation of a frame edge from its expected position, in pixels.
const SLACK_PX: f32 = 1.3;

/// Largest width or height of an image, in pixels.
const LARGEST_SIDE: usize = 16_384;

/// A plate relative to the camera: the cell in front of its item, and the heading towards it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Sighting {
    /// Cells ahead of the camera.
    pub ahead: i8,
    /// Cells to the right of the camera; negative to the left.
    pub right: i8,
    /// Right turns from the camera's heading to the heading towards the rack: 0, 1 or 3.
    pub face: i8,
    /// The plate.
    pub plate: Plate,
}

/// A plate in the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Landmark {
    /// The cell in front of the item.
    pub standpoint: Cell,
    /// The heading from there to the rack.
    pub face: Heading,
    /// The plate.
    pub plate: Plate,
}

impl Sighting {
    /// The plate in the world, seen from `camera`; `None` off the grid.
    pub fn seen_from(self, camera: Pose) -> Option<Landmark> {
        Some(Landmark {
            standpoint: camera.cell_at(self.ahead, self.right)?,
            face: camera.heading.turned(self.face),
            plate: self.plate,
        })
    }
}

/// An image: RGBA, 8 bits each, rows top to bottom without gaps.
#[derive(Clone, Copy)]
struct RgbaView<'a> {
    width: u32,
    height: u32,
    rgba: &'a [u8],
}

impl RgbaView<'_> {
    /// The red, green and blue of the pixel in column `x` and row `y`, both inside the image.
    fn rgb(&self, x: u32, y: u32) -> [u8; 3] {
        let at = 4 * (y as usize * self.width as usize + x as usize);
        [self.rgba[at], self.rgba[at + 1], self.rgba[at + 2]]
    }
}

/// All readable plates in an image of `width` x `height` pixels, nearest rows first.
///
/// `rgba` holds 4 bytes per pixel, rows top to bottom without gaps. Returns nothing if its length does not fit.
pub fn read(width: u32, height: u32, rgba: &[u8]) -> Vec<Sighting> {
    let frame = &RgbaView { width, height, rgba };
    let (width, height) = (width as usize, height as usize);
    let sides = 1..=LARGEST_SIDE;
    let is_image = sides.contains(&width) && sides.contains(&height);
    if !is_image || rgba.len() != 4 * width * height {
        return Vec::new();
    }
    let focal = focal_length_px(frame.width);
    let mut votes: Vec<(Sighting, u32)> = Vec::new();
    let runs = magenta_runs(rgba, width, height);
    for column in runs.chunk_by(|a, b| a.x == b.x) {
        for (i, lower) in column.iter().enumerate() {
            let Some(reading) = column[i + 1..]
                .iter()
                .find_map(|upper| ColumnReading::between(frame, lower, upper))
            else {
                continue;
            };
            let Some(sighting) = reading.place(focal) else { continue };
            match votes.iter_mut().find(|(known, _)| *known == sighting) {
                Some((_, count)) => *count += 1,
                None => votes.push((sighting, 1)),
            }
        }
    }
    let mut sightings: Vec<_> = votes
        .into_iter()
        .filter(|(sighting, count)| 2 * count >= columns_of(sighting, frame.width))
        .map(|(sighting, _)| sighting)
        .collect();
    sightings.sort_unstable();
    sightings
}

/// A vertical run of magenta pixels above the horizon.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct MagentaRun {
    /// Column.
    x: u16,
    /// Pixels between the horizon and its lower edge.
    bottom: u16,
    /// Pixels between the horizon and its upper edge.
    top: u16,
}

/// All runs of magenta in the upper half, by column and upwards.
fn magenta_runs(pixels: &[u8], width: usize, height: usize) -> Vec<MagentaRun> {
    const NONE: u32 = u32::MAX;
    let horizon = height / 2;
    let mut runs: Vec<MagentaRun> = Vec::new();
    let mut latest = vec![NONE; width];
    for above in 0..horizon {
        let row = &pixels[4 * width * (horizon - 1 - above)..][..4 * width];
        for (block, pixels) in row.chunks(4 * 16).enumerate() {
            // Most pixels are not magenta, and 16 of them are tested as fast as one.
            if !pixels.chunks_exact(4).fold(false, |any, pixel| any | is_magenta(pixel)) {
                continue;
            }
            for (i, pixel) in pixels.chunks_exact(4).enumerate() {
                if !is_magenta(pixel) {
                    continue;
                }
                let (x, above) = (16 * block + i, above as u16);
                match runs.get_mut(latest[x] as usize) {
                    Some(run) if run.top == above => run.top += 1,
                    _ => {
                        latest[x] = runs.len() as u32;
                        runs.push(MagentaRun { x: x as u16, bottom: above, top: above + 1 });
                    }
                }
            }
        }
    }
    runs.sort_unstable();
    runs
}

fn is_magenta(pixel: &[u8]) -> bool {
    (pixel[0] > 160) & (pixel[1] < 96) & (pixel[2] > 160)
}

/// A plate in one column.
#[derive(Debug, Clone, Copy)]
struct ColumnReading {
    /// Pixels right of the image's centre.
    right_px: f32,
    /// Pixels per metre at the plate's distance.
    scale: f32,
    plate: Plate,
}

impl ColumnReading {
    /// The plate between the lower and upper edge of its frame, if they fit.
    fn between(frame: &RgbaView<'_>, lower: &MagentaRun, upper: &MagentaRun) -> Option<Self> {
        let middle = |run: &MagentaRun| f32::from(run.bottom + run.top) / 2.0;
        let thickness = |run: &MagentaRun| f32::from(run.top - run.bottom);
        let scale = (middle(upper) - middle(lower)) / (SIZE_M - FRAME_M);
        let lower_px = scale * (BOTTOM_M + FRAME_M / 2.0);
        let fits = scale >= LEAST_SCALE
            && (middle(lower) - lower_px).abs() <= SLACK_PX
            && [lower, upper]
                .iter()
                .all(|run| (thickness(run) - scale * FRAME_M).abs() <= SLACK_PX);
        if !fits {
            return None;
        }
        let mut bands = [0; BANDS];
        for (i, band) in bands.iter_mut().enumerate() {
            let above_m = BOTTOM_M + SIZE_M - FRAME_M - BAND_M * (i as f32 + 0.5);
            // Measured from the lower edge, which is nearer than the horizon.
            let above_px = middle(lower) + scale * (above_m - BOTTOM_M - FRAME_M / 2.0);
            let y = (frame.height / 2).checked_sub(1 + above_px as u32)?;
            *band = band_of(frame.rgb(u32::from(lower.x), y))?;
        }
        let right_px = f32::from(lower.x) + 0.5 - frame.width as f32 / 2.0;
        Some(Self { right_px, scale, plate: Plate(bands) })
    }

    /// The position of the plate: of those along the column's ray, the one whose distance agrees best with the size.
    fn place(&self, focal: f32) -> Option<Sighting> {
        let slope = self.right_px / focal;
        let distance = focal / self.scale;
        let mut best: Option<(f32, Sighting)> = None;
        let mut consider = |distance: f32, across: f32, sighting: Sighting| {
            let off_centre = (across - across.round()).abs();
            let off_size = (focal / distance - self.scale).abs() * (SIZE_M - FRAME_M);
            if off_centre <= SIZE_M / 2.0
                && off_size <= SLACK_PX
                && best.is_none_or(|(least, _)| off_size < least)
            {
                best = Some((off_size, sighting));
            }
        };
        for step in 0..2_i8 {
            // A face that looks at the camera: `cells + PLATE_M` ahead, at a whole number to the side.
            let cells = (distance - PLATE_M).floor().max(0.0) as i8 + step;
            let ahead = f32::from(cells) + PLATE_M;
            let across = slope * ahead;
            let right = across.round() as i8;
            consider(ahead, across, Sighting { ahead: cells, right, face: 0, plate: self.plate });

            // A face along the line of sight: `cells + PLATE_M` to the side, at a whole number ahead.
            let cells = (slope.abs() * distance - PLATE_M).floor().max(0.0) as i8 + step;
            let ahead = (f32::from(cells) + PLATE_M) / slope.abs();
            let (right, face) = if slope > 0.0 { (cells, 1) } else { (-cells, 3) };
            let plate = self.plate;
            consider(ahead, ahead, Sighting { ahead: ahead.round() as i8, right, face, plate });
        }
        best.map(|(_, sighting)| sighting)
    }
}

/// Pixel columns of a plate's bands if nothing hides it.
fn columns_of(sighting: &Sighting, width: u32) -> u32 {
    let (ahead, right) = (f32::from(sighting.ahead), f32::from(sighting.right));
    let half = SIZE_M / 2.0 - FRAME_M;
    let (from, to) = match sighting.face {
        0 => ((right - half) / (ahead + PLATE_M), (right + half) / (ahead + PLATE_M)),
        _ => {
            let side = right.abs() + PLATE_M;
            (side / (ahead + half), side / (ahead - half))
        }
    };
    let focal = focal_length_px(width);
    let (from, to) = ((focal * from).max(-focal), (focal * to).min(focal));
    (to - from).max(0.0) as u32
}

/// The band with this colour, within the tolerance.
fn band_of(rgb: [u8; 3]) -> Option<u8> {
    debug_assert!(!BAND_RGB.contains(&FRAME_RGB));
    let near = |colour: &[u8; 3]| colour.iter().zip(rgb).all(|(&a, b)| a.abs_diff(b) <= TOLERANCE);
    BAND_RGB.iter().position(near).map(|band| band as u8)
}

#[cfg(test)]
#[path = "read_tests.rs"]
mod tests;
