//! The program as its users run it: real processes, shared memory, servers and browsers.
//!
//! One binary, because linking one for each file takes longer than compiling it.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod banks;
mod cache_folder;
mod conformance;
mod controls;
mod documents;
mod drill_sim;
mod engines;
mod example_policies;
mod example_worlds;
mod exports;
mod external;
mod faulty_server;
mod grounded;
mod instruments;
mod keys;
mod leftovers;
mod limits;
mod memories;
mod model_builder;
mod own_world;
mod paper;
mod pipeline;
mod python;
mod ray;
mod real_server;
mod run_documents;
mod statistics;
mod streams;
mod terminal;
mod transfer;
mod units;
mod viewer;
mod vision_server;
mod world;
