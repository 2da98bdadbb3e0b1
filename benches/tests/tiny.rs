//! Runs every bench at its smallest size and without baselines, and checks that its measurements have unique ids.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use benches::{BENCHES, BenchSession, Size};

/// One at a time: benches start processes.
static MACHINE: Mutex<()> = Mutex::new(());

fn tiny(name: &str) {
    let _alone = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let programs = Path::new(env!("CARGO_BIN_EXE_memtransfer-bench")).parent().unwrap();
    let bench = BENCHES.iter().find(|bench| bench.name == name).unwrap();
    let session = BenchSession::new(bench.name, Size::Tiny, programs).unwrap();
    let measurements = (bench.run)(&session).unwrap();
    assert!(!measurements.is_empty(), "{name} measured nothing");
    let mut ids = BTreeSet::new();
    for measurement in &measurements {
        let (id, ours) = (&measurement.id, &measurement.ours);
        assert!(id.starts_with(&format!("{name}.")), "{id} does not start with its bench");
        assert!(ids.insert(id), "{id}: twice");
        assert!(!ours.is_empty() && ours.iter().all(|value| value.is_finite()), "{id}: {ours:?}");
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

tests! { hop chain render embed search suite }
