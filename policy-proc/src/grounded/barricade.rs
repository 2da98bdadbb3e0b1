//! Finds barricades in images: three boards with red and white stripes, one above the other.
//!
//! The camera alone determines where the boards of a barricade on a given cell would appear, so the reader
//! tests each cell ahead. Nothing else in the world has stripes at these three heights. A barricade that is
//! partly hidden is not found.

use domain::camera::{CAMERA_HEIGHT_M, focal_length_px};

use peer::FrameView;

/// Heights of the boards' centres above the floor, in metres.
const BOARDS_M: [f32; 3] = [0.33, 0.73, 1.13];

/// Heights between the boards, in metres.
const GAPS_M: [f32; 2] = [0.53, 0.93];

/// Distance of the boards from the near edge of the cell, in metres.
const SETBACK_M: f32 = 0.10;

/// The farthest row of cells that is tested.
const FARTHEST: i8 = 6;

/// Points sampled on each board.
const POINTS: usize = 24;

/// Cells with a barricade that faces the camera, as (cells ahead, cells to the right).
pub(super) fn read(frame: &FrameView<'_>) -> Vec<(i8, i8)> {
    let ahead = 1..=FARTHEST;
    let cells = ahead.flat_map(|ahead| (-ahead..=ahead).map(move |right| (ahead, right)));
    cells.filter(|&(ahead, right)| stands_on(frame, ahead, right)).collect()
}

fn stands_on(frame: &FrameView<'_>, ahead: i8, right: i8) -> bool {
    // The lowest board in the nearest cell is below the image.
    let boards = &BOARDS_M[usize::from(ahead == 1)..];
    let gaps = &GAPS_M[usize::from(ahead == 1)..];
    boards.iter().all(|&height| {
        let (mut red, mut white) = (0, 0);
        for colour in line_across(frame, ahead, right, height) {
            red += usize::from(is_red(colour));
            white += usize::from(is_white(colour));
        }
        3 * red >= POINTS && 4 * white >= POINTS
    }) && gaps.iter().all(|&height| {
        let red = line_across(frame, ahead, right, height).filter(|&colour| is_red(colour)).count();
        6 * red < POINTS
    })
}

/// The colours along a horizontal line across the barricade's front.
fn line_across<'a>(
    frame: &'a FrameView<'_>,
    ahead: i8,
    right: i8,
    height_m: f32,
) -> impl Iterator<Item = [u8; 3]> + 'a {
    let focal = focal_length_px(frame.width);
    let scale = focal / (f32::from(ahead) - 0.5 + SETBACK_M);
    let y = frame.height as f32 / 2.0 + scale * (CAMERA_HEIGHT_M - height_m);
    (0..POINTS).map(move |i| {
        let across = f32::from(right) - 0.5 + (i as f32 + 0.5) / POINTS as f32;
        let x = frame.width as f32 / 2.0 + scale * across;
        if x < 0.0 || y < 0.0 { [0; 3] } else { frame.rgb(x as u32, y as u32) }
    })
}

fn is_red([red, green, blue]: [u8; 3]) -> bool {
    red > 100 && green < 70 && blue < 70
}

fn is_white([red, green, blue]: [u8; 3]) -> bool {
    red.min(green).min(blue) > 120
}

#[cfg(test)]
mod tests {
    use super::*;
    use domain::{Heading, Pose};
    use plates::painter::{PlateAisle, PlateImage};

    /// An image with a barricade on the cell, as the camera sees it.
    fn with_barricade(ahead: i8, right: i8) -> Vec<u8> {
        let side = 448_u32;
        let mut pixels = PlateImage::background(side, 3).pixels().to_vec();
        let focal = focal_length_px(side);
        let scale = focal / (f32::from(ahead) - 0.5 + SETBACK_M);
        for y in side / 2..side {
            for x in 0..side {
                let height = CAMERA_HEIGHT_M - (y as f32 + 0.5 - 224.0) / scale;
                let across = (x as f32 + 0.5 - 224.0) / scale - f32::from(right);
                let on_board = BOARDS_M.iter().any(|board| (height - board).abs() < 0.11);
                if !on_board || across.abs() > 0.5 {
                    continue;
                }
                let is_red = ((across + height + 8.0) / 0.125) as i32 % 2 == 0;
                let at = 4 * (y * side + x) as usize;
                let colour = if is_red { [214, 28, 30] } else { [246, 246, 244] };
                pixels[at..at + 3].copy_from_slice(&colour);
            }
        }
        pixels
    }

    fn frame_of(side: u32, pixels: &[u8]) -> FrameView<'_> {
        FrameView { id: 1, content_hash: [0; 16], width: side, height: side, pixels }
    }

    #[test]
    fn barricades_are_found_where_they_stand() {
        for (ahead, right) in [(1, 0), (2, -1), (3, 1), (5, 0)] {
            let pixels = with_barricade(ahead, right);
            assert_eq!(read(&frame_of(448, &pixels)), [(ahead, right)]);
        }
    }

    #[test]
    fn other_images_have_none() {
        let aisle = PlateAisle::new().picture(Pose::new(10, 12, Heading::N));
        for (side, pixels) in [(448, aisle.pixels()), (64, &[128; 64 * 64 * 4]), (64, &[])] {
            assert_eq!(read(&frame_of(side, pixels)), []);
        }
    }
}
