//! Readers of what comes from outside, without a server, for the fuzz targets in `tests/fuzz`. Not part of the client.

pub use crate::endpoint::read_env_file as env_file;
pub use crate::reply::{error_message, read as reply};
