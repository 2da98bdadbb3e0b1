//! What tests of several crates share, and no program links: rigs around one process of a run, scripted processes, a chat
//! server that follows a script, and records of runs.

pub mod chat_server;
pub mod process;
pub mod records;
pub mod scripted;
