//! The memory: embeds frames, builds the representations, retrieves.
//!
//! - [`serve`] is the process in a run; [`engine`] knows what each lane waits for, [`episode`] is one of them, `embedded_views`
//!   are the views that they share;
//! - `hosted` is the memory of an episode: one of the built-in memories of [`representation`], or an external one, of which
//!   [`external`] has what the host knows;
//! - a [`bank`] is what a memory is built from: [`demonstrations`] and their views; [`items`] turns what a memory supplies
//!   into a recall, and [`document_loader`] publishes its documents;
//! - `sequences` are memories that persist over a stream, and [`snapshots`] these memories on disk;
//! - [`encoder`] computes embeddings, [`embedding_cache`] keeps them; [`manifest`] lists encoders, [`paths`] their files;
//! - [`builders`] write documents before a run;
//! - [`embed_command`] embeds images, and [`search_profile`] measures searches, for users.
//!
//! What is not here: stepping and rendering (sim-proc), deciding (policy-proc), scoring (results).

pub mod bank;
pub mod builders;
pub mod demonstrations;
pub mod document_loader;
pub mod embed_command;
mod embedded_views;
pub mod embedding_cache;
pub mod encoder;
pub mod engine;
mod environment;
pub mod episode;
pub mod external;
#[doc(hidden)]
pub mod fuzzing;
mod hosted;
pub mod items;
pub mod manifest;
pub mod paths;
pub mod representation;
pub mod search_profile;
mod sequences;
pub mod serve;
pub mod snapshots;
mod views;
