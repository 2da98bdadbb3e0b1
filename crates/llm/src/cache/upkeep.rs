//! Listing and removing the replies of a cache.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use serde::Serialize;

use super::{EXTENSION, FORM, ReplyCache, StoredReply};

/// The prefix of files that are being written.
pub(super) const UNFINISHED: &str = ".unfinished-";

/// The age from which an unfinished file counts as left behind by a process that died.
const ABANDONED_AFTER: Duration = Duration::from_secs(3600);

/// The content of a cache.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CacheListing {
    /// The folder.
    pub folder: PathBuf,
    /// Number of replies.
    pub entries: u64,
    /// Their size in bytes.
    pub bytes: u64,
    /// Replies that cannot be read.
    pub broken: u64,
    /// Replies that earlier versions stored as answers of the model, and that are failures of a server. They are not used.
    pub failures: u64,
    /// All that can be read, by model.
    pub models: Vec<ModelReplies>,
}

/// The replies of one model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ModelReplies {
    /// The model.
    pub model: String,
    /// Number of replies.
    pub entries: u64,
    /// Their size in bytes.
    pub bytes: u64,
    /// When the oldest was stored, in seconds since 1970.
    pub oldest: u64,
    /// When the newest was stored, in seconds since 1970.
    pub newest: u64,
}

/// A number of replies and their size.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct CacheSize {
    /// How many.
    pub entries: u64,
    /// Their size in bytes.
    pub bytes: u64,
}

/// The outcome of pruning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Pruned {
    /// Removed replies.
    pub removed: CacheSize,
    /// Replies left.
    pub left: CacheSize,
}

struct EntryFile {
    path: PathBuf,
    bytes: u64,
    modified: SystemTime,
}

impl CacheSize {
    fn add(&mut self, file: &EntryFile) {
        self.entries += 1;
        self.bytes += file.bytes;
    }
}

impl ReplyCache {
    /// The content of the cache.
    ///
    /// # Errors
    /// When its folder exists and cannot be read.
    pub fn list(&self) -> io::Result<CacheListing> {
        let mut models = BTreeMap::<String, ModelReplies>::new();
        let (mut all, mut broken, mut failures) = (CacheSize::default(), 0, 0);
        for file in self.entries()? {
            let text = match durable::input::read(&file.path) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                text => text.unwrap_or_default(),
            };
            all.add(&file);
            let Ok(StoredReply { stored, model, reply, .. }) = serde_json::from_slice(&text) else {
                broken += 1;
                continue;
            };
            failures += u64::from(reply.judged().is_err());
            let replies = models.entry(model.clone()).or_insert(ModelReplies {
                model,
                entries: 0,
                bytes: 0,
                oldest: stored,
                newest: stored,
            });
            replies.entries += 1;
            replies.bytes += file.bytes;
            (replies.oldest, replies.newest) =
                (replies.oldest.min(stored), replies.newest.max(stored));
        }
        let CacheSize { entries, bytes } = all;
        let models = models.into_values().collect();
        Ok(CacheListing { folder: self.folder.clone(), entries, bytes, broken, failures, models })
    }

    /// Removes replies older than `older_than`, then the oldest until at most `max_bytes` are left.
    ///
    /// # Errors
    /// When a folder cannot be read, or a file cannot be removed.
    pub fn prune(
        &self,
        older_than: Option<Duration>,
        max_bytes: Option<u64>,
        now: SystemTime,
    ) -> io::Result<Pruned> {
        let mut entries = self.entries()?;
        entries.sort_by(|a, b| (a.modified, &a.path).cmp(&(b.modified, &b.path)));
        let (mut removed, mut left) = (CacheSize::default(), CacheSize::default());
        entries.iter().for_each(|file| left.add(file));
        for file in entries {
            // A modification time in the future counts as new.
            let age = now.duration_since(file.modified).unwrap_or_default();
            let old = older_than.is_some_and(|most| age > most);
            if !old && max_bytes.is_none_or(|most| left.bytes <= most) {
                break;
            }
            remove(&file.path)?;
            removed.add(&file);
            left.entries -= 1;
            left.bytes -= file.bytes;
        }
        Ok(Pruned { removed, left })
    }

    /// Removes the replies that are not used: those that cannot be read, and failures of a server that earlier versions
    /// stored as answers. With `dry_run` it removes none, and returns what it would do.
    ///
    /// # Errors
    /// As [`Self::prune`].
    pub fn prune_unusable(&self, dry_run: bool) -> io::Result<Pruned> {
        let (mut removed, mut left) = (CacheSize::default(), CacheSize::default());
        for file in self.entries()? {
            let text = durable::input::read(&file.path).unwrap_or_default();
            let stored = serde_json::from_slice::<StoredReply>(&text);
            if stored.is_ok_and(|stored| stored.reply.judged().is_ok()) {
                left.add(&file);
                continue;
            }
            if !dry_run {
                remove(&file.path)?;
            }
            removed.add(&file);
        }
        Ok(Pruned { removed, left })
    }

    /// Removes every reply, and no other files.
    ///
    /// # Errors
    /// As [`Self::prune`].
    pub fn clear(&self) -> io::Result<CacheSize> {
        let mut removed = CacheSize::default();
        for file in self.entries()? {
            remove(&file.path)?;
            removed.add(&file);
        }
        for folder in folders(&self.folder.join(FORM))? {
            // A folder that another process writes to is not empty, and stays.
            drop(fs::remove_dir(folder));
        }
        Ok(removed)
    }

    /// The files of all entries. Abandoned unfinished files are removed.
    fn entries(&self) -> io::Result<Vec<EntryFile>> {
        let mut entries = Vec::new();
        for folder in folders(&self.folder.join(FORM))? {
            for file in fs::read_dir(folder)? {
                let path = file?.path();
                // Another process may have removed it.
                let Ok(facts) = fs::metadata(&path) else { continue };
                let modified = facts.modified()?;
                let unfinished = path.file_name().and_then(|name| name.to_str());
                if unfinished.is_some_and(|name| name.starts_with(UNFINISHED)) {
                    if modified.elapsed().is_ok_and(|age| age > ABANDONED_AFTER) {
                        remove(&path)?;
                    }
                } else if path.extension().is_some_and(|extension| extension == EXTENSION) {
                    entries.push(EntryFile { path, bytes: facts.len(), modified });
                }
            }
        }
        Ok(entries)
    }
}

/// The subfolders of a folder; none when it does not exist.
fn folders(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let inside = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        inside => inside?,
    };
    let paths = inside.map(|entry| entry.map(|entry| entry.path()));
    paths.filter(|path| path.as_ref().map_or(true, |path| path.is_dir())).collect()
}

fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;

    use super::super::CacheKey;
    use super::*;
    use crate::{ChatRequest, reply};

    const DAY: Duration = Duration::from_secs(86_400);

    /// A cache of four replies of two models, from 0 to 3 days old.
    fn cache(folder: &Path, now: SystemTime) -> ReplyCache {
        let cache = ReplyCache::at(folder);
        let body = br#"{"choices":[{"message":{"content":"North."}}]}"#;
        let request = ChatRequest::text("?", 9);
        for days in 0..4 {
            let model = if days == 3 { "older" } else { "newer" };
            let key = CacheKey::of(&crate::ChatSettings::new(model), &request, days).unwrap();
            cache.put(&key, model, &reply::read(body).unwrap()).unwrap();
            let file = File::options().write(true).open(cache.path(&key)).unwrap();
            file.set_modified(now - DAY * days).unwrap();
        }
        cache
    }

    #[test]
    fn old_replies_are_removed_first() {
        let now = SystemTime::now();
        for (older_than, max_bytes, expected) in [
            (None, None, 4),
            (Some(DAY * 5 / 2), None, 3),
            (Some(DAY / 2), None, 1),
            (None, Some(0), 0),
            (None, Some(1 << 20), 4),
            (Some(DAY * 5 / 2), Some(700), 2),
        ] {
            let folder = tempfile::tempdir().unwrap();
            let cache = cache(folder.path(), now);
            let before = cache.list().unwrap();
            let Pruned { removed, left } = cache.prune(older_than, max_bytes, now).unwrap();
            assert_eq!(left.entries, expected, "{older_than:?} {max_bytes:?} {before:?}");
            assert_eq!(removed.entries + left.entries, 4);
            let after = cache.list().unwrap();
            assert_eq!((after.entries, after.bytes), (left.entries, left.bytes));
            assert_eq!(before.bytes, removed.bytes + left.bytes);
        }
    }

    #[test]
    fn a_listing_groups_by_model_and_counts_broken_entries() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache(folder.path(), SystemTime::now());
        let broken = cache.folder.join(FORM).join("aa");
        fs::create_dir_all(&broken).unwrap();
        fs::write(broken.join("aa.json"), "{").unwrap();
        let CacheListing { entries, broken, failures, models, .. } = cache.list().unwrap();
        assert_eq!((entries, broken, failures), (5, 1, 0));
        let models: Vec<_> =
            models.iter().map(|replies| (&*replies.model, replies.entries)).collect();
        assert_eq!(models, [("newer", 3), ("older", 1)]);
    }

    #[test]
    fn replies_that_are_not_used_are_counted_and_removed() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache(folder.path(), SystemTime::now());
        let key = CacheKey::of(&crate::ChatSettings::new("newer"), &ChatRequest::text("?", 9), 9)
            .unwrap();
        let answer = reply::read(br#"{"choices":[{"message":{"content":"North."}}]}"#).unwrap();
        let failure = crate::ChatReply { finish_reason: Some("error".to_owned()), ..answer };
        cache.put(&key, "newer", &failure).unwrap();
        fs::write(cache.path(&key).with_file_name("aa.json"), "{").unwrap();
        let CacheListing { entries, broken, failures, .. } = cache.list().unwrap();
        assert_eq!((entries, broken, failures), (6, 1, 1));
        let counted = cache.prune_unusable(true).unwrap();
        assert_eq!((counted.removed.entries, counted.left.entries), (2, 4));
        assert_eq!(cache.list().unwrap().entries, 6, "nothing was removed");
        assert_eq!(cache.prune_unusable(false).unwrap(), counted);
        let CacheListing { entries, broken, failures, .. } = cache.list().unwrap();
        assert_eq!((entries, broken, failures), (4, 0, 0));
    }

    #[test]
    fn clearing_leaves_other_files() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache(folder.path(), SystemTime::now());
        fs::write(folder.path().join("notes.json"), "mine").unwrap();
        assert_eq!(cache.clear().unwrap().entries, 4);
        assert_eq!(cache.list().unwrap().entries, 0);
        assert!(folder.path().join("notes.json").exists());
        assert_eq!(ReplyCache::at("/nowhere").list().unwrap().entries, 0);
    }
}
