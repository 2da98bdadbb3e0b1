//! Writing files: all of one or nothing.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

/// Writes a file by way of its draft, which `write` is given; a file of that name is replaced.
pub(crate) fn write_whole(path: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))?;
    }
    let mut draft = OsString::from(path);
    draft.push(".part");
    let draft = PathBuf::from(draft);
    let written = write(&draft).and_then(|()| {
        fs::rename(&draft, path).with_context(|| format!("cannot write {}", path.display()))
    });
    if written.is_err() {
        // What is left of a failed attempt is of no use.
        let _ = fs::remove_file(&draft);
    }
    written
}

/// Writes a text in the same way.
pub(crate) fn write_text(path: &Path, text: &str) -> Result<()> {
    write_whole(path, |draft| {
        durable::output::write(draft, text)
            .with_context(|| format!("cannot write {}", path.display()))
    })
}

/// Whether `path` names a file with this extension, as opposed to a folder.
pub(crate) fn is_file(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension))
}
