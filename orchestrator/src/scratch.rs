//! Temporary folders and unfinished copies, and what a killed program left of them.
//!
//! A program keeps a lock on each while it uses it, which the kernel releases when the program ends in any way. What is unlocked
//! and bears the name of one is abandoned, and `memtransfer clean` removes it.

use std::fs::{self, File, Permissions, TryLockError};
use std::io;
use std::io::ErrorKind::{AlreadyExists, NotFound};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use tempfile::{NamedTempFile, TempDir};

/// How the names of temporary folders begin.
const FOLDER: &str = "memtransfer-scratch-";

/// The file in a temporary folder that is locked while the folder is used.
const LOCK: &str = "lock";

/// How the names of unfinished copies begin.
const DRAFT: &str = ".memtransfer-draft-";

/// A temporary folder of this program. Dropping it removes it.
#[derive(Debug)]
pub struct ScratchFolder {
    folder: TempDir,
    _lock: File,
}

impl ScratchFolder {
    /// An empty folder that only this user can read.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn new() -> io::Result<Self> {
        loop {
            let folder = tempfile::Builder::new().prefix(FOLDER).tempdir()?;
            // Unless a cleaner was first.
            let lock = match File::create_new(folder.path().join(LOCK)) {
                Err(error) if matches!(error.kind(), NotFound | AlreadyExists) => continue,
                lock => lock?,
            };
            lock.lock()?;
            if folder.path().exists() {
                return Ok(Self { folder, _lock: lock });
            }
        }
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// An unfinished file in `folder` with the permissions that the umask lets files have.
///
/// # Errors
/// When the system refuses.
pub(crate) fn draft_in(folder: &Path) -> io::Result<NamedTempFile> {
    // Other users of the folder read the file, as far as the umask lets them.
    let permissions = Permissions::from_mode(0o666);
    let mut named = tempfile::Builder::new();
    named.prefix(DRAFT).permissions(permissions);
    loop {
        let draft = named.tempfile_in(folder)?;
        // On a file system without locks, drafts that are in use cannot be distinguished from abandoned ones, and all stay.
        if let Err(error) = draft.as_file().lock() {
            tracing::debug!(%error, folder = %folder.display(), "an unfinished copy cannot be locked");
        }
        // Unless a cleaner was first.
        if draft.path().exists() {
            return Ok(draft);
        }
    }
}

/// The temporary folders of this user that killed programs left.
///
/// # Errors
/// When the folder of temporary files cannot be read.
pub fn abandoned_folders() -> io::Result<Vec<PathBuf>> {
    let own = rustix::process::getuid().as_raw();
    abandoned(&std::env::temp_dir(), FOLDER, |path| {
        let about = fs::symlink_metadata(path)?;
        // One that was killed when it had just made its folder, or was removing it, has left no lock.
        let is_free = match is_unlocked(&path.join(LOCK)) {
            Err(error) if error.kind() == NotFound => true,
            is_unlocked => is_unlocked?,
        };
        Ok(about.is_dir() && about.uid() == own && is_free)
    })
}

/// The unfinished copies in `folder` that killed programs left; none if there is no such folder.
///
/// # Errors
/// When the folder cannot be read.
pub fn abandoned_drafts(folder: &Path) -> io::Result<Vec<PathBuf>> {
    abandoned(folder, DRAFT, |path| Ok(fs::symlink_metadata(path)?.is_file() && is_unlocked(path)?))
}

/// Removes what [`abandoned_folders`] or [`abandoned_drafts`] has found.
///
/// # Errors
/// When the system refuses.
pub fn remove(abandoned: &Path) -> io::Result<()> {
    let removed = fs::symlink_metadata(abandoned).and_then(|about| {
        // Kept meanwhile: a program that has just made it finds it removed, and makes another one.
        let lock = match about.is_dir() {
            true => durable::output::open_lock(&abandoned.join(LOCK))?,
            false => durable::input::open(abandoned)?,
        };
        match lock.try_lock() {
            Ok(()) if about.is_dir() => fs::remove_dir_all(abandoned),
            Ok(()) => fs::remove_file(abandoned),
            Err(TryLockError::WouldBlock) => Ok(()),
            Err(TryLockError::Error(error)) => Err(error),
        }
    });
    // Another one may have been faster.
    removed.or_else(|error| if error.kind() == NotFound { Ok(()) } else { Err(error) })
}

fn abandoned(
    folder: &Path,
    prefix: &str,
    is_abandoned: impl Fn(&Path) -> io::Result<bool>,
) -> io::Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let entry = entry?;
        let has_name = entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes());
        // What cannot be looked at, or has just gone, is not ours to remove.
        if has_name && is_abandoned(&entry.path()).unwrap_or(false) {
            found.push(entry.path());
        }
    }
    found.sort();
    Ok(found)
}

fn is_unlocked(file: &Path) -> io::Result<bool> {
    Ok(durable::input::open(file)?.try_lock().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_in_use_is_not_abandoned_and_what_was_left_is() {
        let used = ScratchFolder::new().unwrap();
        let left = ScratchFolder::new().unwrap();
        let path = left.path().to_owned();
        fs::write(path.join("view.png"), "x").unwrap();
        // As a kill leaves it: without a lock, and not removed.
        let ScratchFolder { folder, _lock: lock } = left;
        assert_eq!(folder.keep(), path);
        drop(lock);
        // As a kill leaves it that comes before there is a lock.
        let unborn = tempfile::Builder::new().prefix(FOLDER).tempdir().unwrap().keep();
        let used_path = used.path().to_owned();
        let found = abandoned_folders().unwrap();
        assert!(found.contains(&path) && found.contains(&unborn) && !found.contains(&used_path));
        for left in [&path, &path, &unborn] {
            remove(left).unwrap();
            assert!(!left.exists());
        }
        // One that was made after the look.
        remove(&used_path).unwrap();
        assert!(used_path.exists());
        drop(used);
        assert!(!used_path.exists());
    }

    #[test]
    fn drafts_of_living_programs_and_other_files_stay() {
        let folder = tempfile::tempdir().unwrap();
        let living = draft_in(folder.path()).unwrap();
        let (_, left) = draft_in(folder.path()).unwrap().keep().unwrap();
        fs::write(folder.path().join("object"), "x").unwrap();
        fs::create_dir(folder.path().join(format!("{DRAFT}folder"))).unwrap();
        assert_eq!(abandoned_drafts(folder.path()).unwrap(), [left]);
        assert!(living.path().exists());
        assert_eq!(abandoned_drafts(&folder.path().join("none")).unwrap(), [] as [PathBuf; 0]);
    }
}
