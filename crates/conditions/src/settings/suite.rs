//! Names of suites.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A suite as the user names it: a name, or the path of a file if it has a slash or ends in `.toml`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SuiteName(String);

impl SuiteName {
    /// The suite that runs by default.
    pub fn quick() -> Self {
        Self("quick".to_owned())
    }

    /// The name or path as given.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The path, if it is one.
    pub fn file(&self) -> Option<&Path> {
        let is_path = self.0.contains('/') || self.0.ends_with(".toml");
        is_path.then(|| Path::new(&self.0))
    }

    /// The name, or the file's name without folder and extension.
    pub fn word(&self) -> &str {
        self.file().and_then(Path::file_stem).and_then(|stem| stem.to_str()).unwrap_or(&self.0)
    }
}

impl FromStr for SuiteName {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(Self(text.to_owned()))
    }
}

impl fmt::Display for SuiteName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}
