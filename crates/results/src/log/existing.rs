//! A run that is already in a folder: locking, recognising and removing it.

use std::fs::{self, File};
use std::path::Path;

use rustix::fs::FlockOperation;

use super::files::{CONTENTS, EPISODES_FILE, LOGS_FOLDER};
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

/// The manifest of the run in `dir`, or none when the folder is empty; an error when it holds something else. The inner
/// error is a manifest that cannot be read, which `--fresh` replaces.
pub(super) fn existing(dir: &Path) -> Result<Option<Result<Manifest, LogError>>, LogError> {
    if dir.join(MANIFEST_FILE).exists() {
        return Ok(Some(Manifest::read(dir)));
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

/// Removes the run in `dir` and returns a note about it.
pub(super) fn remove_run(dir: &Path) -> Result<String, LogError> {
    let episodes = fs::read(dir.join(EPISODES_FILE)).unwrap_or_default();
    let finished = episodes.iter().filter(|&&byte| byte == b'\n').count();
    // The manifest goes last: what is left of a run stays recognisable as one.
    for name in CONTENTS.iter().rev() {
        let path = dir.join(name);
        if *name == LOGS_FOLDER {
            remove_logs(&path, |name| !is_of_external_memory(name))?;
        } else if path.is_dir() {
            fs::remove_dir_all(&path).map_err(system("remove", &path))?;
        } else if path.exists() {
            fs::remove_file(&path).map_err(system("remove", &path))?;
        }
    }
    Ok(format!(
        "--fresh: removed the earlier run in {} ({finished} finished episodes)",
        dir.display()
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
