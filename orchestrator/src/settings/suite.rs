//! Suites: settings as a file, shipped or the user's own.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::Layer;
use crate::names::{UnknownName, nearest};

const SHIPPED: &[(&str, &str)] = &[("quick", include_str!("../../../assets/suites/quick.toml"))];

/// A suite as it is asked for: a name, or the path of a file if it has a slash or ends in `.toml`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SuiteName(String);

impl SuiteName {
    /// The suite that runs unless another is asked for.
    pub fn quick() -> Self {
        Self("quick".to_owned())
    }

    /// The file it names, if it names one.
    fn file(&self) -> Option<&Path> {
        let is_path = self.0.contains('/') || self.0.ends_with(".toml");
        is_path.then(|| Path::new(&self.0))
    }

    /// One word for it: the name, or the file's without folder and ending.
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

/// Why a suite cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SuiteError {
    /// No suite has the name.
    #[error("{0}; a file is named by its path, for example ./my-suite.toml")]
    Unknown(UnknownName),
    /// The file cannot be read.
    #[error("cannot read suite {}: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A key that no suite has.
    #[error("suite {file}: unknown key `{key}`{}", nearest(key, known).map_or_else(
        || format!(" (known: {})", known.join(", ")),
        |nearest| format!(": did you mean `{nearest}`?")
    ))]
    UnknownKey {
        /// The file, or the name of a shipped suite.
        file: String,
        /// The key.
        key: String,
        /// Every key there is.
        known: Vec<String>,
    },
    /// A value that cannot be.
    #[error("suite {file}: {problem}")]
    Invalid {
        /// The file, or the name of a shipped suite.
        file: String,
        /// The place, the value and what was expected.
        problem: String,
    },
}

/// The shipped suites by name, each with its text.
pub fn shipped_suites() -> &'static [(&'static str, &'static str)] {
    SHIPPED
}

/// Reads a suite: a file by its path, else `suites/<name>.toml` below `assets`, else a shipped one.
///
/// # Errors
/// When there is none of that name, or the file cannot be read or says something it cannot.
pub fn load_suite(suite: &SuiteName, assets: Option<&Path>) -> Result<Layer, SuiteError> {
    let read = |path: &Path| {
        let unreadable = |source| SuiteError::Unreadable { path: path.to_owned(), source };
        std::fs::read_to_string(path).map_err(unreadable)
    };
    if let Some(path) = suite.file() {
        return parse(&path.display().to_string(), &read(path)?);
    }
    let own = assets.map(|dir| dir.join("suites").join(format!("{suite}.toml")));
    if let Some(path) = own.filter(|path| path.exists()) {
        return parse(&path.display().to_string(), &read(&path)?);
    }
    match SHIPPED.iter().find(|(name, _)| *name == suite.0) {
        Some((name, text)) => parse(name, text),
        None => {
            let known = SHIPPED.iter().map(|(name, _)| *name);
            Err(SuiteError::Unknown(UnknownName::new("suite", &suite.0, known)))
        }
    }
}

fn parse(file: &str, text: &str) -> Result<Layer, SuiteError> {
    let file = file.to_owned();
    let invalid = |error: toml::de::Error| SuiteError::Invalid {
        file: file.clone(),
        problem: error.to_string().trim_end().to_owned(),
    };
    // Unknown keys first: the message that names the nearest one beats the parser's list of all.
    let mut known = Layer::keys();
    known.retain(|key| key != "suite");
    let table: toml::Table = text.parse().map_err(invalid)?;
    if let Some(key) = table.keys().find(|key| !known.contains(key)) {
        return Err(SuiteError::UnknownKey { file, key: key.clone(), known });
    }
    toml::from_str(text).map_err(invalid)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_suites_can_be_read() {
        for (name, _) in shipped_suites() {
            load_suite(&SuiteName((*name).to_owned()), None).unwrap();
        }
    }

    #[test]
    fn what_is_wrong_with_a_suite_is_said_with_its_file() {
        let error = |text: &str| parse("my.toml", text).unwrap_err().to_string();
        insta::assert_snapshot!(error("memry = []"), @"suite my.toml: unknown key `memry`: did you mean `memory`?");
        insta::assert_snapshot!(error("runs = 1\nmemory = [\"episodik\"]"), @r#"
        suite my.toml: TOML parse error at line 2, column 10
          |
        2 | memory = ["episodik"]
          |          ^^^^^^^^^^^^
        unknown memory `episodik`: did you mean `episodic`? (known: working, full-context, summary, semantic, hybrid, episodic)
        "#);
        // A suite cannot name a suite.
        assert!(error("suite = \"quick\"").contains("unknown key `suite`"));
        let error = load_suite(&SuiteName("quik".to_owned()), None).unwrap_err();
        insta::assert_snapshot!(error, @"unknown suite `quik`: did you mean `quick`? (known: quick); a file is named by its path, for example ./my-suite.toml");
    }

    #[test]
    fn a_folder_of_assets_can_bring_its_own_suites() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("suites")).unwrap();
        std::fs::write(dir.path().join("suites/quick.toml"), "runs = 7").unwrap();
        let layer = load_suite(&SuiteName::quick(), Some(dir.path())).unwrap();
        assert_eq!(layer, Layer { runs: Some(7), ..Layer::default() });
    }
}
