//! The simulator: steps the world and renders what the agent sees into shared memory.
//!
//! - [`serve`]: its part in a run. [`world`] carries out commands, [`control`] chooses the view that is
//!   shown, [`views`] keeps account of what is resident; all three are pure.
//! - [`renderer`]: poses in, pixels out, the only place that knows wgpu; [`painter`] is what the serve loop
//!   asks of it, [`studio`] how many there are, `easels` their threads.
//! - [`contact_sheet`]: the whole catalogue on one picture. [`render_command`] and [`serve_command`]: the verbs of the program.

pub mod contact_sheet;
pub mod control;
mod easels;
mod neighbours;
pub mod painter;
pub mod render_command;
pub mod renderer;
pub mod serve;
pub mod serve_command;
pub mod studio;
pub mod views;
pub mod world;
