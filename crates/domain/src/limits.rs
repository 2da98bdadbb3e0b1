//! The largest sizes of what a run is made of: what fits into messages and shared memory, and so what settings may say.

/// Longest instruction of a case, in bytes.
pub const MAX_INSTRUCTION: usize = 232;

/// Longest window of past steps.
pub const MAX_WINDOW: usize = 32;

/// Most steps of a retrieved segment: the matched view and the views after it.
pub const MAX_SEGMENT: usize = 32;

/// Most items that a memory supplies at a step.
pub const MAX_ITEMS: usize = 8;

/// Most external memories of a run.
pub const MAX_EXTERNAL_MEMORIES: usize = 8;

/// Most world processes of a run.
pub const MAX_WORLDS: usize = 16;

/// Maximum number of frames that a run can keep resident.
pub const MAX_FRAMES: u32 = 1 << 20;
