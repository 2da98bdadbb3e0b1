//! The names of the files in a run folder.

use super::manifest::MANIFEST_FILE;

/// Name of the file in a run's folder.
pub const STATUS_FILE: &str = "status.json";

pub(super) const EPISODES_FILE: &str = "episodes.jsonl";
pub(super) const TIMINGS_FILE: &str = "timings.jsonl";
pub(super) const REQUESTS_FILE: &str = "requests.jsonl";
pub(super) const ERRORS_FILE: &str = "errors.jsonl";
pub(super) const SESSIONS_FILE: &str = "sessions.jsonl";
pub(super) const LATENCY_FILE: &str = "latency.jsonl";
pub(super) const STREAMS_FILE: &str = "streams.json";
pub(super) const ELSEWHERE_FILE: &str = "elsewhere.json";
pub(super) const SNAPSHOTS_FOLDER: &str = "snapshots";
pub(super) const DOCUMENTS_FOLDER: &str = "documents";
pub(super) const PROMPTS_FOLDER: &str = "prompts";
pub(super) const LOGS_FOLDER: &str = "logs";
/// The folder of reports about a single run.
pub const REPORT_FOLDER: &str = "report";

/// Everything that a run folder may hold. No other file in it is touched.
pub(super) const CONTENTS: [&str; 24] = [
    MANIFEST_FILE,
    "manifest.json.new",
    EPISODES_FILE,
    TIMINGS_FILE,
    REQUESTS_FILE,
    ERRORS_FILE,
    SESSIONS_FILE,
    LATENCY_FILE,
    STATUS_FILE,
    "status.json.new",
    "episodes.jsonl.new",
    "episodes.damaged.jsonl",
    "timings.damaged.jsonl",
    "requests.damaged.jsonl",
    "errors.damaged.jsonl",
    "sessions.damaged.jsonl",
    "latency.damaged.jsonl",
    STREAMS_FILE,
    ELSEWHERE_FILE,
    SNAPSHOTS_FOLDER,
    DOCUMENTS_FOLDER,
    PROMPTS_FOLDER,
    LOGS_FOLDER,
    REPORT_FOLDER,
];
