//! What benches measure: one table for the reader, one JSON file for other programs.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use orchestrator::machine::Machine;
use serde::Serialize;

/// A measured quantity, usually beside that of another program.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measurement {
    /// Unique among all benches, and begins with the name of its bench.
    pub id: String,
    /// What is measured, in a few words.
    pub description: String,
    /// Unit of all values: `us`, `steps/s`.
    pub unit: &'static str,
    /// Our values, one for each round.
    pub ours: Vec<f64>,
    /// The values of the program to compare with.
    pub baseline: Option<BaselineValues>,
    /// What the median should reach.
    pub target: Option<Target>,
    /// Parameters of the measurement: sizes, threads.
    pub parameters: BTreeMap<&'static str, String>,
}

/// The values of another program, or of a lower bound, in the same rounds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BaselineValues {
    /// Name and version.
    pub name: String,
    /// One value for each round.
    pub values: Vec<f64>,
}

/// What the median of the rounds should reach.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// Our value is at most so many times the baseline's.
    RatioAtMost(f64),
    /// Our value is at least so many times the baseline's.
    RatioAtLeast(f64),
    /// Our value is at most this.
    AtMost(f64),
}

impl Measurement {
    /// A measurement of ours, with one value for each round.
    pub fn new(
        id: impl Into<String>,
        description: impl Into<String>,
        unit: &'static str,
        ours: Vec<f64>,
    ) -> Self {
        let (id, description, parameters) = (id.into(), description.into(), BTreeMap::new());
        Self { id, description, unit, ours, baseline: None, target: None, parameters }
    }

    /// Sets the values of a baseline in the same rounds; without values, there is no baseline.
    #[must_use]
    pub fn beside(mut self, name: impl Into<String>, values: Vec<f64>) -> Self {
        self.baseline = (!values.is_empty()).then(|| BaselineValues { name: name.into(), values });
        self
    }

    /// Sets the target.
    #[must_use]
    pub fn target(self, target: Target) -> Self {
        Self { target: Some(target), ..self }
    }

    /// Adds a parameter.
    #[must_use]
    pub fn parameter(mut self, name: &'static str, value: impl ToString) -> Self {
        self.parameters.insert(name, value.to_string());
        self
    }

    /// Our values divided by the baseline's, for each round.
    fn ratios(&self) -> Vec<f64> {
        let baseline = self.baseline.iter().flat_map(|baseline| &baseline.values);
        self.ours.iter().zip(baseline).map(|(ours, theirs)| ours / theirs).collect()
    }

    /// Whether the median meets the target; `None` without a target or without the values it needs.
    pub fn meets_target(&self) -> Option<bool> {
        Some(match self.target? {
            Target::RatioAtMost(bound) => median(&self.ratios())? <= bound,
            Target::RatioAtLeast(bound) => median(&self.ratios())? >= bound,
            Target::AtMost(bound) => median(&self.ours)? <= bound,
        })
    }

    /// The cells of its row in the table.
    fn row(&self) -> [String; 6] {
        let baseline = self.baseline.as_ref();
        let target = match self.target {
            None => String::new(),
            Some(Target::RatioAtMost(bound)) => format!("at most {bound} x"),
            Some(Target::RatioAtLeast(bound)) => format!("at least {bound} x"),
            Some(Target::AtMost(bound)) => format!("at most {bound} {}", self.unit),
        };
        let missed = if self.meets_target() == Some(false) { ", missed" } else { "" };
        [
            self.description.clone(),
            with_range(&self.ours, self.unit),
            baseline.map_or_else(String::new, |baseline| baseline.name.clone()),
            baseline.map_or_else(String::new, |baseline| with_range(&baseline.values, self.unit)),
            with_range(&self.ratios(), ""),
            target + missed,
        ]
    }
}

/// The median; `None` of no values.
pub fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let lower = sorted.get(sorted.len().checked_sub(1)? / 2)?;
    Some(f64::midpoint(*lower, sorted[sorted.len() / 2]))
}

/// The median with its unit, and the range of several values.
fn with_range(values: &[f64], unit: &str) -> String {
    let Some(median) = median(values) else { return String::new() };
    let text = format!("{} {unit}", significant(median));
    if values.len() == 1 {
        return text.trim_end().to_owned();
    }
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let greatest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    format!("{} ({} to {})", text.trim_end(), significant(least), significant(greatest))
}

/// A number with two or three significant digits, or all digits of a large one.
fn significant(value: f64) -> String {
    let digits = match value.abs() {
        size if size >= 100.0 => 0,
        size if size >= 10.0 => 1,
        size if size >= 0.1 => 2,
        _ => 4,
    };
    format!("{value:.digits$}")
}

/// The results of one bench.
#[derive(Debug, Serialize)]
pub struct BenchOutcome {
    /// Name of the bench.
    pub name: &'static str,
    /// Duration in seconds.
    pub seconds: f64,
    /// Why it failed.
    pub error: Option<String>,
    /// What it measured.
    pub measurements: Vec<Measurement>,
}

/// The results of all benches on one machine. Displayed as a table, in Markdown.
#[derive(Debug, Serialize)]
pub struct Results {
    /// The machine.
    pub machine: Machine,
    /// The commit of the programs, followed by `+` if files had been changed since.
    pub commit: Option<&'static str>,
    /// Each bench, in order.
    pub benches: Vec<BenchOutcome>,
}

impl Results {
    /// Writes the results as JSON.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).context("cannot serialise the results")?;
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)
                .with_context(|| format!("cannot create {}", folder.display()))?;
        }
        fs::write(path, text + "\n").with_context(|| format!("cannot write {}", path.display()))
    }
}

impl fmt::Display for Results {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rows = vec![
            ["measurement", "ours", "beside", "its value", "ratio", "target"].map(str::to_owned),
        ];
        rows.push([const { String::new() }; 6]);
        let measurements = self.benches.iter().flat_map(|outcome| &outcome.measurements);
        rows.extend(measurements.map(Measurement::row));
        let width = |column: usize| {
            rows.iter().map(|row| row[column].chars().count()).max().unwrap_or_default()
        };
        let widths = [0, 1, 2, 3, 4, 5].map(width);
        for (number, row) in rows.iter().enumerate() {
            let fill = if number == 1 { '-' } else { ' ' };
            for (cell, width) in row.iter().zip(widths) {
                let padding = width - cell.chars().count();
                write!(f, "| {cell}{} ", fill.to_string().repeat(padding))?;
            }
            writeln!(f, "|")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hop(ours: [f64; 3]) -> Measurement {
        Measurement::new("hop.one-way", "a hop", "ns", ours.to_vec())
    }

    #[test]
    fn ratios_are_taken_for_each_round_and_the_median_counts() {
        let beside = |ours| hop(ours).beside("iceoryx2", vec![10.0, 10.0, 20.0]);
        let meets = |target| beside([10.0, 40.0, 40.0]).target(target).meets_target();
        assert_eq!(meets(Target::RatioAtMost(2.0)), Some(true));
        assert_eq!(meets(Target::RatioAtMost(1.9)), Some(false));
        assert_eq!(meets(Target::RatioAtLeast(2.1)), Some(false));
        assert_eq!(meets(Target::AtMost(40.0)), Some(true));
        assert_eq!(hop([1.0; 3]).target(Target::RatioAtMost(2.0)).meets_target(), None);
        assert_eq!(median(&[4.0, 1.0]), Some(2.5));
        assert_eq!(median(&[]), None);
    }

    #[test]
    fn the_table_shows_the_median_and_range_and_says_what_missed_its_target() {
        let measurements = vec![
            hop([500.0, 510.0, 490.0])
                .beside("iceoryx2", vec![200.0; 3])
                .target(Target::RatioAtMost(1.5)),
            Measurement::new("suite.warm", "the suite", "s", vec![31.25])
                .target(Target::AtMost(60.0)),
        ];
        let outcome = BenchOutcome { name: "hop", seconds: 1.0, error: None, measurements };
        let results = Results { machine: Machine::default(), commit: None, benches: vec![outcome] };
        let table = "\
| measurement | ours                | beside   | its value           | ratio               | target                |
| ----------- | ------------------- | -------- | ------------------- | ------------------- | --------------------- |
| a hop       | 500 ns (490 to 510) | iceoryx2 | 200 ns (200 to 200) | 2.50 (2.45 to 2.55) | at most 1.5 x, missed |
| the suite   | 31.2 s              |          |                     |                     | at most 60 s          |
";
        assert_eq!(results.to_string(), table);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("target/bench.json");
        results.write(&path).unwrap();
        let json: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
        let first = &json["benches"][0]["measurements"][0];
        assert_eq!(first["baseline"]["values"][2], 200.0);
        assert_eq!(first["target"]["ratio_at_most"], 1.5);
    }
}
