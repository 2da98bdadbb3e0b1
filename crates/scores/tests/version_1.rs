//! A run that version 1 recorded (the scripted stand-in on part of the suite rq2), rewritten in the format of today, opens, and its
//! scores are those that version 1 computed, to the last digit.

use std::path::Path;

use run_log::{LogError, RunFolder, RunLog};
use scores::score;
use serde_json::Value;

fn folder() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/rq2-version-1"))
}

/// Removes what changed on purpose: the intervals, the counts of episodes that were given up, and the policy's label.
fn without_intervals(value: &mut Value) {
    match value {
        Value::Object(map) => {
            ["interval", "errored", "planned", "bounds", "policy"].iter().for_each(|key| {
                map.remove(*key);
            });
            map.values_mut().for_each(without_intervals);
        }
        Value::Array(list) => list.iter_mut().for_each(without_intervals),
        _ => {}
    }
}

#[test]
fn scores_equal_those_of_version_1() {
    let log = RunLog::read(folder()).unwrap();
    assert_eq!((log.damaged.len(), log.episodes.len()), (0, log.manifest.episodes as usize));
    let text = std::fs::read_to_string(folder().join("scores.json")).unwrap();
    let mut expected: Value = serde_json::from_str(&text).unwrap();
    let mut found = serde_json::to_value(score(&log)).unwrap();
    without_intervals(&mut expected);
    without_intervals(&mut found);
    assert_eq!(found, expected);
}

#[test]
fn the_run_can_be_resumed_and_another_format_is_refused_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    for name in
        ["manifest.json", "case-book.json", "episodes.jsonl", "timings.jsonl", "sessions.jsonl"]
    {
        std::fs::copy(folder().join(name), dir.path().join(name)).unwrap();
    }
    let manifest = RunLog::read(dir.path()).unwrap().manifest;
    let planned = manifest.episodes as usize;
    let opened = RunFolder::open(dir.path(), manifest, false).unwrap();
    assert_eq!((opened.finished.len(), opened.notes.len()), (planned, 0));
    drop(opened);

    let path = dir.path().join("manifest.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("\"format\": 4", "\"format\": 3")).unwrap();
    let error = RunLog::read(dir.path()).unwrap_err();
    assert!(matches!(error, LogError::OtherFormat { .. }));
    let shown = error.to_string().replace(&dir.path().display().to_string(), "RUN");
    insta::assert_snapshot!(shown, @"RUN/manifest.json: the run has format 3, and this program reads format 4: memtransfer 0.1.0 (commit dbc81347328c7991e08e864d21b4c8e133d6ac7d) wrote it and can read it. The files beside it are untouched; to run, choose another --out");
}
