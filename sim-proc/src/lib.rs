//! The simulator: steps the world and renders what agents see into shared memory.
//!
//! - [`world`]: the warehouse in the role of a run's world, which the crate `peer` serves. [`worlds`] numbers the worlds, and
//!   [`lanes`] executes commands.
//! - [`render_workers`]: the renderers of a run; [`view_folder`] shares their views with other processes.
//! - [`renderer`]: poses in, pixels out, with two backends.
//! - [`view_source`]: single views, outside a run.
//! - [`first_views`]: whether a case begins with a view of a target.
//! - [`serve_command`], [`views_command`], [`act_command`], [`book_command`] and [`world_commands`]: the command line.

pub mod act_command;
pub mod book_command;
pub mod first_views;
pub mod lanes;
pub mod lived;
pub mod render_workers;
pub mod renderer;
mod renderer_args;
pub mod serve_command;
pub mod view_folder;
pub mod view_source;
pub mod views_command;
pub mod world;
pub mod world_commands;
pub mod worlds;
