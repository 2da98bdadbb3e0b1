//! Writing files: all of one or nothing.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

/// The name of `path` while it is written.
pub(crate) fn draft_of(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".part");
    name.into()
}

/// Makes the folder that `path` lies in.
pub(crate) fn make_parent(path: &Path) -> Result<()> {
    match path.parent() {
        Some(parent) => {
            fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))
        }
        None => Ok(()),
    }
}

/// Writes a file by way of its draft, which `write` is given; a file of that name is replaced.
pub(crate) fn write_whole(path: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    make_parent(path)?;
    let draft = draft_of(path);
    let written = write(&draft).and_then(|()| {
        fs::rename(&draft, path).with_context(|| format!("cannot write {}", path.display()))
    });
    if written.is_err() {
        // What is left of a failed attempt is of no use.
        let _ = fs::remove_file(&draft);
    }
    written
}

/// Whether `path` names a file with this extension, as opposed to a folder.
pub(crate) fn is_file(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension))
}
