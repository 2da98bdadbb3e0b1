//! `test`: sets up and builds at the same time, runs every test, and prints a line of totals.
//!
//! Cargo runs test binaries one after another.

use std::io::{BufRead, BufReader, Write};
use std::num::NonZero;
use std::process::Stdio;
use std::thread;

use anyhow::Context;

use crate::cache::Cache;
use crate::pins::{Pins, Purpose};
use crate::setup;
use crate::workspace::{Workspace, succeeds};

/// What cargo tests: everything. That benches run is tested, not how fast they are.
const TESTS: [&str; 6] = [
    "test",
    "--release",
    "--workspace",
    "--no-fail-fast",
    "--config",
    "profile.release.package.benches.opt-level=0",
];

/// The variable with the number of tests that run at a time.
const TEST_THREADS: &str = "RUST_TEST_THREADS";

/// Sets up, builds and runs the tests. Returns whether all passed.
pub(crate) fn run(
    pins: &Pins,
    cache: &Cache,
    workspace: &Workspace,
    test_arguments: &[String],
) -> anyhow::Result<bool> {
    // Set-up mostly waits for downloads, and nothing that it installs is needed to build.
    let (set_up, built) = thread::scope(|scope| {
        let set_up = scope.spawn(|| setup::install_missing(Purpose::Tests, pins, cache, workspace));
        let built = build(workspace);
        (set_up.join().expect("set-up does not panic"), built)
    });
    set_up?;
    if !built? {
        return Ok(false);
    }
    eprintln!("testing");
    let mut command = workspace.cargo(&TESTS);
    if std::env::var_os(TEST_THREADS).is_none() {
        // Many tests wait for processes most of the time.
        let cores = thread::available_parallelism().map_or(1, NonZero::get);
        command.env(TEST_THREADS, (cores + cores.div_ceil(2)).to_string());
    }
    let mut child = command
        .arg("--")
        .args(test_arguments)
        .stdout(Stdio::piped())
        .spawn()
        .context("cannot start cargo test")?;
    let output = child.stdout.take().context("cargo test has no output")?;

    let mut summary = TestTotals::default();
    let mut stdout = std::io::stdout().lock();
    for line in BufReader::new(output).split(b'\n') {
        let line = line.context("cannot read cargo test's output")?;
        stdout.write_all(&line).and_then(|()| stdout.write_all(b"\n")).context("cannot write")?;
        summary.add(&String::from_utf8_lossy(&line));
    }
    let passed = child.wait().context("cannot wait for cargo test")?.success();

    writeln!(stdout)?;
    for name in &summary.failed_names {
        writeln!(stdout, "failed: {name}")?;
    }
    if !passed && summary.failed == 0 {
        writeln!(stdout, "the tests could not be built or run; the reason is above")?;
    }
    writeln!(
        stdout,
        "tests: {} passed, {} failed, {} skipped",
        summary.passed, summary.failed, summary.ignored
    )?;
    Ok(passed)
}

/// Builds the programs, the Python package's extension and the tests. Returns whether all could be built.
fn build(workspace: &Workspace) -> anyhow::Result<bool> {
    Ok(workspace.build_programs(&["memtransfer-tests"])?
        && workspace.build_python_extension()?
        && succeeds(workspace.cargo(&TESTS).arg("--no-run"))?)
}

/// Totals over all test binaries, parsed from their output.
#[derive(Default, PartialEq, Eq, Debug)]
struct TestTotals {
    passed: u64,
    failed: u64,
    ignored: u64,
    failed_names: Vec<String>,
}

impl TestTotals {
    /// Parses a line: `test result: ok. 3 passed; 0 failed; 1 ignored; ...` or `test NAME ... FAILED`.
    fn add(&mut self, line: &str) {
        if let Some(result) = line.strip_prefix("test result: ") {
            // The result ends in a full stop; semicolons separate the counts.
            let counts = result.split_once(". ").map_or("", |(_, counts)| counts);
            for (number, what) in counts.split("; ").filter_map(|part| part.split_once(' ')) {
                let Ok(number) = number.parse::<u64>() else { continue };
                match what {
                    "passed" => self.passed += number,
                    "failed" => self.failed += number,
                    "ignored" => self.ignored += number,
                    _ => {}
                }
            }
        } else if let Some(name) =
            line.strip_prefix("test ").and_then(|rest| rest.strip_suffix(" ... FAILED"))
        {
            self.failed_names.push(name.to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn totals_add_up_over_test_binaries() {
        let mut summary = TestTotals::default();
        let output = "\
running 3 tests
test pose::turns ... ok
test pose::moves ... FAILED
test slow ... ignored
test result: FAILED. 1 passed; 1 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.02s
running 2 tests
test result: ok. 2 passed; 0 failed; 0 ignored; 0 measured; 7 filtered out; finished in 1.50s
";
        output.lines().for_each(|line| summary.add(line));
        let failed_names = vec!["pose::moves".to_owned()];
        assert_eq!(summary, TestTotals { passed: 3, failed: 1, ignored: 1, failed_names });
    }
}
