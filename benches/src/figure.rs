//! What a bench gives: a figure with one value a round, and beside it the peer's.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Which way is good.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// More is better.
    Higher,
    /// Less is better.
    Lower,
}

/// Something that was measured, once a round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Unique over all benches, and the same from run to run: figures are compared by it.
    pub id: String,
    /// What was measured, for a reader.
    pub what: String,
    /// In what: `us`, `steps/s`.
    pub unit: String,
    /// Which way is good.
    pub better: Better,
    /// Ours, a value a round.
    pub ours: Vec<f64>,
    /// The peer's.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub peer: Option<PeerFigure>,
    /// What it should come to.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub target: Option<Target>,
    /// What decides the figure: sizes, threads, versions.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub parameters: BTreeMap<String, String>,
    /// What a reader must know about it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub note: Option<String>,
    /// Its place on a plot, where it is one point of a curve.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub point: Option<Point>,
}

/// What a peer came to, in the same rounds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PeerFigure {
    /// Its name.
    pub name: String,
    /// Its version.
    pub version: String,
    /// A value a round: the round of the value in the same place of `ours`.
    pub values: Vec<f64>,
}

/// What a figure should come to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// The bound.
    pub bound: Bound,
    /// As the table says it.
    pub text: String,
}

/// A bound, in the direction in which the figure is good.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Bound {
    /// Of ours divided by the peer's.
    Ratio(f64),
    /// Of ours.
    Value(f64),
}

/// A place on a plot: both axes are logarithmic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// The plot.
    pub plot: String,
    /// The line on it.
    pub line: String,
    /// What the horizontal axis is, with its unit.
    pub axis: String,
    /// Where on it.
    pub x: f64,
}

impl Figure {
    /// A figure without values yet.
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
            peer: None,
            target: None,
            parameters: BTreeMap::new(),
            note: None,
            point: None,
        }
    }

    /// With our values, one a round.
    #[must_use]
    pub fn ours(mut self, values: impl Into<Vec<f64>>) -> Self {
        self.ours = values.into();
        self
    }

    /// With the values of a peer in the same rounds.
    #[must_use]
    pub fn peer(
        mut self,
        name: impl Into<String>,
        version: impl Into<String>,
        values: impl Into<Vec<f64>>,
    ) -> Self {
        let (name, version, values) = (name.into(), version.into(), values.into());
        self.peer = Some(PeerFigure { name, version, values });
        self
    }

    /// With a target.
    #[must_use]
    pub fn target(mut self, bound: Bound, text: impl Into<String>) -> Self {
        self.target = Some(Target { bound, text: text.into() });
        self
    }

    /// With a parameter.
    #[must_use]
    pub fn parameter(mut self, name: impl Into<String>, value: impl ToString) -> Self {
        self.parameters.insert(name.into(), value.to_string());
        self
    }

    /// With a note.
    #[must_use]
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.note = Some(note.into());
        self
    }

    /// As a point of a curve.
    #[must_use]
    pub fn point(
        mut self,
        plot: impl Into<String>,
        line: impl Into<String>,
        axis: impl Into<String>,
        x: f64,
    ) -> Self {
        self.point = Some(Point { plot: plot.into(), line: line.into(), axis: axis.into(), x });
        self
    }

    /// What our rounds came to.
    pub fn summary(&self) -> Option<Summary> {
        Summary::of(&self.ours)
    }

    /// What the peer's came to.
    pub fn peer_summary(&self) -> Option<Summary> {
        self.peer.as_ref().and_then(|peer| Summary::of(&peer.values))
    }

    /// Ours divided by the peer's, round by round, summed up.
    pub fn ratio(&self) -> Option<Summary> {
        let peer = self.peer.as_ref()?;
        let both = self.ours.iter().zip(&peer.values);
        Summary::of(&both.map(|(ours, theirs)| ours / theirs).collect::<Vec<_>>())
    }

    /// Whether the target is met by the median; `None` where there is none, or nothing to judge it by.
    pub fn meets_target(&self) -> Option<bool> {
        let (found, bound) = match self.target.as_ref()?.bound {
            Bound::Ratio(bound) => (self.ratio()?.median, bound),
            Bound::Value(bound) => (self.summary()?.median, bound),
        };
        Some(match self.better {
            Better::Higher => found >= bound,
            Better::Lower => found <= bound,
        })
    }
}

/// What the rounds of a figure came to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The middle value; the mean of the two middle ones of an even number.
    pub median: f64,
    /// The smallest.
    pub min: f64,
    /// The largest.
    pub max: f64,
}

impl Summary {
    /// Of `values`; `None` when there are none, or one is not a number.
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

/// A number with as many digits as mean something, and thousands set apart.
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
    fn rounds_are_summed_up_by_their_middle_and_their_ends() {
        let of = |values: &[f64]| Summary::of(values).map(|s| (s.median, s.min, s.max));
        assert_eq!(of(&[3.0, 1.0, 2.0]), Some((2.0, 1.0, 3.0)));
        assert_eq!(of(&[4.0, 1.0]), Some((2.5, 1.0, 4.0)));
        assert_eq!((of(&[]), of(&[1.0, f64::NAN])), (None, None));
    }

    #[test]
    fn ratios_are_taken_round_by_round_and_targets_in_the_direction_that_is_good() {
        let figure = |better| {
            Figure::new("f", "f", "us", better)
                .ours([10.0, 30.0, 20.0])
                .peer("peer", "1", [10.0, 10.0, 10.0])
                .target(Bound::Ratio(2.0), "within 2 x")
        };
        assert_eq!(figure(Better::Lower).ratio().map(|ratio| ratio.median), Some(2.0));
        assert_eq!(figure(Better::Lower).meets_target(), Some(true));
        assert_eq!(
            figure(Better::Higher).target(Bound::Value(21.0), "").meets_target(),
            Some(false)
        );
        assert_eq!(Figure::new("f", "f", "us", Better::Lower).meets_target(), None);
    }

    #[test]
    fn numbers_are_shown_with_the_digits_that_mean_something() {
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
