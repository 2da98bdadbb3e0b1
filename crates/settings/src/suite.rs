//! Suites: settings in a file, shipped or the user's own.

use std::path::Path;

use anyhow::{Result, anyhow};
use results::names::UnknownName;
use results::settings::SuiteName;

use super::Layer;

macro_rules! shipped {
    ($($name:literal)*) => {
        &[$(($name, include_str!(concat!("../../../assets/suites/", $name, ".toml")))),*]
    };
}

/// The shipped suites by name, each with its text, in the order in which they are listed.
pub const SHIPPED_SUITES: &[(&str, &str)] =
    shipped!("quick" "rq1" "rq2" "rq3" "design" "paper" "stream" "growth" "conflict" "transfer");

/// Reads a suite: a file by its path, else `suites/<name>.toml` in `assets`, else a shipped one.
///
/// # Errors
/// When there is no such suite, the file cannot be read, or its content is invalid.
pub fn load_suite(suite: &SuiteName, assets: Option<&Path>) -> Result<Layer> {
    let read = |path: &Path| {
        durable::input::read_text(path)
            .map_err(|error| anyhow!("cannot read suite {}: {error}", path.display()))
            .and_then(|text| Layer::suite(&path.display().to_string(), &text))
    };
    if let Some(path) = suite.file() {
        return read(path);
    }
    let own = assets.map(|dir| dir.join("suites").join(format!("{suite}.toml")));
    if let Some(path) = own.filter(|path| path.exists()) {
        return read(&path);
    }
    let shipped = SHIPPED_SUITES.iter().find(|(name, _)| *name == suite.word());
    match shipped {
        Some((name, text)) => Layer::suite(name, text),
        None => {
            let known = SHIPPED_SUITES.iter().map(|(name, _)| *name);
            let unknown = UnknownName::new("suite", suite.word(), known);
            Err(anyhow!("{unknown}; a file is named by its path, for example ./my-suite.toml"))
        }
    }
}

#[cfg(test)]
mod tests;
