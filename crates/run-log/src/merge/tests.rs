use std::path::Path;

use super::*;
use crate::records::{manifest, record, timings, without_checksums};
use crate::{Opened, RunFolder, RunLog, SessionEvent, UnitId};

/// A line of a journal, as it is written.
fn line(entry: &impl serde::Serialize) -> String {
    String::from_utf8(sealed::line(entry).unwrap()).unwrap()
}

const PLAN: &str = "ab";

/// A finished unit in `dir`, with successful episodes of these cases, on this processor.
fn write_unit(dir: &Path, number: u32, cases: &[String], processor: &str) {
    let part = dir.join(format!("{number}.part"));
    let unit = Some(UnitId { plan: PLAN.to_owned(), number });
    let opened = RunFolder::open(&part, Manifest { unit, ..manifest() }, false).unwrap();
    let Opened { mut folder, .. } = opened;
    let facts = |name: &str, value: &str| BTreeMap::from([(name.to_owned(), value.to_owned())]);
    let processes = BTreeMap::from([
        ("memory".to_owned(), facts("encoder_sha256", "12")),
        ("machine".to_owned(), facts("processor", processor)),
    ]);
    folder.introduce(processes).unwrap();
    for case in cases {
        let record = record(case, true);
        let timings = timings(&record);
        folder.finish(&[(record, timings)]).unwrap();
    }
    let shutdown_reports = BTreeMap::new();
    let reason = "complete".to_owned();
    folder.note(SessionEvent::Ended { finished: 1, errors: 0, reason, shutdown_reports }).unwrap();
    drop(folder);
    finish_unit(&part, &dir.join(unit_folder(number))).unwrap();
}

/// Cases by unit, in the order of the plan.
fn cases(units: u32, size: u32) -> Vec<Vec<String>> {
    (0..units)
        .map(|unit| (0..size).map(|case| format!("t01-{:08}", unit * size + case)).collect())
        .collect()
}

fn planned(cases: &[Vec<String>]) -> impl Iterator<Item = UnitEpisode> {
    (0..).zip(cases).flat_map(|(unit, cases)| {
        cases.iter().map(move |case| planned_episode(record(case, true), unit))
    })
}

fn planned_episode(record: EpisodeRecord, unit: u32) -> UnitEpisode {
    UnitEpisode { facts: PlannedFacts::of(&record), key: record.key, unit }
}

#[test]
fn units_in_several_folders_become_one_run_in_the_order_of_the_plan() {
    let dir = tempfile::tempdir().unwrap();
    let (one, two) = (dir.path().join("one"), dir.path().join("two"));
    let cases = cases(3, 2);
    write_unit(&one, 2, &[cases[2][1].clone(), cases[2][0].clone()], "a");
    write_unit(&two, 0, &cases[0], "b");
    let units = UnitFolders(vec![one.clone(), two]);
    assert_eq!(units.missing(3), [1]);
    write_unit(&one, 1, &cases[1], "a");
    // The same again is harmless.
    write_unit(&one, 1, &cases[1], "a");
    assert!(units.missing(3).is_empty());

    let mut whole = manifest();
    let differences = units.check(3, PLAN, &mut whole).unwrap();
    let shown = differences.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
    let shown = shown.replace(&*dir.path().to_string_lossy(), "");
    insta::assert_snapshot!(shown, @"
    machine, processor:
      b in /two/unit-000000
      a in /one/unit-000001
    ");
    assert_eq!(whole.processes["machine"]["processor"], "b");

    let out = dir.path().join("run");
    assert_eq!(merge(&whole, &units, planned(&cases), &out).unwrap(), 6);
    let expected: String = cases.concat().iter().map(|case| line(&record(case, true))).collect();
    assert_eq!(fs::read_to_string(out.join(EPISODES_FILE)).unwrap(), expected);
    let log = RunLog::read(&out).unwrap();
    assert_eq!((log.episodes.len(), log.timings.len(), log.damaged.len()), (6, 6, 0));
    let sessions: Vec<u32> = log.timings.iter().map(|timings| timings.session).collect();
    assert_eq!(sessions, [1, 1, 2, 2, 3, 3]);
    assert_eq!(log.sessions.len(), 3);
    assert!(matches!(merge(&whole, &units, planned(&cases), &out), Err(MergeError::NotEmpty(_))));
}

#[test]
fn what_disagrees_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let (one, two, out) = (dir.path().join("one"), dir.path().join("two"), dir.path().join("run"));
    let cases = cases(1, 2);
    write_unit(&one, 0, &cases[0], "a");
    write_unit(&two, 0, &cases[0], "a");
    let units = UnitFolders(vec![one, two.clone()]);
    let shown = |error: MergeError| error.to_string().replace(&*dir.path().to_string_lossy(), "");
    let refused = || shown(merge(&manifest(), &units, planned(&cases), &out).unwrap_err());

    let log = two.join("unit-000000").join(EPISODES_FILE);
    let text = fs::read_to_string(&log).unwrap();
    let old = without_checksums(&text);
    fs::write(&log, old.replacen("\"images\":140", "\"images\":141", 1)).unwrap();
    insta::assert_snapshot!(refused(), @"/one/unit-000000 and /two/unit-000000 disagree about episodic/original/unchanged/original/run1/t01-00000000: find out which machine is wrong, and remove its folder of the unit");
    fs::write(&log, &text[..text.len() - 1]).unwrap();
    insta::assert_snapshot!(refused(), @"/two/unit-000000: episodes.jsonl, line 2: the line is torn; remove this folder and execute the unit again");
    fs::write(&log, &text).unwrap();
    let more = [cases[0].clone(), vec!["t01-9".to_owned()]].concat();
    let error = merge(&manifest(), &units, planned(&[more]), &out).unwrap_err();
    insta::assert_snapshot!(shown(error), @"/one/unit-000000: its log lacks episodic/original/unchanged/original/run1/t01-9; remove this folder and execute the unit again");
    let error = merge(&manifest(), &units, planned(&[cases[0][..1].to_vec()]), &out).unwrap_err();
    insta::assert_snapshot!(shown(error), @"/one/unit-000000: the unit has no episode episodic/original/unchanged/original/run1/t01-00000001 in the plan, and one in its log; remove this folder and execute the unit again");

    let sessions = units.0[0].join("unit-000000").join(SESSIONS_FILE);
    let kept = fs::read(&sessions).unwrap();
    fs::remove_file(&sessions).unwrap();
    insta::assert_snapshot!(refused(), @"/one/unit-000000: sessions.jsonl names no session; remove this folder and execute the unit again");
    fs::write(&sessions, kept).unwrap();
    let asked = "\"prompt_tokens\":7,\"world\"";
    for folder in &units.0 {
        let log = folder.join("unit-000000").join(EPISODES_FILE);
        fs::write(log, old.replacen("\"world\"", asked, 1)).unwrap();
    }
    insta::assert_snapshot!(refused(), @"/one/unit-000000: requests.jsonl lacks 10 requests of episodic/original/unchanged/original/run1/t01-00000000; remove this folder and execute the unit again");
    for folder in &units.0 {
        fs::write(folder.join("unit-000000").join(EPISODES_FILE), &text).unwrap();
    }

    let draft = dir.path().join("run.merging");
    assert!(!draft.exists(), "a merge that failed leaves nothing behind");
    fs::create_dir_all(draft.join("documents")).unwrap();
    fs::write(draft.join("documents/thesis.txt"), "years").unwrap();
    insta::assert_snapshot!(refused(), @"/run.merging is not empty: choose another --out, or remove it");
    fs::remove_dir_all(&draft).unwrap();
    // Nor is anything written through a link.
    let elsewhere = dir.path().join("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    std::os::unix::fs::symlink(&elsewhere, &draft).unwrap();
    insta::assert_snapshot!(refused(), @"/run.merging is not empty: choose another --out, or remove it");
    fs::remove_file(&draft).unwrap();

    insta::assert_snapshot!(shown(units.check(1, "cd", &mut manifest()).unwrap_err()), @"/one/unit-000000 is not unit 0 of this plan: it is unit 0 of the plan ab. Give the plan with which it was executed, unchanged, or remove this folder and execute the unit again");
    let unit = units.0[0].join("unit-000000").join("manifest.json");
    let kept = fs::read(&unit).unwrap();
    fs::write(&unit, "{}").unwrap();
    insta::assert_snapshot!(shown(units.check(1, PLAN, &mut manifest()).unwrap_err()), @"/one/unit-000000: manifest.json: it is not the manifest of a run: it has no format; remove this folder and execute the unit again");
    fs::write(&unit, kept).unwrap();
    let mut other = manifest();
    other.hashes.insert("layout".to_owned(), "11".to_owned());
    insta::assert_snapshot!(shown(units.check(1, PLAN, &mut other).unwrap_err()), @r#"/one/unit-000000 is not unit 0 of this plan: contents of layout: "11" there, "00" now. Give the plan with which it was executed, unchanged, or remove this folder and execute the unit again"#);
    assert_eq!(merge(&manifest(), &units, planned(&cases), &out).unwrap(), 2, "after all that");
}

#[test]
fn a_record_that_is_not_of_the_plan_and_changed_line_ends_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (units, out) = (UnitFolders(vec![dir.path().join("units")]), dir.path().join("run"));
    let cases = cases(1, 1);
    write_unit(&units.0[0], 0, &cases[0], "a");
    let log = units.0[0].join("unit-000000").join(EPISODES_FILE);
    let text = fs::read_to_string(&log).unwrap();
    let old = without_checksums(&text);
    let seed = record(&cases[0][0], true).seed;
    let refused = |from: &str, to: &str| {
        assert!(old.contains(from), "{from}");
        fs::write(&log, old.replacen(from, to, 1)).unwrap();
        let error = merge(&manifest(), &units, planned(&cases), &out).unwrap_err().to_string();
        error.replace(&*dir.path().to_string_lossy(), "")
    };
    insta::assert_snapshot!(refused("\"task\":1", "\"task\":2"), @r#"/units/unit-000000: "task" of episodic/original/unchanged/original/run1/t01-00000000 is 2, and 1 in the plan; remove this folder and execute the unit again"#);
    insta::assert_snapshot!(refused(&format!("\"seed\":{seed}"), "\"seed\":6"), @r#"/units/unit-000000: "seed" of episodic/original/unchanged/original/run1/t01-00000000 is 6, and 8985188509719532159 in the plan; remove this folder and execute the unit again"#);
    insta::assert_snapshot!(refused("\"reference\":8", "\"reference\":80"), @r#"/units/unit-000000: "reference" of episodic/original/unchanged/original/run1/t01-00000000 is 80, and 8 in the plan; remove this folder and execute the unit again"#);
    insta::assert_snapshot!(refused("\n", "\r\n"), @"/units/unit-000000: episodes.jsonl, line 1: white space around the record, such as the line ends of Windows; remove this folder and execute the unit again");
    insta::assert_snapshot!(refused("{", " {"), @"/units/unit-000000: episodes.jsonl, line 1: white space around the record, such as the line ends of Windows; remove this folder and execute the unit again");
    fs::write(&log, text.replacen("\"images\":140", "\"images\":141", 1)).unwrap();
    let error = merge(&manifest(), &units, planned(&cases), &out).unwrap_err().to_string();
    assert!(
        error.contains("episodes.jsonl, line 1: it was changed after it was written"),
        "{error}"
    );
    fs::write(&log, text).unwrap();
    assert_eq!(merge(&manifest(), &units, planned(&cases), &out).unwrap(), 1);
}

#[test]
fn prompts_are_merged_with_what_they_name_whatever_the_sessions_are_numbered() {
    let dir = tempfile::tempdir().unwrap();
    let (units, cases) = (UnitFolders(vec![dir.path().join("units")]), cases(2, 1));
    for (number, (cases, session)) in (0..).zip(cases.iter().zip([1, u32::MAX])) {
        write_unit(&units.0[0], number, cases, "a");
        let unit = units.0[0].join(unit_folder(number));
        let prompts = unit.join(PROMPTS_FOLDER);
        let hash = format!("{number:032}");
        for (folder, file) in [
            (format!("session-{session}"), "generation-1.jsonl".to_owned()),
            ("images".to_owned(), format!("{hash}.png")),
            ("documents".to_owned(), format!("{hash}.txt")),
        ] {
            fs::create_dir_all(prompts.join(&folder)).unwrap();
            fs::write(prompts.join(folder).join(file), "x").unwrap();
        }
        let sessions = unit.join(SESSIONS_FILE);
        let text = without_checksums(&fs::read_to_string(&sessions).unwrap());
        let renumbered = text.replace("\"session\":1", &format!("\"session\":{session}"));
        fs::write(&sessions, renumbered).unwrap();
    }
    let out = dir.path().join("run");
    // A unit may come from elsewhere.
    let (secret, link) =
        (dir.path().join("secret"), units.0[0].join("unit-000001/prompts/images/x"));
    fs::write(&secret, "secret").unwrap();
    std::os::unix::fs::symlink(&secret, &link).unwrap();
    let error = merge(&manifest(), &units, planned(&cases), &out).unwrap_err().to_string();
    assert!(error.contains("it is a symbolic link"), "{error}");
    fs::remove_file(&link).unwrap();
    merge(&manifest(), &units, planned(&cases), &out).unwrap();
    let prompts = out.join(PROMPTS_FOLDER);
    for file in ["session-1/generation-1.jsonl", "session-4294967295/generation-1.jsonl"] {
        assert!(prompts.join(file).exists(), "{file}");
    }
    for number in 0..2 {
        assert!(prompts.join(format!("images/{number:032}.png")).exists());
        assert!(prompts.join(format!("documents/{number:032}.txt")).exists());
    }
}

/// Prints time and memory of a merge of as many records as `MEMTRANSFER_TEST_RECORDS` says, in units of 100.
#[test]
#[ignore = "a measurement: cargo test --release -p run-log --lib merge_in_constant_memory -- --ignored --nocapture"]
fn merge_in_constant_memory() {
    let records = std::env::var("MEMTRANSFER_TEST_RECORDS");
    let records: u32 = records.map_or(1_000_000, |text| text.parse().unwrap());
    let dir = tempfile::tempdir_in(std::env::var("MEMTRANSFER_TEST_DIR").unwrap()).unwrap();
    let units = UnitFolders(vec![dir.path().join("units")]);
    let case = |number: u32| format!("t01-{number:08}");
    let count = records / 100;
    let text = |values: &mut dyn Iterator<Item = Vec<u8>>| {
        values.fold(Vec::new(), |mut all, one| {
            all.extend(one);
            all.push(b'\n');
            all
        })
    };
    for number in 0..count {
        let unit = units.0[0].join(unit_folder(number));
        fs::create_dir_all(&unit).unwrap();
        let id = UnitId { plan: PLAN.to_owned(), number };
        let manifest = Manifest { unit: Some(id), ..manifest() };
        fs::write(unit.join("manifest.json"), serde_json::to_vec(&manifest).unwrap()).unwrap();
        let cases = (number * 100..(number + 1) * 100).map(|number| record(&case(number), true));
        let records: Vec<EpisodeRecord> = cases.collect();
        let mut lines = records.iter().map(|record| serde_json::to_vec(record).unwrap());
        fs::write(unit.join(EPISODES_FILE), text(&mut lines)).unwrap();
        let mut lines = records.iter().map(|record| serde_json::to_vec(&timings(record)).unwrap());
        fs::write(unit.join(TIMINGS_FILE), text(&mut lines)).unwrap();
        let event = SessionEvent::Failed { generation: 1, reason: String::new() };
        let session = SessionRecord { session: 1, unix_s: 0, event };
        fs::write(unit.join(SESSIONS_FILE), serde_json::to_vec(&session).unwrap()).unwrap();
    }
    let peak = || {
        let status = fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap().to_owned();
        line.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let (before, start) = (peak(), std::time::Instant::now());
    assert!(units.missing(count).is_empty());
    let mut whole = manifest();
    units.check(count, PLAN, &mut whole).unwrap();
    let planned =
        (0..records).map(|number| planned_episode(record(&case(number), true), number / 100));
    let merged = merge(&whole, &units, planned, &dir.path().join("run")).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    println!("{merged} records in {seconds:.1} s; before {before}, after {}", peak());
}
