//! Frames for the tests of this module.

use domain::camera::{CAMERA_HEIGHT_M, focal_length_px};
use peer::FrameView;
use plates::painter::PlateImage;

/// A painted image as a frame.
pub(super) fn frame(picture: &PlateImage, id: u64) -> FrameView<'_> {
    square_frame(picture.pixels(), id)
}

/// The pixels of a square image as a frame.
pub(super) fn square_frame(pixels: &[u8], id: u64) -> FrameView<'_> {
    let side = (pixels.len() / 4).isqrt() as u32;
    FrameView { id, content_hash: content_hash(pixels), width: side, height: side, pixels }
}

/// Paints a barricade on a cell, as the simulator draws it, over a square image.
pub(super) fn paint_barricade(pixels: &mut [u8], (ahead, right): (i8, i8)) {
    let side = (pixels.len() / 4).isqrt();
    let boards_m: [f32; 3] = [0.33, 0.73, 1.13];
    let scale = focal_length_px(side as u32) / (f32::from(ahead) - 0.4);
    for (at, pixel) in pixels.chunks_exact_mut(4).enumerate() {
        let from_centre = |at: usize| (at as f32 + 0.5 - side as f32 / 2.0) / scale;
        let height = CAMERA_HEIGHT_M - from_centre(at / side);
        let across = from_centre(at % side) - f32::from(right);
        let on_board = boards_m.iter().any(|board| (height - board).abs() < 0.11);
        if on_board && across.abs() <= 0.5 {
            let is_red = ((across + height + 8.0) / 0.125) as i32 % 2 == 0;
            let colour = if is_red { [214, 28, 30] } else { [246, 246, 244] };
            pixel[..3].copy_from_slice(&colour);
        }
    }
}

/// A frame without any texture.
pub(super) fn blank_frame(id: u64) -> FrameView<'static> {
    let pixels = &[128; 64 * 64 * 4];
    FrameView { id, content_hash: content_hash(pixels), width: 64, height: 64, pixels }
}

/// The hash that the simulator gives a frame.
pub(super) fn content_hash(pixels: &[u8]) -> [u8; 16] {
    let mut hash = [0; 16];
    hash.copy_from_slice(&blake3::hash(pixels).as_bytes()[..16]);
    hash
}
