//! Replies on disk, so that a request is paid for once.
//!
//! A reply is found by everything that decides it: the model, the messages with the bytes of their images, every
//! parameter of the request, and the number of the repetition ([`CacheKey`]). The server's address is not part of the
//! key: the same model behind another address would give the same reply. Where it does not, use another folder.
//!
//! Failures are never stored, and those that earlier versions stored as answers are not used. An entry is a file that
//! appears whole, so processes may share a folder: two that write the same entry write replies to the same request. An
//! entry that cannot be read counts as missing and is replaced.

mod upkeep;

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use domain::{NoCacheFolder, cache_folder, create_private_folder};
use serde::{Deserialize, Serialize};

use crate::reply::ChatReply;
use crate::request::{ChatRequest, Dialect};
use crate::settings::ChatSettings;

pub use upkeep::{CacheListing, CacheSize, ModelReplies, Pruned};

/// The version of entries and keys. Another version is another folder.
const FORM: &str = "replies-1";

/// The extension of entry files.
const EXTENSION: &str = "json";

/// A folder of replies. Processes and threads may share it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReplyCache {
    folder: PathBuf,
}

/// The hash of a request and its repetition.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct CacheKey(String);

/// The content of an entry file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredReply {
    /// The key, so that a file under a wrong name is noticed.
    key: String,
    /// When it was stored, in seconds since 1970.
    stored: u64,
    /// The model that was asked for.
    model: String,
    reply: ChatReply,
}

impl CacheKey {
    /// The key of repetition `repeat` of a request with these settings. `None` when the request refers to an image outside itself,
    /// which may change.
    pub(crate) fn of(settings: &ChatSettings, request: &ChatRequest, repeat: u32) -> Option<Self> {
        let mut hasher = blake3::Hasher::new();
        hasher.update(FORM.as_bytes()).update(&repeat.to_le_bytes());
        // The body with every optional field, whatever the server at hand refuses.
        let body = Dialect::default().body(settings, request);
        let written = serde_json::to_writer(&mut hasher, &body).is_ok();
        (request.is_self_contained() && written)
            .then(|| Self(hasher.finalize().to_hex().to_string()))
    }
}

impl fmt::Display for CacheKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(key) = self;
        f.write_str(key)
    }
}

impl ReplyCache {
    /// The replies in `folder`, which need not exist yet.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into() }
    }

    /// The folder `responses` in the [`cache_folder`].
    ///
    /// # Errors
    /// When the environment names no cache folder.
    pub fn from_environment() -> Result<Self, NoCacheFolder> {
        Ok(Self::at(cache_folder()?.join("responses")))
    }

    /// The cache that the setting `response-cache` means: `on`, `off`, or a folder.
    ///
    /// # Errors
    /// When it is `on` and the environment names no cache folder.
    pub fn from_setting(setting: &str) -> Result<Option<Self>, NoCacheFolder> {
        match setting {
            "off" => Ok(None),
            "on" => Self::from_environment().map(Some),
            folder => Ok(Some(Self::at(folder))),
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The cached reply. One that cannot be read, or is not the model's answer ([`ChatReply::judged`]), is logged and counts
    /// as missing.
    pub(crate) fn get(&self, key: &CacheKey) -> Option<ChatReply> {
        let path = self.path(key);
        let problem = match durable::input::read(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return None,
            Err(error) => error.to_string(),
            Ok(text) => match serde_json::from_slice::<StoredReply>(&text) {
                Err(error) => error.to_string(),
                Ok(stored) if stored.key != key.to_string() => "it has another key".to_owned(),
                Ok(stored) => match stored.reply.judged() {
                    Ok(reply) => return Some(reply),
                    Err(problem) => problem,
                },
            },
        };
        tracing::warn!("the cached reply {} is not used: {problem}", path.display());
        None
    }

    /// Stores a reply of `model`.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub(crate) fn put(&self, key: &CacheKey, model: &str, reply: &ChatReply) -> io::Result<()> {
        let path = self.path(key);
        let folder = path.parent().unwrap_or(&self.folder);
        create_private_folder(folder)?;
        let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let entry = StoredReply {
            key: key.to_string(),
            stored: since_1970.map_or(0, |since| since.as_secs()),
            model: model.to_owned(),
            reply: reply.clone(),
        };
        let mut file = tempfile::Builder::new().prefix(upkeep::UNFINISHED).tempfile_in(folder)?;
        serde_json::to_writer(&mut file, &entry)?;
        file.persist(path).map_err(|error| error.error)?;
        Ok(())
    }

    /// The file of a key, in one of 256 folders.
    pub(crate) fn path(&self, CacheKey(key): &CacheKey) -> PathBuf {
        let shard = key.get(..2).unwrap_or_default();
        self.folder.join(FORM).join(shard).join(key).with_extension(EXTENSION)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::reply::ReplyContent;
    use crate::request::{ChatMessage, ChatRole, ContentPart, ImageUrl, MessageContent};

    fn request(text: &str, image: &str) -> ChatRequest {
        let image = ContentPart::ImageUrl { image_url: ImageUrl { url: image.into() } };
        let parts = vec![ContentPart::Text { text: text.into() }, image];
        let message = ChatMessage { role: ChatRole::User, content: MessageContent::Parts(parts) };
        ChatRequest { messages: vec![message], max_tokens: 30, choices: Vec::new() }
    }

    fn reply(text: &str) -> ChatReply {
        ChatReply {
            content: ReplyContent::Text(text.to_owned()),
            model: Some("m-1".into()),
            prompt_tokens: Some(10),
            completion_tokens: None,
            cached_tokens: Some(4),
            image_tokens: None,
            finish_reason: Some("stop".into()),
            reasoned: false,
        }
    }

    const IMAGE: &str = "data:image/png;base64,AA==";

    #[test]
    fn everything_that_determines_a_reply_is_in_its_key() {
        let key = |model: &str, request: &ChatRequest, repeat| {
            CacheKey::of(&ChatSettings::new(model), request, repeat).unwrap()
        };
        let original = key("m", &request("Where?", IMAGE), 0);
        assert_eq!(key("m", &request("Where?", IMAGE), 0), original);
        let longer = ChatRequest { max_tokens: 31, ..request("Where?", IMAGE) };
        let mut spoken = request("Where?", IMAGE);
        spoken.messages[0].role = ChatRole::System;
        let mut twice = request("Where?", IMAGE);
        twice.messages.push(ChatMessage::text(ChatRole::Assistant, "North."));
        for other in [
            key("m", &request("Where?", "data:image/png;base64,AB=="), 0),
            key("m", &request("Where", IMAGE), 0),
            key("n", &request("Where?", IMAGE), 0),
            key("m", &request("Where?", IMAGE), 1),
            key("m", &longer, 0),
            key("m", &spoken, 0),
            key("m", &twice, 0),
        ] {
            assert_ne!(other, original);
        }
        let mut options = [(); 3].map(|()| ChatSettings::new("m"));
        options[0].options.reasoning = domain::ReasoningRequest::Low;
        options[1].options.system_role = domain::SystemRole::User;
        options[2].options.extra_body.insert("top_k".to_owned(), 1.into());
        let plain = CacheKey::of(&ChatSettings::new("m"), &spoken, 0);
        for settings in options {
            assert_ne!(CacheKey::of(&settings, &spoken, 0), plain);
        }
        let elsewhere = request("Where?", "http://a/view.png");
        assert_eq!(CacheKey::of(&ChatSettings::new("m"), &elsewhere, 0), None);
    }

    /// If this value changes, no cached reply is found any more: change [`FORM`] too.
    #[test]
    fn the_key_of_a_known_request() {
        let key = CacheKey::of(&ChatSettings::new("m"), &request("Where?", IMAGE), 0).unwrap();
        insta::assert_snapshot!(key, @"a50e4dceaa29a1e8b98c4a5bd6055b2593a9db392328467e4683d5c10ab3d3eb");
    }

    #[test]
    fn stored_replies_are_found_and_broken_ones_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let cache = ReplyCache::at(folder.path().join("responses"));
        let key = CacheKey::of(&ChatSettings::new("m"), &request("Where?", IMAGE), 0).unwrap();
        let other = CacheKey::of(&ChatSettings::new("m"), &request("Where?", IMAGE), 1).unwrap();
        assert_eq!(cache.get(&key), None);
        cache.put(&key, "m", &reply("North.")).unwrap();
        assert_eq!(cache.get(&key), Some(reply("North.")));
        assert_eq!(cache.get(&other), None);

        let whole = fs::read(cache.path(&key)).unwrap();
        for broken in [&b""[..], &whole[..whole.len() / 2], b"{}", b"\xff"] {
            fs::write(cache.path(&key), broken).unwrap();
            assert_eq!(cache.get(&key), None);
            cache.put(&key, "m", &reply("South.")).unwrap();
            assert_eq!(cache.get(&key), Some(reply("South.")));
        }
        fs::create_dir_all(cache.path(&other).parent().unwrap()).unwrap();
        fs::write(cache.path(&other), &whole).unwrap();
        assert_eq!(cache.get(&other), None, "it has another key");

        // As earlier versions stored the failure of a server.
        let failure = ChatReply {
            content: ReplyContent::Empty,
            finish_reason: Some("abort".into()),
            ..reply("")
        };
        cache.put(&key, "m", &failure).unwrap();
        assert_eq!(cache.get(&key), None);
    }

    #[test]
    fn many_write_and_read_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let keys: Vec<_> = (0..5)
            .map(|n| CacheKey::of(&ChatSettings::new("m"), &request("?", IMAGE), n).unwrap())
            .collect();
        std::thread::scope(|scope| {
            for _ in 0..8 {
                let (folder, keys) = (folder.path(), &keys);
                scope.spawn(move || {
                    let cache = ReplyCache::at(folder);
                    for round in 0..20 {
                        let key = &keys[round % keys.len()];
                        if let Some(known) = cache.get(key) {
                            assert_eq!(known, reply("North."));
                        }
                        cache.put(key, "m", &reply("North.")).unwrap();
                        assert!(cache.get(key).is_some(), "half an entry was seen");
                    }
                });
            }
        });
        assert_eq!(ReplyCache::at(folder.path()).list().unwrap().entries, 5);
    }

    #[test]
    fn the_setting_is_on_off_or_a_folder() {
        assert_eq!(ReplyCache::from_setting("off").unwrap(), None);
        assert_eq!(ReplyCache::from_setting("d").unwrap(), Some(ReplyCache::at("d")));
    }
}
