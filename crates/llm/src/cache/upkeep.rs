//! What lies in a cache, and taking some of it or all of it away.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use serde::Serialize;

use super::{EXTENSION, Entry, FORM, ResponseCache};

/// How a file begins that does not have its name yet.
pub(super) const UNFINISHED: &str = ".unfinished-";

/// No process takes that long to write a reply: whoever began an older file has died.
const ABANDONED_AFTER: Duration = Duration::from_secs(3600);

/// What lies in a cache.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Listing {
    /// Where.
    pub folder: PathBuf,
    /// How many replies.
    pub entries: u64,
    /// How large they are together.
    pub bytes: u64,
    /// Those of them that cannot be read.
    pub broken: u64,
    /// The others, by the model that was asked.
    pub models: Vec<Held>,
}

/// The replies of one model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Held {
    /// Its name.
    pub model: String,
    /// How many replies.
    pub entries: u64,
    /// How large they are together.
    pub bytes: u64,
    /// When the oldest was stored, in seconds since 1970.
    pub oldest: u64,
    /// And the newest.
    pub newest: u64,
}

/// Some replies.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Amount {
    /// How many.
    pub entries: u64,
    /// How large they are together.
    pub bytes: u64,
}

/// What was taken away, and what is left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Pruned {
    /// Taken away.
    pub removed: Amount,
    /// Left.
    pub left: Amount,
}

struct Found {
    path: PathBuf,
    bytes: u64,
    modified: SystemTime,
}

impl Amount {
    fn add(&mut self, found: &Found) {
        self.entries += 1;
        self.bytes += found.bytes;
    }
}

impl ResponseCache {
    /// What lies in it.
    ///
    /// # Errors
    /// When its folder is there and cannot be read.
    pub fn list(&self) -> io::Result<Listing> {
        let mut models = BTreeMap::<String, Held>::new();
        let (mut all, mut broken) = (Amount::default(), 0);
        for found in self.entries()? {
            let text = match fs::read(&found.path) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                text => text.unwrap_or_default(),
            };
            all.add(&found);
            let Ok(Entry { stored, model, .. }) = serde_json::from_slice(&text) else {
                broken += 1;
                continue;
            };
            let held = models.entry(model.clone()).or_insert(Held {
                model,
                entries: 0,
                bytes: 0,
                oldest: stored,
                newest: stored,
            });
            held.entries += 1;
            held.bytes += found.bytes;
            (held.oldest, held.newest) = (held.oldest.min(stored), held.newest.max(stored));
        }
        let Amount { entries, bytes } = all;
        let models = models.into_values().collect();
        Ok(Listing { folder: self.folder.clone(), entries, bytes, broken, models })
    }

    /// Takes away what is older than `older_than`, then the oldest until `max_bytes` are left at most.
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
        let (mut removed, mut left) = (Amount::default(), Amount::default());
        entries.iter().for_each(|found| left.add(found));
        for found in entries {
            // What comes from the future is new.
            let age = now.duration_since(found.modified).unwrap_or_default();
            let old = older_than.is_some_and(|most| age > most);
            if !old && max_bytes.is_none_or(|most| left.bytes <= most) {
                break;
            }
            remove(&found.path)?;
            removed.add(&found);
            left.entries -= 1;
            left.bytes -= found.bytes;
        }
        Ok(Pruned { removed, left })
    }

    /// Takes everything away that it wrote, and nothing else.
    ///
    /// # Errors
    /// As [`Self::prune`].
    pub fn clear(&self) -> io::Result<Amount> {
        let mut removed = Amount::default();
        for found in self.entries()? {
            remove(&found.path)?;
            removed.add(&found);
        }
        for folder in folders(&self.folder.join(FORM))? {
            // One in which somebody writes at this moment stays.
            drop(fs::remove_dir(folder));
        }
        Ok(removed)
    }

    /// The files of all entries. Those that were begun and abandoned are removed on the way.
    fn entries(&self) -> io::Result<Vec<Found>> {
        let mut entries = Vec::new();
        for folder in folders(&self.folder.join(FORM))? {
            for file in fs::read_dir(folder)? {
                let path = file?.path();
                // Another process may have removed it in between.
                let Ok(facts) = fs::metadata(&path) else { continue };
                let modified = facts.modified()?;
                let unfinished = path.file_name().and_then(|name| name.to_str());
                if unfinished.is_some_and(|name| name.starts_with(UNFINISHED)) {
                    if modified.elapsed().is_ok_and(|age| age > ABANDONED_AFTER) {
                        remove(&path)?;
                    }
                } else if path.extension().is_some_and(|extension| extension == EXTENSION) {
                    entries.push(Found { path, bytes: facts.len(), modified });
                }
            }
        }
        Ok(entries)
    }
}

/// The folders in a folder; none when it is not there.
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

    use super::super::super::message::{Message, Question, Speaker};
    use super::super::super::reply::{self};
    use super::super::Key;
    use super::*;

    const DAY: Duration = Duration::from_secs(86_400);

    /// A cache of four replies of two models, from 0 to 3 days old.
    fn cache(folder: &Path, now: SystemTime) -> ResponseCache {
        let cache = ResponseCache::at(folder);
        let body = br#"{"choices":[{"message":{"content":"North."}}]}"#;
        let question =
            Question { messages: vec![Message::text(Speaker::User, "?")], max_tokens: 9 };
        for days in 0..4 {
            let model = if days == 3 { "older" } else { "newer" };
            let key = Key::of(model, &question, days).unwrap();
            cache.put(&key, model, &reply::read(body).unwrap()).unwrap();
            let file = File::options().write(true).open(cache.path(&key)).unwrap();
            file.set_modified(now - DAY * days).unwrap();
        }
        cache
    }

    #[test]
    fn what_is_old_or_too_much_goes_the_oldest_first() {
        let now = SystemTime::now();
        for (older_than, max_bytes, expected) in [
            (None, None, 4),
            (Some(DAY * 5 / 2), None, 3),
            (Some(DAY / 2), None, 1),
            (None, Some(0), 0),
            (None, Some(1 << 20), 4),
            (Some(DAY * 5 / 2), Some(900), 2),
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
    fn a_listing_tells_models_apart_and_counts_what_is_broken() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache(folder.path(), SystemTime::now());
        let broken = cache.folder.join(FORM).join("aa");
        fs::create_dir_all(&broken).unwrap();
        fs::write(broken.join("aa.json"), "{").unwrap();
        let Listing { entries, broken, models, .. } = cache.list().unwrap();
        assert_eq!((entries, broken), (5, 1));
        let models: Vec<_> = models.iter().map(|held| (&*held.model, held.entries)).collect();
        assert_eq!(models, [("newer", 3), ("older", 1)]);
    }

    #[test]
    fn clearing_leaves_what_is_not_the_caches() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache(folder.path(), SystemTime::now());
        fs::write(folder.path().join("notes.json"), "mine").unwrap();
        assert_eq!(cache.clear().unwrap().entries, 4);
        assert_eq!(cache.list().unwrap().entries, 0);
        assert!(folder.path().join("notes.json").exists());
        assert_eq!(ResponseCache::at("/nowhere").list().unwrap().entries, 0);
    }
}
