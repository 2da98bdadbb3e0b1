//! Case books for tests, written in this process.

use case_book::{BookFile, BookRequest};
use conditions::settings::RunSettings;
use settings::{Layer, resolve};
use warehouse::case_book::write_books;

use crate::books::Books;
use crate::selection::SelectedCases;

/// What `settings` select.
pub(crate) fn select(settings: &RunSettings) -> SelectedCases {
    let write = |request: &BookRequest| {
        let books = write_books(request)?;
        Ok(Books {
            cases: BookFile::new(books.cases)?,
            demonstrations: BookFile::new(books.demonstrations)?,
            streams: books.streams,
            elsewhere: books.elsewhere,
        })
    };
    SelectedCases::written_by(write, settings).unwrap()
}

/// What settings with these flags select.
pub(crate) fn selected(flags: &[(&str, &str)]) -> SelectedCases {
    let layer = Layer::flags(flags.iter().copied()).unwrap();
    select(&resolve([layer]).unwrap().settings)
}
