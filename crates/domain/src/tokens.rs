//! How many tokens texts and images have, before any server has counted them.

/// Characters of English prose per token.
pub const PROSE: f64 = 4.0;

/// Characters of a document per token: coordinates make short tokens. A summary of 42,136 characters has 18,700.
pub const DOCUMENT: f64 = 2.3;

/// Tokens of an image of the default size (specification, section 2).
pub const IMAGE: u64 = 256;

/// The tokens of `prose` characters of prose and `document` characters of documents, rounded up.
pub fn of_text(prose: u64, document: u64) -> u64 {
    (prose as f64 / PROSE + document as f64 / DOCUMENT).ceil() as u64
}
