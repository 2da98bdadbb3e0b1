//! The latency of search alone, measured by the process that searches: `memory-proc profile`, which prints one JSON
//! object per line.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};

use supervise::sibling;

/// One measurement, as the memory process prints it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SearchMeasurement {
    /// Entries of the memory.
    pub entries: u32,
    /// Components of a vector.
    pub dimension: u32,
    /// Entries that are embeddings of rendered views; the others are seeded neighbours of them.
    pub real: u32,
    /// `exact` or `approximate`.
    pub search: String,
    /// Queries of a batch.
    pub batch: u32,
    /// Threads.
    pub threads: u32,
    /// Seconds to build the index.
    pub build_s: f64,
    /// Bytes of the index.
    pub bytes: u64,
    /// Number of queries.
    pub queries: u64,
    /// Latency of a batch, in nanoseconds.
    pub latency_ns: SearchTimes,
    /// Queries per second.
    pub queries_per_s: f64,
    /// Bytes read per second, where a search reads all of them.
    pub bytes_per_s: Option<f64>,
    /// Share of queries whose nearest entry was found.
    pub recall_at_1: f64,
    /// Share of the ten nearest entries that were found.
    pub recall_at_10: f64,
}

/// The distribution of a search's latency, in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SearchTimes {
    /// Median.
    pub p50: u64,
    /// 90th percentile.
    pub p90: u64,
    /// 99th percentile.
    pub p99: u64,
    /// 99.9th percentile.
    pub p999: u64,
    /// Maximum.
    pub max: u64,
}

/// Measures one kind of search in a memory of `entries`, for about `seconds` per measurement.
///
/// # Errors
/// When the process cannot be started, fails, or prints something else.
pub fn measure(kind: &str, entries: u32, seconds: f64) -> Result<Vec<SearchMeasurement>> {
    let mut child = Command::new(sibling("memory-proc")?)
        .args(["profile", "--search", kind, "--entries", &entries.to_string()])
        .args(["--seconds", &seconds.to_string()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot start memory-proc")?;
    let errors = child.stderr.take().context("memory-proc has no standard error")?;
    let messages = std::thread::spawn(move || std::io::read_to_string(errors).unwrap_or_default());
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
