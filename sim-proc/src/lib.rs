//! The simulator: steps the world and renders what agents see into shared memory.
//!
//! - [`serve`]: the simulator's part in a run. [`worlds`] numbers the worlds, [`lanes`] executes commands, [`view_control`]
//!   chooses the view to show, [`view_cache`] keeps track of resident views; all four are pure.
//! - [`render_pool`]: worker threads that render beside the serve loop; [`render_workers`] opens them,
//!   and [`view_folder`] shares their views with other processes.
//! - [`renderer`]: poses in, pixels out, with two backends.
//! - [`view_source`]: single views, outside a run.
//! - [`first_views`]: whether a case begins with a view of a target.
//! - [`serve_command`], [`views_command`], [`act_command`], [`book_command`] and [`world_commands`]: the command line.

pub mod act_command;
pub mod book_command;
pub mod first_views;
pub mod lanes;
pub mod lived;
pub mod render_pool;
pub mod render_workers;
pub mod renderer;
mod renderer_args;
pub mod serve;
pub mod serve_command;
pub mod view_cache;
pub mod view_control;
pub mod view_folder;
pub mod view_source;
pub mod views_command;
mod wakeups;
pub mod world_commands;
pub mod worlds;
