//! Reads assets: text files that people edit.

use std::path::Path;

/// Why an asset cannot be used. The message names the file, the place in it and what is expected there.
#[derive(Debug, thiserror::Error)]
pub enum AssetError {
    /// The file cannot be read.
    #[error("cannot read {file}: {source}")]
    Unreadable {
        /// The file's path.
        file: String,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The content is invalid.
    #[error("{file}: {problem}")]
    Invalid {
        /// The file's path, or its name if it is compiled in.
        file: String,
        /// What is wrong, with the value, and what is expected.
        problem: String,
    },
}

/// What is wrong with a text. The caller knows the file.
pub(crate) type Problem = String;

/// Reads `path` as text.
pub(crate) fn read(path: &Path) -> Result<String, AssetError> {
    durable::input::read_text(path)
        .map_err(|source| AssetError::Unreadable { file: path.display().to_string(), source })
}

/// Adds the file's name to a problem with its text.
pub(crate) fn invalid(file: impl ToString) -> impl FnOnce(Problem) -> AssetError {
    move |problem| AssetError::Invalid { file: file.to_string(), problem }
}

/// Parses TOML. The problem contains the line, the offending text and the known keys.
pub(crate) fn toml<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, Problem> {
    toml::from_str(text).map_err(|error| error.to_string().trim_end().to_owned())
}
