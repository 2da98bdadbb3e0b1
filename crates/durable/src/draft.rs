//! A folder that is replaced as a whole.

use std::ffi::OsString;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, RenameFlags};
use rustix::io::Errno;

/// A folder beside the one that it will replace. Killed at any moment, the program leaves the old folder or the new one
/// under its name, and perhaps a draft, which the next one removes. Dropped unfinished, it is removed.
#[derive(Debug)]
pub struct FolderDraft {
    target: PathBuf,
    draft: PathBuf,
}

impl FolderDraft {
    /// The end of a draft's name.
    pub const SUFFIX: &str = ".memtransfer-draft";

    /// Makes an empty draft of the folder `target`, and the folders above it.
    ///
    /// # Errors
    /// When `target` has no name, or the system refuses.
    pub fn new(target: &Path) -> io::Result<Self> {
        let nameless = || io::Error::new(ErrorKind::InvalidInput, "the folder has no name");
        let mut name = OsString::from(target.file_name().ok_or_else(nameless)?);
        name.push(Self::SUFFIX);
        let draft = target.with_file_name(name);
        if let Some(parent) = target.parent() {
            fs::create_dir_all(parent)?;
        }
        remove(&draft)?;
        fs::create_dir(&draft)?;
        Ok(Self { target: target.to_owned(), draft })
    }

    /// Where the files go.
    pub fn path(&self) -> &Path {
        &self.draft
    }

    /// Gives the draft its name, in place of what is there.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn finish(self) -> io::Result<()> {
        let Self { target, draft } = &self;
        match rustix::fs::renameat_with(CWD, draft, CWD, target, RenameFlags::EXCHANGE) {
            Ok(()) => Ok(()),
            Err(Errno::NOENT) => fs::rename(draft, target),
            // A file system that cannot exchange two names.
            Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) => {
                let mut old = OsString::from(draft);
                old.push("-old");
                remove(Path::new(&old))?;
                fs::rename(target, &old)?;
                fs::rename(draft, target)?;
                remove(Path::new(&old))
            }
            Err(errno) => Err(errno.into()),
        }
        // What was there before has the draft's name now, and is removed with it.
    }
}

impl Drop for FolderDraft {
    fn drop(&mut self) {
        // The next draft removes what is left.
        let _ = remove(&self.draft);
    }
}

/// Removes a folder, or a file or link in its place, if there is one.
fn remove(path: &Path) -> io::Result<()> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error),
        Ok(found) if found.is_dir() => fs::remove_dir_all(path),
        Ok(_) => fs::remove_file(path),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_replaced_as_a_whole_or_not_at_all() {
        let base = tempfile::tempdir().unwrap();
        let target = base.path().join("new/pages");
        let names = |folder: &Path| {
            let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
            let mut names: Vec<String> =
                names.map(|name| name.to_string_lossy().into_owned()).collect();
            names.sort();
            names
        };
        let parent = target.parent().unwrap();
        for (name, leftover) in [("a", false), ("b", true)] {
            if leftover {
                fs::create_dir(parent.join("pages.memtransfer-draft")).unwrap();
                fs::write(parent.join("pages.memtransfer-draft/half"), "").unwrap();
            }
            let draft = FolderDraft::new(&target).unwrap();
            fs::write(draft.path().join(name), "").unwrap();
            draft.finish().unwrap();
            assert_eq!(
                (names(parent), names(&target)),
                (vec!["pages".to_owned()], vec![name.to_owned()])
            );
        }
        let draft = FolderDraft::new(&target).unwrap();
        fs::write(draft.path().join("c"), "").unwrap();
        drop(draft);
        assert_eq!(
            (names(parent), names(&target)),
            (vec!["pages".to_owned()], vec!["b".to_owned()])
        );

        // A link is replaced, and not what it points to.
        let mine = base.path().join("mine");
        fs::create_dir(&mine).unwrap();
        fs::write(mine.join("file"), "mine").unwrap();
        std::os::unix::fs::symlink(&mine, parent.join("link")).unwrap();
        FolderDraft::new(&parent.join("link")).unwrap().finish().unwrap();
        assert_eq!((names(&mine), names(&parent.join("link"))), (vec!["file".to_owned()], vec![]));
        assert_eq!(names(parent), ["link", "pages"]);
        assert!(FolderDraft::new(Path::new("..")).is_err());
    }
}
