//! Readers of received bytes without a queue, for the fuzz targets in `tests/fuzz`. Not part of the wire.

use domain::{DocumentKind, UnknownCode};

use crate::banks::{BankHeader, BankWords};
use crate::documents::Content;

/// The content of a received document.
///
/// # Errors
/// When the bytes are not of this kind.
pub fn document(kind: DocumentKind, bytes: &[u8]) -> Result<Content, UnknownCode> {
    Content::read(kind, bytes)
}

/// The bytes of a document as they are sent.
pub fn document_bytes(content: &Content) -> &[u8] {
    content.bytes()
}

/// Checks a received bank.
///
/// # Errors
/// When its parts do not lie within the words.
pub fn check_bank(header: &BankHeader, words: &[u64]) -> Result<(), UnknownCode> {
    BankWords { header, words }.check().map(drop)
}
