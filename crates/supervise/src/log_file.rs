//! The log file of a child process: what it prints. Of more than a limit, the first and the last part are kept, and a line
//! between them says how many bytes were left out.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The line that stands for what was left out begins and ends with these.
const NOTE: (&str, &str) = ("\n[memtransfer: ", " bytes were left out here]\n");

/// How much of a log is kept, in bytes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LogLimits {
    /// Its first part.
    pub first: u64,
    /// At least this much of its end, and at most twice.
    pub last: u64,
}

impl LogLimits {
    /// Those of every log: at most 24 MiB and a line.
    pub(crate) const STANDARD: Self = Self { first: 8 << 20, last: 8 << 20 };
}

/// A place in a log: what one process prints begins there.
#[derive(Debug)]
pub(crate) struct LogPosition {
    /// The file, if there was one. Open, so that no later file gets its inode: the log is another file once something was left out.
    file: Option<File>,
    offset: u64,
}

impl LogPosition {
    /// The end of the file `path`, which may be missing.
    pub(crate) fn end_of(path: &Path) -> Self {
        let found = durable::open(path).and_then(|file| Ok((file.metadata()?.len(), file)));
        match found {
            Ok((offset, file)) => Self { file: Some(file), offset },
            Err(_) => Self { file: None, offset: 0 },
        }
    }

    /// Where the process's output begins in `file`. If something was left out since, all of its end is that of the process.
    pub(crate) fn offset_in(&self, file: &File) -> io::Result<u64> {
        let Some(then) = &self.file else { return Ok(0) };
        Ok(if file.metadata()?.ino() == then.metadata()?.ino() { self.offset } else { 0 })
    }
}

/// A log file that is written to.
#[derive(Debug)]
pub(crate) struct LogFile {
    path: PathBuf,
    file: File,
    length: u64,
    limits: LogLimits,
}

impl LogFile {
    /// Opens the log `path` for appending. What is there already takes the room of a first and a last part at most.
    ///
    /// # Errors
    /// When the system refuses.
    pub(crate) fn open(path: &Path, limits: LogLimits) -> io::Result<Self> {
        let file = durable::append(path)?;
        let length = file.metadata()?.len();
        let mut log = Self { path: path.to_owned(), file, length, limits };
        // 100: the line about what was left out.
        if length > limits.first + limits.last + 100 {
            log.leave_out()?;
        }
        Ok(log)
    }

    /// Appends everything that `output` gives until its end. What a full disk does not take is lost: a program must not stop
    /// because of its log.
    pub(crate) fn take(&mut self, mut output: impl Read) {
        let mut buffer = vec![0; 64 << 10];
        loop {
            match output.read(&mut buffer) {
                Ok(0) => return,
                Ok(count) => {
                    if let Err(error) = self.append(&buffer[..count]) {
                        tracing::debug!(%error, log = %self.path.display(), "output is lost");
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => {
                    tracing::warn!(%error, log = %self.path.display(), "cannot read the output");
                    return;
                }
            }
        }
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)?;
        self.length += bytes.len() as u64;
        let LogLimits { first, last } = self.limits;
        if self.length > first + 2 * last { self.leave_out() } else { Ok(()) }
    }

    /// Replaces the file by one with its first part and its last one.
    fn leave_out(&mut self) -> io::Result<()> {
        let LogLimits { first, last } = self.limits;
        let (start, end) = (self.read(0, first)?, self.read(self.length - last, last)?);
        let middle = self.length - first - last;
        let (earlier, note_length) = self.left_out_before()?;
        let left_out = (earlier + middle).saturating_sub(note_length);
        let draft = self.path.with_extension("log.new");
        let mut file = durable::create(&draft)?;
        let note = format!("{}{left_out}{}", NOTE.0, NOTE.1);
        file.write_all(&[&start, note.as_bytes(), &end].concat())?;
        fs::rename(&draft, &self.path)?;
        self.file = durable::append(&self.path)?;
        self.length = self.file.metadata()?.len();
        Ok(())
    }

    /// The number in the line about what was left out earlier, and the length of that line.
    fn left_out_before(&mut self) -> io::Result<(u64, u64)> {
        let text = self.read(self.limits.first, 100)?;
        let text = String::from_utf8_lossy(&text);
        let number = text.strip_prefix(NOTE.0).and_then(|rest| rest.split_once(NOTE.1));
        let number = number.and_then(|(number, _)| number.parse::<u64>().ok());
        Ok(number.map_or((0, 0), |number| {
            let note = format!("{}{number}{}", NOTE.0, NOTE.1);
            (number, note.len() as u64)
        }))
    }

    fn read(&mut self, from: u64, count: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.file.seek(SeekFrom::Start(from))?;
        (&mut self.file).take(count).read_to_end(&mut bytes)?;
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_a_long_log_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("policy.log");
        let limits = LogLimits { first: 100, last: 1000 };
        let mut log = LogFile::open(&path, limits).unwrap();
        let line = |number: u32| format!("line {number:05}\n");
        log.take(line(0).as_bytes());
        let before = LogPosition::end_of(&path);
        for number in 1..10_000 {
            log.take(line(number).as_bytes());
            assert!(fs::metadata(&path).unwrap().len() <= 100 + 2 * 1000 + 100);
        }
        drop(log);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("line 00000\nline 00001\n"), "{text}");
        assert!(text.ends_with("line 09998\nline 09999\n"), "{text}");
        let (start, rest) = text.split_once(NOTE.0).unwrap();
        let (number, end) = rest.split_once(NOTE.1).unwrap();
        let kept = start.len() + end.len();
        assert_eq!(number.parse::<usize>().unwrap() + kept, 10_000 * line(0).len());
        assert_eq!(before.offset_in(&File::open(&path).unwrap()).unwrap(), 0);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no draft is left");

        // The next process.
        let mut log = LogFile::open(&path, limits).unwrap();
        let position = LogPosition::end_of(&path);
        log.take(&b"next\n"[..]);
        let offset = position.offset_in(&File::open(&path).unwrap()).unwrap() as usize;
        assert_eq!(&fs::read_to_string(&path).unwrap()[offset..], "next\n");
        assert_eq!(fs::read_to_string(&path).unwrap().matches(NOTE.0).count(), 1);
    }
}
