//! A run that is already in a folder: locking, recognising and removing it.

use std::fs::{self, File};
use std::io;
use std::path::Path;

use rustix::fs::FlockOperation;

use super::files::{
    CONTENTS, EPISODES_FILE, ERRORS_FILE, LOGS_FOLDER, REPORT_FILES, REPORT_FOLDER, REQUESTS_FILE,
};
use super::manifest::MANIFEST_FILE;
use super::{LogError, Manifest, system};

/// The processes of a run that write logs, beside the external memories.
const PROCESSES: [&str; 3] = ["sim", "memory", "policy"];

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
/// touched; files in the folders of logs and of the report that a run does not write are named in the note.
pub(super) fn remove_run(dir: &Path) -> Result<String, LogError> {
    let episodes = durable::read(&dir.join(EPISODES_FILE)).unwrap_or_default();
    let finished = episodes.iter().filter(|&&byte| byte == b'\n').count();
    let (mut removed, mut left) = (Vec::new(), Vec::new());
    // The manifest goes last: what is left of a run stays recognisable as one.
    for name in CONTENTS.iter().rev() {
        let path = dir.join(name);
        let Ok(found) = fs::symlink_metadata(&path) else { continue };
        let in_folder = |file: String| format!("{name}/{file}");
        if *name == LOGS_FOLDER {
            remove_logs(&path, is_of_own_process)?;
            let is_foreign = |log: &str| !is_of_own_process(log) && !is_of_external_memory(log);
            left.extend(names_in(&path)?.into_iter().filter(|log| is_foreign(log)).map(in_folder));
        } else if *name == REPORT_FOLDER && found.is_dir() {
            let foreign = remove_report(&path)?;
            if !foreign.is_empty() {
                left.extend(foreign.into_iter().map(in_folder));
                continue;
            }
        } else if found.is_dir() {
            fs::remove_dir_all(&path).map_err(system("remove", &path))?;
        } else {
            fs::remove_file(&path).map_err(system("remove", &path))?;
        }
        removed.push(*name);
    }
    removed.reverse();
    let left = match &left[..] {
        [] => String::new(),
        left => format!("; left what a run does not write: {}", left.join(", ")),
    };
    Ok(format!(
        "--fresh: removed the earlier run in {} ({finished} finished episodes): {}{left}",
        dir.display(),
        removed.join(", ")
    ))
}

/// Removes the report in the folder `report`, and the folder if nothing else is in it. Returns what else is in it.
fn remove_report(report: &Path) -> Result<Vec<String>, LogError> {
    let (known, foreign): (Vec<String>, Vec<String>) =
        names_in(report)?.into_iter().partition(|name| REPORT_FILES.contains(&&**name));
    for name in known {
        let path = report.join(name);
        let remove = if path.is_dir() { fs::remove_dir_all } else { fs::remove_file };
        remove(&path).map_err(system("remove", &path))?;
    }
    if foreign.is_empty() {
        fs::remove_dir(report).map_err(system("remove", report))?;
    }
    Ok(foreign)
}

/// The names in `folder`, in order.
fn names_in(folder: &Path) -> Result<Vec<String>, LogError> {
    let name = |entry: io::Result<fs::DirEntry>| entry.map(|entry| entry.file_name());
    let entries = fs::read_dir(folder).map_err(system("list", folder))?;
    let names: io::Result<Vec<_>> = entries.map(name).collect();
    let names = names.map_err(system("list", folder))?;
    let mut names: Vec<_> = names.iter().map(|name| name.to_string_lossy().into_owned()).collect();
    names.sort();
    Ok(names)
}

/// The process of a log, from the name of its file or of the file's draft.
fn process_of(log: &str) -> Option<&str> {
    log.strip_suffix(".log").or_else(|| log.strip_suffix(".log.new"))
}

/// Whether a log is that of one of the run's own processes.
fn is_of_own_process(log: &str) -> bool {
    process_of(log).is_some_and(|process| PROCESSES.contains(&process))
}

/// Whether a log is that of an external memory. These start before the run's folder is opened, and write to theirs already
/// when an earlier run is removed.
pub(super) fn is_of_external_memory(log: &str) -> bool {
    let index = process_of(log).and_then(|process| process.strip_prefix("external-memory-"));
    index.is_some_and(|index| !index.is_empty() && index.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Removes the logs of the processes whose names `which` selects.
pub(super) fn remove_logs(logs: &Path, which: impl Fn(&str) -> bool) -> Result<(), LogError> {
    if !logs.exists() {
        return Ok(());
    }
    for entry in fs::read_dir(logs).map_err(system("list", logs))? {
        let entry = entry.map_err(system("list", logs))?;
        let path = entry.path();
        if which(&entry.file_name().to_string_lossy()) && !path.is_dir() {
            fs::remove_file(&path).map_err(system("remove", &path))?;
        }
    }
    Ok(())
}
