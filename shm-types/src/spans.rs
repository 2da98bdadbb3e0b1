//! Spans of each process's work, for `memtransfer run --trace`.
//!
//! A process writes one [`Span`] per line into a file of its own if [`Attach::spans`](crate::Attach::spans) names a
//! folder.
//! A span is a batch of work, not a step: the times of steps are in the messages.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::attach::Attach;
use crate::message::Role;
use crate::process::monotonic_ns;

/// A batch of work.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Span {
    /// The thread.
    pub track: String,
    /// The kind of work.
    pub name: String,
    /// Its start, CLOCK_MONOTONIC.
    pub start_ns: u64,
    /// Its end.
    pub end_ns: u64,
    /// The number of items.
    pub count: u64,
}

/// Writes the spans of a process, if the run asks for them.
#[derive(Debug, Default)]
pub struct Spans {
    file: Option<BufWriter<File>>,
}

impl Spans {
    /// Opens the file of the process `role`, if the run asks for spans. `index` tells worlds and external memories apart.
    ///
    /// # Errors
    /// When the file cannot be created.
    pub fn open(attach: &Attach, role: Role, index: u8) -> io::Result<Self> {
        let Some(folder) = &attach.spans else { return Ok(Self::default()) };
        let file = File::create(spans_file(folder, role, index, attach.generation))?;
        Ok(Self { file: Some(BufWriter::new(file)) })
    }

    /// The start of a span: the time, if spans are written.
    pub fn begin(&self) -> Option<u64> {
        self.file.is_some().then(monotonic_ns)
    }

    /// Ends a span that [began](Self::begin), of `count` items; one without items is not written.
    pub fn end(&mut self, began: Option<u64>, track: &str, name: &str, count: usize) {
        if let Some(start_ns) = began.filter(|_| count > 0) {
            self.add(start_ns, monotonic_ns(), track, name, count);
        }
    }

    /// Adds a span. After a write error no more spans are written, and the log says so.
    pub fn add(&mut self, start_ns: u64, end_ns: u64, track: &str, name: &str, count: usize) {
        let Some(file) = &mut self.file else { return };
        let (track, name) = (track.to_owned(), name.to_owned());
        let span = Span { track, name, start_ns, end_ns, count: count as u64 };
        let written = serde_json::to_writer(&mut *file, &span).map_err(io::Error::from);
        if let Err(error) = written.and_then(|()| file.write_all(b"\n")) {
            tracing::warn!(%error, "cannot write spans; no more are written");
            self.file = None;
        }
    }
}

/// The file in `folder` of the spans of the process `role` in one generation. `index` tells worlds and external memories apart.
pub fn spans_file(folder: &Path, role: Role, index: u8, generation: u32) -> PathBuf {
    folder.join(format!("{}-{generation}.{index}.jsonl", role.word()))
}
