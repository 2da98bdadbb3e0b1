//! Every target on its corpus: inputs that were interesting, and all that ever failed.

use std::fs;
use std::path::{Path, PathBuf};

use memtransfer_fuzz::{TARGETS, run};

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

#[test]
fn every_target_holds_for_its_corpus_and_for_parts_of_it() {
    for target in TARGETS {
        run(target, b"");
        let entries = fs::read_dir(corpus().join(target.0)).unwrap();
        let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        files.sort();
        assert!(!files.is_empty(), "{} has no corpus", target.0);
        for file in files {
            eprintln!("{}", file.display());
            let input = fs::read(&file).unwrap();
            run(target, &input);
            for part in 1..8 {
                run(target, &input[..input.len() * part / 8]);
            }
        }
    }
}

#[test]
fn every_corpus_belongs_to_a_target_and_is_small() {
    for entry in fs::read_dir(corpus()).unwrap() {
        let folder = entry.unwrap().path();
        let name = folder.file_name().unwrap().to_str().unwrap().to_owned();
        assert!(TARGETS.iter().any(|target| target.0 == name), "{name}");
        let files = fs::read_dir(&folder).unwrap().map(|file| file.unwrap().metadata().unwrap());
        let bytes: u64 = files.map(|file| file.len()).sum();
        assert!(bytes <= 64 << 10, "{name} has {bytes} bytes: cut its files down");
    }
}
