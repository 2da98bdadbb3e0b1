//! Run folders of any length: read one episode at a time, or part by part.

use std::collections::BTreeMap;
use std::io::{self, BufRead};
use std::iter::Peekable;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use super::check::{check_each_record, check_records, occurs_twice};
use super::files::{EPISODES_FILE, ERRORS_FILE, REQUESTS_FILE, SESSIONS_FILE, TIMINGS_FILE};
use super::journal::{JournalLines, open_lines, unchecked};
use super::sorted::{KeyedLine, LineReader, LineSorter, SortedLines};
use super::{
    DamagedLine, EpisodeError, EpisodeRecord, EpisodeTimings, LogError, RequestRecord, RunLog,
    sealed, system,
};

/// Says what is wrong with a record.
type RecordCheck = dyn FnMut(&EpisodeRecord) -> Result<(), String> + Send;

/// The finished episodes of a run, read one at a time, in the order of the log.
pub struct EpisodeReader {
    path: PathBuf,
    lines: Option<JournalLines<Box<dyn BufRead + Send>>>,
    check: Box<RecordCheck>,
    damaged: Vec<DamagedLine>,
}

impl EpisodeReader {
    /// The episodes of the run in `dir`, of which nothing has been read yet.
    ///
    /// # Errors
    /// When there is none, or its log is broken.
    pub fn open(dir: &Path) -> Result<Self, LogError> {
        let (head, known) = RunLog::read_head(dir)?;
        let path = dir.join(EPISODES_FILE);
        let lines = open_lines(&path)?;
        Ok(Self {
            lines: lines.map(|lines| JournalLines::new(&path, Box::new(lines) as _)),
            check: Box::new(check_records(known, &head.manifest)),
            damaged: Vec::new(),
            path,
        })
    }

    /// The lines until now that cannot be used, and are left out.
    pub fn damaged(&self) -> &[DamagedLine] {
        &self.damaged
    }
}

impl Iterator for EpisodeReader {
    type Item = Result<EpisodeRecord, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        let lines = self.lines.as_mut()?;
        loop {
            match lines.next(&mut self.check).map_err(system("read", &self.path)).transpose()? {
                Ok(Ok(record)) => return Some(Ok(record)),
                Ok(Err(damaged)) => self.damaged.push(damaged),
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// A run folder that is read part by part, whatever the length of its log, in the order of the keys of its episodes.
///
/// Its journals are sorted into scratch files first.
#[derive(Debug)]
pub struct RunParts {
    head: RunLog,
    scratch: PathBuf,
    episodes: SortedLines,
    timings: SortedLines,
    requests: SortedLines,
}

impl RunParts {
    /// The run in `dir`. Scratch files, about as large as the journals, are in the file system of `scratch`, and have no name.
    ///
    /// # Errors
    /// When there is none, its log is broken, or the system refuses.
    pub fn open(dir: &Path, scratch: &Path) -> Result<Self, LogError> {
        let (mut head, known) = RunLog::read_head(dir)?;
        let check = check_each_record(known, &head.manifest);
        let damaged = &mut head.damaged;
        let errors: Vec<EpisodeError> = super::read::read(dir, ERRORS_FILE, unchecked, damaged)?;
        let mut errors: BTreeMap<String, EpisodeError> =
            errors.into_iter().map(|error| (error.key.clone(), error)).collect();
        let mut twice = Vec::new();
        let keep = |line: &KeyedLine, is_repeated: bool| {
            let key = String::from_utf8_lossy(&line.key);
            errors.remove(&*key);
            if is_repeated {
                let (file, number) = (EPISODES_FILE.to_owned(), line.number as usize);
                let text = line.text.clone();
                twice.push(DamagedLine::new(file, number, &occurs_twice(&key), text));
            }
            !is_repeated
        };
        let sorter = JournalSorter { dir, scratch };
        let key = |record: &EpisodeRecord| record.key.clone();
        let (episodes, mut found) = sorter.sort(EPISODES_FILE, check, key, keep)?;
        found.append(&mut twice);
        found.sort_by_key(|damaged| damaged.line);
        // As they are found when the whole log is read: those of the episodes first.
        let of_errors = std::mem::replace(damaged, found);
        let key = |timings: &EpisodeTimings| timings.key.clone();
        let (timings, found) = sorter.sort(TIMINGS_FILE, unchecked, key, |_, _| true)?;
        damaged.extend(found);
        let key = |request: &RequestRecord| request.key.clone();
        let (requests, found) = sorter.sort(REQUESTS_FILE, unchecked, key, |_, _| true)?;
        damaged.extend(found.into_iter().chain(of_errors));
        head.errors = errors.into_values().collect();
        head.sessions = super::read::read(dir, SESSIONS_FILE, unchecked, damaged)?;
        Ok(Self { head, scratch: scratch.to_owned(), episodes, timings, requests })
    }

    /// The run's log without its episodes, their timings and their requests.
    pub fn head(&self) -> &RunLog {
        &self.head
    }

    /// As [`head`](Self::head), to leave out errors.
    pub fn head_mut(&mut self) -> &mut RunLog {
        &mut self.head
    }

    /// The finished episodes.
    pub fn episodes(&self) -> impl Iterator<Item = Result<EpisodeRecord, LogError>> {
        self.episodes.lines().map(|line| entry(&self.scratch, line))
    }

    /// All of them in one log, as [`RunLog::read`] reads them.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn whole(&self) -> Result<RunLog, LogError> {
        let whole = self.parts(usize::MAX, |_| 1).next().transpose()?;
        Ok(RunLog { errors: self.head.errors.clone(), ..whole.unwrap_or(self.head.clone()) })
    }

    /// Leaves out the finished episodes that `keep` does not keep.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn retain(&mut self, mut keep: impl FnMut(&EpisodeRecord) -> bool) -> Result<(), LogError> {
        let scratch = &self.scratch;
        let mut kept = LineSorter::new(scratch);
        for line in self.episodes.lines() {
            let line = line.map_err(system("read a scratch file in", scratch))?;
            let record: EpisodeRecord = entry(scratch, Ok(line.clone()))?;
            if keep(&record) {
                kept.add(&record.key, line.number as usize, &line.text)
                    .map_err(system("write a scratch file in", scratch))?;
            }
        }
        let kept = kept.finish(|_, _| true);
        self.episodes = kept.map_err(system("write a scratch file in", scratch))?;
        Ok(())
    }

    /// The log in parts: each has a number of finished episodes, with their timings and requests, and no errors. A part ends with the
    /// episode with which the sum of `weight` reaches `most`.
    pub fn parts<W: FnMut(&EpisodeRecord) -> usize>(
        &self,
        most: usize,
        weight: W,
    ) -> impl Iterator<Item = Result<RunLog, LogError>> {
        let mut timings = Joined::new(&self.timings, &self.scratch);
        let mut requests = Joined::new(&self.requests, &self.scratch);
        let mut episodes = self.episodes.lines();
        let (mut weight, mut is_over) = (weight, false);
        let read = move || -> Result<Option<RunLog>, LogError> {
            let mut part = RunLog { errors: Vec::new(), ..self.head.clone() };
            let mut sum = 0;
            while sum < most && !is_over {
                let Some(line) = episodes.next() else {
                    is_over = true;
                    break;
                };
                let record: EpisodeRecord = entry(&self.scratch, line)?;
                sum = sum.saturating_add(weight(&record).max(1));
                // The last of each key: those of an episode that was set aside come before those of its repetition.
                part.timings.extend(timings.of(&record.key)?.pop());
                part.requests.extend(requests.of(&record.key)?);
                part.episodes.push(record);
            }
            Ok(Some(part).filter(|part| !part.episodes.is_empty()))
        };
        let mut read = Some(read);
        std::iter::from_fn(move || {
            let part = read.as_mut()?().transpose();
            if !matches!(part, Some(Ok(_))) {
                read = None;
            }
            part
        })
    }
}

/// Sorts the journals of a run.
#[derive(Clone, Copy)]
struct JournalSorter<'a> {
    dir: &'a Path,
    scratch: &'a Path,
}

impl JournalSorter<'_> {
    /// The lines of the journal `file` whose entries `check` accepts, in the order of their keys, and the damaged ones.
    fn sort<T: DeserializeOwned>(
        self,
        file: &str,
        check: impl Fn(&T) -> Result<(), String>,
        key: impl Fn(&T) -> String,
        keep: impl FnMut(&KeyedLine, bool) -> bool,
    ) -> Result<(SortedLines, Vec<DamagedLine>), LogError> {
        let path = self.dir.join(file);
        let mut sorter = LineSorter::new(self.scratch);
        let mut damaged = Vec::new();
        if let Some(reader) = open_lines(&path)? {
            let mut lines = JournalLines::new(&path, reader);
            while let Some(line) = lines.next(&check).map_err(system("read", &path))? {
                match line {
                    Ok(entry) => sorter
                        .add(&key(&entry), lines.number(), lines.text())
                        .map_err(system("write a scratch file in", self.scratch))?,
                    Err(line) => damaged.push(line),
                }
            }
        }
        let sorted = sorter.finish(keep);
        Ok((sorted.map_err(system("write a scratch file in", self.scratch))?, damaged))
    }
}

/// Entries that are looked up by keys in ascending order.
struct Joined<'a, T> {
    lines: Peekable<LineReader<'a>>,
    scratch: &'a Path,
    entries: std::marker::PhantomData<T>,
}

impl<'a, T: DeserializeOwned> Joined<'a, T> {
    fn new(lines: &'a SortedLines, scratch: &'a Path) -> Self {
        Self { lines: lines.lines().peekable(), scratch, entries: std::marker::PhantomData }
    }

    /// The entries of `key`, in the order of the journal.
    fn of(&mut self, key: &str) -> Result<Vec<T>, LogError> {
        let mut found = Vec::new();
        let is_until = |line: &io::Result<KeyedLine>| {
            line.as_ref().map_or(true, |line| line.key.as_slice() <= key.as_bytes())
        };
        while let Some(line) = self.lines.next_if(is_until) {
            if line.as_ref().is_ok_and(|line| line.key != key.as_bytes()) {
                continue;
            }
            found.push(entry(self.scratch, line)?);
        }
        Ok(found)
    }
}

/// The entry of a sorted line.
fn entry<T: DeserializeOwned>(scratch: &Path, line: io::Result<KeyedLine>) -> Result<T, LogError> {
    let read = line.and_then(|line| sealed::read(&line.text).map_err(io::Error::other));
    read.map_err(system("read a scratch file in", scratch))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::manifest::Manifest;
    use crate::records::{manifest, record};

    /// A run in `dir` with these records, two damaged lines, a record that occurs twice, timings in another order, of which one was
    /// measured twice, and requests of an attempt that was given up.
    fn write_run(dir: &Path, records: &[EpisodeRecord]) {
        let manifest: Manifest = manifest();
        manifest.write(dir).unwrap();
        let journal = |file: &str, lines: &[Vec<u8>]| {
            fs::write(dir.join(file), lines.concat()).unwrap();
        };
        let mut lines: Vec<Vec<u8>> =
            records.iter().map(|record| sealed::line(record).unwrap()).collect();
        lines.insert(1, b"damaged\n".to_vec());
        lines.push(lines[0].clone());
        lines.push(b"{\"key\":\"torn".to_vec());
        journal(EPISODES_FILE, &lines);
        let of = |record: &EpisodeRecord, session: u32| {
            let mut timings = crate::records::timings(record);
            timings.session = session;
            timings
        };
        let mut lines: Vec<Vec<u8>> =
            records.iter().rev().map(|one| sealed::line(&of(one, 1)).unwrap()).collect();
        lines.push(sealed::line(&of(&records[0], 2)).unwrap());
        lines.push(b"?\n".to_vec());
        journal(TIMINGS_FILE, &lines);
        let mut lines = Vec::new();
        for step in [0, 1, 0, 1] {
            for record in records {
                lines.push(sealed::line(&crate::records::request(&record.key, step)).unwrap());
            }
        }
        journal(REQUESTS_FILE, &lines);
        let error = |key: &str| {
            let error =
                EpisodeError { key: key.to_owned(), session: 1, error: "it fell".to_owned() };
            sealed::line(&error).unwrap()
        };
        journal(ERRORS_FILE, &[error(&records[0].key), error("other"), error("other")]);
    }

    fn records() -> Vec<EpisodeRecord> {
        let cases = ["d", "a", "c", "b", "e"];
        let seed = manifest().settings.seed;
        let keyed = cases.iter().map(|case| {
            let mut one = record(case, *case != "c");
            one.seed = one.own_key().seed(seed);
            one
        });
        keyed.collect()
    }

    #[test]
    fn parts_together_are_the_log_and_episodes_come_in_its_order() {
        let folder = tempfile::tempdir().unwrap();
        write_run(folder.path(), &records());
        let log = RunLog::read(folder.path()).unwrap();
        assert_eq!(log.damaged.len(), 3, "{:?}", log.damaged);
        let mut parts = RunParts::open(folder.path(), folder.path()).unwrap();
        assert_eq!(parts.head().damaged, log.damaged);
        assert_eq!(parts.head().errors, log.errors);
        assert_eq!(parts.head().sessions, log.sessions);
        let episodes: Result<Vec<_>, _> = parts.episodes().collect();
        assert_eq!(episodes.unwrap(), log.episodes);
        for most in [1, 2, 9] {
            let read: Vec<RunLog> = parts.parts(most, |_| 1).collect::<Result<_, _>>().unwrap();
            assert_eq!(read.len(), log.episodes.len().div_ceil(most));
            let joined = |of: fn(&RunLog) -> usize| read.iter().map(of).sum::<usize>();
            assert_eq!(joined(|part| part.errors.len()), 0);
            let episodes: Vec<_> = read.iter().flat_map(|part| part.episodes.clone()).collect();
            assert_eq!(episodes, log.episodes);
            let timings: Vec<_> = read.iter().flat_map(|part| part.timings.clone()).collect();
            assert_eq!(timings, log.timings);
            let mut requests = log.requests.clone();
            requests.sort_by(|a, b| a.key.cmp(&b.key));
            let found: Vec<_> = read.iter().flat_map(|part| part.requests.clone()).collect();
            assert_eq!(found, requests);
        }
        parts.retain(|record| !record.is_success()).unwrap();
        let whole = parts.whole().unwrap();
        assert_eq!((whole.episodes.len(), whole.timings.len(), whole.requests.len()), (1, 1, 4));

        let mut reader = EpisodeReader::open(folder.path()).unwrap();
        let first = reader.next().unwrap().unwrap();
        assert_eq!((first, reader.damaged().len()), (records().remove(0), 0), "no more is read");
        let rest: Vec<_> = reader.by_ref().collect::<Result<_, _>>().unwrap();
        assert_eq!(rest, records()[1..]);
        assert_eq!(reader.damaged(), &log.damaged[..2]);
    }

    #[test]
    fn a_run_without_journals_has_no_parts() {
        let folder = tempfile::tempdir().unwrap();
        manifest().write(folder.path()).unwrap();
        let parts = RunParts::open(folder.path(), folder.path()).unwrap();
        assert!(
            parts.parts(9, |_| 1).next().is_none() && parts.whole().unwrap().episodes.is_empty()
        );
        assert!(EpisodeReader::open(folder.path()).unwrap().next().is_none());
        let none = folder.path().join("none");
        assert!(matches!(RunParts::open(&none, folder.path()), Err(LogError::NoRun(_))));
    }
}
