//! The grounded policy on rendered views, without processes: what it reads in them compared with the
//! truth of the warehouse, and cases walked with memory, without, and under controls.
//!
//! A pixel difference stands in for the encoder here: what is tested is the policy.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

mod reading;
mod views;
mod walking;
