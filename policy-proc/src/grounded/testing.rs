//! What tests of the grounded policy share.

use plates::painter::Picture;

use crate::FrameView;

/// A painted picture as a frame.
pub(super) fn view(picture: &Picture, id: u64) -> FrameView<'_> {
    let side = picture.width();
    FrameView { id, width: side, height: side, pixels: picture.pixels(), ..FrameView::NONE }
}
