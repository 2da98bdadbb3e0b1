//! What tests of several crates share, and no program links: rigs around one process of a run, scripted processes, a chat
//! server that follows a script, and records of runs.

pub mod chat_server;
pub mod process;
#[expect(clippy::unwrap_used, reason = "a fixture that cannot be made fails its test")]
pub mod records;
pub mod scripted;
