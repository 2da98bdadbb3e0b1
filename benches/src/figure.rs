//! Figures: one value per round, with the baseline's value of the same round.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Direction of improvement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// Larger is better.
    Higher,
    /// Smaller is better.
    Lower,
}

/// A measured quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// Unique over all benches and stable between runs; figures are compared by it.
    pub id: String,
    /// Description.
    pub what: String,
    /// Unit: `us`, `steps/s`.
    pub unit: String,
    /// Direction of improvement.
    pub better: Better,
    /// Our values, one per round.
    pub ours: Vec<f64>,
    /// The baseline's values.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub baseline: Option<BaselineFigure>,
    /// Target.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub target: Option<Target>,
    /// Parameters of the measurement: sizes, threads, versions.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub parameters: BTreeMap<String, String>,
    /// A remark for the reader.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub note: Option<String>,
}

/// Values of a baseline in the same rounds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BaselineFigure {
    /// Name.
    pub name: String,
    /// Version.
    pub version: String,
    /// One value per round, in the order of `ours`.
    pub values: Vec<f64>,
}

/// A target of a figure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// The bound.
    pub bound: FigureBound,
    /// Text in the table.
    pub text: String,
}

/// A bound in the direction of improvement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FigureBound {
    /// On ours divided by the baseline's.
    Ratio(f64),
    /// On ours.
    Value(f64),
}

impl Measurement {
    /// Creates a figure without values.
    pub fn new(
        id: impl Into<String>,
        what: impl Into<String>,
        unit: impl Into<String>,
        better: Better,
    ) -> Self {
        Self {
            id: id.into(),
            what: what.into(),
            unit: unit.into(),
            better,
            ours: Vec::new(),
            baseline: None,
            target: None,
            parameters: BTreeMap::new(),
            note: None,
        }
    }

    /// Sets our values, one per round.
    #[must_use]
    pub fn ours(mut self, values: impl Into<Vec<f64>>) -> Self {
        self.ours = values.into();
        self
    }

    /// Sets the values of a baseline in the same rounds.
    #[must_use]
    pub fn baseline(
        mut self,
        name: impl Into<String>,
        version: impl Into<String>,
        values: impl Into<Vec<f64>>,
    ) -> Self {
        let (name, version, values) = (name.into(), version.into(), values.into());
        self.baseline = Some(BaselineFigure { name, version, values });
        self
    }

    /// Sets the target.
    #[must_use]
    pub fn target(mut self, bound: FigureBound, text: impl Into<String>) -> Self {
        self.target = Some(Target { bound, text: text.into() });
        self
    }

    /// Adds a parameter.
    #[must_use]
    pub fn parameter(mut self, name: impl Into<String>, value: impl ToString) -> Self {
        self.parameters.insert(name.into(), value.to_string());
        self
    }

    /// Sets the note.
    #[must_use]
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.note = Some(note.into());
        self
    }

    /// Summary of our rounds.
    pub fn summary(&self) -> Option<MeasurementSummary> {
        MeasurementSummary::of(&self.ours)
    }

    /// Summary of the baseline's rounds.
    pub fn baseline_summary(&self) -> Option<MeasurementSummary> {
        self.baseline.as_ref().and_then(|baseline| MeasurementSummary::of(&baseline.values))
    }

    /// Summary of ours divided by the baseline's, per round.
    pub fn ratio(&self) -> Option<MeasurementSummary> {
        let baseline = self.baseline.as_ref()?;
        let both = self.ours.iter().zip(&baseline.values);
        MeasurementSummary::of(&both.map(|(ours, theirs)| ours / theirs).collect::<Vec<_>>())
    }

    /// Whether the median meets the target; `None` without a target or without the values it needs.
    pub fn meets_target(&self) -> Option<bool> {
        let (found, bound) = match self.target.as_ref()?.bound {
            FigureBound::Ratio(bound) => (self.ratio()?.median, bound),
            FigureBound::Value(bound) => (self.summary()?.median, bound),
        };
        Some(match self.better {
            Better::Higher => found >= bound,
            Better::Lower => found <= bound,
        })
    }
}

/// Summary of a figure's rounds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MeasurementSummary {
    /// Median.
    pub median: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

impl MeasurementSummary {
    /// Summarises `values`; `None` when there are none or one is not finite.
    pub fn of(values: &[f64]) -> Option<Self> {
        if values.is_empty() || !values.iter().all(|value| value.is_finite()) {
            return None;
        }
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let upper = sorted[sorted.len() / 2];
        let lower = sorted[(sorted.len() - 1) / 2];
        Some(Self {
            median: f64::midpoint(lower, upper),
            min: sorted[0],
            max: sorted[sorted.len() - 1],
        })
    }
}

/// Formats a number with significant digits and thousands separators.
pub fn shown(value: f64) -> String {
    let digits = match value.abs() {
        size if size >= 100.0 || size == 0.0 => 0,
        size if size >= 10.0 => 1,
        size if size >= 0.1 => 2,
        _ => 4,
    };
    let text = format!("{:.digits$}", value.abs());
    let (whole, rest) = text.split_once('.').unwrap_or((&text, ""));
    let groups: Vec<&str> = whole
        .as_bytes()
        .rchunks(3)
        .rev()
        .map(|group| std::str::from_utf8(group).unwrap_or_default())
        .collect();
    let sign = if value < 0.0 { "-" } else { "" };
    let point = if rest.is_empty() { "" } else { "." };
    format!("{sign}{}{point}{rest}", groups.join(","))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_is_median_and_range() {
        let of = |values: &[f64]| MeasurementSummary::of(values).map(|s| (s.median, s.min, s.max));
        assert_eq!(of(&[3.0, 1.0, 2.0]), Some((2.0, 1.0, 3.0)));
        assert_eq!(of(&[4.0, 1.0]), Some((2.5, 1.0, 4.0)));
        assert_eq!((of(&[]), of(&[1.0, f64::NAN])), (None, None));
    }

    #[test]
    fn ratios_are_taken_per_round_and_targets_in_the_direction_of_improvement() {
        let figure = |better| {
            Measurement::new("f", "f", "us", better)
                .ours([10.0, 30.0, 20.0])
                .baseline("baseline", "1", [10.0, 10.0, 10.0])
                .target(FigureBound::Ratio(2.0), "within 2 x")
        };
        assert_eq!(figure(Better::Lower).ratio().map(|ratio| ratio.median), Some(2.0));
        assert_eq!(figure(Better::Lower).meets_target(), Some(true));
        assert_eq!(
            figure(Better::Higher).target(FigureBound::Value(21.0), "").meets_target(),
            Some(false)
        );
        assert_eq!(Measurement::new("f", "f", "us", Better::Lower).meets_target(), None);
    }

    #[test]
    fn numbers_are_shown_with_significant_digits() {
        for (value, text) in [
            (1_234_567.8, "1,234,568"),
            (999.6, "1,000"),
            (62.04, "62.0"),
            (1.5, "1.50"),
            (-0.25, "-0.25"),
            (0.0, "0"),
            (0.0012, "0.0012"),
        ] {
            assert_eq!(shown(value), text);
        }
    }
}
