//! Suites: settings as a file, shipped or the user's own.

use std::path::{Path, PathBuf};

use results::names::{UnknownName, nearest};
use results::settings::SuiteName;

use super::{GROUP_KEYS, Layer};

/// The shipped suites, in the order in which they are listed.
macro_rules! shipped {
    ($($name:literal)*) => {
        &[$(($name, include_str!(concat!("../../../assets/suites/", $name, ".toml")))),*]
    };
}

const SHIPPED: &[(&str, &str)] = shipped!("quick" "rq1" "rq2" "rq3" "design" "paper");

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
    #[error("suite {file}: unknown key `{key}`{place}{}", nearest(key, known).map_or_else(
        || format!(" (known: {})", known.join(", ")),
        |nearest| format!(": did you mean `{nearest}`?")
    ))]
    UnknownKey {
        /// The file, or the name of a shipped suite.
        file: String,
        /// The key.
        key: String,
        /// Where, unless at the top level: ` in group 2`.
        place: String,
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
    match SHIPPED.iter().find(|(name, _)| *name == suite.as_str()) {
        Some((name, text)) => parse(name, text),
        None => {
            let known = SHIPPED.iter().map(|(name, _)| *name);
            Err(SuiteError::Unknown(UnknownName::new("suite", suite.as_str(), known)))
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
    let table: toml::Table = text.parse().map_err(invalid)?;
    let unknown = |table: &toml::Table, known: Vec<String>, place: String| {
        let key = table.keys().find(|key| !known.contains(key))?.clone();
        Some(SuiteError::UnknownKey { file: file.clone(), key, place, known })
    };
    let mut known = Layer::keys();
    known.retain(|key| key != "suite");
    known.push("group".to_owned());
    let in_group: Vec<String> =
        ["name"].iter().chain(GROUP_KEYS).map(|key| (*key).to_owned()).collect();
    let groups = table.get("group").and_then(toml::Value::as_array).into_iter().flatten();
    let groups: Vec<&toml::Table> = groups.filter_map(toml::Value::as_table).collect();
    let found = unknown(&table, known, String::new()).or_else(|| {
        let mut groups = (1..).zip(&groups);
        groups.find_map(|(n, group)| unknown(group, in_group.clone(), format!(" in group {n}")))
    });
    if let Some(error) = found {
        return Err(error);
    }
    let mut names: Vec<Option<&str>> =
        groups.iter().map(|group| group.get("name").and_then(toml::Value::as_str)).collect();
    names.sort_unstable();
    if names.contains(&None) || names.windows(2).any(|pair| pair[0] == pair[1]) {
        let problem = "every [[group]] needs a `name` of its own".to_owned();
        return Err(SuiteError::Invalid { file: file.clone(), problem });
    }
    toml::from_str(text).map_err(invalid)
}

#[cfg(test)]
mod tests;
