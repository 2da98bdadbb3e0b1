//! A file of the site: a page, a script, an image.

use anyhow::Result;
use serde::Serialize;

/// A file of the site.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct File {
    /// Its MIME type.
    pub kind: &'static str,
    /// Its content.
    pub bytes: Vec<u8>,
}

impl File {
    pub(crate) fn text(kind: &'static str, text: impl Into<Vec<u8>>) -> Self {
        Self { kind, bytes: text.into() }
    }

    /// A script that passes `value` to the front end as `name`.
    pub(crate) fn script(name: &str, value: &impl Serialize) -> Result<Self> {
        let (name, value) = (serde_json::to_string(name)?, serde_json::to_string(value)?);
        Ok(Self::text("text/javascript", format!("memtransfer.receive({name},{value});\n")))
    }
}
