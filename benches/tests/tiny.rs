//! Runs every bench at its smallest size and without baselines, and checks that its figures have unique ids.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use benches::{BENCHES, BenchSession, Hardware, Size};

/// One at a time: benches start processes.
static MACHINE: Mutex<()> = Mutex::new(());

fn tiny(name: &str) {
    let _alone = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let programs = Path::new(env!("CARGO_BIN_EXE_memtransfer-bench")).parent().unwrap();
    let bench = BENCHES.iter().find(|bench| bench.name == name).unwrap();
    let mut session =
        BenchSession::new(bench.name, Size::Tiny, Hardware::CPU, 1, programs, None).unwrap();
    let figures = (bench.run)(&mut session).unwrap();
    assert!(!figures.is_empty(), "{name} returned no figure");
    let mut ids = BTreeSet::new();
    for figure in &figures {
        assert!(
            figure.id.starts_with(&format!("{name}.")),
            "{}: the id does not start with its bench",
            figure.id
        );
        assert!(ids.insert(&figure.id), "{}: twice", figure.id);
        assert!(!figure.ours.is_empty(), "{}: it has no value", figure.id);
        assert!(
            figure.ours.iter().all(|value| value.is_finite()),
            "{}: {:?}",
            figure.id,
            figure.ours
        );
    }
}

/// One test for each bench, and a test that the list is complete.
macro_rules! tests {
    ($($name:ident)*) => {
        $(#[test] fn $name() { tiny(stringify!($name)); })*

        #[test]
        fn every_bench_is_here() {
            let names: Vec<&str> = BENCHES.iter().map(|bench| bench.name).collect();
            assert_eq!(names, [$(stringify!($name)),*]);
        }
    };
}

tests! { hop chain render embed overlap search growth curves suite }
