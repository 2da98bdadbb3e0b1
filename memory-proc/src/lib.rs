//! The memory: embeds frames, builds the representations, retrieves.
//!
//! A table of contents, outside in: [`paths`] and [`manifest`] say which encoder there is and where its
//! files lie; [`encoder`] runs it.
//!
//! What is not here: stepping and rendering (sim-proc), deciding (policy-proc), scoring (orchestrator).

pub mod demonstrations;
pub mod embedding;
pub mod embedding_cache;
pub mod encoder;
pub mod engine;
pub mod episode;
pub mod index;
pub mod manifest;
pub mod paths;
pub mod representation;
mod views;
