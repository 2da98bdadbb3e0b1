//! The simulator: steps the world and renders what the agent sees into shared memory.

pub mod contact_sheet;
pub mod render_command;
pub mod renderer;
