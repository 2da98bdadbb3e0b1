//! Spans: what each process was at when, so that a trace can show what overlapped.
//!
//! A process writes them where [`Attach::spans`](crate::Attach::spans) asks for it, a [`Span`] a line, into a file
//! of its own; `memtransfer run --trace` puts them together when the run is over. A span is a batch of work, not
//! a step: how long a step waited where, its messages say.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::attach::Attach;
use crate::message::Role;
use crate::process::monotonic_ns;

/// A piece of work.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Span {
    /// The thread, or whatever else does one thing after the other.
    pub track: String,
    /// What was done.
    pub name: String,
    /// When it began, CLOCK_MONOTONIC.
    pub start_ns: u64,
    /// When it was done.
    pub end_ns: u64,
    /// On how many.
    pub count: u64,
}

/// Where a process keeps its spans, if anybody wants them.
#[derive(Debug, Default)]
pub struct Spans {
    file: Option<BufWriter<File>>,
}

impl Spans {
    /// Where the run that `attach` describes wants them of the process `role`.
    ///
    /// # Errors
    /// When the file cannot be made.
    pub fn open(attach: &Attach, role: Role) -> io::Result<Self> {
        let Some(folder) = &attach.spans else { return Ok(Self::default()) };
        let file = File::create(spans_file(folder, role, attach.generation))?;
        Ok(Self { file: Some(BufWriter::new(file)) })
    }

    /// The time, if anybody wants spans: where one begins.
    pub fn begin(&self) -> Option<u64> {
        self.file.is_some().then(monotonic_ns)
    }

    /// Ends a span that [began](Self::begin), on `count` pieces; one on none was not worth the mention.
    pub fn end(&mut self, began: Option<u64>, track: &str, name: &str, count: usize) {
        if let Some(start_ns) = began.filter(|_| count > 0) {
            self.add(start_ns, monotonic_ns(), track, name, count);
        }
    }

    /// Adds a span. A file that cannot be written to is given up, and the log says so.
    pub fn add(&mut self, start_ns: u64, end_ns: u64, track: &str, name: &str, count: usize) {
        let Some(file) = &mut self.file else { return };
        let (track, name) = (track.to_owned(), name.to_owned());
        let span = Span { track, name, start_ns, end_ns, count: count as u64 };
        let written = serde_json::to_writer(&mut *file, &span).map_err(io::Error::from);
        if let Err(error) = written.and_then(|()| file.write_all(b"\n")) {
            tracing::warn!(%error, "spans are kept no longer");
            self.file = None;
        }
    }
}

/// The file in `folder` for the spans of the process `role` in one generation.
pub fn spans_file(folder: &Path, role: Role, generation: u32) -> PathBuf {
    folder.join(format!("{}-{generation}.jsonl", role.word()))
}
