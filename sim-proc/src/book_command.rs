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

#[cfg(test)]
mod tests {
    use std::fs;

    use case_book::{CaseBook, DemonstrationBook};

    use super::*;

    #[test]
    fn the_files_are_those_of_the_request_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let (request, out) = (folder.path().join("request.json"), folder.path().join("out"));
        let args = BookArgs { request: request.clone(), out: out.clone() };
        let missing = format!("{:#}", run(&args).unwrap_err());
        assert!(missing.starts_with("cannot read "), "{missing}");
        let asked = BookRequest { cases: vec!["t01-01".to_owned()], ..BookRequest::default() };
        let text = serde_json::to_string(&asked).unwrap();
        fs::write(&request, &text[1..]).unwrap();
        let damaged = format!("{:#}", run(&args).unwrap_err());
        assert!(damaged.contains("request.json is no request for a case book: "), "{damaged}");
        assert!(!out.exists());
        fs::write(&request, &text).unwrap();
        for _ in 0..2 {
            run(&args).unwrap();
            let names = fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name());
            let mut names: Vec<_> = names.collect();
            names.sort();
            assert_eq!(names, [CASE_BOOK_FILE, DEMONSTRATIONS_FILE]);
        }
        let book = BookFile::<CaseBook>::read(&out.join(CASE_BOOK_FILE)).unwrap().book;
        let demonstrations = out.join(DEMONSTRATIONS_FILE);
        let demonstrations = BookFile::<DemonstrationBook>::read(&demonstrations).unwrap().book;
        assert_eq!(book.cases.len(), demonstrations.cases.len());
    }
}
