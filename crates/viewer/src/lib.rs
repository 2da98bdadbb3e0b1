//! Pages that show a run: a grid of its episodes, each episode step by step, two of them side by side.
//!
//! [`Site`] turns run folders into files: data as scripts ([`data`]), views rendered from poses ([`world_client::frames`]), and a front
//! end without a build step (`web/`). [`write_bundle`] writes them to a folder that opens from the disk, [`ViewServer`] answers
//! requests with the same files, made when they are asked for.
//!
//! What is not here: figures and tables (`scores`, `report`), pixels and the rules of the world (`sim-proc`, a child process).

mod bundle;
pub mod data;
mod file;
mod server;
mod site;
#[cfg(test)]
mod testing;
mod view_file;

pub use bundle::{Bundle, write_bundle};
pub use file::File;
pub use server::{Address, ViewServer};
pub use site::{Site, logged_image};
