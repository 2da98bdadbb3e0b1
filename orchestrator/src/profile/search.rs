//! The latency of search alone, measured by the process that searches: `memory-proc profile`, which prints one JSON
//! object per line.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use domain::search_profile::SearchMeasurement;

use supervise::sibling;

/// Measures searches in a memory of `entries`, for about `seconds` per measurement.
///
/// # Errors
/// When the process cannot be started, fails, or prints something else.
pub fn measure(entries: u32, seconds: f64) -> Result<Vec<SearchMeasurement>> {
    let mut child = Command::new(sibling("memory-proc")?)
        .args(["profile", "--entries", &entries.to_string()])
        .args(["--seconds", &seconds.to_string()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot start memory-proc")?;
    let errors = child.stderr.take().context("memory-proc has no standard error")?;
    let read = move || std::io::read_to_string(errors).unwrap_or_default();
    let messages = std::thread::Builder::new().spawn(read).context("cannot start a thread")?;
    let output = BufReader::new(child.stdout.take().context("memory-proc has no output")?);
    let read: Result<Vec<SearchMeasurement>> = output
        .lines()
        .map(|line| {
            let line = line?;
            serde_json::from_str(&line).with_context(|| format!("memory-proc printed {line:?}"))
        })
        .collect();
    let status = child.wait().context("cannot wait for memory-proc")?;
    let messages = messages.join().unwrap_or_default();
    if !status.success() {
        let last =
            messages.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("no message");
        bail!("memory-proc ended ({status}): {last}");
    }
    read
}
