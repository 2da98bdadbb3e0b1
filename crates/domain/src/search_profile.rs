//! How long a search takes: what `memory-proc profile` prints, one measurement a line.

use serde::{Deserialize, Serialize};

/// A measurement of the search in a memory of one size.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SearchMeasurement {
    /// Size of the memory.
    pub entries: u32,
    /// Numbers in a vector.
    pub dimension: usize,
    /// Entries that are embeddings of images.
    pub real: u32,
    /// Queries in one call.
    pub batch: usize,
    /// Threads of the search.
    pub threads: usize,
    /// Seconds that quantizing the vectors took, without generating them.
    pub build_s: f64,
    /// Size of the memory in bytes.
    pub bytes: usize,
    /// Number of queries.
    pub queries: usize,
    /// Time of a call.
    pub latency_ns: SearchLatency,
    /// Queries answered per second.
    pub queries_per_s: f64,
    /// Bytes read per second.
    pub bytes_per_s: f64,
}

/// Percentiles, in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SearchLatency {
    /// The median.
    pub p50: u64,
    /// The 90th percentile.
    pub p90: u64,
    /// The 99th percentile.
    pub p99: u64,
    /// The 99.9th percentile.
    pub p999: u64,
    /// The maximum.
    pub max: u64,
}

impl SearchMeasurement {
    /// The median time of a call, in seconds.
    pub fn seconds(&self) -> f64 {
        self.latency_ns.p50 as f64 / 1e9
    }
}
