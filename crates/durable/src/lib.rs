//! Operations on the files that a run is resumed from: its log, its manifest, snapshots of memories.
//!
//! They do what the standard library does, except that they follow no symbolic link, so that a folder from elsewhere makes
//! the program read and write nothing outside of it. In a drill ([`inject`]) they also fail as a disk does that is full,
//! broken or slow, or as the program does that is killed in the middle of a write.
//!
//! [`input`] reads files that a user names, [`output`] writes them.

#![deny(unsafe_code)]

mod beneath;
mod draft;
pub mod input;
mod known;
pub mod output;

pub use beneath::{check_no_links, open_beneath};
pub use draft::FolderDraft;
pub use known::{KnownNames, Removal};

use std::fs::{self, File};
use std::io::{self, BufReader, ErrorKind, Read, Write};
use std::path::Path;
use std::sync::OnceLock;

use rustix::fs::OFlags;

/// Most bytes of a file of a run that are read, 16 GiB: what a run of tens of millions of requests logs.
const RUN_FILE_LIMIT: u64 = 16 << 30;

/// An operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operation {
    /// A whole file is read.
    Read,
    /// This many bytes are written.
    Write(usize),
    /// A file or folder is flushed to the disk.
    Sync,
    /// Another thread is asked to flush a file.
    SyncSoon,
    /// A file or folder gets another name.
    Rename,
}

/// What goes wrong with an operation.
pub enum Fault {
    /// It fails. Of a write, the first `written` bytes reach the file before. `error` is called then; it may end the thread
    /// instead of returning.
    Fails {
        /// Bytes that are written.
        written: usize,
        /// The error.
        error: Box<dyn FnOnce() -> io::Error>,
    },
    /// A read is interrupted by signals and returns few bytes at a time.
    ShortReads,
}

/// Decides which operations go wrong.
pub trait Faults: Send + Sync {
    /// The fault of the next operation, if it has one.
    fn fault(&self, operation: Operation, path: &Path) -> Option<Fault>;
}

static FAULTS: OnceLock<Box<dyn Faults>> = OnceLock::new();

/// Lets `faults` decide from now on which operations go wrong. Returns `false` if another one does already.
pub fn inject(faults: Box<dyn Faults>) -> bool {
    FAULTS.set(faults).is_ok()
}

fn fault(operation: Operation, path: &Path) -> Option<Fault> {
    FAULTS.get()?.fault(operation, path)
}

/// The error of an operation that writes nothing, if it fails.
fn check(operation: Operation, path: &Path) -> io::Result<()> {
    match fault(operation, path) {
        Some(Fault::Fails { error, .. }) => Err(error()),
        Some(Fault::ShortReads) | None => Ok(()),
    }
}

/// Opens the regular file `path` for reading; `path` itself must not be a symbolic link.
///
/// # Errors
/// When it is something else, or the system refuses.
pub fn open(path: &Path) -> io::Result<File> {
    input::regular(beneath::open_at(rustix::fs::CWD, path, OFlags::RDONLY)?)
}

/// Reads the whole file `path`, a regular file and no symbolic link.
///
/// # Errors
/// When it is something else or too large, or the system refuses.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    match fault(Operation::Read, path) {
        Some(Fault::Fails { error, .. }) => Err(error()),
        Some(Fault::ShortReads) => {
            let (mut text, mut file) = (Vec::new(), Interrupted(open(path)?, false));
            file.read_to_end(&mut text).map(|_| text)
        }
        None => input::read_at_most(open(path)?, RUN_FILE_LIMIT),
    }
}

/// Opens the file `path`, a regular file and no symbolic link, to be read line by line.
///
/// # Errors
/// When it is something else, or the system refuses.
pub fn open_buffered(path: &Path) -> io::Result<BufReader<impl Read + Send + use<>>> {
    let file: Box<dyn Read + Send> = match fault(Operation::Read, path) {
        Some(Fault::Fails { error, .. }) => return Err(error()),
        Some(Fault::ShortReads) => Box::new(Interrupted(open(path)?, false)),
        None => Box::new(open(path)?),
    };
    Ok(BufReader::with_capacity(1 << 16, file))
}

/// Opens the file `path` for appending and reading, and creates it if it is missing; `path` itself must not be a symbolic link.
///
/// # Errors
/// When it is something else than a regular file, or the system refuses.
pub fn append(path: &Path) -> io::Result<File> {
    let flags = OFlags::RDWR | OFlags::APPEND | OFlags::CREATE;
    input::regular(beneath::open_at(rustix::fs::CWD, path, flags)?)
}

/// Opens an empty file `path` for writing, in place of the content of any that is there; `path` itself must not be a
/// symbolic link.
///
/// # Errors
/// When it is something else than a regular file, or the system refuses.
pub fn create(path: &Path) -> io::Result<File> {
    let flags = OFlags::WRONLY | OFlags::TRUNC | OFlags::CREATE;
    input::regular(beneath::open_at(rustix::fs::CWD, path, flags)?)
}

/// Writes `bytes` to `file`, which was opened as `path`, with one call where the system takes them all at once.
///
/// # Errors
/// When the system refuses; part of the bytes may have been written.
pub fn write(file: &mut File, path: &Path, bytes: &[u8]) -> io::Result<()> {
    match fault(Operation::Write(bytes.len()), path) {
        Some(Fault::Fails { written, error }) => {
            file.write_all(&bytes[..written.min(bytes.len())])?;
            Err(error())
        }
        Some(Fault::ShortReads) | None => file.write_all(bytes),
    }
}

/// Writes a file that holds `bytes`, in place of any that is there.
///
/// # Errors
/// As [`write()`].
pub fn write_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    write(&mut create(path)?, path, bytes)
}

/// Returns when the data of `file`, which was opened as `path`, is on the disk.
///
/// # Errors
/// When the system refuses.
pub fn sync(file: &File, path: &Path) -> io::Result<()> {
    check(Operation::Sync, path)?;
    file.sync_data()
}

/// Returns when a file, or the entries of a folder, are on the disk.
///
/// # Errors
/// When the system refuses.
pub fn sync_path(path: &Path) -> io::Result<()> {
    check(Operation::Sync, path)?;
    File::open(path)?.sync_all()
}

/// Returns when the name of `path` is on the disk: flushes the folder that it is in.
///
/// # Errors
/// When the system refuses.
pub fn sync_name(path: &Path) -> io::Result<()> {
    let folder = path.parent().filter(|folder| *folder != Path::new(""));
    sync_path(folder.unwrap_or(Path::new(".")))
}

/// Called where another thread is asked to flush `path`, which may fail in a drill.
///
/// # Errors
/// In a drill.
pub fn check_sync_soon(path: &Path) -> io::Result<()> {
    check(Operation::SyncSoon, path)
}

/// Gives `from` the name `to`, in place of any file of that name.
///
/// # Errors
/// When the system refuses.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    check(Operation::Rename, to)?;
    fs::rename(from, to)
}

/// Replaces the file `path` by one that holds `bytes`: written as `draft`, flushed, then renamed, so that a kill at any
/// moment leaves the old file or the new one. The new name may not be on the disk yet.
///
/// # Errors
/// As the steps.
pub fn replace(path: &Path, draft: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = create(draft)?;
    write(&mut file, draft, bytes)?;
    check(Operation::Sync, draft)?;
    file.sync_all()?;
    rename(draft, path)
}

/// A file whose reads are short, each after one that a signal interrupts.
struct Interrupted(File, bool);

impl Read for Interrupted {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.1 = !self.1;
        if self.1 {
            return Err(ErrorKind::Interrupted.into());
        }
        let few = buffer.len().min(7);
        self.0.read(&mut buffer[..few])
    }
}

#[cfg(test)]
mod tests {
    use std::io::BufRead;

    use super::*;

    /// Fails every operation on files called `bad`, after two bytes.
    struct Bad;

    impl Faults for Bad {
        fn fault(&self, operation: Operation, path: &Path) -> Option<Fault> {
            let name = path.file_name()?.to_str()?;
            match name {
                "short" if operation == Operation::Read => Some(Fault::ShortReads),
                "bad" => {
                    let error = Box::new(|| io::Error::from(ErrorKind::StorageFull));
                    Some(Fault::Fails { written: 2, error })
                }
                _ => None,
            }
        }
    }

    #[test]
    fn operations_do_what_they_say_unless_a_fault_is_injected() {
        assert!(inject(Box::new(Bad)) && !inject(Box::new(Bad)));
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["good", "short"] {
            write_file(&path(name), b"0123456789").unwrap();
            assert_eq!(read(&path(name)).unwrap(), b"0123456789");
            let mut text = Vec::new();
            open_buffered(&path(name)).unwrap().read_until(b'8', &mut text).unwrap();
            assert_eq!(text, b"012345678");
            sync_path(&path(name)).unwrap();
        }
        replace(&path("good"), &path("draft"), b"new").unwrap();
        assert_eq!(read(&path("good")).unwrap(), b"new");
        assert!(!path("draft").exists());

        let full = |outcome: io::Result<()>| outcome.unwrap_err().kind() == ErrorKind::StorageFull;
        assert!(full(write_file(&path("bad"), b"0123")));
        assert_eq!(fs::read(path("bad")).unwrap(), b"01", "part of it was written");
        assert!(full(open_buffered(&path("bad")).map(drop)));
        assert!(full(read(&path("bad")).map(drop)) && full(sync_path(&path("bad"))));
        assert!(full(rename(&path("good"), &path("bad"))) && path("good").exists());
        assert!(full(replace(&path("bad"), &path("draft"), b"4")));
        assert_eq!(fs::read(path("bad")).unwrap(), b"01", "not replaced");
    }
}
