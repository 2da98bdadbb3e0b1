//! The run folder: the manifest of a run, and a record of every episode.
//!
//! Reading one works on any machine; the crate starts nothing and links no iceoryx2.
//!
//! | file | holds | written |
//! |---|---|---|
//! | `manifest.json` | settings, versions, hashes, facts that the processes reported | first |
//! | `episodes.jsonl` | one line for each finished episode; independent of time and lanes | durably, when it ends |
//! | `timings.jsonl` | one line for each finished episode: times | beside it |
//! | `requests.jsonl` | one line for each request to a model: tokens, attempts, latency | as they are answered |
//! | `errors.jsonl` | episodes given up because of a fault of the infrastructure | as they happen |
//! | `sessions.jsonl` | starts, restarts and ends of the processes | as they happen |
//! | `documents/` | the documents that memory supplies | before the first episode |
//! | `prompts/` | requests to the policy and its answers ([`domain::prompt_log`]), with `--log-prompts` | by the policy |
//! | `*.damaged.jsonl` | lines that could not be used, moved there | when the run is resumed |
//! | `logs/` | stderr of the processes | by them |
//! | `report/` | pages and data files (crate `report`) | by `memtransfer report` |
//!
//! The crate `scores` computes scores from these files alone.

pub mod answers;
mod check;
pub mod date;
mod existing;
mod files;
mod folder;
mod journal;
mod known;
pub mod latency;
mod manifest;
pub mod memory_label;
mod merge;
mod parts;
pub mod policy;
mod read;
mod record;
mod sealed;
mod sorted;
pub mod source;
pub mod step_view;
pub mod usage;

pub use files::{
    DOCTOR_FILE, DOCUMENTS_FOLDER, ELSEWHERE_FILE, EPISODES_FILE, LOGS_FOLDER, PROMPT_FILE,
    PROMPTS_FOLDER, REPORT_FOLDER, REQUESTS_FILE, SNAPSHOTS_FOLDER, STATUS_FILE, STREAMS_FILE,
    TIMINGS_FILE, report_names,
};
pub use folder::{LEARNED_FACTS, Opened, RunFolder};
pub use journal::{DamagedLine, Journal, JournalContents, JournalTail, damaged_file, read_journal};
pub use manifest::{
    CASE_BOOK_HASH, DEMONSTRATIONS_HASH, Difference, DocumentFacts, DocumentUsage, ELSEWHERE_HASH,
    ExternalMemoryFacts, FORMAT, Manifest, PROMPT_HASH, STREAMS_HASH, UnitId,
};
pub use merge::{
    FactDifference, MergeError, PlannedFacts, UnitEpisode, UnitFolders, finish_unit, merge,
    unit_folder,
};
pub use parts::{EpisodeReader, RunParts};
pub use read::{RunLog, tell_apart};
pub use record::{
    BlockedRecord, Ending, EpisodeError, EpisodeRecord, EpisodeTimings, RecallTotals,
    RequestRecord, SessionEvent, SessionRecord, Stages, StreamRecord, Unread,
};

// The fixtures of `rigs` name this crate, also where its own tests include them.
#[cfg(test)]
extern crate self as run_log;
#[cfg(test)]
#[expect(dead_code, unreachable_pub, reason = "other crates use the rest of it")]
#[path = "../../rigs/src/records.rs"]
mod records;

use std::io;
use std::path::{Path, PathBuf};

use case_book::BookError;

/// Why a run folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The system refused.
    #[error("cannot {doing} {}: {source}", path.display())]
    System {
        /// The operation.
        doing: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The manifest cannot be understood.
    #[error(
        "{}: {problem}. The run cannot be read without it; the files beside it are untouched. Restore it, or run into \
         another --out", path.display()
    )]
    BrokenManifest {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// Another version of the program wrote the folder.
    #[error(
        "{}: the run has format {format}, and this program reads format {FORMAT}: {writer} wrote it and can read it. The files beside \
         it are untouched; to run, choose another --out", path.display()
    )]
    OtherFormat {
        /// The manifest.
        path: PathBuf,
        /// Its format.
        format: u64,
        /// The program that wrote it.
        writer: String,
    },
    /// The case book cannot be used.
    #[error("{0}. Records are checked with it: restore it, or run into another --out")]
    BrokenBook(#[from] BookError),
    /// The folder holds a run with other settings, or of other code.
    #[error(
        "{} holds a run with other settings or code:\n{}\nUse the same settings and code to continue it, remove it to start over (as `run \
         --fresh` does), or choose another --out",
        dir.display(), differences.iter().map(|d| format!("  {d}")).collect::<Vec<_>>().join("\n")
    )]
    OtherSettings {
        /// The folder.
        dir: PathBuf,
        /// What differs.
        differences: Vec<Difference>,
    },
    /// The folder holds finished episodes that the run does not have.
    #[error(
        "{} holds {count} finished episodes that this command leaves out, for example {example}. A run can grow, but not \
         shrink: ask for at least the same memories, conditions, cases and runs, remove it to start over (as `run --fresh` \
         does), or choose another --out",
        dir.display()
    )]
    NotPlanned {
        /// The folder.
        dir: PathBuf,
        /// Number of such episodes.
        count: usize,
        /// The key of one.
        example: String,
    },
    /// The folder holds something else.
    #[error(
        "{} holds files and is no run folder (it has no manifest.json): choose another --out", .0.display()
    )]
    NotARun(PathBuf),
    /// There is no run there.
    #[error("{} holds no run: `memtransfer ls runs` lists the runs", .0.display())]
    NoRun(PathBuf),
    /// Another process is writing to it.
    #[error(
        "another memtransfer is writing to {}: wait until it is done, or choose another --out", .0.display()
    )]
    Locked(PathBuf),
    /// The file system has no locks.
    #[error(
        "the file system of {} has no locks ({source}), without which two runs could write to it: choose an --out elsewhere, or mount \
         this one with locks (NFS: with `rpc.statd`)",
        .dir.display()
    )]
    NoLocks {
        /// The folder.
        dir: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// An episode that is finished was run again.
    #[error("{0} was run twice: this is a mistake in the program, please report it")]
    Twice(String),
}

fn system<'a>(doing: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> LogError + 'a {
    move |source| LogError::System { doing, path: path.to_owned(), source }
}
