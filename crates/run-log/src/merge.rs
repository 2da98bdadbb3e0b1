//! Joins the run folders of units into the run folder that one machine would have written.
//!
//! Episodes come in the order of the plan. They are the same bytes as in the units' logs, which must agree where a unit was
//! executed more than once; times are those of the first folder that has the unit. Sessions are numbered anew. One unit
//! at a time is in memory.

mod unit_folders;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use domain::create_private_folder;
use domain::prompt_log::session_folder;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::existing::{lock, stays};
use super::files::{
    CASE_BOOK_FILE, DEMONSTRATIONS_FILE, DOCUMENTS_FOLDER, ELSEWHERE_FILE, EPISODES_FILE,
    ERRORS_FILE, LATENCY_FILE, PROMPT_FILE, PROMPTS_FOLDER, REQUESTS_FILE, SESSIONS_FILE,
    SNAPSHOTS_FOLDER, STREAMS_FILE, TIMINGS_FILE, run_names,
};
use super::{
    EpisodeError, EpisodeRecord, EpisodeTimings, LogError, Manifest, RequestRecord, SessionRecord,
    sealed, system,
};
use crate::latency::LatencyRecord;

use unit_folders::sync_all;
pub use unit_folders::{FactDifference, UnitFolders, finish_unit, unit_folder};

/// Why units cannot be merged.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    /// A folder cannot be read or written.
    #[error(transparent)]
    Log(#[from] LogError),
    /// A unit is part of another plan.
    #[error(
        "{} is not unit {number} of this plan: {problem}. Give the plan with which it was executed, unchanged, or remove this \
         folder and execute the unit again",
        dir.display()
    )]
    OtherPlan {
        /// The unit's folder.
        dir: PathBuf,
        /// The unit that it was taken for.
        number: u32,
        /// What differs.
        problem: String,
    },
    /// A unit's log cannot be used.
    #[error("{}: {problem}; remove this folder and execute the unit again", dir.display())]
    Broken {
        /// The unit's folder.
        dir: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// Two executions of a unit differ.
    #[error(
        "{} and {} disagree about {key}: find out which machine is wrong, and remove its folder of the unit",
        one.display(), other.display()
    )]
    Disagree {
        /// The folder of one execution.
        one: PathBuf,
        /// That of the other.
        other: PathBuf,
        /// The key of an episode with different records.
        key: String,
    },
    /// The folder of the merged run has files.
    #[error("{} is not empty: choose another --out, or remove it", .0.display())]
    NotEmpty(PathBuf),
}

/// An episode of the plan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnitEpisode {
    /// Its key.
    pub key: String,
    /// The unit that it is part of.
    pub unit: u32,
    /// What its record has to say.
    pub facts: PlannedFacts,
}

/// What of an episode's record follows from the plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlannedFacts {
    /// Its task's number.
    pub task: u8,
    /// Its seed.
    pub seed: u64,
    /// Length of its reference.
    pub reference: u32,
}

impl PlannedFacts {
    /// Those of a record.
    pub fn of(&EpisodeRecord { task, seed, reference, .. }: &EpisodeRecord) -> Self {
        Self { task, seed, reference }
    }

    /// Checks that the record of the episode `key` says these, which are `source`, and not `recorded`.
    pub(super) fn check(self, recorded: Self, key: &str, source: &str) -> Result<(), String> {
        let fields = [
            ("task", recorded.task.into(), self.task.into()),
            ("seed", recorded.seed, self.seed),
            ("reference", recorded.reference.into(), self.reference.into()),
        ];
        match fields.into_iter().find(|(_, recorded, planned)| recorded != planned) {
            None => Ok(()),
            Some((field, recorded, planned)) => {
                Err(format!("\"{field}\" of {key} is {recorded}, and {planned} {source}"))
            }
        }
    }
}

/// Writes the run that consists of `episodes`, which are all episodes of `units`, unit by unit, into the folder `out`. Returns their number.
///
/// # Errors
/// When a unit's log is broken, incomplete, or two executions of it disagree; when `out` is not empty.
pub fn merge(
    manifest: &Manifest,
    units: &UnitFolders,
    episodes: impl IntoIterator<Item = UnitEpisode>,
    out: &Path,
) -> Result<u64, MergeError> {
    if fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(MergeError::NotEmpty(out.to_owned()));
    }
    let mut draft = out.as_os_str().to_owned();
    draft.push(".merging");
    let draft = PathBuf::from(draft);
    if fs::symlink_metadata(&draft).is_ok_and(|found| found.is_symlink()) {
        return Err(MergeError::NotEmpty(draft));
    }
    fs::create_dir_all(&draft).map_err(system("make", &draft))?;
    // The rest of a merge that was interrupted is replaced.
    let others = run_names().and_then(|names| names.others_in(&draft));
    let mut others = others.map_err(system("list", &draft))?.into_iter();
    if others.any(|path| !stays(&path)) {
        return Err(MergeError::NotEmpty(draft));
    }
    let _lock = lock(&draft)?;
    let written = write(manifest, units, episodes, &draft);
    if written.is_err() {
        // What is wrong with the units is the error to report, not that a folder stays behind.
        let _ = fs::remove_dir_all(&draft);
    }
    let count = written?;
    fs::rename(&draft, out).map_err(system("rename", &draft))?;
    durable::sync_name(out).map_err(system("flush", out))?;
    Ok(count)
}

/// Writes the merged run into the folder `draft`. Returns the number of episodes.
fn write(
    manifest: &Manifest,
    units: &UnitFolders,
    episodes: impl IntoIterator<Item = UnitEpisode>,
    draft: &Path,
) -> Result<u64, MergeError> {
    let mut run = MergedRun::new(draft, manifest.settings.max_steps)?;
    let mut loaded: Option<LoadedUnit> = None;
    let mut count = 0;
    for episode in episodes {
        let mut current = match loaded.take() {
            Some(current) if current.number == episode.unit => current,
            before => {
                before.map_or(Ok(()), LoadedUnit::check_written)?;
                run.load(episode.unit, &units.of(episode.unit))?
            }
        };
        run.write(&mut current, &episode)?;
        loaded = Some(current);
        count += 1;
    }
    loaded.map_or(Ok(()), LoadedUnit::check_written)?;
    run.finish()?;
    manifest.write(draft)?;
    sync_all(draft).map_err(system("flush", draft))?;
    Ok(count)
}

/// Lines of an episode log by key.
type LinesByKey = BTreeMap<String, LoggedLine>;

/// A line of the log.
#[derive(PartialEq)]
struct LoggedLine {
    bytes: Vec<u8>,
    facts: PlannedFacts,
}

/// The episode log of a unit.
struct UnitLog {
    lines: LinesByKey,
    /// The number of requests to a model that an episode took, by key.
    requests: BTreeMap<String, u32>,
}

/// The first key under which two logs of a unit have different lines, or only one has a line.
fn first_disagreement(one: &LinesByKey, other: &LinesByKey) -> Option<String> {
    let mut keys = one.keys().chain(other.keys());
    keys.find(|key| one.get(*key) != other.get(*key)).cloned()
}

/// The episodes of a unit that are not written yet.
struct LoadedUnit {
    number: u32,
    dir: PathBuf,
    /// Sessions of the units before.
    sessions_before: u32,
    episodes: LinesByKey,
    timings: BTreeMap<String, EpisodeTimings>,
}

impl LoadedUnit {
    /// Checks that everything was written: the unit has no other episodes than the plan.
    fn check_written(self) -> Result<(), MergeError> {
        match self.episodes.into_keys().next() {
            None => Ok(()),
            Some(key) => {
                let problem =
                    format!("the unit has no episode {key} in the plan, and one in its log");
                Err(MergeError::Broken { dir: self.dir, problem })
            }
        }
    }
}

/// The files of the merged run.
struct MergedRun<'a> {
    dir: &'a Path,
    max_steps: u32,
    episodes: BufWriter<File>,
    timings: BufWriter<File>,
    requests: BufWriter<File>,
    errors: BufWriter<File>,
    sessions: BufWriter<File>,
    latency: BufWriter<File>,
    /// Sessions so far.
    session_count: u32,
}

impl<'a> MergedRun<'a> {
    /// Starts the files in `dir`, over those of a merge that was interrupted.
    fn new(dir: &'a Path, max_steps: u32) -> Result<Self, LogError> {
        for entry in fs::read_dir(dir).map_err(system("list", dir))? {
            let path = entry.map_err(system("list", dir))?.path();
            let removed =
                if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
            removed.map_err(system("remove", &path))?;
        }
        let create = |file: &str| {
            let path = dir.join(file);
            File::create(&path).map(BufWriter::new).map_err(system("make", &path))
        };
        Ok(Self {
            dir,
            max_steps,
            episodes: create(EPISODES_FILE)?,
            timings: create(TIMINGS_FILE)?,
            requests: create(REQUESTS_FILE)?,
            errors: create(ERRORS_FILE)?,
            sessions: create(SESSIONS_FILE)?,
            latency: create(LATENCY_FILE)?,
            session_count: 0,
        })
    }

    /// Reads the episodes of a unit, whose executions are in `dirs`, and copies everything else of the first one.
    fn load(&mut self, number: u32, dirs: &[PathBuf]) -> Result<LoadedUnit, MergeError> {
        let Some((dir, others)) = dirs.split_first() else {
            let dir = PathBuf::from(unit_folder(number));
            return Err(MergeError::Broken { dir, problem: "it has gone".to_owned() });
        };
        let log = self.read_episodes(dir)?;
        for other in others {
            let other_lines = self.read_episodes(other)?.lines;
            if let Some(key) = first_disagreement(&log.lines, &other_lines) {
                let (one, other) = (dir.clone(), other.clone());
                return Err(MergeError::Disagree { one, other, key });
            }
        }
        let sessions_before = self.session_count;
        self.copy_journals(dir, &log.requests)?;
        durable::check_no_links(dir).map_err(system("read", dir))?;
        let files =
            [CASE_BOOK_FILE, DEMONSTRATIONS_FILE, STREAMS_FILE, ELSEWHERE_FILE, PROMPT_FILE];
        for name in [DOCUMENTS_FOLDER, SNAPSHOTS_FOLDER].into_iter().chain(files) {
            copy(&dir.join(name), &self.dir.join(name))?;
        }
        self.copy_prompts(dir, sessions_before)?;
        Ok(LoadedUnit {
            number,
            dir: dir.clone(),
            sessions_before,
            episodes: log.lines,
            timings: read_timings(dir)?,
        })
    }

    /// The episode log in `dir`, checked.
    fn read_episodes(&self, dir: &Path) -> Result<UnitLog, MergeError> {
        let mut log = UnitLog { lines: BTreeMap::new(), requests: BTreeMap::new() };
        read_lines(dir, EPISODES_FILE, |line| {
            let record: EpisodeRecord = sealed::read(line).map_err(io::Error::other)?;
            if line.trim_ascii().len() + 1 != line.len() {
                // The merged log has to have the bytes of one machine's.
                return Err(io::Error::other(
                    "white space around the record, such as the line ends of Windows",
                ));
            }
            record.check(self.max_steps).map_err(io::Error::other)?;
            if let (Some(_), Some(requests)) = (record.prompt_tokens, record.requests) {
                log.requests.insert(record.key.clone(), requests);
            }
            let logged = LoggedLine { bytes: line.to_vec(), facts: PlannedFacts::of(&record) };
            match log.lines.insert(record.key.clone(), logged) {
                None => Ok(()),
                Some(_) => Err(io::Error::other(format!("the log has {} twice", record.key))),
            }
        })?;
        Ok(log)
    }

    /// Copies the journals in `dir` with new numbers of sessions. `requests` has the number of requests that each episode took.
    fn copy_journals(
        &mut self,
        dir: &Path,
        requests: &BTreeMap<String, u32>,
    ) -> Result<(), MergeError> {
        let broken = |problem| MergeError::Broken { dir: dir.to_owned(), problem };
        let sessions_before = self.session_count;
        let renumber = |session: &mut u32| *session = session.saturating_add(sessions_before);
        let mut last_session = 0;
        copy_lines(dir, SESSIONS_FILE, &mut self.sessions, |record: &mut SessionRecord| {
            last_session = last_session.max(record.session);
            renumber(&mut record.session);
        })?;
        let mut missing = requests.clone();
        copy_lines(dir, REQUESTS_FILE, &mut self.requests, |record: &mut RequestRecord| {
            if let Some(count) = missing.get_mut(&record.key) {
                *count = count.saturating_sub(1);
            }
            renumber(&mut record.session);
        })?;
        if let Some((key, count)) = missing.into_iter().find(|(_, count)| *count > 0) {
            return Err(broken(format!("{REQUESTS_FILE} lacks {count} requests of {key}")));
        }
        copy_lines(dir, ERRORS_FILE, &mut self.errors, |record: &mut EpisodeError| {
            renumber(&mut record.session);
        })?;
        copy_lines(dir, LATENCY_FILE, &mut self.latency, |record: &mut LatencyRecord| {
            renumber(&mut record.session);
        })?;
        if last_session == 0 {
            return Err(broken(format!("{SESSIONS_FILE} names no session")));
        }
        self.session_count = sessions_before.saturating_add(last_session);
        Ok(())
    }

    /// Copies the prompts in `dir`, whose sessions come after `sessions_before` others.
    fn copy_prompts(&self, dir: &Path, sessions_before: u32) -> Result<(), MergeError> {
        let (from, to) = (dir.join(PROMPTS_FOLDER), self.dir.join(PROMPTS_FOLDER));
        if !from.exists() {
            return Ok(());
        }
        create_private_folder(&to).map_err(system("make", &to))?;
        // Named by their content, so that units may have the same.
        for stored in ["images", "documents"] {
            copy(&from.join(stored), &to.join(stored))?;
        }
        for session in sessions_in(&from)? {
            let renumbered = sessions_before.saturating_add(session);
            copy(&session_folder(&from, session), &session_folder(&to, renumbered))?;
        }
        Ok(())
    }

    /// Writes the episode `episode` of `unit`.
    fn write(&mut self, unit: &mut LoadedUnit, episode: &UnitEpisode) -> Result<(), MergeError> {
        let UnitEpisode { key, facts, .. } = episode;
        let broken = |problem| MergeError::Broken { dir: unit.dir.clone(), problem };
        let line =
            unit.episodes.remove(key).ok_or_else(|| broken(format!("its log lacks {key}")))?;
        facts.check(line.facts, key, "in the plan").map_err(broken)?;
        let failed = system("write to", self.dir);
        let timings = unit.timings.remove(key).map(|mut timings| {
            timings.session = timings.session.saturating_add(unit.sessions_before);
            timings
        });
        let write = || {
            self.episodes.write_all(&line.bytes)?;
            timings.map_or(Ok(()), |timings| write_line(&mut self.timings, &timings))
        };
        write().map_err(failed).map_err(Into::into)
    }

    fn finish(mut self) -> Result<(), LogError> {
        let files = [
            &mut self.episodes,
            &mut self.timings,
            &mut self.requests,
            &mut self.errors,
            &mut self.sessions,
            &mut self.latency,
        ];
        files.into_iter().try_for_each(Write::flush).map_err(system("write to", self.dir))
    }
}

/// Calls `each` with the bytes of every line of a unit's file; a missing one is empty.
fn read_lines(
    dir: &Path,
    file: &str,
    mut each: impl FnMut(&[u8]) -> io::Result<()>,
) -> Result<(), MergeError> {
    let path = dir.join(file);
    let mut lines = match durable::open(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        opened => BufReader::new(opened.map_err(system("read", &path))?),
    };
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        let read = lines.read_until(b'\n', &mut line).map_err(system("read", &path))?;
        if read == 0 {
            break;
        }
        let used = match line.ends_with(b"\n") {
            true => each(&line),
            false => Err(io::Error::other("the line is torn")),
        };
        used.map_err(|error| MergeError::Broken {
            dir: dir.to_owned(),
            problem: format!("{file}, line {number}: {error}"),
        })?;
    }
    Ok(())
}

/// Copies the entries of a unit's journal, each changed by `change`.
fn copy_lines<T: Serialize + DeserializeOwned>(
    dir: &Path,
    file: &str,
    to: &mut BufWriter<File>,
    mut change: impl FnMut(&mut T),
) -> Result<(), MergeError> {
    read_lines(dir, file, |line| {
        let mut entry = sealed::read(line).map_err(io::Error::other)?;
        change(&mut entry);
        write_line(to, &entry)
    })
}

fn write_line(to: &mut BufWriter<File>, entry: &impl Serialize) -> io::Result<()> {
    to.write_all(&sealed::line(entry)?)
}

/// The timings of the episodes of a unit, by key.
fn read_timings(dir: &Path) -> Result<BTreeMap<String, EpisodeTimings>, MergeError> {
    let mut timings = BTreeMap::new();
    read_lines(dir, TIMINGS_FILE, |line| {
        let record: EpisodeTimings = sealed::read(line).map_err(io::Error::other)?;
        timings.insert(record.key.clone(), record);
        Ok(())
    })?;
    Ok(timings)
}

/// The sessions that have a folder in the folder `prompts`.
fn sessions_in(prompts: &Path) -> Result<Vec<u32>, LogError> {
    let mut sessions = Vec::new();
    for entry in fs::read_dir(prompts).map_err(system("list", prompts))? {
        let name = entry.map_err(system("list", prompts))?.file_name();
        let number = name.to_str().and_then(|name| name.strip_prefix("session-")?.parse().ok());
        sessions.extend::<Option<u32>>(number);
    }
    sessions.sort_unstable();
    Ok(sessions)
}

/// Copies a file or folder, if it is there, and nothing that is there already: the names of equal things are equal. What is
/// neither, such as a symbolic link or a pipe, is refused.
fn copy(from: &Path, to: &Path) -> Result<(), LogError> {
    let Ok(kind) = fs::symlink_metadata(from) else { return Ok(()) };
    if !kind.is_dir() {
        if to.exists() {
            return Ok(());
        }
        let copied = || io::copy(&mut durable::open(from)?, &mut durable::create(to)?);
        return copied().map(drop).map_err(system("copy", from));
    }
    fs::create_dir_all(to).map_err(system("make", to))?;
    // Prompts stay private.
    let mode = fs::metadata(from).and_then(|from| fs::set_permissions(to, from.permissions()));
    mode.map_err(system("make", to))?;
    for entry in fs::read_dir(from).map_err(system("list", from))? {
        let entry = entry.map_err(system("list", from))?;
        copy(&entry.path(), &to.join(entry.file_name()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
