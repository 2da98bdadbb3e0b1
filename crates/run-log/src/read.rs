//! A run folder as it is read.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use case_book::{CaseFacts, WorldFacts};
use serde_json::Value;

use super::check::check_records;
use super::files::{EPISODES_FILE, ERRORS_FILE, REQUESTS_FILE, SESSIONS_FILE, TIMINGS_FILE};
use super::journal::unchecked;
use super::known::KnownFacts;
use super::manifest::{CASES_HASH, MANIFEST_FILE, contents_of};
use super::{
    DamagedLine, EpisodeError, EpisodeRecord, EpisodeTimings, LogError, Manifest, RequestRecord,
    SessionRecord, read_journal,
};

/// A run folder as it is read, also while another process writes to it.
#[derive(Debug, Clone)]
pub struct RunLog {
    /// The folder.
    pub dir: PathBuf,
    /// The name of the run among others: the last part of its folder, and as much before it as
    /// [`tell_apart`] has added.
    pub name: String,
    /// The manifest.
    pub manifest: Manifest,
    /// The world, from the case book; the default for a run that was killed before the world wrote that.
    pub world: WorldFacts,
    /// The cases, by id, from the case book; none where [`world`](Self::world) is the default.
    pub cases: BTreeMap<String, CaseFacts>,
    /// Finished episodes, by key.
    pub episodes: Vec<EpisodeRecord>,
    /// Their timings, by key.
    pub timings: Vec<EpisodeTimings>,
    /// Requests to the model in the order of their answers, those of unfinished attempts at an episode included.
    pub requests: Vec<RequestRecord>,
    /// Episodes that were given up and not finished since, by key: the last error of each.
    pub errors: Vec<EpisodeError>,
    /// Events of the sessions.
    pub sessions: Vec<SessionRecord>,
    /// Lines that cannot be used, and whose content is missing above. Resuming the run sets them aside and repeats
    /// their episodes.
    pub damaged: Vec<DamagedLine>,
}

impl RunLog {
    /// What a reader must know of a world that is not deterministic.
    pub fn varies(&self) -> Option<String> {
        self.manifest.world_varies.then(|| {
            format!(
                "The world {} is not deterministic: a resumed or repeated run may differ, single episodes cannot be reproduced, \
                 and differences that `memtransfer validate` names are expected.",
                self.world.declaration.name
            )
        })
    }

    /// Checks that a run whose episodes have the keys `planned` contains every finished episode: a run can grow, but
    /// not shrink.
    ///
    /// # Errors
    /// When a finished episode is missing from `planned`.
    pub fn check_planned(&self, planned: &BTreeSet<String>) -> Result<(), LogError> {
        let mut outside = self.episodes.iter().filter(|record| !planned.contains(&record.key));
        let Some(first) = outside.next() else { return Ok(()) };
        Err(LogError::NotPlanned {
            dir: self.dir.clone(),
            count: 1 + outside.count(),
            example: first.key.clone(),
        })
    }

    /// Reads the run in `dir`, all of it. [`RunParts`](super::RunParts) reads logs that do not fit into memory.
    ///
    /// # Errors
    /// When there is none, or its log is broken.
    pub fn read(dir: &Path) -> Result<Self, LogError> {
        let (mut log, known) = Self::read_head(dir)?;
        let check = check_records(known, &log.manifest);
        let damaged = &mut log.damaged;
        log.episodes = read(dir, EPISODES_FILE, check, damaged)?;
        log.episodes.sort_by(|a, b| a.key.cmp(&b.key));
        let timings: Vec<EpisodeTimings> = read(dir, TIMINGS_FILE, unchecked, damaged)?;
        // The last of each key: those of an episode that was set aside come before those of its repetition.
        let timings: BTreeMap<String, EpisodeTimings> =
            timings.into_iter().map(|timings| (timings.key.clone(), timings)).collect();
        log.timings = timings.into_values().collect();
        log.requests = read(dir, REQUESTS_FILE, unchecked, damaged)?;
        let finished: BTreeSet<&str> =
            log.episodes.iter().map(|record| record.key.as_str()).collect();
        let errors: Vec<EpisodeError> = read(dir, ERRORS_FILE, unchecked, damaged)?;
        let open = errors.into_iter().filter(|error| !finished.contains(error.key.as_str()));
        let errors: BTreeMap<String, EpisodeError> =
            open.map(|error| (error.key.clone(), error)).collect();
        log.errors = errors.into_values().collect();
        log.sessions = read(dir, SESSIONS_FILE, unchecked, damaged)?;
        Ok(log)
    }

    /// Reads the manifest and the world of the run in `dir`: its log without what its journals hold.
    ///
    /// # Errors
    /// When there is none, or a file is broken.
    pub fn without_journals(dir: &Path) -> Result<Self, LogError> {
        Ok(Self::read_head(dir)?.0)
    }

    /// As [`without_journals`](Self::without_journals), with what follows of each record from the run.
    pub(super) fn read_head(dir: &Path) -> Result<(Self, KnownFacts), LogError> {
        if !dir.join(MANIFEST_FILE).exists() {
            return Err(LogError::NoRun(dir.to_owned()));
        }
        let manifest = Manifest::read(dir)?;
        let known = KnownFacts::of(dir, &manifest)?;
        let head = Self {
            dir: dir.to_owned(),
            name: last_parts(dir, 1),
            manifest,
            world: known.world(),
            cases: known.cases(),
            episodes: Vec::new(),
            timings: Vec::new(),
            requests: Vec::new(),
            errors: Vec::new(),
            sessions: Vec::new(),
            damaged: Vec::new(),
        };
        Ok((head, known))
    }

    /// The types of the tasks of cases, by the case's id: of those that the manifest or an episode tells.
    pub fn tasks(&self) -> BTreeMap<&str, u8> {
        let told = self.manifest.tasks.iter().map(|(case, task)| (case.as_str(), *task));
        told.chain(self.episodes.iter().map(|one| (one.case.as_str(), one.task))).collect()
    }

    /// What two runs must have in common for their figures to be comparable: that of their manifests, and
    /// of a world that does not hash what its cases are made from, its name and the cases.
    pub fn protocol(&self) -> BTreeMap<String, Value> {
        let mut protocol = self.manifest.protocol();
        if !self.manifest.hashes.contains_key(CASES_HASH) && !self.cases.is_empty() {
            let cases = serde_json::to_string(&self.cases).unwrap_or_default();
            let hash = blake3::hash(cases.as_bytes()).to_hex().to_string();
            protocol.insert("world".to_owned(), self.world.declaration.name.clone().into());
            protocol.insert(contents_of(CASES_HASH), hash.into());
        }
        protocol
    }

    /// The first eight digits of the hash of the [protocol](Self::protocol), which stand for it.
    pub fn protocol_id(&self) -> String {
        let protocol = Value::from_iter(self.protocol()).to_string();
        blake3::hash(protocol.as_bytes()).to_hex()[..8].to_owned()
    }

    /// The timings of the finished episodes, by key.
    pub fn timings_by_key(&self) -> BTreeMap<&str, &EpisodeTimings> {
        self.timings.iter().map(|timings| (timings.key.as_str(), timings)).collect()
    }

    /// Whether both are the log of one run: their folders are the same.
    pub fn is_same_run(&self, other: &Self) -> bool {
        let folder = |log: &Self| log.dir.canonicalize().ok();
        std::ptr::eq(self, other) || folder(self).is_some_and(|own| folder(other) == Some(own))
    }

    /// Whether every planned episode is finished, and none was given up.
    pub fn is_complete(&self) -> bool {
        self.errors.is_empty() && self.episodes.len() >= self.manifest.episodes as usize
    }

    /// When the run began, in seconds since 1970.
    pub fn began_unix_s(&self) -> Option<u64> {
        self.sessions.iter().map(|record| record.unix_s).min()
    }
}

/// Gives runs whose folders have the same last part longer names: as many parts as it takes to tell them apart.
pub fn tell_apart<'a>(logs: impl IntoIterator<Item = &'a mut RunLog>) {
    let logs: Vec<&mut RunLog> = logs.into_iter().collect();
    let folders: Vec<PathBuf> =
        logs.iter().map(|log| log.dir.canonicalize().unwrap_or(log.dir.clone())).collect();
    for (at, log) in logs.into_iter().enumerate() {
        let others = || folders.iter().filter(|folder| **folder != folders[at]);
        let is_shared = |count: &usize| {
            others().any(|other| last_parts(other, *count) == last_parts(&folders[at], *count))
        };
        let longest = folders[at].components().count();
        let enough = (1..longest).find(|count| !is_shared(count)).unwrap_or(longest);
        log.name = last_parts(&folders[at], enough);
    }
}

/// The last `count` parts of `dir`.
fn last_parts(dir: &Path, count: usize) -> String {
    let parts: Vec<_> = dir.components().collect();
    let last: PathBuf = parts[parts.len().saturating_sub(count)..].iter().collect();
    last.to_string_lossy().into_owned()
}

/// The entries of a journal; the damaged lines come to `damaged`.
pub(super) fn read<T: serde::de::DeserializeOwned>(
    dir: &Path,
    file: &str,
    check: impl FnMut(&T) -> Result<(), String>,
    damaged: &mut Vec<DamagedLine>,
) -> Result<Vec<T>, LogError> {
    let contents = read_journal(&dir.join(file), check)?;
    damaged.extend(contents.damaged);
    Ok(contents.entries)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::records::log;

    #[test]
    fn runs_are_told_apart_by_their_folders() {
        let names = |folders: &[&str]| -> Vec<String> {
            let at = |folder: &&str| RunLog { dir: folder.into(), ..log(vec![]) };
            let mut logs: Vec<RunLog> = folders.iter().map(at).collect();
            tell_apart(&mut logs);
            logs.into_iter().map(|log| log.name).collect()
        };
        assert_eq!(names(&["/runs/a", "/runs/b"]), ["a", "b"]);
        assert_eq!(names(&["/x/runs/a", "/y/runs/a", "/x/b"]), ["x/runs/a", "y/runs/a", "b"]);
        assert_eq!(names(&["/a", "/x/a"]), ["/a", "x/a"]);
        assert_eq!(names(&["/runs/a", "/runs/a"]), ["a", "a"]);
    }
}
