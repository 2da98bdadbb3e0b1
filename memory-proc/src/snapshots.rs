//! Snapshots of memories that learn, on disk: `<folder>/<sequence>/<snapshot>/`, named by their content.
//!
//! A snapshot is written under another name, synced and then renamed, so one that bears its name is complete. It is read
//! only if its content has the digest that it is named by.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use domain::{SEQUENCE_ENDED, hex};
use shm_types::message::SnapshotId;

/// The folder that a snapshot is written into before it has its name.
const UNFINISHED: &str = "unfinished";

/// Maximum size of the files of a snapshot, in bytes.
const MAX_SNAPSHOT_BYTES: u64 = 1 << 30;

/// The folder of a run's snapshots.
#[derive(Debug, Clone)]
pub struct SnapshotFolder(PathBuf);

impl SnapshotFolder {
    /// Snapshots in `folder`, which is created with the first of them.
    pub fn new(folder: PathBuf) -> Self {
        Self(folder)
    }

    fn of(&self, sequence: u64) -> PathBuf {
        self.0.join(format!("{sequence:016x}"))
    }

    /// An empty folder for the files of a snapshot that [`Self::finish`] completes.
    pub(crate) fn begin(&self, sequence: u64) -> Result<PathBuf, String> {
        let of_sequence = self.of(sequence);
        if !of_sequence.is_dir() {
            done(&of_sequence, "create", fs::create_dir_all(&of_sequence))?;
            // The log names what is in it, so its own name must be on disk before.
            sync(&self.0)?;
            done(&self.0, "sync", durable::sync_name(&self.0))?;
        }
        let folder = of_sequence.join(UNFINISHED);
        remove(&folder)?;
        done(&folder, "create", fs::create_dir(&folder))?;
        Ok(folder)
    }

    /// Completes the snapshot that was begun: syncs and names it. Keeps `earlier` beside it and removes all others of the
    /// sequence.
    pub(crate) fn finish(&self, sequence: u64, earlier: SnapshotId) -> Result<SnapshotId, String> {
        let folder = self.of(sequence);
        let unfinished = folder.join(UNFINISHED);
        let id = digest(&unfinished, true)?;
        let target = folder.join(hex(&id));
        // One of the same content may be damaged.
        remove(&target)?;
        done(&target, "create", durable::rename(&unfinished, &target))?;
        sync(&folder)?;
        let kept = [hex(&id), hex(&earlier)];
        for entry in done(&folder, "read", fs::read_dir(&folder))? {
            let entry = done(&folder, "read", entry)?;
            let name = entry.file_name();
            // Files of the user stay.
            let is_snapshot = name.to_str().is_some_and(|name| {
                name.len() == hex(&id).len() && name.bytes().all(|byte| byte.is_ascii_hexdigit())
            });
            if is_snapshot && !kept.iter().any(|kept| name == kept.as_str()) {
                remove(&entry.path())?;
            }
        }
        Ok(id)
    }

    /// The folder of a snapshot, if it is whole.
    pub(crate) fn find(&self, sequence: u64, id: SnapshotId) -> Result<PathBuf, String> {
        let folder = self.of(sequence).join(hex(&id));
        let what = match folder.is_dir() {
            false => "is missing".to_owned(),
            true => match digest(&folder, false)? {
                found if found == id => return Ok(folder),
                found => format!("is damaged: its content is that of {}", hex(&found)),
            },
        };
        Err(format!(
            "snapshot {} {what}. {SEQUENCE_ENDED}, delete its lines from episodes.jsonl; `run --fresh` runs all again",
            folder.display()
        ))
    }
}

/// The first bytes of the BLAKE3 hash of all files in `folder`: names and contents, in the order of names. Folders are
/// part of the names.
fn digest(folder: &Path, sync_files: bool) -> Result<SnapshotId, String> {
    let mut hasher = blake3::Hasher::new();
    let bytes = size(folder)?;
    if bytes > MAX_SNAPSHOT_BYTES {
        return Err(format!(
            "what the memory saved has {bytes} bytes, and at most {MAX_SNAPSHOT_BYTES} can be kept"
        ));
    }
    add_folder(&mut hasher, folder, "", sync_files)?;
    let mut id = SnapshotId::default();
    id.copy_from_slice(&hasher.finalize().as_bytes()[..size_of::<SnapshotId>()]);
    Ok(id)
}

/// Bytes of all files in `folder`.
fn size(folder: &Path) -> Result<u64, String> {
    let mut bytes = 0_u64;
    for entry in done(folder, "read", fs::read_dir(folder))? {
        let path = done(folder, "read", entry)?.path();
        let file = done(&path, "read", fs::symlink_metadata(&path))?;
        bytes = bytes.saturating_add(if file.is_dir() { size(&path)? } else { file.len() });
    }
    Ok(bytes)
}

fn add_folder(
    hasher: &mut blake3::Hasher,
    folder: &Path,
    prefix: &str,
    sync_files: bool,
) -> Result<(), String> {
    let entries: io::Result<Vec<_>> = fs::read_dir(folder).and_then(Iterator::collect);
    let mut names = Vec::new();
    for entry in done(folder, "read", entries)? {
        let name = entry.file_name().into_string();
        names.push(
            name.map_err(|name| format!("{}: file name {name:?} is not UTF-8", folder.display()))?,
        );
    }
    names.sort_unstable();
    for name in names {
        let path = folder.join(&name);
        let name = format!("{prefix}{name}");
        let kind = done(&path, "read", fs::symlink_metadata(&path))?;
        if kind.is_dir() {
            add_folder(hasher, &path, &format!("{name}/"), sync_files)?;
        } else if kind.is_file() {
            let content = done(&path, "read", durable::read(&path))?;
            for part in [name.as_bytes(), &content] {
                hasher.update(&(part.len() as u64).to_le_bytes());
                hasher.update(part);
            }
            if sync_files {
                sync(&path)?;
            }
        } else {
            let path = path.display();
            return Err(format!("{path} is neither a file nor a folder"));
        }
    }
    if sync_files { sync(folder) } else { Ok(()) }
}

/// Waits until a file or the entries of a folder are on disk.
fn sync(path: &Path) -> Result<(), String> {
    done(path, "sync", durable::sync_path(path))
}

fn remove(path: &Path) -> Result<(), String> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        outcome => done(path, "remove", outcome),
    }
}

fn done<T>(path: &Path, what: &str, outcome: io::Result<T>) -> Result<T, String> {
    outcome.map_err(|error| format!("cannot {what} {}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    fn write(folder: &SnapshotFolder, text: &str, earlier: SnapshotId) -> SnapshotId {
        let unfinished = folder.begin(7).unwrap();
        fs::create_dir(unfinished.join("memory")).unwrap();
        fs::write(unfinished.join("memory/store"), text).unwrap();
        fs::write(unfinished.join("list"), "one").unwrap();
        folder.finish(7, earlier).unwrap()
    }

    #[test]
    fn the_two_newest_are_kept_and_named_by_their_content() {
        let root = tempfile::tempdir().unwrap();
        let folder = SnapshotFolder::new(root.path().join("snapshots"));
        let first = write(&folder, "a", SnapshotId::default());
        let second = write(&folder, "b", first);
        assert_eq!(write(&folder, "b", first), second);
        let third = write(&folder, "c", second);
        let found = [first, second, third].map(|id| folder.find(7, id).is_ok());
        assert_eq!(found, [false, true, true]);
        assert_eq!(fs::read_dir(folder.of(7)).unwrap().count(), 2);
        assert!(folder.find(8, third).is_err());
    }

    /// The paths that were flushed; no operation fails.
    struct Flushed(&'static Mutex<Vec<PathBuf>>);

    impl durable::Faults for Flushed {
        fn fault(&self, operation: durable::Operation, path: &Path) -> Option<durable::Fault> {
            if operation == durable::Operation::Sync {
                self.0.lock().unwrap().push(path.to_owned());
            }
            None
        }
    }

    #[test]
    fn folders_that_lead_to_a_snapshot_are_on_disk_before_it() {
        static FLUSHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
        assert!(durable::inject(Box::new(Flushed(&FLUSHED))));
        let root = tempfile::tempdir().unwrap();
        let snapshots = root.path().join("snapshots");
        let folder = SnapshotFolder::new(snapshots.clone());
        folder.begin(7).unwrap();
        let flushed = |path: &Path| FLUSHED.lock().unwrap().iter().any(|found| found == path);
        assert!(flushed(&snapshots) && flushed(root.path()));
    }

    #[test]
    fn a_damaged_snapshot_is_refused_with_what_to_do() {
        let root = tempfile::tempdir().unwrap();
        let folder = SnapshotFolder::new(root.path().to_owned());
        let id = write(&folder, "abc", SnapshotId::default());
        let store = folder.find(7, id).unwrap().join("memory/store");
        for damage in ["ab", "abd", ""] {
            fs::write(&store, damage).unwrap();
            let error = folder.find(7, id).unwrap_err().to_string();
            assert!(error.contains("is damaged") && error.contains("--fresh"), "{error}");
            assert!(error.contains(SEQUENCE_ENDED), "{error}");
        }
        fs::write(&store, "abc").unwrap();
        assert!(folder.find(7, id).is_ok());
        fs::write(store.with_file_name("further"), "").unwrap();
        assert!(folder.find(7, id).is_err());
        fs::remove_dir_all(store.parent().unwrap()).unwrap();
        assert!(folder.find(7, id).is_err());
        fs::remove_dir_all(folder.of(7)).unwrap();
        assert!(folder.find(7, id).unwrap_err().to_string().contains("is missing"));
        assert_eq!(write(&folder, "abc", id), id, "written again");
    }
}
