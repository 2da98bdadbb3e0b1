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
        let old = old(&draft);
        if fs::symlink_metadata(target).is_err() && fs::symlink_metadata(&old).is_ok() {
            // Killed between the two renames of a file system that cannot exchange names.
            fs::rename(&old, target)?;
        }
        remove(&draft)?;
        fs::create_dir(&draft)?;
        Ok(Self { target: target.to_owned(), draft })
    }

    /// Where the files go.
    pub fn path(&self) -> &Path {
        &self.draft
    }

    /// Links what is at `others`, paths below the folder that will be replaced, into the draft, so that it stays. A file that
    /// the draft has under the same name is the newer one.
    ///
    /// # Errors
    /// When the system refuses, for example on a file system without hard links.
    pub fn keep(&self, others: &[PathBuf]) -> io::Result<()> {
        others.iter().try_for_each(|path| link(&self.target.join(path), &self.draft.join(path)))
    }

    /// Gives the draft its name, in place of what is there, and the permissions of a folder there.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn finish(self) -> io::Result<()> {
        let Self { target, draft } = &self;
        if fs::symlink_metadata(target).is_ok_and(|found| found.is_dir()) {
            copy_mode(target, draft)?;
        }
        match rustix::fs::renameat_with(CWD, draft, CWD, target, RenameFlags::EXCHANGE) {
            Ok(()) => Ok(()),
            Err(Errno::NOENT) => fs::rename(draft, target),
            // A file system that cannot exchange two names.
            Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) => {
                let old = old(draft);
                remove(&old)?;
                fs::rename(target, &old)?;
                fs::rename(draft, target)?;
                remove(&old)
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

/// The name that the folder of before has for a moment.
fn old(draft: &Path) -> PathBuf {
    let mut old = OsString::from(draft);
    old.push("-old");
    old.into()
}

/// Gives the file `from`, or everything in the folder `from`, a second name in the place `to`.
fn link(from: &Path, to: &Path) -> io::Result<()> {
    if let Some(parent) = to.parent() {
        fs::create_dir_all(parent)?;
    }
    if !fs::symlink_metadata(from)?.is_dir() {
        return match fs::hard_link(from, to) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists && to.is_file() => Ok(()),
            outcome => outcome,
        };
    }
    fs::create_dir_all(to)?;
    copy_mode(from, to)?;
    for entry in fs::read_dir(from)? {
        let name = entry?.file_name();
        link(&from.join(&name), &to.join(name))?;
    }
    Ok(())
}

/// Gives the folder `to` the permissions of the folder `from`.
fn copy_mode(from: &Path, to: &Path) -> io::Result<()> {
    fs::set_permissions(to, fs::metadata(from)?.permissions())
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
    use std::os::unix::fs::PermissionsExt;

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

        // What is not part of the new folder is kept where that is asked for, at every depth.
        let draft = FolderDraft::new(&target).unwrap();
        fs::create_dir_all(target.join("mine/deep")).unwrap();
        fs::write(target.join("mine/deep/file"), "mine").unwrap();
        let is_private =
            |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777 == 0o700;
        let private = [target.clone(), target.join("mine/deep")];
        for folder in &private {
            fs::set_permissions(folder, fs::Permissions::from_mode(0o700)).unwrap();
        }
        fs::write(draft.path().join("b"), "new").unwrap();
        draft.keep(&["mine".into(), "b".into()]).unwrap();
        draft.finish().unwrap();
        assert_eq!(names(&target), ["b", "mine"]);
        assert!(private.iter().all(|folder| is_private(folder)));
        assert_eq!(fs::read(target.join("mine/deep/file")).unwrap(), b"mine");
        assert_eq!(fs::read(target.join("b")).unwrap(), b"new");
        // After a kill between two renames, the folder of before has its name again.
        fs::rename(&target, parent.join("pages.memtransfer-draft-old")).unwrap();
        drop(FolderDraft::new(&target).unwrap());
        assert_eq!(
            (names(parent), names(&target)),
            (vec!["pages".into()], vec!["b".into(), "mine".into()])
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
