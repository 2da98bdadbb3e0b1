//! Shared memory between nodes, threads and processes. Every test has a run of its own.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

mod bus;
mod child;
mod common;
mod documents;
mod external;
mod frames;
mod registry;
mod worlds;
