//! The simulator: steps the world and renders what the agent sees into shared memory.

pub mod render_command;
pub mod renderer;
