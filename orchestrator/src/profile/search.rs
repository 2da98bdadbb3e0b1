//! The latency of search alone, measured by the process that searches: `memory-proc profile`, which prints one JSON
//! object per line.

use std::process::{Command, Output, Stdio};

use anyhow::{Context, Result, bail};
use domain::search_profile::SearchMeasurement;

use supervise::sibling;

/// Measures searches in a memory of `entries`, for about `seconds` per measurement.
///
/// # Errors
/// When the process cannot be started, fails, or prints something else.
pub fn measure(entries: u32, seconds: f64) -> Result<Vec<SearchMeasurement>> {
    let mut command = Command::new(sibling("memory-proc")?);
    command
        .args(["profile", "--entries", &entries.to_string()])
        .args(["--seconds", &seconds.to_string()])
        .stdin(Stdio::null());
    let output = supervise::output_until(&mut command, || false);
    let Output { status, stdout, stderr } =
        output.context("cannot start memory-proc")?.context("memory-proc was stopped")?;
    if !status.success() {
        let messages = String::from_utf8_lossy(&stderr);
        let last =
            messages.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("no message");
        bail!("memory-proc ended ({status}): {last}");
    }
    let parse = |line: &str| {
        serde_json::from_str(line).with_context(|| format!("memory-proc printed {line:?}"))
    };
    String::from_utf8(stdout)?.lines().map(parse).collect()
}
