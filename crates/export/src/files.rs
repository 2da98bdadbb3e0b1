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
    // What an interrupted export left. A link in its place goes, and not what it points to.
    let _ = fs::remove_file(&draft);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_in_the_place_of_a_draft_is_not_written_through() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(path("mine"), "mine").unwrap();
        std::os::unix::fs::symlink("mine", path("table.csv.part")).unwrap();
        write_text(&path("table.csv"), "new").unwrap();
        assert_eq!(fs::read_to_string(path("mine")).unwrap(), "mine");
        assert_eq!(fs::read_to_string(path("table.csv")).unwrap(), "new");
        assert!(fs::symlink_metadata(path("table.csv")).unwrap().is_file());
    }
}
