//! Frames for the tests of this module.

use peer::FrameView;
use plates::painter::PlateImage;

/// A painted image as a frame.
pub(super) fn frame(picture: &PlateImage, id: u64) -> FrameView<'_> {
    let side = picture.width();
    let content_hash = content_hash(picture.pixels());
    FrameView { id, content_hash, width: side, height: side, pixels: picture.pixels() }
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
