//! The names of the files and folders in a run folder.

use super::manifest::MANIFEST_FILE;

/// The live status of a session.
pub const STATUS_FILE: &str = "status.json";
/// The journal of finished episodes.
pub const EPISODES_FILE: &str = "episodes.jsonl";
/// The journal of their timings.
pub const TIMINGS_FILE: &str = "timings.jsonl";
/// The journal of requests to a model.
pub const REQUESTS_FILE: &str = "requests.jsonl";
pub(super) const ERRORS_FILE: &str = "errors.jsonl";
pub(super) const SESSIONS_FILE: &str = "sessions.jsonl";
pub(super) const LATENCY_FILE: &str = "latency.jsonl";
/// The streams, of a run that consists of streams.
pub const STREAMS_FILE: &str = "streams.json";
/// The other warehouse, if tasks are demonstrated in one.
pub const ELSEWHERE_FILE: &str = "elsewhere.json";
/// The snapshots of memories that learn.
pub const SNAPSHOTS_FOLDER: &str = "snapshots";
/// The documents that memory supplied.
pub const DOCUMENTS_FOLDER: &str = "documents";
/// The requests to the policy and its answers.
pub const PROMPTS_FOLDER: &str = "prompts";
/// The logs of the processes.
pub const LOGS_FOLDER: &str = "logs";
/// The reports about a single run.
pub const REPORT_FOLDER: &str = "report";

/// Everything in the folder of a report. `report.md` is of earlier versions.
pub const REPORT_FILES: [&str; 10] = [
    "report.html",
    "report.md",
    "figures",
    "tables",
    "conditions.csv",
    "conditions.parquet",
    "episodes.csv",
    "episodes.parquet",
    "streams.csv",
    "streams.parquet",
];

/// Everything that a run folder may hold. No other file in it is touched.
pub(super) const CONTENTS: [&str; 26] = [
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
    "report.memtransfer-draft",
    "report.memtransfer-draft-old",
];
