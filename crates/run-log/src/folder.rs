//! The run folder as it is written: opened, locked, extended.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use domain::create_private_folder;

use super::check::check_records;
use super::existing::{existing, has_lines, is_without_results, lock, remove_run};
use super::files::{
    EPISODES_FILE, ERRORS_FILE, LATENCY_FILE, LOGS_FOLDER, REQUESTS_FILE, SESSIONS_FILE,
    TIMINGS_FILE, memory_log_names,
};
use super::journal::unchecked;
use super::known::KnownFacts;
use super::manifest::{CODE, CODE_OF_POLICY, POLICY};
use super::{
    Difference, EpisodeError, EpisodeRecord, EpisodeTimings, Journal, LogError, Manifest,
    RequestRecord, SessionEvent, SessionRecord, damaged_file, system,
};
use crate::latency::LatencyRecord;

#[cfg(test)]
mod tests;

/// A run folder that this process writes to, with a lock that keeps other processes from doing so.
#[derive(Debug)]
pub struct RunFolder {
    dir: PathBuf,
    manifest: Manifest,
    session: u32,
    episodes: Journal<EpisodeRecord>,
    timings: Journal<EpisodeTimings>,
    requests: Journal<RequestRecord>,
    errors: Journal<EpisodeError>,
    sessions: Journal<SessionRecord>,
    latency: Journal<LatencyRecord>,
    /// [`hash`]es of the keys of finished episodes.
    finished: HashSet<u128>,
    /// Facts that were learned in this session, process and name, each with what earlier sessions have learned.
    learned: HashMap<(String, String), Option<String>>,
    /// Dropped last, after everything else is closed.
    _lock: File,
}

/// An opened run folder, and what was found in it.
#[derive(Debug)]
pub struct Opened {
    /// The folder.
    pub folder: RunFolder,
    /// Finished episodes.
    pub finished: Vec<EpisodeRecord>,
    /// Requests to the model so far.
    pub requests: Vec<RequestRecord>,
    /// Messages for the user: what was removed, cut or set aside.
    pub notes: Vec<String>,
}

impl RunFolder {
    /// Makes the folder `dir` for the run that `manifest` describes, or opens it to resume that run.
    /// `fresh` removes an earlier run in it first; without it, nothing is removed.
    ///
    /// # Errors
    /// When the folder holds another run, something else, a manifest that cannot be read, a symbolic link, or a broken log;
    /// when another process is writing to it; when the system refuses.
    pub fn open(dir: &Path, manifest: Manifest, fresh: bool) -> Result<Opened, LogError> {
        fs::create_dir_all(dir).map_err(system("make", dir))?;
        // The lock is a file: a folder of something else is refused before it gets one.
        existing(dir)?;
        let lock = lock(dir)?;
        let mut notes = Vec::new();
        let earlier = existing(dir)?;
        // Everything below writes into the folder by name.
        durable::check_no_links(dir).map_err(system("write to", dir))?;
        let manifest = match earlier {
            Some(there) if !fresh => {
                let differences = manifest.differences(&there);
                if !differences.is_empty() && !is_without_results(dir) {
                    return Err(LogError::OtherSettings { dir: dir.to_owned(), differences });
                }
                // Of a run without results, only the manifest is replaced.
                if !differences.is_empty() {
                    manifest
                } else {
                    manifest.continuing(there, &mut notes)
                }
            }
            Some(_) => {
                notes.push(remove_run(dir)?);
                manifest
            }
            None => manifest,
        };
        let check = check_records(KnownFacts::of(dir, &manifest)?, &manifest);
        manifest.write(dir)?;

        let (episodes, finished) = journal(&dir.join(EPISODES_FILE), check, &mut notes)?;
        let (timings, _) = journal(&dir.join(TIMINGS_FILE), unchecked, &mut notes)?;
        let (requests, asked) = journal(&dir.join(REQUESTS_FILE), unchecked, &mut notes)?;
        let (errors, _) = journal(&dir.join(ERRORS_FILE), unchecked, &mut notes)?;
        let (sessions, past): (Journal<SessionRecord>, _) =
            journal(&dir.join(SESSIONS_FILE), unchecked, &mut notes)?;
        let (latency, _) = journal(&dir.join(LATENCY_FILE), unchecked, &mut notes)?;
        let logs = dir.join(LOGS_FOLDER);
        create_private_folder(&logs).map_err(system("make", &logs))?;
        File::open(dir).and_then(|dir| dir.sync_all()).map_err(system("flush", dir))?;

        let folder = Self {
            dir: dir.to_owned(),
            manifest,
            session: past.iter().map(|record| record.session).max().unwrap_or(0).saturating_add(1),
            episodes,
            timings,
            requests,
            errors,
            sessions,
            latency,
            finished: finished.iter().map(|record| hash(&record.key)).collect(),
            learned: HashMap::new(),
            _lock: lock,
        };
        Ok(Opened { folder, finished, requests: asked, notes })
    }

    /// The folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Its manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The number of this session, from 1.
    pub fn session(&self) -> u32 {
        self.session
    }

    /// Checks that a run can be kept in `dir`: it is missing, empty, or holds a run.
    ///
    /// # Errors
    /// When it holds something else.
    pub fn check(dir: &Path) -> Result<(), LogError> {
        if dir.exists() { existing(dir).map(drop) } else { Ok(()) }
    }

    /// Removes the logs of the external memories of an earlier run in `dir`, before those of the next run start.
    ///
    /// # Errors
    /// When another process is writing to the run; when the system refuses.
    pub fn remove_memory_logs(dir: &Path) -> Result<(), LogError> {
        let logs = dir.join(LOGS_FOLDER);
        if !logs.exists() {
            return Ok(());
        }
        if existing(dir)?.is_none() {
            return Ok(());
        }
        let _lock = lock(dir)?;
        durable::check_no_links(dir).map_err(system("remove logs in", dir))?;
        let remove = || memory_log_names()?.remove_in(&logs).map(drop);
        remove().map_err(system("remove logs in", &logs))
    }

    /// Whether the run folder at `dir` has finished episodes.
    pub fn has_episodes(dir: &Path) -> bool {
        has_lines(dir, EPISODES_FILE)
    }

    /// The file that the process called `role` writes its stderr to.
    pub fn log_file(&self, role: &str) -> PathBuf {
        self.dir.join(LOGS_FOLDER).join(format!("{role}.log"))
    }

    /// Records finished episodes; they survive any kill of the process. If a model was asked, or a memory has learned from
    /// one, requests and episodes are on the disk when this returns, otherwise some milliseconds later.
    ///
    /// # Errors
    /// When an episode is finished already; when an operation of the system fails.
    pub fn finish(&mut self, episodes: &[(EpisodeRecord, EpisodeTimings)]) -> Result<(), LogError> {
        if episodes.is_empty() {
            return Ok(());
        }
        // Requests before episodes, so that no finished episode lacks its requests.
        let cost =
            episodes.iter().any(|(record, _)| record.prompt_tokens.is_some_and(|sum| sum > 0));
        if cost {
            self.requests.sync()?;
        }
        // Memory removes the last snapshot but one when it learns again: no later snapshot may be on the disk without this
        // record.
        let learned = episodes.iter().any(|(record, _)| {
            record.stream.as_ref().is_some_and(|stream| stream.snapshot.is_some())
        });
        for (record, _) in episodes {
            if !self.finished.insert(hash(&record.key)) {
                return Err(LogError::Twice(record.key.clone()));
            }
            self.episodes.append(record)?;
        }
        if cost || learned {
            self.episodes.sync()?;
        } else {
            self.episodes.sync_soon()?;
        }
        // Timings after the episodes: a crash in between loses a measurement and no result.
        episodes.iter().try_for_each(|(_, timings)| self.timings.append(timings))
    }

    /// Records a request to the model.
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn asked(&mut self, request: &RequestRecord) -> Result<(), LogError> {
        self.requests.append(request)
    }

    /// Records an episode that was given up.
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn give_up(&mut self, error: &EpisodeError) -> Result<(), LogError> {
        self.errors.append(error)?;
        self.errors.sync()
    }

    /// Records an event of the session.
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn note(&mut self, event: SessionEvent) -> Result<(), LogError> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let unix_s = now.map_or(0, |since| since.as_secs());
        if let SessionEvent::Ended { .. } = event {
            // A later failure of the thread that flushes would go unnoticed.
            self.episodes.sync()?;
        }
        self.sessions.append(&SessionRecord { session: self.session, unix_s, event })?;
        self.sessions.sync()
    }

    /// Adds a line about the latency of a stage.
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn measured(&mut self, record: &LatencyRecord) -> Result<(), LogError> {
        self.latency.append(record)
    }

    /// Records the facts that the processes reported in the manifest, the first time. Later, returns how they differ
    /// from the recorded ones.
    ///
    /// # Errors
    /// When the policy tells other code than when the run began; when an operation of the system fails.
    pub fn introduce(
        &mut self,
        processes: BTreeMap<String, BTreeMap<String, String>>,
    ) -> Result<Vec<String>, LogError> {
        if self.manifest.processes.is_empty() {
            self.manifest.processes = processes;
            self.manifest.write(&self.dir)?;
            return Ok(Vec::new());
        }
        let mut changes = Vec::new();
        let code = processes.get(POLICY).and_then(|facts| facts.get(CODE));
        if let (Some(here), Some(there)) = (code, self.manifest.policy_code())
            && here != there
        {
            let key = CODE_OF_POLICY.to_owned();
            let difference = Difference { key, there: there.to_owned(), here: here.clone() };
            let (dir, differences) = (self.dir.clone(), vec![difference]);
            return Err(LogError::OtherSettings { dir, differences });
        }
        for (role, then) in &self.manifest.processes {
            // A memory that was left out has no process.
            let Some(now) = processes.get(role) else { continue };
            for (fact, then) in then {
                if LEARNED_FACTS.contains(&fact.as_str()) {
                    continue;
                }
                let now = now.get(fact).map_or("nothing", String::as_str);
                if now != then {
                    changes
                        .push(format!("{role}: {fact} was {then} when the run began, now {now}"));
                }
            }
        }
        Ok(changes)
    }

    /// Adds facts that a process has learned since it was ready to the manifest. Returns those that differ from what an
    /// earlier session has learned. The manifest then has both, `sessions.jsonl` each with its session.
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn learn(
        &mut self,
        role: &str,
        facts: &BTreeMap<String, String>,
    ) -> Result<Vec<String>, LogError> {
        let known = self.manifest.processes.entry(role.to_owned()).or_default();
        let mut changes = Vec::new();
        for (fact, now) in facts {
            let name = (role.to_owned(), fact.clone());
            let is_first = !self.learned.contains_key(&name);
            let before = &*self.learned.entry(name).or_insert_with(|| known.get(fact).cloned());
            // Episodes of earlier sessions are part of the same figures.
            let joined = match before {
                None => now.clone(),
                Some(before) if says(before, now) => before.clone(),
                Some(before) => {
                    if is_first {
                        changes.push(format!(
                            "{role}: {fact} was {before} in an earlier session, now {now}"
                        ));
                    }
                    format!("{before}{LATER}{now}")
                }
            };
            known.insert(fact.clone(), joined);
        }
        self.manifest.write(&self.dir)?;
        let (process, facts) = (role.to_owned(), facts.clone());
        self.note(SessionEvent::Learned { process, facts })?;
        Ok(changes)
    }
}

/// What joins the values that a fact had in several sessions.
const LATER: &str = "; in a later session ";

/// Whether the last of the joined values `before` is `now`.
fn says(before: &str, now: &str) -> bool {
    before.rsplit(LATER).next() == Some(now)
}

/// The facts that a policy learns from the replies of its server ([`RunFolder::learn`]), and so does not have when it is
/// ready.
pub const LEARNED_FACTS: [&str; 4] = ["answers", "fields", "reasoning", "temperature"];

/// Opens the journal in `path`, and adds notes on what was cut or set aside.
fn journal<T: serde::Serialize + serde::de::DeserializeOwned>(
    path: &Path,
    check: impl FnMut(&T) -> Result<(), String>,
    notes: &mut Vec<String>,
) -> Result<(Journal<T>, Vec<T>), LogError> {
    let (journal, contents) = Journal::open(path, check)?;
    if contents.torn > 0 {
        notes.push(format!(
            "{}: cut {} bytes of a line that was being written when the program was killed",
            path.file_name().unwrap_or_default().display(),
            contents.torn
        ));
    }
    let aside = damaged_file(path);
    notes.extend(
        contents.damaged.iter().map(|line| format!("{line}; moved to {}", aside.display())),
    );
    Ok((journal, contents.entries))
}

/// The first 16 bytes of the BLAKE3 hash of a key. A run can have millions of keys, whose text would take more memory.
fn hash(key: &str) -> u128 {
    let hash = blake3::hash(key.as_bytes());
    hash.as_bytes().first_chunk().copied().map_or(0, u128::from_le_bytes)
}
