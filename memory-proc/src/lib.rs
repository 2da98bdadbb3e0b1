//! The memory: embeds frames, builds the representations, retrieves.
//!
//! A table of contents, outside in:
//!
//! - [`serve`] takes part in a run; [`engine`] knows what each lane waits for, [`episode`] one of them;
//! - [`documents`]: texts built once from the demonstrations of all cases, before a run; the [`library`] reads
//!   and publishes them;
//! - [`representation`]: what is stored and what a step is supplied with, made of [`demonstrations`];
//! - [`index`]: the nearest view; [`embedding`] and [`embedding_cache`]: vectors, and keeping them;
//! - [`encoder`] makes them; [`manifest`] and [`paths`] say which there are and where their files lie;
//! - [`embed_command`] shows what an encoder makes of pictures, [`profile`] how long a search takes.
//!
//! What is not here: stepping and rendering (sim-proc), deciding (policy-proc), scoring (orchestrator).

pub mod demonstrations;
pub mod documents;
pub mod embed_command;
pub use search::embedding;
pub mod embedding_cache;
pub mod encoder;
pub mod engine;
pub mod episode;
pub use search as index;
pub mod library;
pub mod manifest;
pub mod paths;
pub mod profile;
pub mod representation;
pub mod serve;
mod views;
