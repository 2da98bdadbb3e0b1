//! The run folder: created, locked, resumed, read.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use rustix::fs::FlockOperation;

use super::manifest::MANIFEST_FILE;
use super::{
    DamagedLine, EpisodeError, EpisodeRecord, EpisodeTimings, Journal, LogError, Manifest,
    RequestRecord, SessionEvent, SessionRecord, damaged_file, read_journal, system,
};
use crate::latency::LatencyRecord;

/// Name of the file in a run's folder.
pub const STATUS_FILE: &str = "status.json";

const EPISODES_FILE: &str = "episodes.jsonl";
const TIMINGS_FILE: &str = "timings.jsonl";
const REQUESTS_FILE: &str = "requests.jsonl";
const ERRORS_FILE: &str = "errors.jsonl";
const SESSIONS_FILE: &str = "sessions.jsonl";
const LATENCY_FILE: &str = "latency.jsonl";
const DOCUMENTS_FOLDER: &str = "documents";
const PROMPTS_FOLDER: &str = "prompts";
const LOGS_FOLDER: &str = "logs";
/// Where [`report`](crate::report) writes about a single run.
pub const REPORT_FOLDER: &str = "report";

/// Everything that a run folder may hold. No other file in it is touched.
const CONTENTS: [&str; 21] = [
    MANIFEST_FILE,
    "manifest.json.new",
    EPISODES_FILE,
    TIMINGS_FILE,
    REQUESTS_FILE,
    ERRORS_FILE,
    SESSIONS_FILE,
    LATENCY_FILE,
    STATUS_FILE,
    "status.json.new",
    "episodes.jsonl.new",
    "episodes.damaged.jsonl",
    "timings.damaged.jsonl",
    "requests.damaged.jsonl",
    "errors.damaged.jsonl",
    "sessions.damaged.jsonl",
    "latency.damaged.jsonl",
    DOCUMENTS_FOLDER,
    PROMPTS_FOLDER,
    LOGS_FOLDER,
    REPORT_FOLDER,
];

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
    finished: BTreeSet<String>,
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
    /// `fresh` removes an earlier run in it first.
    ///
    /// # Errors
    /// When the folder holds another run, something else, or a broken log; when another process is
    /// writing to it; when the system refuses.
    pub fn open(dir: &Path, manifest: Manifest, fresh: bool) -> Result<Opened, LogError> {
        fs::create_dir_all(dir).map_err(system("make", dir))?;
        let lock = lock(dir)?;
        let mut notes = Vec::new();
        let manifest = match existing(dir)? {
            // A run without an episode or a request, perhaps for want of a model, is replaced.
            Some(_) if !fresh && !has_episodes(dir) && !has_requests(dir) => {
                remove_run(dir)?;
                manifest
            }
            Some(there) if !fresh => {
                let there = there?;
                let differences = manifest.differences(&there);
                if !differences.is_empty() {
                    return Err(LogError::OtherSettings { dir: dir.to_owned(), differences });
                }
                if manifest.commit != there.commit {
                    let commit = |m: &Manifest| m.commit.clone().unwrap_or("unknown".to_owned());
                    notes.push(format!(
                        "the run was begun with commit {} and goes on with {}",
                        commit(&there),
                        commit(&manifest)
                    ));
                }
                // What is free to change is as this session has it.
                let prices = manifest.prices.or(there.prices);
                let mut documents = there.documents;
                documents.extend(manifest.documents);
                let (processes, commit) = (there.processes, there.commit);
                Manifest { processes, commit, prices, documents, ..manifest }
            }
            Some(_) => {
                notes.extend(remove_run(dir)?);
                manifest
            }
            None => manifest,
        };
        manifest.write(dir)?;

        let mut open = JournalOpener { dir, notes: &mut notes };
        let check = check_record(manifest.settings.max_steps);
        let (episodes, finished) = open.journal::<EpisodeRecord>(EPISODES_FILE, check)?;
        let (timings, _) = open.journal(TIMINGS_FILE, unchecked)?;
        let (requests, asked) = open.journal(REQUESTS_FILE, unchecked)?;
        let (errors, _) = open.journal(ERRORS_FILE, unchecked)?;
        let (sessions, past) = open.journal::<SessionRecord>(SESSIONS_FILE, unchecked)?;
        let (latency, _) = open.journal(LATENCY_FILE, unchecked)?;
        let logs = dir.join(LOGS_FOLDER);
        fs::create_dir_all(&logs).map_err(system("make", &logs))?;
        File::open(dir).and_then(|dir| dir.sync_all()).map_err(system("flush", dir))?;

        let folder = Self {
            dir: dir.to_owned(),
            manifest,
            session: past.iter().map(|record| record.session).max().unwrap_or(0) + 1,
            episodes,
            timings,
            requests,
            errors,
            sessions,
            latency,
            finished: finished.iter().map(|record| record.key.clone()).collect(),
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

    /// Whether the run folder at `dir` has finished episodes.
    pub fn has_episodes(dir: &Path) -> bool {
        has_episodes(dir)
    }

    /// Where a run folder at `dir` keeps the documents that memory supplied.
    pub fn documents_of(dir: &Path) -> PathBuf {
        dir.join(DOCUMENTS_FOLDER)
    }

    /// Where a run folder at `dir` keeps what the policy was given and what it answered.
    pub fn prompts_of(dir: &Path) -> PathBuf {
        dir.join(PROMPTS_FOLDER)
    }

    /// The file that the process called `role` writes its stderr to.
    pub fn log_file(&self, role: &str) -> PathBuf {
        self.dir.join(LOGS_FOLDER).join(format!("{role}.log"))
    }

    /// Whether the episode has finished.
    pub fn is_finished(&self, key: &str) -> bool {
        self.finished.contains(key)
    }

    /// The number of finished episodes.
    pub fn count_finished(&self) -> u64 {
        self.finished.len() as u64
    }

    /// Records finished episodes; they survive any kill of the process. If a model was asked, requests and episodes
    /// are on the disk when this returns, otherwise some milliseconds later.
    ///
    /// # Errors
    /// When an operation of the system fails.
    pub fn finish(&mut self, episodes: &[(EpisodeRecord, EpisodeTimings)]) -> Result<(), LogError> {
        if episodes.is_empty() {
            return Ok(());
        }
        // What they cost before the episodes: no finished one is without.
        let cost =
            episodes.iter().any(|(record, _)| record.prompt_tokens.is_some_and(|sum| sum > 0));
        if cost {
            self.requests.sync()?;
        }
        for (record, _) in episodes {
            assert!(self.finished.insert(record.key.clone()), "{} was run twice", record.key);
            self.episodes.append(record)?;
        }
        if cost {
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

    /// Puts what the processes said about themselves into the manifest, the first time; later says how
    /// they differ from then.
    ///
    /// # Errors
    /// When an operation of the system fails.
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
        for (role, then) in &self.manifest.processes {
            let now = processes.get(role);
            for (fact, then) in then {
                let now = now.and_then(|facts| facts.get(fact)).map_or("nothing", String::as_str);
                if now != then {
                    changes
                        .push(format!("{role}: {fact} was {then} when the run began, now {now}"));
                }
            }
        }
        Ok(changes)
    }
}

/// A run folder as it is read, also while another process writes to it.
#[derive(Debug, Clone)]
pub struct RunLog {
    /// The folder.
    pub dir: PathBuf,
    /// The manifest.
    pub manifest: Manifest,
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
    /// Lines that cannot be used: what they say is missing above. A run sets them aside and repeats their episodes.
    pub damaged: Vec<DamagedLine>,
}

impl RunLog {
    /// Checks that a run whose episodes have the keys `planned` contains every finished episode: a run can grow, and not
    /// shrink.
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

    /// Reads the run in `dir`.
    ///
    /// # Errors
    /// When there is none, or its log is broken.
    pub fn read(dir: &Path) -> Result<Self, LogError> {
        if !dir.join(MANIFEST_FILE).exists() {
            return Err(LogError::NoRun { dir: dir.to_owned() });
        }
        let manifest = Manifest::read(dir)?;
        let mut damaged = Vec::new();
        let check = check_record(manifest.settings.max_steps);
        let mut episodes = read(dir, EPISODES_FILE, check, &mut damaged)?;
        episodes.sort_by(|a: &EpisodeRecord, b| a.key.cmp(&b.key));
        let timings: Vec<EpisodeTimings> = read(dir, TIMINGS_FILE, unchecked, &mut damaged)?;
        // The last of each key: those of an episode that was set aside come before those of its repetition.
        let timings: BTreeMap<String, EpisodeTimings> =
            timings.into_iter().map(|timings| (timings.key.clone(), timings)).collect();
        let timings = timings.into_values().collect();
        let requests = read(dir, REQUESTS_FILE, unchecked, &mut damaged)?;
        let finished: BTreeSet<&str> = episodes.iter().map(|record| record.key.as_str()).collect();
        let errors: Vec<EpisodeError> = read(dir, ERRORS_FILE, unchecked, &mut damaged)?;
        let open = errors.into_iter().filter(|error| !finished.contains(error.key.as_str()));
        let errors: BTreeMap<String, EpisodeError> =
            open.map(|error| (error.key.clone(), error)).collect();
        let errors = errors.into_values().collect();
        let sessions = read(dir, SESSIONS_FILE, unchecked, &mut damaged)?;
        let dir = dir.to_owned();
        Ok(Self { dir, manifest, episodes, timings, requests, errors, sessions, damaged })
    }

    /// The name by which the policy introduced itself, for example a model's; `None` when none has started.
    pub fn policy_name(&self) -> Option<&str> {
        self.manifest.policy_name()
    }

    /// When the run was begun, in seconds since 1970.
    pub fn began_unix_s(&self) -> Option<u64> {
        self.sessions.iter().map(|record| record.unix_s).min()
    }
}

fn read<T: serde::de::DeserializeOwned>(
    dir: &Path,
    file: &str,
    check: impl FnMut(&T) -> Result<(), String>,
    damaged: &mut Vec<DamagedLine>,
) -> Result<Vec<T>, LogError> {
    let contents = read_journal(&dir.join(file), check)?;
    damaged.extend(contents.damaged);
    Ok(contents.entries)
}

/// Checks records against themselves and against those before.
fn check_record(max_steps: u32) -> impl FnMut(&EpisodeRecord) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    move |record| {
        record.check(max_steps)?;
        let is_new = seen.insert(record.key.clone());
        if is_new { Ok(()) } else { Err(format!("{} is there already", record.key)) }
    }
}

fn unchecked<T>(_: &T) -> Result<(), String> {
    Ok(())
}

/// Opens journals, and notes what was cut or set aside.
struct JournalOpener<'a> {
    dir: &'a Path,
    notes: &'a mut Vec<String>,
}

impl JournalOpener<'_> {
    fn journal<T: serde::Serialize + serde::de::DeserializeOwned>(
        &mut self,
        file: &str,
        check: impl FnMut(&T) -> Result<(), String>,
    ) -> Result<(Journal<T>, Vec<T>), LogError> {
        let path = self.dir.join(file);
        let (journal, contents) = Journal::open(&path, check)?;
        if contents.torn > 0 {
            self.notes.push(format!(
                "{file}: cut {} bytes of a line that was being written when the program was killed",
                contents.torn
            ));
        }
        let lines = contents
            .damaged
            .iter()
            .map(|line| format!("{line}; moved to {}", damaged_file(&path).display()));
        self.notes.extend(lines);
        Ok((journal, contents.entries))
    }
}

/// Locks the folder until the file is dropped.
fn lock(dir: &Path) -> Result<File, LogError> {
    let file = File::open(dir).map_err(system("open", dir))?;
    match rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(file),
        Err(rustix::io::Errno::WOULDBLOCK) => Err(LogError::Locked { dir: dir.to_owned() }),
        Err(errno) => Err(system("lock", dir)(errno.into())),
    }
}

/// The manifest of the run in `dir`, or none when the folder is empty; an error when it holds something
/// else. A manifest that cannot be read is the inner error: `--fresh` gets past it.
fn existing(dir: &Path) -> Result<Option<Result<Manifest, LogError>>, LogError> {
    if dir.join(MANIFEST_FILE).exists() {
        return Ok(Some(Manifest::read(dir)));
    }
    for entry in fs::read_dir(dir).map_err(system("list", dir))? {
        let name = entry.map_err(system("list", dir))?.file_name();
        // A draft without its manifest: killed in the first moment of a run.
        if name != "manifest.json.new" {
            return Err(LogError::NotARun { dir: dir.to_owned() });
        }
    }
    Ok(None)
}

/// Whether the run in `dir` has finished an episode.
fn has_episodes(dir: &Path) -> bool {
    fs::metadata(dir.join(EPISODES_FILE)).is_ok_and(|file| file.len() > 0)
}

/// Whether the run in `dir` has sent a request.
fn has_requests(dir: &Path) -> bool {
    fs::metadata(dir.join(REQUESTS_FILE)).is_ok_and(|file| file.len() > 0)
}

/// Removes the run in `dir` and says what that was.
fn remove_run(dir: &Path) -> Result<Vec<String>, LogError> {
    let lines = |file: &str| {
        fs::read(dir.join(file)).map_or(0, |text| text.iter().filter(|&&b| b == b'\n').count())
    };
    let note = format!(
        "--fresh: removed the earlier run in {} ({} finished episodes)",
        dir.display(),
        lines(EPISODES_FILE)
    );
    // The manifest goes last: a folder with part of a run in it stays recognisable as one.
    for name in CONTENTS.iter().rev() {
        let path = dir.join(name);
        if path.is_dir() {
            fs::remove_dir_all(&path).map_err(system("remove", &path))?;
        } else if path.exists() {
            fs::remove_file(&path).map_err(system("remove", &path))?;
        }
    }
    Ok(vec![note])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::DocumentFacts;
    use crate::log::testing::{manifest, record, request, timings};

    fn keys(records: &[EpisodeRecord]) -> Vec<&str> {
        records.iter().map(|record| record.key.as_str()).collect()
    }

    fn add(folder: &mut RunFolder, case: &str) {
        let record = record(case, true);
        folder.finish(&[(record.clone(), timings(&record))]).unwrap();
    }

    #[test]
    fn a_run_goes_on_where_it_was_killed() {
        let dir = tempfile::tempdir().unwrap();
        let open = |fresh| RunFolder::open(dir.path(), manifest(), fresh).unwrap();
        let mut folder = open(false).folder;
        add(&mut folder, "t01-01");
        add(&mut folder, "t01-02");
        assert_eq!(folder.session(), 1);
        folder.note(SessionEvent::Failed { generation: 1, reason: "x".into() }).unwrap();
        drop(folder);
        // Killed in the middle of a line.
        let path = dir.path().join(EPISODES_FILE);
        let text = fs::read(&path).unwrap();
        fs::write(&path, &text[..text.len() - 7]).unwrap();

        let Opened { mut folder, finished, notes, .. } = open(false);
        assert_eq!(keys(&finished), [record("t01-01", true).key]);
        assert!(notes[0].starts_with("episodes.jsonl: cut "), "{notes:?}");
        assert_eq!(folder.session(), 2);
        assert!(!folder.is_finished(&record("t01-02", true).key));
        add(&mut folder, "t01-02");
        drop(folder);
        assert_eq!(fs::read(&path).unwrap(), text, "the log is as if nothing had happened");

        let opened = open(true);
        assert!(opened.finished.is_empty());
        assert!(opened.notes[0].contains("(2 finished episodes)"), "{:?}", opened.notes);
    }

    #[test]
    fn what_was_spent_is_known_after_a_kill_whether_or_not_an_episode_was_finished() {
        let dir = tempfile::tempdir().unwrap();
        let open = || RunFolder::open(dir.path(), manifest(), false).unwrap();
        let mut folder = open().folder;
        (0..3).for_each(|step| folder.asked(&request("a", step)).unwrap());
        drop(folder);
        // Killed in the middle of a line.
        let path = dir.path().join(REQUESTS_FILE);
        let text = fs::read(&path).unwrap();
        fs::write(&path, &text[..text.len() - 7]).unwrap();

        let Opened { mut folder, finished, requests, notes } = open();
        assert_eq!((finished.len(), requests.len()), (0, 2));
        assert!(notes[0].starts_with("requests.jsonl: cut "), "{notes:?}");
        assert_eq!(requests, [request("a", 0), request("a", 1)]);
        // The episode runs again, and what it took before was spent all the same.
        (0..3).for_each(|step| folder.asked(&request("a", step)).unwrap());
        add(&mut folder, "t01-01");
        drop(folder);
        assert_eq!(RunLog::read(dir.path()).unwrap().requests.len(), 5);
    }

    #[test]
    fn a_run_can_grow_and_not_shrink() {
        let dir = tempfile::tempdir().unwrap();
        let document = |sha256: &str| DocumentFacts {
            sha256: sha256.to_owned(),
            builder: "extractive".to_owned(),
            address: None,
            bytes: 1,
            words: 1,
        };
        let with = |documents: &[(&str, &str)]| {
            let facts =
                documents.iter().map(|(name, sha256)| ((*name).to_owned(), document(sha256)));
            Manifest { documents: facts.collect(), ..manifest() }
        };
        let mut first = with(&[("summary/original", "aa")]);
        first.settings.limit = Some(10);
        let mut folder = RunFolder::open(dir.path(), first, false).unwrap().folder;
        add(&mut folder, "t01-01");
        drop(folder);

        let mut larger = with(&[("semantic/original", "bb")]);
        larger.settings.limit = Some(20);
        larger.settings.groups[0].runs = 3;
        let folder = RunFolder::open(dir.path(), larger, false).unwrap().folder;
        let names: Vec<&String> = folder.manifest().documents.keys().collect();
        assert_eq!(names, ["semantic/original", "summary/original"]);
        assert_eq!(folder.manifest().settings.limit, Some(20));
        drop(folder);

        let other = with(&[("summary/original", "cc")]);
        let error = RunFolder::open(dir.path(), other, false).unwrap_err().to_string();
        assert!(error.contains("document summary/original: \"aa\" there, \"cc\" now"), "{error}");

        let log = RunLog::read(dir.path()).unwrap();
        let key = log.episodes[0].key.clone();
        log.check_planned(&BTreeSet::from([key.clone(), "another".to_owned()])).unwrap();
        let error = log.check_planned(&BTreeSet::new()).unwrap_err().to_string();
        assert!(error.contains("1 finished episodes") && error.contains(&key), "{error}");
    }

    #[test]
    fn another_run_is_not_touched() {
        let dir = tempfile::tempdir().unwrap();
        let open = |manifest| RunFolder::open(dir.path(), manifest, false);
        let mut other = manifest();
        other.settings.seed = 9;
        drop(open(other).unwrap());
        let mut folder = open(manifest()).unwrap().folder;
        assert_eq!(folder.manifest().settings.seed, 1, "nothing had been finished with seed 9");
        add(&mut folder, "t01-01");
        drop(folder);
        let mut other = manifest();
        other.settings.seed = 8;
        other.settings.lanes += 1;
        other.settings.adapter = Some("processor".to_owned());
        other.hashes.insert("layout".into(), "ff".into());
        let error = open(other).unwrap_err().to_string();
        let error = error.replace(&dir.path().display().to_string(), "DIR");
        insta::assert_snapshot!(error, @r#"
        DIR holds a run with other settings:
          adapter: not set there, "processor" now
          contents of layout: "00" there, "ff" now
          seed: 1 there, 8 now
        Use the same settings to go on with it, --fresh to start over, or another --out
        "#);
    }

    #[test]
    fn a_folder_with_other_things_is_refused_and_one_in_use_too() {
        let dir = tempfile::tempdir().unwrap();
        let open = || RunFolder::open(dir.path(), manifest(), true);
        let held = open().unwrap();
        assert!(matches!(open(), Err(LogError::Locked { .. })));
        drop(held);
        fs::remove_file(dir.path().join(MANIFEST_FILE)).unwrap();
        assert!(matches!(open(), Err(LogError::NotARun { .. })));
        assert!(dir.path().join(EPISODES_FILE).exists());
        assert!(matches!(RunLog::read(dir.path()), Err(LogError::NoRun { .. })));
    }

    #[test]
    fn a_damaged_record_is_named_set_aside_and_its_episode_is_open_again() {
        let dir = tempfile::tempdir().unwrap();
        let open = || RunFolder::open(dir.path(), manifest(), false).unwrap();
        let mut folder = open().folder;
        ["t01-01", "t01-02", "t01-03"].iter().for_each(|case| add(&mut folder, case));
        drop(folder);
        let path = dir.path().join(EPISODES_FILE);
        let text = fs::read_to_string(&path).unwrap();
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        // One line edited, one torn, one twice.
        lines[0] = lines[0].replace("\"steps\":10", "\"steps\":931");
        lines[1].truncate(40);
        lines.push(lines[2].clone());
        fs::write(&path, lines.join("\n") + "\n").unwrap();

        let log = RunLog::read(dir.path()).unwrap();
        assert_eq!(keys(&log.episodes), [record("t01-03", true).key]);
        let shown: Vec<String> = log.damaged.iter().map(ToString::to_string).collect();
        insta::assert_snapshot!(shown.join("\n"), @r#"
        episodes.jsonl, line 1: "steps" is 931, and "actions" has 10
        episodes.jsonl, line 2: control character (\u0000-\u001F) found while parsing a string at line 2 column 0
        episodes.jsonl, line 4: episodic/original/unchanged/original/run1/t01-03 is there already
        "#);

        let Opened { mut folder, finished, notes, .. } = open();
        assert_eq!((keys(&finished), notes.len()), (vec![&*record("t01-03", true).key], 3));
        assert!(!folder.is_finished(&record("t01-01", true).key));
        ["t01-01", "t01-02"].iter().for_each(|case| add(&mut folder, case));
        drop(folder);
        let log = RunLog::read(dir.path()).unwrap();
        assert_eq!((log.episodes.len(), log.timings.len(), log.damaged.len()), (3, 3, 0));
        let aside = fs::read_to_string(damaged_file(&path)).unwrap();
        assert_eq!(aside.lines().count(), 3, "nothing is lost");
    }

    #[test]
    fn an_error_counts_until_the_episode_is_finished() {
        let dir = tempfile::tempdir().unwrap();
        let mut folder = RunFolder::open(dir.path(), manifest(), false).unwrap().folder;
        for case in ["t01-01", "t01-02"] {
            let (key, error) = (record(case, true).key, "overdue".to_owned());
            folder.give_up(&EpisodeError { key, session: 1, error }).unwrap();
        }
        add(&mut folder, "t01-02");
        let log = RunLog::read(dir.path()).unwrap();
        assert_eq!(
            log.errors.iter().map(|e| e.key.as_str()).collect::<Vec<_>>(),
            [record("t01-01", true).key]
        );
    }

    #[test]
    fn processes_that_changed_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let facts = |adapter: &str| {
            let facts = BTreeMap::from([("adapter".to_owned(), adapter.to_owned())]);
            BTreeMap::from([("sim".to_owned(), facts)])
        };
        let open = || RunFolder::open(dir.path(), manifest(), false).unwrap().folder;
        let mut first = open();
        assert!(first.introduce(facts("llvmpipe")).unwrap().is_empty());
        add(&mut first, "t01-01");
        drop(first);
        assert!(open().introduce(facts("llvmpipe")).unwrap().is_empty());
        assert_eq!(
            open().introduce(facts("other")).unwrap(),
            ["sim: adapter was llvmpipe when the run began, now other"]
        );
    }
}
