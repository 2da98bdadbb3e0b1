//! What can go wrong between a pose and its pixels.

/// Why the renderer could not start or could not render.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// No Vulkan driver answered, and an adapter of one was asked for.
    #[error(
        "no Vulkan driver found, and so no adapter {wanted:?}; leave it out, or say \"processor\", to draw \
         without one"
    )]
    NoVulkan {
        /// The text that was asked for.
        wanted: String,
    },
    /// Vulkan is there, but not the adapter that was asked for.
    #[error(
        "no Vulkan adapter's name contains {wanted:?}; there are: {found}, and \"processor\", which needs none"
    )]
    NoSuchAdapter {
        /// The text that was asked for.
        wanted: String,
        /// The names of the adapters that exist.
        found: String,
    },
    /// The adapter refused to give a device.
    #[error("the Vulkan adapter {adapter:?} gave no device: {reason}")]
    NoDevice {
        /// The adapter's name.
        adapter: String,
        /// The driver's words.
        reason: String,
    },
    /// The image size cannot be rendered.
    #[error(
        "frames of {width_px} x {height_px} cannot be rendered: the width must be a multiple of 64 \
         and both sides between 64 and {limit_px}"
    )]
    FrameSize {
        /// The width asked for, in pixels.
        width_px: u32,
        /// The height asked for, in pixels.
        height_px: u32,
        /// The longest side that is accepted, in pixels.
        limit_px: u32,
    },
    /// A destination does not have the size of a frame.
    #[error("a frame takes {expected} bytes, but the destination of view {pose} has {actual}")]
    DestinationSize {
        /// The view's pose, as text.
        pose: String,
        /// Bytes of a frame.
        expected: usize,
        /// Bytes of the destination.
        actual: usize,
    },
    /// The device stopped answering.
    #[error("the render device failed: {0}; start again, and if it repeats update the driver")]
    Device(String),
    /// A thread that draws has ended by itself.
    #[error("a thread that draws has ended; what it said before is the reason")]
    PaintersGone,
    /// The frames a device writes are not the frames it should write.
    #[error("the adapter {adapter:?} failed its self-test: {reason}; try another driver")]
    SelfTest {
        /// The adapter's name.
        adapter: String,
        /// What differed.
        reason: String,
    },
}
