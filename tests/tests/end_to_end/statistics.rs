//! The figures of `memtransfer score` against an implementation of the specification in Python with SciPy.

use std::process::Command;

use memtransfer_tests::{Bench, Ended, needs, program, repository};

#[test]
fn scores_and_comparisons_are_those_of_an_independent_implementation() {
    let bench = Bench::new();
    let mut python = Command::new(needs::python());
    python.arg(repository("tests/python/compare_scores.py"));
    python.arg(program("memtransfer"));
    python.arg(repository("crates/scores/tests/rq2-version-1/manifest.json"));
    python.arg(bench.out("drawn"));
    let ended = Ended::run(&mut python).expect(0);
    let conclusions = "200 conclusions agree, 20 of them about more cases\n";
    assert_eq!(
        ended.stdout,
        format!("200 comparisons agree\n{conclusions}20 blocked conditions agree\n")
    );
}
