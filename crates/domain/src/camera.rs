//! The agent's camera (specification, section 2, and with a mismatch section 6). Policies may know the usual one.

use crate::Mismatch;

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

/// The height of a camera with another height than that of the demonstrations, in centimetres.
const OTHER_HEIGHT_CM: u16 = 170;

/// How far a camera with another field of view sees to either side at a distance of a metre, in centimetres: 70 degrees.
const OTHER_HALF_WIDTH_PERCENT: u8 = 70;

/// The agent's camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct CameraSetup {
    /// Its height above the floor, in centimetres.
    pub height_cm: u16,
    /// The tangent of half its horizontal field of view, in percent.
    pub half_width_percent: u8,
}

impl CameraSetup {
    /// That of the specification, section 2.
    pub const STANDARD: Self =
        Self { height_cm: CAMERA_HEIGHT_CM, half_width_percent: HALF_WIDTH_PERCENT };

    /// That of an episode with this mismatch.
    pub const fn of(mismatch: Mismatch) -> Self {
        match mismatch {
            Mismatch::CameraHeight => Self { height_cm: OTHER_HEIGHT_CM, ..Self::STANDARD },
            Mismatch::FieldOfView => {
                Self { half_width_percent: OTHER_HALF_WIDTH_PERCENT, ..Self::STANDARD }
            }
            Mismatch::None
            | Mismatch::Light
            | Mismatch::Labels
            | Mismatch::Wording
            | Mismatch::Stock => Self::STANDARD,
        }
    }
}
