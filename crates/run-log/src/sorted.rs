//! Lines in the order of their keys, on disk, for journals that do not fit into memory.
//!
//! An external merge sort: lines are sorted in memory as many as fit, each such run of lines goes to a scratch file, and the runs are
//! merged into one. The files have no name, so that nothing is left of them.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Most bytes of lines that are sorted in memory.
const MEMORY: usize = 32 << 20;

/// A line of a journal, with the key of its episode and its number in the journal.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct KeyedLine {
    pub(super) key: Vec<u8>,
    pub(super) number: u64,
    pub(super) text: Vec<u8>,
}

/// Collects lines to sort them.
#[derive(Debug)]
pub(super) struct LineSorter {
    folder: PathBuf,
    memory: usize,
    lines: Vec<KeyedLine>,
    /// Bytes of `lines`.
    bytes: usize,
    /// The sorted runs of lines that did not fit into memory, one after the other.
    spilled: Option<File>,
    runs: Vec<Range<u64>>,
}

/// Lines in the order of their keys; of a key, in the order of the journal.
#[derive(Debug)]
pub(super) struct SortedLines {
    file: File,
    length: u64,
}

impl LineSorter {
    /// A sorter whose scratch files are in the file system of `folder`.
    pub(super) fn new(folder: &Path) -> Self {
        Self::with_memory(folder, MEMORY)
    }

    fn with_memory(folder: &Path, memory: usize) -> Self {
        let (lines, runs) = (Vec::new(), Vec::new());
        Self { folder: folder.to_owned(), memory, lines, bytes: 0, spilled: None, runs }
    }

    /// Adds a line. Lines come in the order of their numbers.
    ///
    /// # Errors
    /// When the system refuses.
    pub(super) fn add(&mut self, key: &str, number: usize, text: &[u8]) -> io::Result<()> {
        let line = KeyedLine { key: key.into(), number: number as u64, text: text.to_owned() };
        self.bytes += size_of::<KeyedLine>() + line.key.len() + line.text.len();
        self.lines.push(line);
        if self.bytes < self.memory {
            return Ok(());
        }
        let file = match self.spilled.take() {
            Some(file) => file,
            None => tempfile::tempfile_in(&self.folder)?,
        };
        let from = self.runs.last().map_or(0, |run| run.end);
        let file = self.spilled.insert(file);
        let mut length = 0;
        let mut out = BufWriter::new(file);
        self.lines.sort_unstable();
        for line in self.lines.drain(..) {
            length += line.write(&mut out)?;
        }
        out.flush()?;
        self.runs.push(from..from + length);
        self.bytes = 0;
        Ok(())
    }

    /// The lines in order that `keep` keeps. It is called with each line in order, and with whether the line before had the same key.
    ///
    /// # Errors
    /// When the system refuses.
    pub(super) fn finish(
        mut self,
        mut keep: impl FnMut(&KeyedLine, bool) -> bool,
    ) -> io::Result<SortedLines> {
        self.lines.sort_unstable();
        let file = tempfile::tempfile_in(&self.folder)?;
        let (mut out, mut length) = (BufWriter::new(&file), 0);
        let mut before: Option<Vec<u8>> = None;
        let mut add = |line: &KeyedLine| {
            let is_repeated = before.as_ref() == Some(&line.key);
            if keep(line, is_repeated) {
                length += line.write(&mut out)?;
            }
            before.get_or_insert_default().clone_from(&line.key);
            io::Result::Ok(())
        };
        let readers = self.runs.iter().zip(self.spilled.iter().cycle());
        let mut runs: Vec<LineReader<'_>> =
            readers.map(|(run, file)| LineReader::new(file, run.clone())).collect();
        let mut memory = std::mem::take(&mut self.lines).into_iter();
        let in_memory = runs.len();
        let mut next = |run: usize| match runs.get_mut(run) {
            Some(run) => run.next().transpose(),
            None => Ok(memory.next()),
        };
        let mut heads = BinaryHeap::new();
        for run in 0..=in_memory {
            heads.extend(next(run)?.map(|line| Reverse((line, run))));
        }
        while let Some(Reverse((line, run))) = heads.pop() {
            add(&line)?;
            heads.extend(next(run)?.map(|line| Reverse((line, run))));
        }
        out.flush()?;
        drop(out);
        Ok(SortedLines { file, length })
    }
}

impl SortedLines {
    /// The lines.
    pub(super) fn lines(&self) -> LineReader<'_> {
        LineReader::new(&self.file, 0..self.length)
    }
}

impl KeyedLine {
    /// Writes it and returns its length there.
    fn write(&self, out: &mut impl Write) -> io::Result<u64> {
        let lengths = [self.key.len() as u64, self.text.len() as u64];
        for number in [lengths[0], lengths[1], self.number] {
            out.write_all(&number.to_le_bytes())?;
        }
        out.write_all(&self.key)?;
        out.write_all(&self.text)?;
        Ok(24 + lengths[0] + lengths[1])
    }
}

/// Reads the lines in a part of a file.
#[derive(Debug)]
pub(super) struct LineReader<'a>(BufReader<FilePart<'a>>);

#[derive(Debug)]
struct FilePart<'a> {
    file: &'a File,
    rest: Range<u64>,
}

impl<'a> LineReader<'a> {
    fn new(file: &'a File, rest: Range<u64>) -> Self {
        Self(BufReader::with_capacity(1 << 16, FilePart { file, rest }))
    }

    fn read(&mut self) -> io::Result<KeyedLine> {
        let mut number = || {
            let mut bytes = [0; 8];
            self.0.read_exact(&mut bytes).map(|()| u64::from_le_bytes(bytes))
        };
        let [key, text, number] = [number()?, number()?, number()?];
        let mut bytes = |length: u64| {
            let mut bytes = vec![0; usize::try_from(length).map_err(io::Error::other)?];
            self.0.read_exact(&mut bytes).map(|()| bytes)
        };
        Ok(KeyedLine { key: bytes(key)?, text: bytes(text)?, number })
    }
}

impl Iterator for LineReader<'_> {
    type Item = io::Result<KeyedLine>;

    fn next(&mut self) -> Option<Self::Item> {
        let is_over = self.0.buffer().is_empty() && self.0.get_ref().rest.is_empty();
        (!is_over).then(|| self.read())
    }
}

impl Read for FilePart<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let rest = usize::try_from(self.rest.end - self.rest.start).unwrap_or(usize::MAX);
        let length = buffer.len().min(rest);
        let read = self.file.read_at(&mut buffer[..length], self.rest.start)?;
        self.rest.start += read as u64;
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_in_the_order_of_keys_whatever_fits_into_memory() {
        let folder = tempfile::tempdir().unwrap();
        let keys = ["m", "a", "z", "a", "", "k", "a", "z"];
        for memory in [1, 200, 300, MEMORY] {
            let mut sorter = LineSorter::with_memory(folder.path(), memory);
            for (number, key) in keys.iter().enumerate() {
                sorter.add(key, number, format!("{key}{number}\n").as_bytes()).unwrap();
            }
            // Of a key, the second one is left out.
            let mut repeated = 0;
            let keep = |line: &KeyedLine, is_repeated: bool| {
                repeated = if is_repeated { repeated + 1 } else { 0 };
                assert_eq!(is_repeated, [3, 6, 7].contains(&line.number));
                repeated != 1
            };
            let sorted = sorter.finish(keep).unwrap();
            for _ in 0..2 {
                let lines: Vec<KeyedLine> = sorted.lines().collect::<io::Result<_>>().unwrap();
                let texts = lines.iter().map(|line| String::from_utf8_lossy(&line.text));
                assert_eq!(texts.collect::<String>(), "4\na1\na6\nk5\nm0\nz2\n");
                assert!(lines.iter().all(|line| {
                    String::from_utf8_lossy(&line.key) == keys[line.number as usize]
                }));
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
