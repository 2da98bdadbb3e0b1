//! Documents of the extractive builder.

use std::path::Path;

use case_book::BookRequest;
use documents::Sources;
use domain::{Appearance, Demonstrations, DocumentKind};
use memory_proc::builders::{DocumentBuilder, Extractive};
use warehouse::case_book::write_books;

/// The document of `kind`, built from `demonstrations` of all cases.
pub(crate) fn document(kind: DocumentKind, demonstrations: Demonstrations) -> String {
    let book = write_books(&BookRequest::default()).unwrap().demonstrations;
    let sources = Sources::new(book, 448, Appearance::STANDARD);
    let (world, listed) = (&sources.book().world, sources.demonstrations(demonstrations));
    Extractive.build(kind, world, &listed, Path::new(""), &mut |_, _| ()).unwrap().text
}
