//! An append-only file of JSON lines that survives a kill at any moment, and damage to any line.

use std::fs::{File, Metadata};
use std::io::{self, BufRead, Read, Seek, SeekFrom};
use std::marker::PhantomData;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::thread::{self, JoinHandle};

use crossbeam::channel::{Receiver, Sender, bounded};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{LogError, sealed, system};

/// What a journal holds.
#[derive(Debug)]
pub struct JournalContents<T> {
    /// The entries that can be used.
    pub entries: Vec<T>,
    /// The lines that cannot.
    pub damaged: Vec<DamagedLine>,
    /// Bytes after the last line end: a line that was being written when the program was killed.
    pub torn: u64,
}

/// A line that is not an entry, or contradicts itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DamagedLine {
    /// The name of the file.
    pub file: String,
    /// The line's number, from 1.
    pub line: usize,
    /// What is wrong with it.
    pub problem: String,
    text: Vec<u8>,
}

impl std::fmt::Display for DamagedLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, line {}: {}", self.file, self.line, self.problem)
    }
}

/// An open journal of `T`.
#[derive(Debug)]
pub struct Journal<T> {
    path: PathBuf,
    file: File,
    flusher: Option<Flusher>,
    entries: PhantomData<fn(&T)>,
}

impl<T: Serialize + DeserializeOwned> Journal<T> {
    /// Opens the journal in `path` and reads it; creates it if it is missing. A torn last line is cut off. Damaged
    /// lines, which `check` may find beside those that cannot be read, are moved to [`damaged_file`].
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn open(
        path: &Path,
        check: impl FnMut(&T) -> Result<(), String>,
    ) -> Result<(Self, JournalContents<T>), LogError> {
        let mut file = durable::append(path).map_err(system("open", path))?;
        let text = durable::read(path).map_err(system("read", path))?;
        let contents = parse(path, &text[..], check).map_err(system("read", path))?;
        if !contents.damaged.is_empty() {
            set_aside(path, &text, &contents.damaged)?;
            file = durable::append(path).map_err(system("open", path))?;
        } else if contents.torn > 0 {
            let whole = text.len() as u64 - contents.torn;
            file.set_len(whole).map_err(system("cut the torn end of", path))?;
        }
        let path = path.to_owned();
        Ok((Self { path, file, flusher: None, entries: PhantomData }, contents))
    }

    /// Adds a line. Nothing is promised about a crash of the machine before [`Journal::sync`].
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn append(&mut self, entry: &T) -> Result<(), LogError> {
        let line = sealed::line(entry)
            .map_err(|error| system("write to", &self.path)(io::Error::other(error)))?;
        let before = self.file.metadata().map_err(system("look at", &self.path))?.len();
        // One write: a kill leaves a line whole, absent or torn, never mixed with another.
        durable::write(&mut self.file, &self.path, &line).map_err(|error| {
            // Nor is the next line mixed with one that a full disk has cut off. If this fails, too, opening the journal finds it.
            let _ = self.file.set_len(before);
            system("write to", &self.path)(error)
        })
    }

    /// Returns when everything added so far is on the disk.
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn sync(&mut self) -> Result<(), LogError> {
        durable::sync(&self.file, &self.path).map_err(system("flush", &self.path))
    }

    /// Starts writing everything added so far to the disk, and does not wait for it: a thread of the journal flushes as
    /// long as there is something new, and once more when the journal is dropped. What was added survives any kill of
    /// this process at once, and a crash of the machine some milliseconds later.
    ///
    /// # Errors
    /// When the system refused an earlier flush, or another thread.
    pub fn sync_soon(&mut self) -> Result<(), LogError> {
        durable::check_sync_soon(&self.path).map_err(system("flush", &self.path))?;
        let flusher = match self.flusher.take() {
            Some(flusher) => flusher,
            None => Flusher::start(&self.file).map_err(system("flush", &self.path))?,
        };
        self.flusher.insert(flusher).ask().map_err(system("flush", &self.path))
    }
}

/// A thread that flushes a file whenever it is asked to.
#[derive(Debug)]
struct Flusher {
    /// Holds at most one request: what is added before it is taken is flushed with it.
    requests: Option<Sender<()>>,
    failure: Receiver<io::Error>,
    thread: Option<JoinHandle<()>>,
}

impl Flusher {
    fn start(file: &File) -> io::Result<Self> {
        let file = file.try_clone()?;
        let (requests, asked) = bounded(1);
        let (failed, failure) = bounded(1);
        let flush = move || {
            for () in asked {
                if let Err(error) = file.sync_data() {
                    // There is room: this is the first failure, and the thread ends with it.
                    let _ = failed.send(error);
                    return;
                }
            }
        };
        let thread = thread::Builder::new().name("log-flusher".to_owned()).spawn(flush)?;
        Ok(Self { requests: Some(requests), failure, thread: Some(thread) })
    }

    fn ask(&self) -> io::Result<()> {
        if let Ok(error) = self.failure.try_recv() {
            return Err(error);
        }
        if let Some(requests) = &self.requests {
            // Full: what was added is flushed with the request that waits.
            let _ = requests.try_send(());
        }
        Ok(())
    }
}

impl Drop for Flusher {
    fn drop(&mut self) {
        self.requests = None;
        if let Some(thread) = self.thread.take() {
            // The thread does not panic; if it did, it has printed the panic.
            let _ = thread.join();
        }
    }
}

/// A check that every entry passes.
pub(super) fn unchecked<T>(_: &T) -> Result<(), String> {
    Ok(())
}

/// Reads the journal in `path` without changing it; a missing one is empty.
///
/// # Errors
/// When an operation of the system fails.
pub fn read_journal<T: DeserializeOwned>(
    path: &Path,
    check: impl FnMut(&T) -> Result<(), String>,
) -> Result<JournalContents<T>, LogError> {
    let parsed = match open_lines(path)? {
        Some(text) => parse(path, text, check),
        None => parse(path, io::empty(), check),
    };
    parsed.map_err(system("read", path))
}

/// Opens the journal in `path`; `None` if there is none.
pub(super) fn open_lines(path: &Path) -> Result<Option<impl BufRead + use<>>, LogError> {
    match durable::open_buffered(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        text => text.map(Some).map_err(system("read", path)),
    }
}

/// Reads a journal as it grows: each byte once.
#[derive(Debug)]
pub struct JournalTail<T> {
    path: PathBuf,
    /// The file that was read last. While it is open, no other file can be taken for it.
    file: Option<File>,
    /// Bytes of its whole lines that were read.
    read: u64,
    entries: PhantomData<fn() -> T>,
}

impl<T: DeserializeOwned> JournalTail<T> {
    /// Reads the journal in `path` from its start.
    pub fn new(path: PathBuf) -> Self {
        Self { path, file: None, read: 0, entries: PhantomData }
    }

    /// The entries of the lines that were added since the last call. Lines that are no entry are left out. `None` when the
    /// journal is another file or has become shorter, because the run was started afresh or damaged lines were moved: the
    /// next call begins at its start.
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn read_new(&mut self) -> Result<Option<Vec<T>>, LogError> {
        let mut file = match durable::open(&self.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Some(Vec::new())),
            file => file.map_err(system("read", &self.path))?,
        };
        let identity = |file: &Metadata| (file.dev(), file.ino());
        let mut read = || {
            let now = file.metadata()?;
            let before = self.file.as_ref().map(File::metadata).transpose()?;
            let is_another = before.is_some_and(|before| identity(&before) != identity(&now));
            if is_another || now.len() < self.read {
                return Ok(None);
            }
            let mut text = Vec::new();
            file.seek(SeekFrom::Start(self.read))?;
            file.read_to_end(&mut text)?;
            Ok(Some(text))
        };
        let text = read().map_err(system("read", &self.path))?;
        self.file = Some(file);
        let Some(text) = text else {
            self.read = 0;
            return Ok(None);
        };
        let whole = whole_lines(&text);
        self.read += whole.len() as u64;
        let lines = whole.split_inclusive(|&byte| byte == b'\n');
        Ok(Some(lines.filter_map(|line| sealed::read(line).ok()).collect()))
    }
}

/// The file that damaged lines of the journal in `path` are moved to: `episodes.damaged.jsonl` for
/// `episodes.jsonl`.
pub fn damaged_file(path: &Path) -> PathBuf {
    path.with_extension("damaged.jsonl")
}

/// Everything up to and including the last line end.
fn whole_lines(text: &[u8]) -> &[u8] {
    let end = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
    &text[..end]
}

/// The lines of a journal, one after the other.
#[derive(Debug)]
pub(super) struct JournalLines<R> {
    file: String,
    reader: R,
    /// The number of the line that was read last.
    number: usize,
    text: Vec<u8>,
    torn: u64,
}

impl<R: BufRead> JournalLines<R> {
    /// The lines that `reader` reads from the journal in `path`.
    pub(super) fn new(path: &Path, reader: R) -> Self {
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Self { file, reader, number: 0, text: Vec::new(), torn: 0 }
    }

    /// Reads the next line; `None` at the end. A line is damaged that is no entry, or that `check` refuses.
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub(super) fn next<T: DeserializeOwned>(
        &mut self,
        mut check: impl FnMut(&T) -> Result<(), String>,
    ) -> io::Result<Option<Result<T, DamagedLine>>> {
        self.text.clear();
        self.reader.read_until(b'\n', &mut self.text)?;
        if self.text.is_empty() {
            return Ok(None);
        }
        self.number += 1;
        if !self.text.ends_with(b"\n") {
            // Not a line that was being written if it has more than itself.
            if !sealed::is_line_and_more(&self.text) {
                self.torn = self.text.len() as u64;
                return Ok(None);
            }
            self.text.push(b'\n');
            return Ok(Some(Err(self.damaged("its line end was changed"))));
        }
        let entry = sealed::read(&self.text).map_err(|problem| without_names(&problem));
        let entry = entry.and_then(|entry| check(&entry).map(|()| entry));
        Ok(Some(entry.map_err(|problem| self.damaged(&problem))))
    }

    /// The line that was read last, with its end.
    pub(super) fn text(&self) -> &[u8] {
        &self.text
    }

    /// The number of the line that was read last, from 1.
    pub(super) fn number(&self) -> usize {
        self.number
    }

    fn damaged(&self, problem: &str) -> DamagedLine {
        DamagedLine::new(self.file.clone(), self.number, problem, self.text.clone())
    }
}

impl DamagedLine {
    /// The line `text`, number `line` of the journal called `file`.
    pub(super) fn new(file: String, line: usize, problem: &str, text: Vec<u8>) -> Self {
        Self { file, line, problem: shortened(problem), text }
    }
}

fn parse<T: DeserializeOwned>(
    path: &Path,
    text: impl BufRead,
    mut check: impl FnMut(&T) -> Result<(), String>,
) -> io::Result<JournalContents<T>> {
    let mut lines = JournalLines::new(path, text);
    let (mut entries, mut damaged) = (Vec::new(), Vec::new());
    while let Some(line) = lines.next(&mut check)? {
        match line {
            Ok(entry) => entries.push(entry),
            Err(line) => damaged.push(line),
        }
    }
    Ok(JournalContents { entries, damaged, torn: lines.torn })
}

/// `problem`, which may repeat a text of any length from a line, cut in the middle.
fn shortened(problem: &str) -> String {
    const EACH: usize = 150;
    if problem.chars().nth(2 * EACH).is_none() {
        return problem.to_owned();
    }
    let start: String = problem.chars().take(EACH).collect();
    let mut end: Vec<char> = problem.chars().rev().take(EACH).collect();
    end.reverse();
    format!("{start} ... {}", end.into_iter().collect::<String>())
}

/// Leaves out of serde's message `problem` the list of all names that it expected.
fn without_names(problem: &str) -> String {
    match (problem.find(", expected one of `"), problem.rfind(" at line ")) {
        (Some(from), Some(to)) if from < to => problem[..from].to_owned() + &problem[to..],
        _ => problem.to_owned(),
    }
}

/// Moves the `damaged` lines of the journal in `path`, which holds `text`, to another file. They are on the disk there
/// before they are removed here.
fn set_aside(path: &Path, text: &[u8], damaged: &[DamagedLine]) -> Result<(), LogError> {
    let aside = damaged_file(path);
    let draft = path.with_extension("jsonl.new");
    let write = || {
        let mut file = durable::append(&aside)?;
        let lines: Vec<u8> = damaged.iter().flat_map(|line| line.text.clone()).collect();
        durable::write(&mut file, &aside, &lines)?;
        durable::sync_path(&aside)?;
        let lines = (1..).zip(whole_lines(text).split_inclusive(|&byte| byte == b'\n'));
        let sound = lines.filter(|(number, _)| damaged.iter().all(|line| line.line != *number));
        let kept: Vec<u8> = sound.flat_map(|(_, line)| line).copied().collect();
        durable::replace(path, &draft, &kept)
    };
    write().map_err(system("set damaged lines aside in", &aside))
}

#[cfg(test)]
mod tests {
    use super::*;

    type Entry = (u32, String);

    fn entries(n: u32) -> Vec<Entry> {
        (0..n).map(|i| (i, "x\ny".repeat(i as usize))).collect()
    }

    #[test]
    fn a_journal_cut_anywhere_keeps_its_whole_lines_and_continues() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j.jsonl");
        let (mut journal, found) = Journal::<Entry>::open(&path, |_| Ok(())).unwrap();
        assert_eq!((found.entries, found.torn), (vec![], 0));
        entries(4).iter().for_each(|entry| journal.append(entry).unwrap());
        journal.sync_soon().unwrap();
        journal.sync().unwrap();
        let text = std::fs::read(&path).unwrap();

        for length in 0..=text.len() {
            std::fs::write(&path, &text[..length]).unwrap();
            let whole = text[..length].iter().filter(|&&byte| byte == b'\n').count() as u32;
            assert_eq!(read(&path), entries(whole));
            let (mut journal, found) = Journal::<Entry>::open(&path, |_| Ok(())).unwrap();
            assert_eq!(found.entries, entries(whole));
            assert_eq!(found.torn > 0, !text[..length].ends_with(b"\n") && length > 0);
            journal.append(&(9, String::new())).unwrap();
            assert_eq!(read(&path).len() as u32, whole + 1);
        }
    }

    fn read(path: &Path) -> Vec<Entry> {
        read_journal(path, |_| Ok(())).unwrap().entries
    }

    #[test]
    fn a_growing_journal_is_read_line_by_line_and_each_once() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j.jsonl");
        let mut tail = JournalTail::<Entry>::new(path.clone());
        assert_eq!(tail.read_new().unwrap(), Some(vec![]));
        let text = b"[0,\"\"]\n[1,\"x\"]\n?\n[2,\"\"]\n";
        let mut read = Vec::new();
        for length in 0..=text.len() {
            std::fs::write(&path, &text[..length]).unwrap();
            read.extend(tail.read_new().unwrap().unwrap());
        }
        assert_eq!(read, [(0, String::new()), (1, "x".to_owned()), (2, String::new())]);
        std::fs::write(&path, b"[7,\"\"]\n").unwrap();
        assert_eq!(tail.read_new().unwrap(), None);
        assert_eq!(tail.read_new().unwrap(), Some(vec![(7, String::new())]));
        std::fs::remove_file(&path).unwrap();
        assert_eq!(
            tail.read_new().unwrap(),
            Some(vec![]),
            "nothing new in a moment without a file"
        );
        std::fs::write(&path, b"[8,\"\"]\n[9,\"longer than before\"]\n").unwrap();
        assert_eq!(tail.read_new().unwrap(), None);
        assert_eq!(tail.read_new().unwrap().unwrap().len(), 2);
    }

    #[test]
    fn a_wrong_name_is_named_without_the_right_ones() {
        let record = serde_json::to_string(&crate::records::record("t01-01", true)).unwrap();
        let problem = |from: &str, to: &str| {
            let text = record.replace(from, to) + "\n";
            let contents =
                parse::<crate::EpisodeRecord>(Path::new("j"), text.as_bytes(), unchecked).unwrap();
            contents.damaged.first().map(ToString::to_string).unwrap_or_default()
        };
        insta::assert_snapshot!(problem("\"task\"", "\"tusk\""), @"j, line 1: unknown field `tusk` at line 1 column 175");
        insta::assert_snapshot!(problem("\"complete\"", "\"whole\""), @"j, line 1: unknown ending `whole` (known: complete, out-of-steps, failed) at line 1 column 222");
        let word = "x".repeat(1 << 20);
        let long = problem("\"complete\"", &format!("\"{word}\""));
        assert!(long.contains("unknown ending `xxx") && long.len() < 400, "{}", long.len());
    }

    #[test]
    fn a_damaged_line_is_named_and_set_aside_and_the_others_stay() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j.jsonl");
        let text = b"[0,\"\"]\n[1,\n[2,\"\"]\n[7,\"\"]\n\xff\n[4,\"\"]\n[3";
        std::fs::write(&path, text).unwrap();
        let seven = |entry: &Entry| if entry.0 == 7 { Err("seven".to_owned()) } else { Ok(()) };
        let contents = read_journal(&path, seven).unwrap();
        let shown: Vec<String> = contents.damaged.iter().map(ToString::to_string).collect();
        insta::assert_snapshot!(shown.join("\n"), @"
        j.jsonl, line 2: EOF while parsing a value at line 2 column 0
        j.jsonl, line 4: seven
        j.jsonl, line 5: expected value at line 1 column 1
        ");
        assert_eq!(std::fs::read(&path).unwrap(), text, "reading changes nothing");

        let (mut journal, contents) = Journal::<Entry>::open(&path, seven).unwrap();
        assert_eq!((contents.entries.len(), contents.damaged.len(), contents.torn), (3, 3, 2));
        journal.append(&(5, String::new())).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"[0,\"\"]\n[2,\"\"]\n[4,\"\"]\n[5,\"\"]\n");
        let aside = dir.path().join("j.damaged.jsonl");
        assert_eq!(std::fs::read(aside).unwrap(), b"[1,\n[7,\"\"]\n\xff\n", "nothing is lost");
    }
}
