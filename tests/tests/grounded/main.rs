//! The grounded policy on rendered views, in one process: the plates it reads compared with the catalogue, and
//! cases run with each memory representation and under controls.
//!
//! Pixel differences replace the encoder here.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

mod documents;
mod episodes;
mod plates_read;
mod recall;
mod runner;
mod views;
