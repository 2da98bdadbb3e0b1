//! Suites: settings in a file, shipped or the user's own.

use std::path::Path;

use anyhow::{Result, anyhow, ensure};
use conditions::settings::SuiteName;
use domain::names::UnknownName;

use super::Layer;

macro_rules! shipped {
    ($($name:literal)*) => {
        &[$(($name, include_str!(concat!("../../../assets/suites/", $name, ".toml")))),*]
    };
}

/// The shipped suites by name, each with its text, in the order in which they are listed.
pub const SHIPPED_SUITES: &[(&str, &str)] = shipped!("quick" "rq1" "rq2" "rq3" "design" "paper" "stream" "growth" "conflict" "transfer" "mismatch");

/// Reads a suite: a file by its path, else a shipped one, else `suites/<name>.toml` in `assets`. Assets do not replace a shipped
/// suite: another one of the same name is read only by its path.
///
/// # Errors
/// When there is no such suite, the file cannot be read, or its content is invalid; when `assets` have another suite of a shipped
/// one's name.
pub fn load_suite(suite: &SuiteName, assets: Option<&Path>) -> Result<Layer> {
    let read = |path: &Path| {
        durable::input::read_text(path)
            .map_err(|error| anyhow!("cannot read suite {}: {error}", path.display()))
    };
    let parse = |path: &Path, text: &str| Layer::suite(&path.display().to_string(), text);
    if let Some(path) = suite.file() {
        return parse(path, &read(path)?);
    }
    let own = assets.map(|dir| dir.join("suites").join(format!("{suite}.toml")));
    let own = match own.filter(|path| path.exists()) {
        Some(path) => Some((read(&path)?, path)),
        None => None,
    };
    let shipped = SHIPPED_SUITES.iter().find(|(name, _)| *name == suite.word());
    match (shipped, own) {
        (Some((name, text)), own) => {
            if let Some((other, path)) = own {
                let path = path.display();
                ensure!(
                    other == *text,
                    "{path} differs from the shipped suite `{name}`, and assets do not replace a shipped suite: name it by its \
                     path, --suite {path}, or give the file another name"
                );
            }
            Layer::suite(name, text)
        }
        (None, Some((text, path))) => parse(&path, &text),
        (None, None) => {
            let known = SHIPPED_SUITES.iter().map(|(name, _)| *name);
            let unknown = UnknownName::new("suite", suite.word(), known);
            Err(anyhow!("{unknown}; a file is named by its path, for example ./my-suite.toml"))
        }
    }
}

#[cfg(test)]
mod tests;
