//! Files that a user names: suites, assets, plans, prices.
//!
//! They must be regular files, because a pipe may never end and a device may hold any amount, and of a limited size.

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

use rustix::fs::{CWD, Mode, OFlags};

/// Most bytes of an input file, 256 MiB: four times what the largest set of cases takes.
pub const INPUT_LIMIT: u64 = 256 << 20;

/// Most bytes of a large input file, 16 GiB: eight times what a file of an ONNX model can hold.
const LARGE_INPUT_LIMIT: u64 = 16 << 30;

/// Reads the input file `path`.
///
/// # Errors
/// When it is no regular file, larger than [`INPUT_LIMIT`], or the system refuses.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    read_at_most(open(path)?, INPUT_LIMIT)
}

/// Reads the input file `path` that may be large: a model, a library or embeddings.
///
/// # Errors
/// When it is no regular file, larger than 16 GiB or than the memory, or the system refuses.
pub fn read_large(path: &Path) -> io::Result<Vec<u8>> {
    read_at_most(open(path)?, LARGE_INPUT_LIMIT)
}

/// Opens the input file `path` for reading.
///
/// # Errors
/// When it is no regular file, or the system refuses.
pub fn open(path: &Path) -> io::Result<File> {
    // A pipe without a writer would wait for one.
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file = rustix::io::retry_on_intr(|| rustix::fs::openat(CWD, path, flags, Mode::empty()))?;
    regular(file.into())
}

/// Reads the input file `path` as text.
///
/// # Errors
/// As [`read`], and when it is not UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    let text = String::from_utf8(read(path)?);
    text.map_err(|error| io::Error::new(ErrorKind::InvalidData, format!("not UTF-8: {error}")))
}

/// The file, if it is a regular one.
pub(crate) fn regular(file: File) -> io::Result<File> {
    let kind = file.metadata()?.file_type();
    if kind.is_file() {
        return Ok(file);
    }
    if kind.is_dir() {
        return Err(rustix::io::Errno::ISDIR.into());
    }
    let kind = match () {
        () if kind.is_fifo() => "a pipe",
        () if kind.is_socket() => "a socket",
        () => "a device",
    };
    Err(io::Error::new(ErrorKind::InvalidInput, format!("it is {kind} and not a regular file")))
}

/// Everything in `file`, if that is at most `limit` bytes.
pub(crate) fn read_at_most(file: File, limit: u64) -> io::Result<Vec<u8>> {
    let too_large = || {
        let problem = format!("it is larger than {} MiB", limit >> 20);
        io::Error::new(ErrorKind::FileTooLarge, problem)
    };
    let size = file.metadata()?.len();
    if size > limit {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(size).map_err(|_| too_large())?)?;
    // It may grow meanwhile.
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit { Err(too_large()) } else { Ok(bytes) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_regular_file_of_limited_size_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("text"), "text").unwrap();
        assert_eq!(read_text(&path("text")).unwrap(), "text");
        // A file that the user names may be reached through a link.
        std::os::unix::fs::symlink("text", path("link")).unwrap();
        assert_eq!(read_text(&path("link")).unwrap(), "text");
        std::fs::write(path("bytes"), [0xff]).unwrap();
        assert_eq!(read_text(&path("bytes")).unwrap_err().kind(), ErrorKind::InvalidData);

        let mode = Mode::RUSR | Mode::WUSR;
        rustix::fs::mkfifoat(CWD, path("pipe"), mode).unwrap();
        File::create(path("large")).unwrap().set_len(INPUT_LIMIT + 1).unwrap();
        let problem = |path: &Path| read(path).unwrap_err().to_string();
        assert_eq!(problem(&path("pipe")), "it is a pipe and not a regular file");
        assert_eq!(problem(Path::new("/dev/zero")), "it is a device and not a regular file");
        assert_eq!(problem(&path("large")), "it is larger than 256 MiB");
        assert!(open(&path("large")).is_ok());
        assert!(read_large(&path("pipe")).is_err() && read_large(Path::new("/dev/zero")).is_err());
        assert_eq!(read(folder.path()).unwrap_err().kind(), ErrorKind::IsADirectory);
        assert_eq!(read(&path("none")).unwrap_err().kind(), ErrorKind::NotFound);
        // Files of a run, too.
        assert!(crate::read(&path("pipe")).is_err() && crate::append(&path("pipe")).is_err());
    }
}
