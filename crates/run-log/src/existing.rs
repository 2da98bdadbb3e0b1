//! A run that is already in a folder: locking, recognising and removing it.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

use durable::Removal;
use rustix::io::Errno;

use super::files::{
    EPISODES_FILE, ERRORS_FILE, LOCK_FILE, LOGS_FOLDER, REQUESTS_FILE, memory_log_names, run_names,
};
use super::manifest::MANIFEST_FILE;
use super::{LogError, Manifest, system};

/// The most names in a message.
const SHOWN: usize = 20;

/// Locks the folder until the file is dropped. The lock is on a file that is opened for writing, because NFS cannot lock
/// anything else; the file stays.
pub(super) fn lock(dir: &Path) -> Result<File, LogError> {
    let path = dir.join(LOCK_FILE);
    let file = durable::append(&path).map_err(system("open", &path))?;
    let without_locks = [Errno::NOLCK, Errno::NOSYS, Errno::OPNOTSUPP].map(Errno::raw_os_error);
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(LogError::Locked(dir.to_owned())),
        Err(TryLockError::Error(error)) => match error.raw_os_error() {
            Some(code) if without_locks.contains(&code) => {
                Err(LogError::NoLocks { dir: dir.to_owned(), source: error })
            }
            _ => Err(system("lock", &path)(error)),
        },
    }
}

/// The manifest of the run in `dir`, or none when the folder is empty; an error when it holds something else, or a manifest
/// that cannot be read: what such a folder holds is not known, and none of it is removed.
pub(super) fn existing(dir: &Path) -> Result<Option<Manifest>, LogError> {
    if fs::symlink_metadata(dir.join(MANIFEST_FILE)).is_ok() {
        return Manifest::read(dir).map(Some);
    }
    for entry in fs::read_dir(dir).map_err(system("list", dir))? {
        let name = entry.map_err(system("list", dir))?.file_name();
        // Only a draft of the manifest: the run was killed when it had just begun. Logs: external memories start earlier.
        let is_of_a_run = match name == LOGS_FOLDER {
            true => has_only_memory_logs(&dir.join(name))?,
            false => name == "manifest.json.new" || name == LOCK_FILE,
        };
        if !is_of_a_run {
            return Err(LogError::NotARun(dir.to_owned()));
        }
    }
    Ok(None)
}

/// Whether the folder `logs` has nothing but logs of external memories.
fn has_only_memory_logs(logs: &Path) -> Result<bool, LogError> {
    let others = memory_log_names().and_then(|names| names.others_in(logs));
    Ok(others.map_err(system("list", logs))?.is_empty())
}

/// Whether the journal `file` in `dir` has anything in it.
pub(super) fn has_lines(dir: &Path, file: &str) -> bool {
    fs::metadata(dir.join(file)).is_ok_and(|file| file.len() > 0)
}

/// Whether the run in `dir` has neither results nor errors: it stopped before, for example because a model was missing.
pub(super) fn is_without_results(dir: &Path) -> bool {
    [EPISODES_FILE, REQUESTS_FILE, ERRORS_FILE].iter().all(|file| !has_lines(dir, file))
}

/// Removes the run in `dir`, whose manifest was read, and returns a note about what was removed and what was left. Only what has
/// a name that a run gives is removed, at every depth, and no log of an external memory. The manifest of the next run replaces
/// that of this one: until then, what is left after a kill is recognisable as a run.
pub(super) fn remove_run(dir: &Path) -> Result<String, LogError> {
    let episodes = durable::read(&dir.join(EPISODES_FILE)).unwrap_or_default();
    let finished = episodes.iter().filter(|&&byte| byte == b'\n').count();
    let remove = || {
        let removal = run_names()?.remove_in(dir)?;
        Ok((removal, memory_log_names()?))
    };
    let (Removal { mut removed, mut left }, memory_logs) =
        remove().map_err(system("remove the run in", dir))?;
    removed.insert(MANIFEST_FILE.into());
    left.retain(|path| {
        let is_memory_log = path.strip_prefix(LOGS_FOLDER).is_ok_and(|log| memory_logs.has(log));
        !stays(path) && !is_memory_log
    });
    let left = match left.len() {
        0 => String::new(),
        _ => format!("; left what a run does not write: {}", listed(&left)),
    };
    Ok(format!(
        "--fresh: removed the earlier run in {} ({finished} finished episodes): {}{left}",
        dir.display(),
        listed(&removed),
    ))
}

/// Whether a file of a run is not removed before the next run: the manifest is replaced, and the lock is held.
pub(super) fn stays(path: &Path) -> bool {
    path == Path::new(MANIFEST_FILE) || path == Path::new(LOCK_FILE)
}

/// The paths, separated by commas; of many, the first and how many more there are.
fn listed<'a>(paths: impl IntoIterator<Item = &'a PathBuf>) -> String {
    let mut names: Vec<String> = paths.into_iter().map(|path| path.display().to_string()).collect();
    let more = names.len().saturating_sub(SHOWN);
    if more > 0 {
        names.truncate(SHOWN);
        names.push(format!("and {more} more"));
    }
    names.join(", ")
}
