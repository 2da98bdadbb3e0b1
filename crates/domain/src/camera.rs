//! The agent's camera (specification, section 2). Policies may know it.

/// Height of the camera above the floor, in centimetres.
pub const CAMERA_HEIGHT_CM: u16 = 120;

/// Height of the camera above the floor, in metres.
pub const CAMERA_HEIGHT_M: f32 = CAMERA_HEIGHT_CM as f32 / 100.0;

/// The tangent of half the horizontal field of view, in percent: 90 degrees.
pub const HALF_WIDTH_PERCENT: u8 = 100;

/// Focal length in pixels of an image `width_px` wide; square pixels, so it serves both axes.
///
/// With 90 degrees this is half the width: a point `right` metres to the side and `ahead` metres in
/// front of the camera is drawn `focal * right / ahead` pixels right of the image's centre.
pub const fn focal_length_px(width_px: u32) -> f32 {
    width_px as f32 / 2.0
}
