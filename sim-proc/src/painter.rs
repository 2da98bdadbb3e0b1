//! What the serve loop asks of a renderer.

use shm_types::{FrameSlot, Pose};
use warehouse::Variant;

use crate::renderer::RenderError;

/// A view and the slot it goes into.
#[derive(Debug)]
pub struct Painting<'a> {
    /// With which barricades.
    pub variant: &'a Variant,
    /// Where from.
    pub pose: Pose,
    /// Where to.
    pub slot: &'a mut FrameSlot,
}

/// Draws views into slots of the frame store. The same view gives the same pixels, whatever else is drawn
/// with it.
pub trait Painter {
    /// Draws every painting and returns when all slots hold their pixels.
    ///
    /// # Errors
    /// When the device fails.
    fn paint(&mut self, paintings: &mut [Painting<'_>]) -> Result<(), RenderError>;

    /// Whether a barricade of `variant` may show in the view from `pose`. Where none may, the pixels are those
    /// of the unchanged world, so that one frame does for both.
    fn may_show_barricade(&mut self, variant: &Variant, pose: Pose) -> bool;

    /// What it runs on, for the manifest.
    fn facts(&self) -> Vec<(&'static str, String)>;

    /// Bytes of pixels that the program itself has copied so far.
    fn pixel_bytes_copied(&self) -> u64;
}
