//! Stored results: `bench.json`, which later versions read for comparison.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};
use orchestrator::machine::Machine;
use serde::{Deserialize, Serialize};

use crate::figure::Measurement;

/// Version of the format.
pub const SCHEMA: u32 = 1;

/// File name.
pub const FILE: &str = "bench.json";

/// Results of all benches on one machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// [`SCHEMA`] of the writer.
    pub schema: u32,
    /// The machine.
    pub machine: Machine,
    /// Each bench that ran, in order.
    pub benches: Vec<BenchOutcome>,
}

/// Result of one bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchOutcome {
    /// Name of the bench.
    pub name: String,
    /// What it measures.
    pub about: String,
    /// Start time, as an HTTP date.
    pub began: String,
    /// Measured commit, followed by `+` if files had been changed since.
    pub commit: Option<String>,
    /// Duration in seconds.
    pub seconds: f64,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<String>,
    /// Its figures.
    pub figures: Vec<Measurement>,
}

impl Results {
    /// No results yet, on this machine.
    pub fn here() -> Self {
        Self { schema: SCHEMA, machine: Machine::here(), benches: Vec::new() }
    }

    /// Adds the result of a bench, replacing an earlier one of the same bench.
    pub fn add(&mut self, outcome: BenchOutcome) {
        match self.benches.iter_mut().find(|known| known.name == outcome.name) {
            Some(known) => *known = outcome,
            None => self.benches.push(outcome),
        }
    }

    /// Every figure, in order.
    pub fn figures(&self) -> impl Iterator<Item = &Measurement> {
        self.benches.iter().flat_map(|outcome| &outcome.figures)
    }

    /// Reads results from a file.
    ///
    /// # Errors
    /// When the file cannot be read or has another version.
    pub fn read(path: &Path) -> Result<Self> {
        let text =
            fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        let value: serde_json::Value = serde_json::from_str(&text)
            .with_context(|| format!("{} is not JSON", path.display()))?;
        match value.get("schema").and_then(serde_json::Value::as_u64) {
            Some(schema) if schema == u64::from(SCHEMA) => {}
            Some(schema) => bail!(
                "{} has version {schema} of the format and this program reads {SCHEMA}; measure again",
                path.display()
            ),
            None => bail!("{} does not hold bench results", path.display()),
        }
        serde_json::from_value(value).with_context(|| format!("{} is not valid", path.display()))
    }

    /// Writes the results into the folder `dir`, atomically.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn write(&self, dir: &Path) -> Result<()> {
        let text =
            serde_json::to_string_pretty(self).context("cannot serialise the results")? + "\n";
        write_whole(&dir.join(FILE), &text)
    }
}

/// Replaces a file atomically.
pub(crate) fn write_whole(path: &Path, text: &str) -> Result<()> {
    let draft = path.with_extension("new");
    fs::write(&draft, text)
        .and_then(|()| fs::rename(&draft, path))
        .with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{Better, FigureBound};

    #[test]
    fn results_round_trip_and_other_files_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let figure = Measurement::new("hop", "a hop", "ns", Better::Lower)
            .ours([250.0, 260.0])
            .baseline("iceoryx2", "0.10", [240.0, 250.0])
            .target(FigureBound::Ratio(1.5), "within 1.5 x")
            .parameter("bytes", 40);
        let mut results = Results::here();
        let outcome = |figures| BenchOutcome {
            name: "hop".to_owned(),
            about: "hops".to_owned(),
            began: "now".to_owned(),
            commit: None,
            seconds: 1.0,
            error: None,
            figures,
        };
        results.add(outcome(Vec::new()));
        results.add(outcome(vec![figure]));
        assert_eq!(results.benches.len(), 1, "the later one counts");
        assert_eq!(results.figures().next().and_then(Measurement::meets_target), Some(true));
        results.write(dir.path()).unwrap();
        let path = dir.path().join(FILE);
        assert_eq!(Results::read(&path).unwrap(), results);

        let text = fs::read_to_string(&path).unwrap();
        for (broken, said) in [
            (text.replace("\"schema\": 1", "\"schema\": 2"), "has version 2"),
            ("{}".to_owned(), "does not hold bench results"),
            ("x".to_owned(), "is not JSON"),
            (text.replace("\"lower\"", "\"below\""), "is not valid"),
        ] {
            fs::write(&path, broken).unwrap();
            let error = Results::read(&path).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
