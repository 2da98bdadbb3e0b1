//! How a chat model is asked, where servers and models differ.

use std::fmt;
use std::str::FromStr;

use crate::names::{named, serde_as_text};

named! {
    /// What a request says about reasoning before the answer.
    ReasoningRequest, "reasoning" {
        /// Not to reason, in every way that servers know.
        Off = "off",
        /// Nothing: the model does as it does by itself.
        Model = "model",
        /// As little as possible.
        Minimal = "minimal",
        /// Little.
        Low = "low",
        /// The usual amount.
        Medium = "medium",
        /// Much.
        High = "high",
    }

    /// How the rules of a conversation are sent.
    SystemRole, "system role" {
        /// As a message of the system.
        System = "system",
        /// As a message of the developer, as newer models of OpenAI call it.
        Developer = "developer",
        /// At the beginning of the user's message, for models that know no other role.
        User = "user",
    }

    /// How the images of a request are encoded.
    ImageFormat, "image format" {
        /// Without loss.
        Png = "png",
        /// Smaller, with a little loss.
        Jpeg = "jpeg",
    }
}

/// Fields of a request that a run sets itself.
pub const REQUEST_FIELDS: [&str; 4] = ["model", "messages", "stream", "n"];

/// The variable of further headers of requests, one a line, which may hold keys.
pub const HEADER_VARIABLE: &str = "MEMTRANSFER_HEADER";

/// Variables that hold keys, which no program gets that asks no model.
pub const KEY_VARIABLES: [&str; 2] = ["OPENAI_API_KEY", HEADER_VARIABLE];

/// What stands for the value of a header where it is shown or stored.
const MASK: &str = "[key]";

/// A header of requests, `NAME: VALUE`. Its value may be a key: it is written and shown as a mask only.
#[derive(Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct SecretHeader {
    name: String,
    value: String,
}

impl SecretHeader {
    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its value; `None` where it was read from a place that has a mask only.
    pub fn value(&self) -> Option<&str> {
        (self.value != MASK).then_some(&*self.value)
    }

    /// The header with its value, as [`FromStr`] reads it.
    pub fn exposed(&self) -> String {
        format!("{}: {}", self.name, self.value)
    }

    /// The variable that gives `headers` to a child process: other users see the arguments of a process. One that is empty
    /// counts as not set.
    pub fn variable(headers: &[Self]) -> (&'static str, String) {
        let headers: Vec<String> = headers.iter().map(Self::exposed).collect();
        (HEADER_VARIABLE, headers.join("\n"))
    }
}

impl FromStr for SecretHeader {
    type Err = NoHeader;

    fn from_str(text: &str) -> Result<Self, NoHeader> {
        let (name, value) = text.split_once(':').ok_or(NoHeader)?;
        let (name, value) = (name.trim().to_owned(), value.trim().to_owned());
        if name.is_empty() || value.is_empty() { Err(NoHeader) } else { Ok(Self { name, value }) }
    }
}

/// A text that is no header. It is not repeated, since it may hold a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a header is written NAME: VALUE")]
pub struct NoHeader;

impl fmt::Display for SecretHeader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {MASK}", self.name)
    }
}

impl fmt::Debug for SecretHeader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SecretHeader({self})")
    }
}

serde_as_text!(SecretHeader);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_value_of_a_header_is_never_written() {
        let header: SecretHeader = " X-Key : a: b ".parse().unwrap();
        assert_eq!((header.name(), header.value()), ("X-Key", Some("a: b")));
        assert_eq!(header.exposed(), "X-Key: a: b");
        let written = serde_json::to_string(&header).unwrap();
        assert_eq!(written, r#""X-Key: [key]""#);
        assert_eq!(format!("{header} {header:?}"), "X-Key: [key] SecretHeader(X-Key: [key])");
        let read: SecretHeader = serde_json::from_str(&written).unwrap();
        assert_eq!(read.value(), None);
        for text in ["X-Key", "X-Key:", ": b"] {
            assert_eq!(text.parse::<SecretHeader>(), Err(NoHeader));
        }
    }
}
