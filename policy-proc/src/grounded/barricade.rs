//! Finds barricades in images: three boards with red and white stripes, one above the other.
//!
//! The camera alone determines where the boards of a barricade on a given cell appear, so the reader tests each
//! cell ahead. Nothing else in the world has stripes at these heights and none between them. A barricade that
//! is partly hidden is not found.

use domain::camera::{CAMERA_HEIGHT_M, focal_length_px};
use peer::FrameView;

/// Heights above the floor, in metres, and whether there is a board: the lowest board and gap come first.
const HEIGHTS_M: [(f32, bool); 5] =
    [(0.33, true), (0.53, false), (0.73, true), (0.93, false), (1.13, true)];

/// Distance of the boards from the near edge of the cell, in metres.
const SETBACK_M: f32 = 0.10;

/// The farthest row of cells that is tested.
const FARTHEST: i8 = 6;

/// Points sampled at each height.
const POINTS: usize = 24;

/// Cells with a barricade that faces the camera, as (cells ahead, cells to the right).
pub(super) fn read(frame: &FrameView<'_>) -> Vec<(i8, i8)> {
    let cells = (1..=FARTHEST).flat_map(|ahead| (-ahead..=ahead).map(move |right| (ahead, right)));
    cells.filter(|&cell| stands_on(frame, cell)).collect()
}

fn stands_on(frame: &FrameView<'_>, cell: (i8, i8)) -> bool {
    // The lowest board and gap in the nearest cell are below the image.
    let visible = if cell.0 == 1 { &HEIGHTS_M[2..] } else { &HEIGHTS_M };
    visible.iter().all(|&(height_m, is_board)| {
        let (mut red, mut white) = (0, 0);
        for [r, g, b] in colours_across(frame, cell, height_m) {
            red += usize::from(r > 100 && g < 70 && b < 70);
            white += usize::from(r.min(g).min(b) > 120);
        }
        if is_board { 3 * red >= POINTS && 4 * white >= POINTS } else { 6 * red < POINTS }
    })
}

/// The colours along a horizontal line across the front of a barricade; black outside the image.
fn colours_across(
    frame: &FrameView<'_>,
    (ahead, right): (i8, i8),
    height_m: f32,
) -> impl Iterator<Item = [u8; 3]> {
    let scale = focal_length_px(frame.width) / (f32::from(ahead) - 0.5 + SETBACK_M);
    let y = frame.height as f32 / 2.0 + scale * (CAMERA_HEIGHT_M - height_m);
    let left = frame.width as f32 / 2.0 + scale * (f32::from(right) - 0.5);
    (0..POINTS).map(move |i| {
        let x = left + scale * (i as f32 + 0.5) / POINTS as f32;
        if x < 0.0 || y < 0.0 { [0; 3] } else { frame.rgb(x as u32, y as u32) }
    })
}

#[cfg(test)]
mod tests {
    use domain::{Heading, Pose};
    use plates::painter::{PlateAisle, PlateImage};

    use super::super::testing::{blank_frame, frame, paint_barricade, square_frame};
    use super::*;

    #[test]
    fn barricades_are_found_where_they_stand() {
        for cell in [(1, 0), (2, -1), (3, 1), (5, 0), (6, 0)] {
            let mut pixels = PlateImage::background(448, 3).pixels().to_vec();
            paint_barricade(&mut pixels, cell);
            assert_eq!(read(&square_frame(&pixels, 1)), [cell]);
        }
    }

    #[test]
    fn other_images_have_none() {
        let aisle = PlateAisle::new().picture(Pose::new(10, 12, Heading::N));
        for other in [frame(&aisle, 1), blank_frame(2), FrameView::NONE] {
            assert_eq!(read(&other), []);
        }
    }
}
