//! Readers of servers' answers without a server, for the fuzz targets in `tests/fuzz`. Not part of the client.

use crate::cache::{CacheKey, ReplyCache};
use crate::reply::ChatReply;
pub use crate::reply::{error_message, read as reply};
use crate::request::ChatRequest;

/// The file of a cached reply, whether it exists or not.
pub fn stored_file(
    cache: &ReplyCache,
    model: &str,
    request: &ChatRequest,
) -> Option<std::path::PathBuf> {
    CacheKey::of(model, request, 0).map(|key| cache.path(&key))
}

/// The cached reply; `None` also where it cannot be used.
pub fn stored(cache: &ReplyCache, model: &str, request: &ChatRequest) -> Option<ChatReply> {
    cache.get(&CacheKey::of(model, request, 0)?)
}

/// Stores a reply.
///
/// # Errors
/// When the folder cannot be written.
pub fn store(
    cache: &ReplyCache,
    model: &str,
    request: &ChatRequest,
    reply: &ChatReply,
) -> std::io::Result<()> {
    match CacheKey::of(model, request, 0) {
        Some(key) => cache.put(&key, model, reply),
        None => Ok(()),
    }
}
