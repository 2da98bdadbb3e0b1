//! The case book of a run, which the world writes: `sim-proc book`.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use case_book::{
    BookFile, BookRequest, CASE_BOOK_FILE, CaseBook, DEMONSTRATIONS_FILE, DemonstrationBook,
};
use conditions::{Route, Start};
use run_log::{
    CASE_BOOK_HASH, DEMONSTRATIONS_HASH, ELSEWHERE_FILE, ELSEWHERE_HASH, STREAMS_FILE, STREAMS_HASH,
};
use shm_types::message::Role;
use supervise::Launch;

use crate::progress::say;

/// The program of the world.
const PROGRAM: &str = "sim-proc";

/// How long the case book is waited for without a word.
const SOON: Duration = Duration::from_secs(10);

/// How long a case book may take to be written where no run says otherwise.
pub const WRITING_TIMEOUT: Duration = Duration::from_secs(300);

/// The files of a case book.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Books {
    /// What the orchestrator knows about cases.
    pub cases: BookFile<CaseBook>,
    /// What memory knows about them.
    pub demonstrations: BookFile<DemonstrationBook>,
    /// The world's own file of the streams, for a run that consists of some.
    pub streams: Option<String>,
    /// The world's own file of the other world in which tasks are demonstrated, if there is one.
    pub elsewhere: Option<String>,
}

/// The command of a world of the user's.
fn external(command: &str) -> Result<Command> {
    let launch = Launch::command(Role::Sim, command)?;
    let mut command = Command::new(launch.program);
    command.args(launch.args);
    Ok(command)
}

impl Books {
    /// Those that the world which `command` starts, or the warehouse, writes for `request`, within `limit`.
    ///
    /// # Errors
    /// When the world's program is missing, cannot write them, with what it printed, or takes longer.
    pub fn of_world(command: Option<&str>, request: &BookRequest, limit: Duration) -> Result<Self> {
        let folder = tempfile::tempdir().context("cannot make a temporary folder")?;
        let (asked, out) = (folder.path().join("request.json"), folder.path().join("out"));
        fs::write(&asked, serde_json::to_vec(request)?)
            .with_context(|| format!("cannot write {}", asked.display()))?;
        let (name, mut command) = match command {
            Some(command) => (command, external(command)?),
            None => (PROGRAM, Command::new(supervise::sibling(PROGRAM)?)),
        };
        command.arg("book").arg("--request").arg(&asked).arg("--out").arg(&out);
        supervise::without_keys(&mut command).stdin(Stdio::null());
        let (began, is_silent) = (Instant::now(), Cell::new(true));
        let is_over = || {
            if began.elapsed() > SOON && is_silent.replace(false) {
                say(&format!("waiting for the case book: `{name} book` is acting out all cases"));
            }
            began.elapsed() > limit
        };
        let ended = supervise::output_until(&mut command, is_over);
        let ended = ended.with_context(|| format!("cannot start {name}"))?.with_context(|| {
            format!(
                "`{name} book` has not ended within {} s (--start-timeout of a run): does a case never end?",
                limit.as_secs()
            )
        })?;
        if !ended.status.success() {
            let printed = String::from_utf8_lossy(&ended.stderr);
            let printed = printed.trim().trim_start_matches("error: ");
            let printed = printed.trim_start_matches("memtransfer: ");
            match printed.is_empty() {
                true => bail!("{name} book ended with {}", ended.status),
                false => bail!("{printed}"),
            }
        }
        Self::read(&out).with_context(|| format!("{name} has written no case book"))
    }

    /// Those in the folder `folder`, which a world has written without knowing `request`.
    ///
    /// # Errors
    /// As [`Self::read`]; also when they lack something that is asked for.
    pub fn written_before(folder: &Path, request: &BookRequest) -> Result<Self> {
        let books = Self::read(folder).with_context(|| {
            format!(
                "{} holds no case book: `your-program book --out DIR` writes one",
                folder.display()
            )
        })?;
        let world = &books.cases.book.world.declaration.name;
        ensure!(
            request.elsewhere.is_none() && request.streams.is_none(),
            "a world that you start has one variant a case: no streams, and no --demos elsewhere"
        );
        let cases = (0..).zip(&books.cases.book.cases);
        let mut has_blocked = false;
        for (number, case) in cases.filter(|(_, case)| request.cases.contains(&case.id)) {
            let id = &case.id;
            let is_blocked = case.reference(Start::New, Route::Blocked).is_some();
            let book = &books.demonstrations.book;
            if let Some(set) = book.missing_set(number, &request.demonstrations, is_blocked) {
                bail!("case {id} of the world {world} has no {}", set.in_words());
            }
            has_blocked |= is_blocked;
        }
        ensure!(
            has_blocked || !request.blocked || request.cases.is_empty(),
            "no case of the world {world} that takes part has a blocked route: leave `blocked` out of --routes"
        );
        Ok(books)
    }

    /// Those in the folder `folder`.
    ///
    /// # Errors
    /// When a file cannot be read, or is not part of a case book.
    pub fn read(folder: &Path) -> Result<Self> {
        let text = |name: &str| {
            let path = folder.join(name);
            let read = path.exists().then(|| durable::input::read_text(&path)).transpose();
            read.with_context(|| format!("cannot read {}", path.display()))
        };
        Ok(Self {
            cases: BookFile::read(&folder.join(CASE_BOOK_FILE))?,
            demonstrations: BookFile::read(&folder.join(DEMONSTRATIONS_FILE))?,
            streams: text(STREAMS_FILE)?,
            elsewhere: text(ELSEWHERE_FILE)?,
        })
    }

    /// Writes them into the folder of a run: each beside the earlier one, and renamed.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let files = [
            (CASE_BOOK_FILE, Some(&self.cases.text)),
            (DEMONSTRATIONS_FILE, Some(&self.demonstrations.text)),
            (STREAMS_FILE, self.streams.as_ref()),
            (ELSEWHERE_FILE, self.elsewhere.as_ref()),
        ];
        for (name, text) in files {
            let Some(text) = text else { continue };
            let path = folder.join(name);
            durable::replace(&path, &path.with_extension("json.new"), text.as_bytes())
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    /// Hashes of what the world was made from, and of the other world, by name.
    pub fn world_hashes(&self) -> BTreeMap<String, String> {
        let mut hashes = self.cases.book.world.hashes.clone();
        let elsewhere = self.elsewhere.iter().map(|text| blake3::hash(text.as_bytes()));
        hashes.extend(elsewhere.map(|hash| (ELSEWHERE_HASH.to_owned(), hash.to_hex().to_string())));
        hashes
    }

    /// The hashes of a run's manifest: those of the world, of the streams and of the books.
    pub fn hashes(&self) -> BTreeMap<String, String> {
        let mut hashes = self.world_hashes();
        let streams = self.cases.book.streams.iter();
        hashes.extend(streams.map(|streams| (STREAMS_HASH.to_owned(), streams.hash.clone())));
        hashes.insert(CASE_BOOK_HASH.to_owned(), self.cases.hash.clone());
        hashes.insert(DEMONSTRATIONS_HASH.to_owned(), self.demonstrations.hash.clone());
        hashes
    }
}
