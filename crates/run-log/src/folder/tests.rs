//! Runs that are written, killed, resumed, damaged and read.

use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::sync::Once;

use conditions::settings::Drawn;

use super::*;
use crate::manifest::MANIFEST_FILE;
use crate::records::{
    keyed, manifest, model_document, record, request, script_document, stream_record, timings,
};
use crate::{DocumentFacts, RunLog};

fn keys(records: &[EpisodeRecord]) -> Vec<&str> {
    records.iter().map(|record| record.key.as_str()).collect()
}

fn add(folder: &mut RunFolder, case: &str) {
    let record = record(case, true);
    folder.finish(&[(record.clone(), timings(&record))]).unwrap();
}

#[test]
fn a_run_continues_where_it_was_killed() {
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
    add(&mut folder, "t01-02");
    drop(folder);
    assert_eq!(fs::read(&path).unwrap(), text, "the log is as without the kill");

    let opened = open(true);
    assert!(opened.finished.is_empty());
    assert!(opened.notes[0].contains("(2 finished episodes)"), "{:?}", opened.notes);
}

/// A disk that cannot flush the episode logs in folders called `unflushable`, and takes half of a line in those called `full`.
struct FaultyDisk;

impl durable::Faults for FaultyDisk {
    fn fault(&self, operation: durable::Operation, path: &Path) -> Option<durable::Fault> {
        let folder = path.parent()?.file_name()?.to_str()?;
        let (written, kind) = match (operation, folder) {
            (durable::Operation::Sync, "unflushable") => (0, ErrorKind::Other),
            (durable::Operation::Write(bytes), "full") => (bytes / 2, ErrorKind::StorageFull),
            _ => return None,
        };
        let error = Box::new(move || kind.into());
        path.ends_with(EPISODES_FILE).then_some(durable::Fault::Fails { written, error })
    }
}

/// A run folder that is called `name`, on a faulty disk.
fn on_faulty_disk(dir: &Path, name: &str) -> RunFolder {
    static INJECT: Once = Once::new();
    INJECT.call_once(|| assert!(durable::inject(Box::new(FaultyDisk))));
    RunFolder::open(&dir.join(name), manifest(), false).unwrap().folder
}

#[test]
fn a_line_that_a_full_disk_cuts_off_is_removed_before_the_next_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let mut folder = on_faulty_disk(dir.path(), "full");
    let record = record("t01-01", true);
    let error = folder.finish(&[(record.clone(), timings(&record))]).unwrap_err().to_string();
    assert!(error.starts_with("cannot write to "), "{error}");
    assert_eq!(fs::read(dir.path().join("full").join(EPISODES_FILE)).unwrap(), b"");
}

#[test]
fn an_episode_that_a_memory_learned_from_is_on_the_disk_before_the_next_one_begins() {
    let dir = tempfile::tempdir().unwrap();
    let mut folder = on_faulty_disk(dir.path(), "unflushable");
    let mut finish = |case, snapshot| {
        let mut record = stream_record(case, true);
        record.stream.as_mut().unwrap().snapshot = snapshot;
        folder.finish(&[(record.clone(), timings(&record))])
    };
    finish("t01-01", None).unwrap();
    let error = finish("t01-02", Some("00".repeat(16))).unwrap_err().to_string();
    assert!(error.starts_with("cannot flush "), "the flush was awaited: {error}");
}

#[test]
fn requests_survive_a_kill_before_their_episode_is_finished() {
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
    // The episode runs again; the earlier requests stay recorded.
    (0..3).for_each(|step| folder.asked(&request("a", step)).unwrap());
    add(&mut folder, "t01-01");
    drop(folder);
    assert_eq!(RunLog::read(dir.path()).unwrap().requests.len(), 5);
}

#[test]
fn a_run_can_grow_but_not_shrink() {
    let dir = tempfile::tempdir().unwrap();
    let document = |sha256: &str| DocumentFacts { sha256: sha256.to_owned(), ..script_document() };
    let with = |documents: &[(&str, &str)]| {
        let facts = documents.iter().map(|(name, sha256)| ((*name).to_owned(), document(sha256)));
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
fn what_a_run_has_built_stays_its_own_when_it_is_resumed() {
    let dir = tempfile::tempdir().unwrap();
    let with = |name: &str, document| Manifest {
        documents: [(name.to_owned(), document)].into(),
        ..manifest()
    };
    let built = model_document("m");
    let first = with("summary/original", built.clone());
    drop(RunFolder::open(dir.path(), first, false).unwrap());
    let copy = DocumentFacts { built: false, ..built.clone() };
    let later = with("summary/original", copy.clone());
    let folder = RunFolder::open(dir.path(), later, false).unwrap().folder;
    assert_eq!(folder.manifest().documents["summary/original"], built);
    drop(folder);
    let grown = with("semantic/original", copy.clone());
    let folder = RunFolder::open(dir.path(), grown, false).unwrap().folder;
    assert_eq!(folder.manifest().documents["semantic/original"], copy);
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
    other.hashes.insert(crate::PROMPT_HASH.into(), "ee".into());
    let error = open(other).unwrap_err().to_string();
    let error = error.replace(&dir.path().display().to_string(), "DIR");
    insta::assert_snapshot!(error, @r#"
    DIR holds a run with other settings or code:
      adapter: not set there, "processor" now
      contents of layout: "00" there, "ff" now
      contents of prompt: not set there, "ee" now
      seed: 1 there, 8 now
    Use the same settings and code to continue it, remove it to start over (as `run --fresh` does), or choose another --out
    "#);
}

/// Programs of earlier versions drew plates for every policy, and the first of them did not say so.
#[test]
fn a_manifest_says_whether_there_were_plates_and_one_without_the_key_is_of_a_run_with_plates() {
    let dir = tempfile::tempdir().unwrap();
    let written = |plates| {
        let mut manifest = manifest();
        manifest.settings.plates = plates;
        manifest.write(dir.path()).unwrap();
        manifest
    };
    let path = dir.path().join(MANIFEST_FILE);
    let without = written(Drawn::Off);
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains("\"plates\": \"off\""), "{text}");
    assert_eq!(Manifest::read(dir.path()).unwrap(), without);

    let with = written(Drawn::On);
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replacen("    \"plates\": \"on\",\n", "", 1)).unwrap();
    assert!(!fs::read_to_string(&path).unwrap().contains("plates"));
    let earlier = Manifest::read(dir.path()).unwrap();
    assert_eq!(earlier, with);
    // It is neither continued without plates nor ranked beside runs without.
    assert_eq!(without.differences(&earlier)[0].to_string(), "plates: \"on\" there, \"off\" now");
    assert_ne!(without.protocol(), earlier.protocol());
    assert_eq!(with.protocol(), earlier.protocol());
}

#[test]
fn a_folder_that_is_in_use_or_holds_other_files_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let open = || RunFolder::open(dir.path(), manifest(), true);
    let held = open().unwrap();
    assert!(matches!(open(), Err(LogError::Locked(_))));
    drop(held);
    fs::remove_file(dir.path().join(MANIFEST_FILE)).unwrap();
    fs::remove_file(dir.path().join("run.lock")).unwrap();
    assert!(matches!(open(), Err(LogError::NotARun(_))));
    assert!(
        !dir.path().join("run.lock").exists(),
        "nothing is written into a folder of something else"
    );
    assert!(dir.path().join(EPISODES_FILE).exists());
    assert!(matches!(RunLog::read(dir.path()), Err(LogError::NoRun(_))));
}

#[test]
fn a_damaged_record_is_named_and_set_aside_and_its_episode_repeated() {
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
    episodes.jsonl, line 1: it was changed after it was written: its checksum does not fit
    episodes.jsonl, line 2: control character (\u0000-\u001F) found while parsing a string at line 2 column 0
    episodes.jsonl, line 4: episodic/original/unchanged/original/run1/t01-03 occurs twice
    "#);

    let Opened { mut folder, finished, notes, .. } = open();
    assert_eq!((keys(&finished), notes.len()), (vec![&*record("t01-03", true).key], 3));
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

#[test]
fn what_sessions_learn_of_a_server_is_kept_together() {
    let dir = tempfile::tempdir().unwrap();
    let session = |case: &str, learned: &[&str]| {
        let mut folder = RunFolder::open(dir.path(), manifest(), false).unwrap().folder;
        add(&mut folder, case);
        let mut changes = Vec::new();
        for value in learned {
            let facts = [("reasoning".to_owned(), (*value).to_owned())].into();
            changes.extend(folder.learn("policy", &facts).unwrap());
        }
        drop(folder);
        let manifest = RunLog::read(dir.path()).unwrap().manifest;
        (changes, manifest.processes["policy"]["reasoning"].clone())
    };
    assert_eq!(
        session("t01-01", &["off", "on"]),
        (Vec::new(), "on".to_owned()),
        "the latest of a session"
    );
    let (changes, kept) = session("t01-02", &["off"]);
    assert_eq!(changes, ["policy: reasoning was on in an earlier session, now off"]);
    assert_eq!(kept, "on; in a later session off");
    assert_eq!(session("t01-03", &["off"]), (Vec::new(), kept), "as the session before");
}

#[test]
fn an_external_memory_is_the_same_when_a_run_goes_on() {
    use domain::MemoryKind;

    use crate::ExternalMemoryFacts;
    use crate::records::external_memory as facts;

    let dir = tempfile::tempdir().unwrap();
    let with = |name: &str, facts: ExternalMemoryFacts| {
        let memories = BTreeMap::from([(name.parse().unwrap(), facts)]);
        RunFolder::open(dir.path(), Manifest { memories, ..manifest() }, false)
    };
    // Its log is older than the folder.
    fs::create_dir(dir.path().join(LOGS_FOLDER)).unwrap();
    fs::write(dir.path().join(LOGS_FOLDER).join("external-memory-0.log"), "x").unwrap();
    let mut folder = with("top-3", facts("1")).unwrap().folder;
    let memory = MemoryKind::External("top-3".parse().unwrap());
    let episode = keyed(EpisodeRecord { memory, ..record("t01-01", true) });
    folder.finish(&[(episode.clone(), timings(&episode))]).unwrap();
    drop(folder);
    let changed = with("top-3", facts("2")).unwrap_err().to_string();
    let lines: Vec<&str> = changed.lines().filter(|line| line.starts_with("  ")).collect();
    assert_eq!(lines, [r#"  version of memory top-3: "1" there, "2" now"#]);
    let with_code = |code: &str, hash: &str| ExternalMemoryFacts {
        code: code.to_owned(),
        files: [("mine.py".to_owned(), hash.to_owned())].into(),
        ..facts("1")
    };
    // Episodes of before are not known to have other code.
    drop(with("top-3", with_code("base.py=1", "a")).unwrap());
    let changed = with("top-3", with_code("base.py=2", "b")).unwrap_err().to_string();
    let lines: Vec<&str> = changed.lines().filter(|line| line.starts_with("  ")).collect();
    assert_eq!(
        lines,
        [
            r#"  code of memory top-3: "base.py=1" there, "base.py=2" now"#,
            r#"  file mine.py of memory top-3: "a" there, "b" now"#
        ]
    );
    assert!(changed.contains("Use the same settings and code"), "{changed}");
    let other = ExternalMemoryFacts { command: Some("python other.py".to_owned()), ..facts("1") };
    let changed = with("top-3", other).unwrap_err().to_string();
    assert!(changed.contains("command of memory top-3: "), "{changed}");
    // Started by the user, another index: the same memory. A second one may join.
    let moved = ExternalMemoryFacts { index: 3, command: None, ..facts("1") };
    assert_eq!(with("top-3", moved).unwrap().finished, [episode]);
    let opened = with("bm25", facts("1")).unwrap();
    assert_eq!(opened.folder.manifest().memories.len(), 2);
    drop(opened);
    // A record of a memory that the run never had is damaged.
    fs::remove_file(dir.path().join(MANIFEST_FILE)).unwrap();
    manifest().write(dir.path()).unwrap();
    let log = RunLog::read(dir.path()).unwrap();
    assert!(log.episodes.is_empty());
    assert!(log.damaged[0].to_string().ends_with("the run has no memory called top-3"));
    let opened = RunFolder::open(dir.path(), manifest(), true).unwrap();
    assert!(opened.finished.is_empty());
    let log = dir.path().join(LOGS_FOLDER).join("external-memory-0.log");
    assert!(log.exists());
    assert!(RunFolder::remove_memory_logs(dir.path()).is_err(), "it is open");
    drop(opened);
    RunFolder::remove_memory_logs(dir.path()).unwrap();
    assert!(!log.exists());
}

#[test]
fn nothing_is_removed_that_no_manifest_of_a_run_describes() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    for folder in ["documents", "report", "prompts", "snapshots"] {
        fs::create_dir(path(folder)).unwrap();
        fs::write(path(folder).join("mine.txt"), "mine").unwrap();
    }
    fs::write(path("status.json"), "mine").unwrap();
    let listed = || {
        let mut names: Vec<PathBuf> = Vec::new();
        let mut folders = vec![dir.path().to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                folders.extend(path.is_dir().then(|| path.clone()));
                names.push(path);
            }
        }
        names.sort();
        names
    };
    let manifest_of_a_run = serde_json::to_string(&manifest()).unwrap();
    for foreign in [
        r#"{"name": "My pages"}"#.to_owned(),
        "{".to_owned(),
        String::new(),
        // Of a version that this program does not know, and a damaged one.
        manifest_of_a_run.replacen("\"format\":4", "\"format\":99", 1),
        manifest_of_a_run.replacen("\"settings\"", "\"setting\"", 1),
    ] {
        fs::write(path(MANIFEST_FILE), &foreign).unwrap();
        let before = listed();
        for fresh in [false, true] {
            let error = RunFolder::open(dir.path(), manifest(), fresh).unwrap_err();
            let is_refused =
                matches!(error, LogError::BrokenManifest { .. } | LogError::OtherFormat { .. });
            assert!(is_refused, "{error}");
            assert!(error.to_string().contains("iles beside it are untouched"), "{error}");
        }
        assert!(RunFolder::remove_memory_logs(dir.path()).is_ok(), "there are none");
        assert_eq!(listed(), before);
        assert_eq!(fs::read_to_string(path(MANIFEST_FILE)).unwrap(), foreign);
    }
    assert_eq!(fs::read_to_string(path("status.json")).unwrap(), "mine");
}

#[test]
fn only_fresh_removes_a_run_and_it_says_what() {
    let dir = tempfile::tempdir().unwrap();
    let open = |manifest, fresh| RunFolder::open(dir.path(), manifest, fresh);
    let mut folder = open(manifest(), false).unwrap().folder;
    let key = record("t01-01", true).key;
    folder.give_up(&EpisodeError { key, session: 1, error: "overdue".to_owned() }).unwrap();
    drop(folder);
    fs::create_dir(dir.path().join("documents")).unwrap();
    fs::write(dir.path().join("notes.txt"), "mine").unwrap();
    // Without an episode, it still has errors.
    let opened = open(manifest(), false).unwrap();
    assert!(opened.notes.is_empty());
    drop(opened);
    assert_eq!(RunLog::read(dir.path()).unwrap().errors.len(), 1);
    let mut other = manifest();
    other.settings.seed = 9;
    assert!(matches!(open(other.clone(), false), Err(LogError::OtherSettings { .. })));
    assert_eq!(RunLog::read(dir.path()).unwrap().errors.len(), 1);

    let notes = open(other, true).unwrap().notes;
    let note = notes[0].replace(&dir.path().display().to_string(), "DIR");
    insta::assert_snapshot!(note, @"--fresh: removed the earlier run in DIR (0 finished episodes): documents, episodes.jsonl, errors.jsonl, latency.jsonl, logs, manifest.json, requests.jsonl, sessions.jsonl, timings.jsonl; left what a run does not write: notes.txt");
    assert_eq!(fs::read_to_string(dir.path().join("notes.txt")).unwrap(), "mine");
}

#[test]
fn a_folder_with_logs_of_something_else_is_no_run() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    fs::create_dir(path("logs")).unwrap();
    RunFolder::check(dir.path()).unwrap();
    // An external memory starts before the run.
    fs::write(path("logs/external-memory-0.log"), "x").unwrap();
    RunFolder::check(dir.path()).unwrap();
    fs::write(path("logs/access.log"), "x").unwrap();
    for fresh in [false, true] {
        let error = RunFolder::open(dir.path(), manifest(), fresh).unwrap_err();
        assert!(matches!(error, LogError::NotARun(_)), "{error}");
    }
    assert!(RunFolder::check(dir.path()).is_err());
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn an_episode_that_is_finished_is_not_logged_again() {
    let dir = tempfile::tempdir().unwrap();
    let mut folder = RunFolder::open(dir.path(), manifest(), false).unwrap().folder;
    add(&mut folder, "t01-01");
    let record = record("t01-01", false);
    let error = folder.finish(&[(record.clone(), timings(&record))]).unwrap_err();
    assert!(matches!(&error, LogError::Twice(key) if *key == record.key), "{error}");
    assert_eq!(RunLog::read(dir.path()).unwrap().episodes.len(), 1);
}

#[test]
fn fresh_leaves_files_of_the_user_in_every_folder_of_a_run() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    drop(RunFolder::open(dir.path(), manifest(), false).unwrap());
    let hash = "0123456789abcdef".repeat(2);
    let written = [
        "logs/sim.log",
        "logs/memory.log",
        "logs/policy.log",
        "logs/policy.log.new",
        "report/report.html",
        "report/figures/main-figure.svg",
        "report/tables/run2-stream-cost.csv",
        "report.memtransfer-draft/figures/half",
        "documents/summary-4.json",
        "documents/semantic-bank-16.json.new",
        "prompts/session-1/generation-2.jsonl",
        &format!("prompts/images/{hash}.png"),
        &format!("prompts/documents/{hash}.new-17"),
        &format!("snapshots/0123456789abcdef/{hash}/memory/store"),
        "snapshots/0123456789abcdef/unfinished/list",
        "status.json.new",
    ];
    let mine = [
        "documents/summary of mine.json",
        "logs/external-memory-notes.txt",
        "logs/notes.txt",
        "notes.txt",
        "prompts/documents/mine.txt",
        "prompts/images/mine.png",
        "prompts/mine.txt",
        "prompts/session-1/mine.txt",
        "report/figures/mine.svg",
        "report/notes.txt",
        "report/tables/mine.csv",
        "snapshots/0123456789abcdef/mine.txt",
        "snapshots/mine.txt",
    ];
    let write = |names: &[&str]| {
        for name in names {
            fs::create_dir_all(path(name).parent().unwrap()).unwrap();
            fs::write(path(name), "x").unwrap();
        }
    };
    let fresh = || RunFolder::open(dir.path(), manifest(), true).unwrap().notes.remove(0);
    write(&written);
    write(&mine);
    let external = "logs/external-memory-0.log";
    write(&[external]);
    let note = fresh();
    let left = format!("; left what a run does not write: {}", mine.join(", "));
    assert!(note.ends_with(&left), "{note}");
    for name in mine.into_iter().chain([external]) {
        assert!(path(name).exists(), "{name}");
    }
    for name in written {
        assert!(!path(name).exists(), "{name}");
    }
    for name in mine {
        fs::remove_file(path(name)).unwrap();
    }
    write(&written);
    assert!(!fresh().contains("left"));
    for folder in ["report", "documents", "prompts", "snapshots", "report.memtransfer-draft"] {
        assert!(!path(folder).exists(), "{folder}");
    }
    // Of many, some are named.
    let many: Vec<String> = (0..30).map(|index| format!("mine-{index:02}")).collect();
    write(&many.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(fresh().ends_with(", mine-18, mine-19, and 10 more"));
}

#[test]
fn a_run_is_not_written_or_read_through_links() {
    use std::os::unix::fs::symlink;

    let dir = tempfile::tempdir().unwrap();
    let (run, mine) = (dir.path().join("run"), dir.path().join("mine"));
    let mut folder = RunFolder::open(&run, manifest(), false).unwrap().folder;
    add(&mut folder, "t01-01");
    drop(folder);
    fs::create_dir(&mine).unwrap();
    fs::write(mine.join("file"), "").unwrap();
    fs::create_dir(run.join("prompts")).unwrap();
    for (link, to) in [
        ("timings.jsonl", "file"),
        ("manifest.json.new", "file"),
        ("status.json", "file"),
        ("logs", "."),
        ("prompts/images", "."),
    ] {
        let (link, kept) = (run.join(link), run.join("kept"));
        let was_there = fs::rename(&link, &kept).is_ok();
        symlink(mine.join(to), &link).unwrap();
        for fresh in [false, true] {
            let error = RunFolder::open(&run, manifest(), fresh).unwrap_err().to_string();
            assert!(error.contains("it is a symbolic link"), "{}: {error}", link.display());
        }
        fs::remove_file(&link).unwrap();
        if was_there {
            fs::rename(&kept, &link).unwrap();
        }
    }
    assert_eq!(fs::read(mine.join("file")).unwrap(), b"");
    assert_eq!(fs::read_dir(&mine).unwrap().count(), 1);

    for file in [MANIFEST_FILE, EPISODES_FILE] {
        let (kept, path) = (mine.join(file), run.join(file));
        fs::rename(&path, &kept).unwrap();
        symlink(&kept, &path).unwrap();
        let error = RunLog::read(&run).unwrap_err().to_string();
        assert!(error.contains("it is a symbolic link"), "{error}");
        fs::rename(&kept, &path).unwrap();
    }
    assert_eq!(RunLog::read(&run).unwrap().episodes.len(), 1);
}
