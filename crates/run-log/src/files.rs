//! The names of the files and folders in a run folder.

use std::io;

use durable::KnownNames;

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
/// Locked by the process that writes to the run.
pub(super) const LOCK_FILE: &str = "run.lock";
pub(super) use case_book::{CASE_BOOK_FILE, DEMONSTRATIONS_FILE};

/// The streams, of a run that consists of streams.
pub const STREAMS_FILE: &str = "streams.json";
/// The other warehouse, if tasks are demonstrated in one.
pub const ELSEWHERE_FILE: &str = "elsewhere.json";
/// The template of the prompt, if the user gave one.
pub const PROMPT_FILE: &str = "prompt.toml";
/// The snapshots of memories that learn.
pub const SNAPSHOTS_FOLDER: &str = "snapshots";
/// The documents that memory supplied.
pub const DOCUMENTS_FOLDER: &str = "documents";
/// The requests to the policy and its answers.
pub const PROMPTS_FOLDER: &str = "prompts";
/// The logs of the processes.
pub const LOGS_FOLDER: &str = "logs";
/// What `doctor` last found out about the servers of the run's model.
pub const DOCTOR_FILE: &str = "doctor.json";
/// The reports about a single run.
pub const REPORT_FOLDER: &str = "report";

/// The names of tables and figures in a report, as a regular expression. Those of memories' figures end with the memory's name.
const REPORT_IDS: &str = concat!(
    "(side-by-side|compare-run[0-9]+-run[0-9]+(-conclusions|-unpaired)?|(run[0-9]+-)?(",
    "(conflict-pairs|elsewhere|pairs)(-conclusions|-unpaired)?|",
    "blocked|blocked-others|conditions|configuration|conflict|cost|design|design-figure|external-pairs|facts|",
    "failures|failures-figure|failure-points|groups|growth|growth-(figure|search|store)|main|main-figure|mixed|",
    "mixed-figure|necessity|provenance|ranking-[0-9]+|reproduction|requests|runs|supplied|time|time-figure|transfer|",
    "transfer-figure|worst-cases|",
    "stream-(adaptation|cost|cost-figure|differences|matrix|matrix-figure|orders|rounds-[a-z0-9-]+|success|success-figure|transfer)))",
);

/// The names in a run folder, as regular expressions, except those of the manifest, of the lock, of the report, and of the logs of
/// external memories.
const RUN_NAMES: [&str; 13] = [
    "(manifest|status)\\.json\\.new",
    "prompt\\.toml(\\.new)?|(status|doctor)\\.json|(case-book|demonstrations|streams|elsewhere)\\.json(\\.new)?",
    "(episodes|timings|requests|errors|sessions|latency)(\\.damaged)?\\.jsonl",
    "episodes\\.jsonl\\.new",
    "logs/((sim|memory|policy)\\.log(\\.new)?)?",
    // What is in a snapshot has the names that its memory gives.
    "snapshots/([0-9a-f]{16}/(([0-9a-f]{32}|unfinished)/.*)?)?",
    "documents/((semantic|summary)-[a-z0-9+-]+\\.json(\\.new)?)?",
    "prompts/",
    "prompts/session-[0-9]+/(generation-[0-9]+\\.jsonl)?",
    "prompts/images/([0-9a-f]{32}\\.(png|new-[0-9]+))?",
    "prompts/documents/([0-9a-f]{32}\\.(txt|json|new-[0-9]+))?",
    "report\\.memtransfer-draft(-old)?/.*",
    "report/",
];

/// The names in the folder of a report.
///
/// # Errors
/// Never: the patterns are tested.
pub fn report_names() -> io::Result<KnownNames> {
    KnownNames::new(report_patterns("").iter().map(String::as_str))
}

/// The names of the logs of external memories, in the folder of logs.
pub(super) fn memory_log_names() -> io::Result<KnownNames> {
    KnownNames::new(["external-memory-[0-9]+\\.log(\\.new)?"])
}

/// The names in a run folder but the manifest, which is replaced, the lock, which is held, and the logs of external memories: these
/// start before the run's folder is opened, and write to theirs already when an earlier run is removed.
pub(super) fn run_names() -> io::Result<KnownNames> {
    let of_report = report_patterns("report/");
    KnownNames::new(RUN_NAMES.into_iter().chain(of_report.iter().map(String::as_str)))
}

/// The names in the folder of a report, each after `folder`.
fn report_patterns(folder: &str) -> [String; 5] {
    [
        format!("{folder}report\\.(html|md)"),
        format!("{folder}(conditions|episodes|streams)\\.(csv|parquet)"),
        format!("{folder}published\\.toml"),
        format!("{folder}figures/({REPORT_IDS}\\.(svg|pdf))?"),
        format!("{folder}tables/({REPORT_IDS}\\.(csv|tex))?"),
    ]
}
