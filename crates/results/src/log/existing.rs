//! A run that is already in a folder: locking, recognising and removing it.

use std::fs::{self, File};
use std::path::Path;

use rustix::fs::FlockOperation;

use super::files::{CONTENTS, EPISODES_FILE, ERRORS_FILE, LOGS_FOLDER, REQUESTS_FILE};
use super::manifest::MANIFEST_FILE;
use super::{LogError, Manifest, system};

/// Locks the folder until the file is dropped.
pub(super) fn lock(dir: &Path) -> Result<File, LogError> {
    let file = File::open(dir).map_err(system("open", dir))?;
    match rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(file),
        Err(rustix::io::Errno::WOULDBLOCK) => Err(LogError::Locked(dir.to_owned())),
        Err(errno) => Err(system("lock", dir)(errno.into())),
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
        if name != "manifest.json.new" && name != LOGS_FOLDER {
            return Err(LogError::NotARun(dir.to_owned()));
        }
    }
    Ok(None)
}

/// Whether the journal `file` in `dir` has anything in it.
pub(super) fn has_lines(dir: &Path, file: &str) -> bool {
    fs::metadata(dir.join(file)).is_ok_and(|file| file.len() > 0)
}

/// Whether the run in `dir` has neither results nor errors: it stopped before, for example because a model was missing.
pub(super) fn is_without_results(dir: &Path) -> bool {
    [EPISODES_FILE, REQUESTS_FILE, ERRORS_FILE].iter().all(|file| !has_lines(dir, file))
}

/// Removes the run in `dir`, whose manifest was read, and returns a note about what was removed. Nothing else in the folder is
/// touched.
pub(super) fn remove_run(dir: &Path) -> Result<String, LogError> {
    let episodes = durable::read(&dir.join(EPISODES_FILE)).unwrap_or_default();
    let finished = episodes.iter().filter(|&&byte| byte == b'\n').count();
    let mut removed = Vec::new();
    // The manifest goes last: what is left of a run stays recognisable as one.
    for name in CONTENTS.iter().rev() {
        let path = dir.join(name);
        let Ok(found) = fs::symlink_metadata(&path) else { continue };
        if *name == LOGS_FOLDER {
            remove_logs(&path, |name| !is_of_external_memory(name))?;
        } else if found.is_dir() {
            fs::remove_dir_all(&path).map_err(system("remove", &path))?;
        } else {
            fs::remove_file(&path).map_err(system("remove", &path))?;
        }
        removed.push(*name);
    }
    removed.reverse();
    Ok(format!(
        "--fresh: removed the earlier run in {} ({finished} finished episodes): {}",
        dir.display(),
        removed.join(", ")
    ))
}

/// Whether a log is that of an external memory. These start before the run's folder is opened, and write to theirs already
/// when an earlier run is removed.
pub(super) fn is_of_external_memory(name: &str) -> bool {
    name.starts_with("external-memory-")
}

/// Removes the logs of the processes whose names `which` selects.
pub(super) fn remove_logs(logs: &Path, which: impl Fn(&str) -> bool) -> Result<(), LogError> {
    if !logs.exists() {
        return Ok(());
    }
    for entry in fs::read_dir(logs).map_err(system("list", logs))? {
        let entry = entry.map_err(system("list", logs))?;
        if which(&entry.file_name().to_string_lossy()) {
            let path = entry.path();
            fs::remove_file(&path).map_err(system("remove", &path))?;
        }
    }
    Ok(())
}
