//! What the serve loop asks of whoever draws.

use domain::Pose;
use shm_types::FrameSlot;
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

/// Draws views into slots of the frame store. The same view gives the same pixels, whoever draws it and
/// whatever else is drawn with it.
pub trait Painter: Send {
    /// Draws every painting and returns when all slots hold their pixels: how many bytes of pixels the program
    /// itself has copied for that.
    ///
    /// # Errors
    /// When the device fails.
    fn paint(&mut self, paintings: &mut [Painting<'_>]) -> Result<u64, RenderError>;
}

/// Whether a barricade of the variant may show in the view from the pose. Where none may, the pixels are those of
/// the unchanged world, so that one frame does for both.
pub type MayShowBarricade = Box<dyn FnMut(&Variant, Pose) -> bool>;

/// Painters, and what else a simulator has to know of drawing.
pub struct Studio {
    /// At least one. They work at the same time, each on a thread of its own.
    pub painters: Vec<Box<dyn Painter>>,
    /// Views that a painter takes on at once, at most: several where a device draws them faster together.
    pub at_once: usize,
    /// Where barricades have to be drawn.
    pub may_show_barricade: MayShowBarricade,
    /// What it draws with, for the manifest.
    pub facts: Vec<(&'static str, String)>,
}
