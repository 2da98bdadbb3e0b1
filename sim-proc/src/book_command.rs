//! `sim-proc book`: writes the case book of a run.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use case_book::{BookFile, BookRequest, CASE_BOOK_FILE, DEMONSTRATIONS_FILE};
use warehouse::case_book::write_books;

/// Arguments of `sim-proc book`.
#[derive(Debug, clap::Args)]
pub struct BookArgs {
    /// What the book has to hold, as JSON.
    #[arg(long, value_name = "FILE")]
    request: PathBuf,

    /// The folder of the files, which is created if missing: case-book.json and demonstrations.json, and streams.json and
    /// elsewhere.json where the run has them.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Writes the files.
///
/// # Errors
/// A request that cannot be read or met, a file that cannot be written.
pub fn run(args: &BookArgs) -> Result<()> {
    let text = durable::input::read_text(&args.request)
        .with_context(|| format!("cannot read {}", args.request.display()))?;
    let request: BookRequest = serde_json::from_str(&text)
        .with_context(|| format!("{} is no request for a case book", args.request.display()))?;
    let books = write_books(&request).context("cannot write the case book")?;
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot create the folder {}", args.out.display()))?;
    let files = [
        (CASE_BOOK_FILE, Some(BookFile::new(books.cases)?.text)),
        (DEMONSTRATIONS_FILE, Some(BookFile::new(books.demonstrations)?.text)),
        (STREAMS_FILE, books.streams),
        (ELSEWHERE_FILE, books.elsewhere),
    ];
    for (name, text) in files {
        if let Some(text) = text {
            write(&args.out.join(name), &text)?;
        }
    }
    Ok(())
}

/// The world's own file of streams.
const STREAMS_FILE: &str = "streams.json";

/// The world's own file of the other warehouse.
const ELSEWHERE_FILE: &str = "elsewhere.json";

/// Writes the file beside its place, then renames it.
fn write(path: &Path, text: &str) -> Result<()> {
    durable::replace(path, &path.with_extension("json.draft"), text.as_bytes())
        .with_context(|| format!("cannot write {}", path.display()))
}
