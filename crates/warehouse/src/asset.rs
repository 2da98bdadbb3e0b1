//! Reading an asset: a text file that people edit, and hence can break.

use std::path::Path;

/// Why an asset cannot be used. The message names the file, the place in it and what would be right.
#[derive(Debug, thiserror::Error)]
pub enum AssetError {
    /// The file could not be read at all.
    #[error("cannot read {file}: {source}")]
    Unreadable {
        /// The file's path.
        file: String,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file was read but says something that cannot be.
    #[error("{file}: {problem}")]
    Invalid {
        /// The file's path, or its name where it was compiled in.
        file: String,
        /// What is wrong, with the value, and what would be right.
        problem: String,
    },
}

/// What is wrong with a text whose file is known to the caller only.
pub(crate) type Problem = String;

/// Reads `path` as text.
pub(crate) fn read(path: &Path) -> Result<String, AssetError> {
    std::fs::read_to_string(path)
        .map_err(|source| AssetError::Unreadable { file: path.display().to_string(), source })
}

/// Puts the file's name before a problem found in its text.
pub(crate) fn invalid(file: impl ToString) -> impl FnOnce(Problem) -> AssetError {
    move |problem| AssetError::Invalid { file: file.to_string(), problem }
}

/// Parses TOML; the problem carries the line, the offending text and the known keys.
pub(crate) fn toml<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, Problem> {
    toml::from_str(text).map_err(|error| error.to_string().trim_end().to_owned())
}
