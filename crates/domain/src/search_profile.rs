//! How long a search takes: what `memory-proc profile` prints, one measurement a line.

use serde::{Deserialize, Serialize};

/// A measurement of one kind of search, in a memory of one size.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SearchMeasurement {
    /// Size of the memory.
    pub entries: u32,
    /// Numbers in a vector.
    pub dimension: usize,
    /// Entries that are embeddings of images.
    pub real: u32,
    /// `exact` or `approximate`.
    pub search: String,
    /// Candidates considered in the graph; absent for exact search.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub searching: Option<usize>,
    /// Queries in one call.
    pub batch: usize,
    /// Threads of the search.
    pub threads: usize,
    /// Seconds that preparing the search took, without generating the vectors.
    pub build_s: f64,
    /// Size of the memory in bytes.
    pub bytes: usize,
    /// Number of queries.
    pub queries: usize,
    /// Time of a call.
    pub latency_ns: SearchLatency,
    /// Queries answered per second.
    pub queries_per_s: f64,
    /// Bytes read per second; absent for approximate search.
    pub bytes_per_s: Option<f64>,
    /// Share of queries whose nearest entry was found.
    pub recall_at_1: f64,
    /// Share of the queries' ten nearest entries that were found.
    pub recall_at_10: f64,
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
