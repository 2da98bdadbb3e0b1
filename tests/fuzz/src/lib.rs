//! Everything that reads bytes from outside, as functions of bytes.
//!
//! A target passes its input to a reader and asserts what must hold for any bytes: an answer or an error, never a panic;
//! what is written is read back equal; nothing is read outside of the folder at hand. Memory and time are limited by the
//! fuzz program. `cargo test` runs every target on its corpus; `cargo xtask drill fuzz` on new inputs, guided by coverage.

#![expect(clippy::unwrap_used, reason = "a target reports what it finds by panicking")]

mod files;
mod input;
mod targets;

/// A reader of bytes from outside.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Its name, and that of its folder in `corpus`.
    pub name: &'static str,
    /// What it reads.
    pub reads: &'static str,
    /// Reads an input. Panics when something does not hold.
    pub run: fn(&[u8]),
}

/// All targets.
pub const TARGETS: &[Target] = targets::ALL;
