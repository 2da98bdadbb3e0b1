//! A view to be rendered and the memory it is rendered into.

use domain::Pose;
use warehouse::Variant;

/// A pose in a world.
#[derive(Debug, Clone, Copy)]
pub struct ViewSpec<'a> {
    /// The camera's pose.
    pub pose: Pose,
    /// Which passages are closed.
    pub variant: &'a Variant,
    /// The index of the renderer's stock.
    pub stock: u32,
}

/// Memory that a frame is written to.
pub enum Destination<'a> {
    /// A shared-memory slot: page-aligned, whole pages, used again and again. At least as long as a frame. The device
    /// writes it directly where it can.
    Slot(&'a mut [u8]),
    /// Ordinary memory, exactly as long as a frame. The wgpu backend copies the frame into it.
    Memory(&'a mut [u8]),
}

impl Destination<'_> {
    pub(super) fn bytes(&self) -> &[u8] {
        match self {
            Self::Slot(bytes) | Self::Memory(bytes) => bytes,
        }
    }

    pub(super) fn bytes_mut(&mut self) -> &mut [u8] {
        match self {
            Self::Slot(bytes) | Self::Memory(bytes) => bytes,
        }
    }
}

/// A view and its destination. Pixels are RGBA, 8 bits per channel, in rows from the top without gaps.
pub struct RenderJob<'a> {
    /// What to render.
    pub view: ViewSpec<'a>,
    /// Where to write it.
    pub destination: Destination<'a>,
}
