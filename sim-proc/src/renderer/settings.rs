//! What a renderer is asked to do, and what it reports about itself.

use std::fmt;
use std::str::FromStr;

use anyhow::{Result, ensure};
use domain::camera::CameraSetup;
use domain::{Appearance, Mismatch};
pub use raster::Samples;

/// Longest side of a frame, in pixels.
const MAX_SIDE_PX: u32 = 4096;

/// Widths must be a multiple of this, so that rows of pixels follow each other without gaps.
const WIDTH_STEP_PX: u32 = 64;

/// What draws the frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backend {
    /// The CPU, with vector instructions. The pixels are the same on every machine.
    Cpu,
    /// A Vulkan device, through wgpu.
    Wgpu,
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Cpu => "cpu",
            Self::Wgpu => "wgpu",
        })
    }
}

impl FromStr for Backend {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        match word {
            "cpu" => Ok(Self::Cpu),
            "wgpu" => Ok(Self::Wgpu),
            _ => Err("expected cpu or wgpu".to_owned()),
        }
    }
}

/// How frames are rendered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RenderSettings {
    /// Width of a frame, in pixels; a multiple of 64.
    pub width_px: u32,
    /// Height of a frame, in pixels.
    pub height_px: u32,
    /// Anti-aliasing.
    pub samples: Samples,
    /// Plates, labels, light and tints.
    pub appearance: Appearance,
    /// The camera.
    pub camera: CameraSetup,
    /// Copy frames into slots even where the device can write them itself.
    pub force_copy: bool,
    /// The backend. `None` is wgpu with an adapter that is named or a graphics card, and otherwise the CPU.
    pub backend: Option<Backend>,
    /// Part of the name of the Vulkan adapter to use. `None` is the best one.
    pub adapter: Option<String>,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            width_px: 448,
            height_px: 448,
            samples: Samples::Four,
            appearance: Appearance::STANDARD,
            camera: CameraSetup::STANDARD,
            force_copy: false,
            backend: None,
            adapter: None,
        }
    }
}

impl RenderSettings {
    /// Those of views in episodes with this mismatch, where these are those of demonstrations.
    #[must_use]
    pub fn with_mismatch(&self, mismatch: Mismatch) -> Self {
        Self {
            appearance: warehouse::appearance(self.appearance, mismatch),
            camera: CameraSetup::of(mismatch),
            ..self.clone()
        }
    }

    /// Bytes of a frame: RGBA, 8 bits per channel.
    pub(super) fn frame_bytes(&self) -> usize {
        4 * self.width_px as usize * self.height_px as usize
    }

    /// Checks the frame size.
    ///
    /// # Errors
    /// When frames of this size cannot be rendered.
    pub(super) fn check(&self) -> Result<()> {
        let &Self { width_px, height_px, .. } = self;
        let sides = 64..=MAX_SIDE_PX;
        let fits = sides.contains(&width_px) && sides.contains(&height_px);
        ensure!(
            fits && width_px.is_multiple_of(WIDTH_STEP_PX),
            "frames of {width_px} x {height_px} cannot be rendered: the width must be a multiple of {WIDTH_STEP_PX} \
             and both sides between 64 and {MAX_SIDE_PX}"
        );
        Ok(())
    }
}

/// How frames get into shared-memory slots.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FramePath {
    /// The backend writes into the slot.
    Direct,
    /// The program copies each frame once.
    Copied {
        /// Why the device does not write into the slot.
        reason: String,
    },
}

impl fmt::Display for FramePath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Direct => f.write_str("direct"),
            Self::Copied { reason } => write!(f, "copied: {reason}"),
        }
    }
}

/// What a renderer runs on and what it has done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RenderReport {
    /// The backend.
    pub backend: Backend,
    /// Name and driver of the Vulkan adapter; `None` for the CPU.
    pub adapter: Option<String>,
    /// How frames get into slots.
    pub frame_path: FramePath,
    /// Bytes of pixels that the program itself has copied so far.
    pub bytes_copied: u64,
}
