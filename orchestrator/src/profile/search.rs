//! The search of a memory by itself, measured by the process that searches: `memory-proc profile`. The orchestrator
//! does not link that process; it starts it and reads a JSON object a line.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};

use supervise::sibling;

/// One measurement, as the memory process tells it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Search {
    /// Entries of the memory.
    pub entries: u32,
    /// Numbers of a vector.
    pub dimension: u32,
    /// How many of the entries are embeddings of pictures; the others are seeded neighbours of them.
    pub real: u32,
    /// `exact` or `approximate`.
    pub search: String,
    /// Queries asked at once.
    pub batch: u32,
    /// Threads.
    pub threads: u32,
    /// Seconds that it took to make the memory ready.
    pub build_s: f64,
    /// Bytes that it takes.
    pub bytes: u64,
    /// Queries that were asked.
    pub queries: u64,
    /// How long a batch took, in nanoseconds.
    pub latency_ns: SearchTimes,
    /// Queries answered in a second.
    pub queries_per_s: f64,
    /// Bytes read from end to end in a second, where that is how it searches.
    pub bytes_per_s: Option<f64>,
    /// Share of queries whose nearest entry was found.
    pub recall_at_1: f64,
    /// Share of the ten nearest entries that were found.
    pub recall_at_10: f64,
}

/// How long searches took, in nanoseconds; as [`Times`](super::recorder::Times), without a mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SearchTimes {
    /// Half took no longer.
    pub p50: u64,
    /// Of ten, nine.
    pub p90: u64,
    /// Of a hundred, 99.
    pub p99: u64,
    /// Of a thousand, 999.
    pub p999: u64,
    /// The longest.
    pub max: u64,
}

/// Has one kind of search measured at one size, for about so many seconds a measurement.
///
/// # Errors
/// When the process cannot be started, fails, or tells what cannot be read; the message has its last words.
pub fn measure(kind: &str, entries: u32, seconds: f64) -> Result<Vec<Search>> {
    let mut child = Command::new(sibling("memory-proc")?)
        .args(["profile", "--search", kind, "--entries", &entries.to_string()])
        .args(["--seconds", &seconds.to_string()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot start memory-proc")?;
    let errors = child.stderr.take().context("memory-proc has no standard error")?;
    let said = std::thread::spawn(move || std::io::read_to_string(errors).unwrap_or_default());
    let output = BufReader::new(child.stdout.take().context("memory-proc has no output")?);
    let read: Result<Vec<Search>> = output
        .lines()
        .map(|line| {
            let line = line?;
            serde_json::from_str(&line).with_context(|| format!("memory-proc told {line:?}"))
        })
        .collect();
    let status = child.wait().context("cannot wait for memory-proc")?;
    let said = said.join().unwrap_or_default();
    if !status.success() {
        let last =
            said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("without a word");
        bail!("memory-proc ended ({status}): {last}");
    }
    read
}
