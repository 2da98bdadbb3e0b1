//! The grounded policy on rendered views, without processes: what it reads in them compared with the
//! truth of the warehouse, and cases walked with each memory representation and under controls.
//!
//! A pixel difference stands in for the encoder here, and small documents written from the same views for
//! the builders' ones: what is tested is the policy.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

mod documents;
mod reading;
mod supply;
mod views;
mod walker;
mod walking;
