//! The lines of `latency.jsonl`: percentiles of each stage of a step.

use domain::MemoryKind;
use serde::{Deserialize, Serialize};

/// Summary of a latency histogram. Times are in microseconds, accurate to one percent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LatencySummary {
    /// Number of samples.
    pub count: u64,
    /// Mean.
    pub mean_us: f64,
    /// Median.
    pub p50_us: f64,
    /// 90th percentile.
    pub p90_us: f64,
    /// 99th percentile.
    pub p99_us: f64,
    /// 99.9th percentile.
    pub p999_us: f64,
    /// Maximum.
    pub max_us: f64,
}

/// One stage of all steps that a session took with one memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LatencyRecord {
    /// The session, from 1.
    pub session: u32,
    /// The memory.
    pub memory: MemoryKind,
    /// The stage's name, or `step` for the sum of all stages.
    pub stage: String,
    /// The distribution.
    #[serde(flatten)]
    pub summary: LatencySummary,
}
