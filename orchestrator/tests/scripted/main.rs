//! The orchestrator's side of a run, with scripted neighbours.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;
mod external_memory;
mod lanes;
mod pipeline;
