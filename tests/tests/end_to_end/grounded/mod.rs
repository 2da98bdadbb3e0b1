//! The grounded policy on rendered views, in one process: the plates it reads compared with the catalogue, and
//! cases run with each memory representation and under controls.
//!
//! Pixel differences replace the encoder here.

mod documents;
mod episodes;
mod plates_read;
mod recall;
mod runner;
mod views;
