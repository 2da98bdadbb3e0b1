//! Files that are written where a user or a cache folder says.
//!
//! They must be regular files: to open a pipe waits for a reader, perhaps for ever.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use rustix::fs::{CWD, Mode, OFlags};

use crate::beneath::refusal;
use crate::input::regular;

/// Opens the file `path`, which is created if it is missing, to lock it.
///
/// # Errors
/// When it is no regular file, or the system refuses.
pub fn open_lock(path: &Path) -> io::Result<File> {
    open(path, OFlags::APPEND)
}

/// Opens the file `path` for writing, empty: in place of the content of any that is there.
///
/// # Errors
/// When it is no regular file, or the system refuses.
pub fn create(path: &Path) -> io::Result<File> {
    open(path, OFlags::TRUNC)
}

/// Writes a file that holds `bytes`, in place of the content of any that is there.
///
/// # Errors
/// When it is no regular file, or the system refuses.
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    create(path)?.write_all(bytes.as_ref())
}

fn open(path: &Path, flags: OFlags) -> io::Result<File> {
    let flags = flags | OFlags::WRONLY | OFlags::CREATE | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let mode = Mode::from_raw_mode(0o666);
    let opened = rustix::io::retry_on_intr(|| rustix::fs::openat(CWD, path, flags, mode));
    regular(opened.map_err(refusal)?.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_regular_file_is_written_and_a_pipe_is_not_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        write(&path("new"), "text").unwrap();
        write(&path("new"), "new").unwrap();
        drop(open_lock(&path("new")).unwrap());
        assert_eq!(std::fs::read(path("new")).unwrap(), b"new");
        drop(open_lock(&path("lock")).unwrap());
        assert_eq!(std::fs::read(path("lock")).unwrap(), b"");
        // A file that the user names may be reached through a link.
        std::os::unix::fs::symlink("new", path("link")).unwrap();
        write(&path("link"), "linked").unwrap();
        assert_eq!(std::fs::read(path("new")).unwrap(), b"linked");

        rustix::fs::mkfifoat(CWD, path("pipe"), Mode::RUSR | Mode::WUSR).unwrap();
        let refused = |outcome: io::Result<()>, words: &str| {
            let problem = outcome.unwrap_err().to_string();
            assert!(problem.contains(words), "{problem}");
        };
        let both = |path: &Path, words: &str| {
            refused(create(path).map(drop), words);
            refused(open_lock(path).map(drop), words);
            refused(crate::append(path).map(drop), words);
            refused(crate::create(path).map(drop), words);
        };
        both(&path("pipe"), "a pipe");
        // Also while something reads from it.
        let reader = crate::beneath::open_at(CWD, &path("pipe"), OFlags::RDONLY).unwrap();
        both(&path("pipe"), "it is a pipe and not a regular file");
        drop(reader);
        both(Path::new("/dev/null"), "it is a device and not a regular file");
        both(folder.path(), "directory");
    }
}
