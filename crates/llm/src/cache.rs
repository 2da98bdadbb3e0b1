//! Replies on disk: what was asked once need not be asked again.
//!
//! A reply is found by everything that decides it: model, messages with the bytes of their images, every
//! parameter of the request, and which repetition of the question it is ([`Key`]). Who served it is not part
//! of that: the same model behind another address would say the same, and where it would not, `off` or another
//! folder is the setting to use.
//!
//! Only replies are kept, never failures. An entry is a file, whole from the moment that it has its name, so
//! processes may share a folder: two that write one entry write the same question's reply, and the last stays.
//! One that cannot be read is as good as missing; the next reply takes its place.

mod upkeep;

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use domain::{NoCacheFolder, cache_folder};
use serde::{Deserialize, Serialize};

use super::message::{Content, Dialect, Part, Question};
use super::reply::Reply;

pub use upkeep::{Amount, Held, Listing, Pruned};

/// The form of an entry, and of what its key is made from. Another form is another folder.
const FORM: &str = "replies-1";

/// How entry files end.
const EXTENSION: &str = "json";

/// A folder of replies. Processes and threads may share it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ResponseCache {
    folder: PathBuf,
}

/// The name of a question and of which repetition of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Key(String);

/// A file of an entry.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    /// The key again, so that a file under a wrong name is noticed.
    key: String,
    /// When it was stored, in seconds since 1970.
    stored: u64,
    /// The model that was asked for.
    model: String,
    reply: Reply,
}

impl Key {
    /// The key of a question to `model`. `None` when an image is somewhere else than in the question: what is
    /// there may change.
    pub fn of(model: &str, question: &Question, repeat: u32) -> Option<Self> {
        let is_here = |part: &Part| match part {
            Part::Text { .. } => true,
            Part::ImageUrl { image_url } => image_url.url.starts_with("data:"),
        };
        let all_here = question.messages.iter().all(|message| match &message.content {
            Content::Text(_) => true,
            Content::Parts(parts) => parts.iter().all(is_here),
        });
        let mut hasher = blake3::Hasher::new();
        hasher.update(FORM.as_bytes()).update(&repeat.to_le_bytes());
        // The body as it is before any server has objected to a field: with every parameter, on one line.
        let body = Dialect::default().body(model, question);
        let written = serde_json::to_writer(&mut hasher, &body).is_ok();
        (all_here && written).then(|| Self(hasher.finalize().to_hex().to_string()))
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(key) = self;
        f.write_str(key)
    }
}

impl ResponseCache {
    /// The replies in `folder`, which need not exist yet.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into() }
    }

    /// The folder `responses` in the cache that the environment names ([`cache_folder`]).
    ///
    /// # Errors
    /// When it names none.
    pub fn from_environment() -> Result<Self, NoCacheFolder> {
        Ok(Self::at(cache_folder()?.join("responses")))
    }

    /// What the setting `response-cache` means: `on`, `off`, or a folder.
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

    /// Where the replies are.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The reply that is known. One that cannot be read is none, and is complained about.
    pub fn get(&self, key: &Key) -> Option<Reply> {
        let path = self.path(key);
        let problem = match fs::read(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return None,
            Err(error) => error.to_string(),
            Ok(text) => match serde_json::from_slice::<Entry>(&text) {
                Err(error) => error.to_string(),
                Ok(entry) if entry.key != key.to_string() => "it is another one's".to_owned(),
                Ok(entry) => return Some(entry.reply),
            },
        };
        tracing::warn!(
            "the stored reply {} cannot be used: {problem}; it is asked anew",
            path.display()
        );
        None
    }

    /// Keeps a reply of `model`, in one step.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn put(&self, key: &Key, model: &str, reply: &Reply) -> io::Result<()> {
        let path = self.path(key);
        let folder = path.parent().unwrap_or(&self.folder);
        fs::create_dir_all(folder)?;
        let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let entry = Entry {
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

    /// A folder for every 256th of the keys, so that none grows large.
    fn path(&self, Key(key): &Key) -> PathBuf {
        let shard = key.get(..2).unwrap_or_default();
        self.folder.join(FORM).join(shard).join(key).with_extension(EXTENSION)
    }
}

#[cfg(test)]
mod tests {
    use super::super::message::{ImageUrl, Message, Speaker};
    use super::super::reply::Outcome;
    use super::*;

    fn question(text: &str, image: &str) -> Question {
        let image = Part::ImageUrl { image_url: ImageUrl { url: image.into() } };
        let parts = vec![Part::Text { text: text.into() }, image];
        let message = Message { role: Speaker::User, content: Content::Parts(parts) };
        Question { messages: vec![message], max_tokens: 30 }
    }

    fn reply(text: &str) -> Reply {
        Reply {
            outcome: Outcome::Text(text.to_owned()),
            model: Some("m-1".into()),
            prompt_tokens: Some(10),
            completion_tokens: None,
            cached_tokens: Some(4),
            image_tokens: None,
            finish_reason: Some("stop".into()),
            system_fingerprint: None,
            reasoned: false,
        }
    }

    const IMAGE: &str = "data:image/png;base64,AA==";

    #[test]
    fn whatever_decides_a_reply_is_in_its_key() {
        let key =
            |model: &str, question: &Question, repeat| Key::of(model, question, repeat).unwrap();
        let original = key("m", &question("Where?", IMAGE), 0);
        assert_eq!(key("m", &question("Where?", IMAGE), 0), original);
        let longer = Question { max_tokens: 31, ..question("Where?", IMAGE) };
        let mut spoken = question("Where?", IMAGE);
        spoken.messages[0].role = Speaker::System;
        let mut twice = question("Where?", IMAGE);
        twice.messages.push(Message::text(Speaker::Assistant, "North."));
        for other in [
            key("m", &question("Where?", "data:image/png;base64,AB=="), 0),
            key("m", &question("Where", IMAGE), 0),
            key("n", &question("Where?", IMAGE), 0),
            key("m", &question("Where?", IMAGE), 1),
            key("m", &longer, 0),
            key("m", &spoken, 0),
            key("m", &twice, 0),
        ] {
            assert_ne!(other, original);
        }
        let elsewhere = question("Where?", "http://a/view.png");
        assert_eq!(Key::of("m", &elsewhere, 0), None);
    }

    /// A change of this value makes every stored reply one that nobody finds: [`FORM`] should change with it.
    #[test]
    fn the_key_of_a_known_question() {
        let key = Key::of("m", &question("Where?", IMAGE), 0).unwrap();
        insta::assert_snapshot!(key, @"a50e4dceaa29a1e8b98c4a5bd6055b2593a9db392328467e4683d5c10ab3d3eb");
    }

    #[test]
    fn what_was_stored_is_found_and_what_is_broken_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let cache = ResponseCache::at(folder.path().join("responses"));
        let key = Key::of("m", &question("Where?", IMAGE), 0).unwrap();
        let other = Key::of("m", &question("Where?", IMAGE), 1).unwrap();
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
        assert_eq!(cache.get(&other), None, "it is another one's");
    }

    #[test]
    fn many_write_and_read_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let keys: Vec<_> =
            (0..5).map(|n| Key::of("m", &question("?", IMAGE), n).unwrap()).collect();
        std::thread::scope(|scope| {
            for _ in 0..8 {
                let (folder, keys) = (folder.path(), &keys);
                scope.spawn(move || {
                    let cache = ResponseCache::at(folder);
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
        assert_eq!(ResponseCache::at(folder.path()).list().unwrap().entries, 5);
    }

    #[test]
    fn the_setting() {
        assert_eq!(ResponseCache::from_setting("off").unwrap(), None);
        assert_eq!(ResponseCache::from_setting("d").unwrap(), Some(ResponseCache::at("d")));
    }
}
