//! One character of a log is damaged, anywhere: no reader takes it for another result.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rigs::records::{manifest, record, request, stream_record, timings, without_checksums};
use run_log::{EPISODES_FILE, RunFolder, RunLog};
use scores::score;

/// What a log says: its figures, and everything that they are computed from.
fn contents(log: &RunLog) -> serde_json::Result<String> {
    let scores = serde_json::to_string(&score(log))?;
    let rest = (&log.episodes, &log.timings, &log.requests, &log.errors);
    Ok(scores + &serde_json::to_string(&rest)?)
}

#[test]
fn no_damaged_character_is_silent_and_changes_a_figure() {
    let dir = tempfile::tempdir().unwrap();
    let mut folder = RunFolder::open(dir.path(), manifest(), false).unwrap().folder;
    for number in 1..=6 {
        let record = record(&format!("t01-0{number}"), number % 2 == 0);
        for step in 0..2 {
            folder.asked(&request(&record.key, step)).unwrap();
        }
        let timings = timings(&record);
        folder.finish(&[(record, timings)]).unwrap();
    }
    drop(folder);
    let sound = RunLog::read(dir.path()).unwrap();
    assert_eq!((sound.episodes.len(), sound.damaged.len()), (6, 0));
    let expected = contents(&sound).unwrap();

    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (file, count) in [(EPISODES_FILE, 600), ("timings.jsonl", 200), ("requests.jsonl", 200)] {
        let path = dir.path().join(file);
        let text = std::fs::read(&path).unwrap();
        let (mut reported, mut without_effect) = (0, 0);
        for _ in 0..count {
            let mut damaged = text.clone();
            let place = rng.next_u32() as usize % damaged.len();
            // Most often a digit or a letter, which leaves it JSON.
            let character = match rng.next_u32() % 3 {
                0 => b'0' + (rng.next_u32() % 10) as u8,
                1 => b'a' + (rng.next_u32() % 26) as u8,
                _ => rng.next_u32() as u8,
            };
            if std::mem::replace(&mut damaged[place], character) == character {
                without_effect += 1;
                continue;
            }
            std::fs::write(&path, &damaged).unwrap();
            let log = RunLog::read(dir.path()).unwrap();
            match log.damaged.is_empty() {
                false => reported += 1,
                true => {
                    without_effect += 1;
                    let line = String::from_utf8_lossy(&damaged);
                    assert_eq!(contents(&log).unwrap(), expected, "{file}, byte {place}: {line}");
                }
            }
        }
        assert!(reported > 9 * without_effect, "{file}: {reported} reported");
        std::fs::write(&path, text).unwrap();
    }
}

#[test]
fn an_edit_of_what_follows_from_the_run_is_reported_without_a_checksum_too() {
    let dir = tempfile::tempdir().unwrap();
    let mut folder = RunFolder::open(dir.path(), manifest(), false).unwrap().folder;
    for record in [record("t01-01", true), stream_record("t01-02", true)] {
        let timings = timings(&record);
        folder.finish(&[(record, timings)]).unwrap();
    }
    drop(folder);
    let path = dir.path().join(EPISODES_FILE);
    let text = without_checksums(&std::fs::read_to_string(&path).unwrap());
    let damaged = |text: &str| {
        std::fs::write(&path, text).unwrap();
        RunLog::read(dir.path()).unwrap().damaged.len()
    };
    assert_eq!(damaged(&text), 0, "as earlier versions wrote it");
    assert_eq!(damaged(&text.replacen("\"seed\":", "\"seed\":1", 1)), 1);
    // The task and the reference follow from the cases: see `run_log::known`.
}
