//! What tests of several crates share, and no program links: rigs around one process of a run, scripted processes, and a chat
//! server that follows a script.

pub mod chat_server;
pub mod process;
pub mod scripted;
