//! Why rendering fails.

/// Why the renderer could not start or could not render.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// There is no Vulkan driver, and one is needed.
    #[error("no Vulkan driver found; --backend cpu renders without one")]
    NoVulkan,
    /// An adapter was given for the CPU backend.
    #[error(
        "--adapter {adapter:?} names a Vulkan adapter, which --backend cpu does not use: leave one of them out"
    )]
    AdapterForCpu {
        /// The adapter that was given.
        adapter: String,
    },
    /// No adapter has the given name.
    #[error(
        "no Vulkan adapter's name contains {wanted:?}; there are: {found}; --backend cpu renders without one"
    )]
    NoSuchAdapter {
        /// The given part of a name.
        wanted: String,
        /// The names of all adapters.
        found: String,
    },
    /// The device of an adapter cannot be opened.
    #[error("cannot open the Vulkan adapter {adapter:?}: {reason}")]
    NoDevice {
        /// The adapter's name.
        adapter: String,
        /// The driver's message.
        reason: String,
    },
    /// The frame size cannot be rendered.
    #[error(
        "frames of {width_px} x {height_px} cannot be rendered: the width must be a multiple of 64 \
         and both sides between 64 and {limit_px}"
    )]
    FrameSize {
        /// The given width, in pixels.
        width_px: u32,
        /// The given height, in pixels.
        height_px: u32,
        /// The longest accepted side, in pixels.
        limit_px: u32,
    },
    /// A destination has the wrong size.
    #[error("a frame takes {expected} bytes, but the destination of view {pose} has {actual}")]
    DestinationSize {
        /// The view's pose, as text.
        pose: String,
        /// Bytes of a frame.
        expected: usize,
        /// Bytes of the destination.
        actual: usize,
    },
    /// The device failed.
    #[error("the render device failed: {0}; start again, and if that fails too, update the driver")]
    Device(String),
    /// A render worker has panicked.
    #[error("a render worker has ended; its own message on standard error says why")]
    WorkerEnded,
}
