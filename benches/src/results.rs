//! Results as they are kept: `bench.json`, a format that later versions read for comparison.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};
use orchestrator::machine::Machine;
use serde::{Deserialize, Serialize};

use crate::figure::{Figure, Summary};

/// The version of the format.
pub const SCHEMA: u32 = 1;

/// The file's name.
pub const FILE: &str = "bench.json";

/// What was measured, where, and when.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// [`SCHEMA`] of the writer.
    pub schema: u32,
    /// The machine.
    pub machine: Machine,
    /// Each bench that ran, in order.
    pub benches: Vec<Outcome>,
}

/// What came of a bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Its name.
    pub name: String,
    /// What it measures.
    pub about: String,
    /// When it began, as in HTTP.
    pub began: String,
    /// The commit that was measured; with a `+` where files had been changed since.
    pub commit: Option<String>,
    /// Seconds that it took.
    pub seconds: f64,
    /// Why it failed, if it did.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<String>,
    /// Its figures.
    pub figures: Vec<Measured>,
}

/// A figure, and what its rounds came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The figure.
    #[serde(flatten)]
    pub figure: Figure,
    /// Our rounds.
    pub summary: Option<Summary>,
    /// The peer's.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub peer_summary: Option<Summary>,
    /// Ours divided by the peer's, round by round.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ratio: Option<Summary>,
    /// Whether the target is met by the median.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub meets_target: Option<bool>,
}

impl From<Figure> for Measured {
    fn from(figure: Figure) -> Self {
        Self {
            summary: figure.summary(),
            peer_summary: figure.peer_summary(),
            ratio: figure.ratio(),
            meets_target: figure.meets_target(),
            figure,
        }
    }
}

impl Results {
    /// Nothing yet, on this machine.
    pub fn here() -> Self {
        Self { schema: SCHEMA, machine: Machine::here(), benches: Vec::new() }
    }

    /// Adds what came of a bench; replaces what came of it before.
    pub fn add(&mut self, outcome: Outcome) {
        match self.benches.iter_mut().find(|known| known.name == outcome.name) {
            Some(known) => *known = outcome,
            None => self.benches.push(outcome),
        }
    }

    /// What came of the bench called `name`.
    pub fn of(&self, name: &str) -> Option<&Outcome> {
        self.benches.iter().find(|outcome| outcome.name == name)
    }

    /// Every figure, in order.
    pub fn figures(&self) -> impl Iterator<Item = &Measured> {
        self.benches.iter().flat_map(|outcome| &outcome.figures)
    }

    /// Reads them.
    ///
    /// # Errors
    /// When the file cannot be read, or is of another version.
    pub fn read(path: &Path) -> Result<Self> {
        let text =
            fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        let value: serde_json::Value = serde_json::from_str(&text)
            .with_context(|| format!("{} is no JSON", path.display()))?;
        match value.get("schema").and_then(serde_json::Value::as_u64) {
            Some(schema) if schema == u64::from(SCHEMA) => {}
            Some(schema) => bail!(
                "{} has version {schema} of the format and this program reads {SCHEMA}: measure anew",
                path.display()
            ),
            None => bail!("{} holds no results of benches", path.display()),
        }
        serde_json::from_value(value)
            .with_context(|| format!("{} cannot be understood", path.display()))
    }

    /// Writes them into the folder `dir`, all of them or nothing.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn write(&self, dir: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).context("results cannot be written")? + "\n";
        write_whole(&dir.join(FILE), &text)
    }
}

/// Writes a file at once: what was there stays until all of it is there.
pub(crate) fn write_whole(path: &Path, text: &str) -> Result<()> {
    let draft = path.with_extension("new");
    fs::write(&draft, text)
        .and_then(|()| fs::rename(&draft, path))
        .with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{Better, Bound};

    #[test]
    fn what_is_written_is_read_and_other_files_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let figure = Figure::new("hop", "a hop", "ns", Better::Lower)
            .ours([250.0, 260.0])
            .peer("iceoryx2", "0.10", [240.0, 250.0])
            .target(Bound::Ratio(1.5), "within 1.5 x")
            .parameter("bytes", 40)
            .point("p", "l", "bytes", 40.0);
        let mut results = Results::here();
        let outcome = |figures| Outcome {
            name: "hop".to_owned(),
            about: "hops".to_owned(),
            began: "now".to_owned(),
            commit: None,
            seconds: 1.0,
            error: None,
            figures,
        };
        results.add(outcome(Vec::new()));
        results.add(outcome(vec![figure.into()]));
        assert_eq!(results.benches.len(), 1, "the later one counts");
        assert_eq!(results.figures().next().and_then(|f| f.meets_target), Some(true));
        results.write(dir.path()).unwrap();
        let path = dir.path().join(FILE);
        assert_eq!(Results::read(&path).unwrap(), results);

        let text = fs::read_to_string(&path).unwrap();
        for (broken, said) in [
            (text.replace("\"schema\": 1", "\"schema\": 2"), "has version 2"),
            ("{}".to_owned(), "holds no results"),
            ("x".to_owned(), "is no JSON"),
            (text.replace("\"lower\"", "\"below\""), "cannot be understood"),
        ] {
            fs::write(&path, broken).unwrap();
            let error = Results::read(&path).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
