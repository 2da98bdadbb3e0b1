//! An append-only file of JSON lines that survives being killed while it is written.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use std::thread::{self, JoinHandle};

use crossbeam::channel::{Receiver, Sender, bounded};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{LogError, system};

/// An open journal of `T`.
#[derive(Debug)]
pub struct Journal<T> {
    path: PathBuf,
    file: File,
    flusher: Option<Flusher>,
    entries: PhantomData<fn(&T)>,
}

impl<T: Serialize + DeserializeOwned> Journal<T> {
    /// Opens the journal in `path`, which is made if it is missing: what it holds, and how many bytes of a
    /// line that was never finished were cut off its end.
    ///
    /// # Errors
    /// When the system refuses, or a finished line is broken.
    pub fn open(path: &Path) -> Result<(Self, Vec<T>, u64), LogError> {
        let options = OpenOptions::new().create(true).append(true).clone();
        let file = options.open(path).map_err(system("open", path))?;
        let text = read_bytes(path)?;
        let whole = whole_lines(&text);
        let entries = parse(path, whole)?;
        let torn = (text.len() - whole.len()) as u64;
        if torn > 0 {
            file.set_len(whole.len() as u64).map_err(system("cut the torn end of", path))?;
        }
        Ok((
            Self { path: path.to_owned(), file, flusher: None, entries: PhantomData },
            entries,
            torn,
        ))
    }

    /// Adds a line. Nothing is promised about a crash of the machine before [`Journal::sync`].
    ///
    /// # Errors
    /// When the system refuses.
    pub fn append(&mut self, entry: &T) -> Result<(), LogError> {
        let mut line = serde_json::to_vec(entry).map_err(|error| LogError::BrokenLine {
            path: self.path.clone(),
            line: 0,
            problem: format!("an entry cannot be written as JSON: {error}"),
        })?;
        line.push(b'\n');
        // One write: a kill leaves a line whole, absent or torn, never mixed with another.
        self.file.write_all(&line).map_err(system("write to", &self.path))
    }

    /// Returns when everything added so far is on the disk.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn sync(&mut self) -> Result<(), LogError> {
        self.file.sync_data().map_err(system("flush", &self.path))
    }

    /// Has everything added so far put on the disk, and does not wait for it: a thread of the journal's own
    /// flushes again and again as long as there is something new, and once more when the journal is dropped.
    /// What was added survives any kill of this process at once, and a crash of the machine some milliseconds
    /// later.
    ///
    /// # Errors
    /// When the system refused an earlier flush, or another thread.
    pub fn sync_soon(&mut self) -> Result<(), LogError> {
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
    /// Holds one request at most: whatever is added before it is taken is flushed with it.
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
                    // There is room: it is the first failure, and the last.
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
            // It does not panic; and if it did, it has said so.
            let _ = thread.join();
        }
    }
}

/// What the journal in `path` holds, without touching it: nothing if it is missing, and without a line that
/// was never finished.
///
/// # Errors
/// When the system refuses, or a finished line is broken.
pub fn read_journal<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, LogError> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    parse(path, whole_lines(&read_bytes(path)?))
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, LogError> {
    std::fs::read(path).map_err(system("read", path))
}

/// Everything up to and including the last line end.
fn whole_lines(text: &[u8]) -> &[u8] {
    let end = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
    &text[..end]
}

fn parse<T: DeserializeOwned>(path: &Path, text: &[u8]) -> Result<Vec<T>, LogError> {
    let lines = text.split_inclusive(|&byte| byte == b'\n').enumerate();
    lines
        .map(|(index, line)| {
            serde_json::from_slice(line).map_err(|error| LogError::BrokenLine {
                path: path.to_owned(),
                line: index + 1,
                problem: error.to_string(),
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    type Entry = (u32, String);

    fn entries(n: u32) -> Vec<Entry> {
        (0..n).map(|i| (i, "x\ny".repeat(i as usize))).collect()
    }

    #[test]
    fn a_journal_cut_anywhere_keeps_its_whole_lines_and_goes_on() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j.jsonl");
        let (mut journal, found, torn) = Journal::<Entry>::open(&path).unwrap();
        assert_eq!((found, torn), (vec![], 0));
        entries(4).iter().for_each(|entry| journal.append(entry).unwrap());
        journal.sync_soon().unwrap();
        journal.sync().unwrap();
        let text = std::fs::read(&path).unwrap();

        for length in 0..=text.len() {
            std::fs::write(&path, &text[..length]).unwrap();
            let whole = text[..length].iter().filter(|&&byte| byte == b'\n').count() as u32;
            assert_eq!(read_journal::<Entry>(&path).unwrap(), entries(whole));
            let (mut journal, found, torn) = Journal::<Entry>::open(&path).unwrap();
            assert_eq!(found, entries(whole));
            assert_eq!(torn > 0, !text[..length].ends_with(b"\n") && length > 0);
            journal.append(&(9, String::new())).unwrap();
            assert_eq!(read_journal::<Entry>(&path).unwrap().len() as u32, whole + 1);
        }
    }

    #[test]
    fn a_broken_line_inside_is_named_and_nothing_is_cut() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j.jsonl");
        let text = "[0,\"\"]\n[1,\n[2,\"\"]\n[3";
        std::fs::write(&path, text).unwrap();
        let error = Journal::<Entry>::open(&path).unwrap_err().to_string();
        assert!(error.contains("j.jsonl, line 2: ") && error.contains("--fresh"), "{error}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }
}
