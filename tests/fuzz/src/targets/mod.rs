//! The readers, by what they read.

pub(crate) mod folders;
pub(crate) mod models;
pub(crate) mod texts;
pub(crate) mod wire;
pub(crate) mod worlds;
