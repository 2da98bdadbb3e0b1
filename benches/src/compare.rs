//! Comparison with earlier results: ratios, and a verdict that is only given where it exceeds the noise.

use crate::figure::{Better, Measurement, MeasurementSummary};
use crate::results::Results;

/// Rounds needed on both sides for a verdict.
const ENOUGH_ROUNDS: usize = 3;

/// A figure before and now.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// The figure's id.
    pub id: String,
    /// Unit.
    pub unit: String,
    /// Earlier value.
    pub before: MeasurementSummary,
    /// Present value.
    pub now: MeasurementSummary,
    /// Ratio of the medians, now to before.
    pub ratio: f64,
    /// The same ratio of the baseline, which shows changes of the machine.
    pub baseline_ratio: Option<f64>,
    /// Conclusion.
    pub verdict: Verdict,
}

/// Conclusion of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Every round is better than every round before.
    Better,
    /// Every round is worse than every round before.
    Worse,
    /// The ranges overlap.
    Indistinguishable,
    /// Too few rounds.
    TooFewRounds,
}

impl Verdict {
    /// The verdict in words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Better => "better",
            Self::Worse => "WORSE",
            Self::Indistinguishable => "indistinguishable",
            Self::TooFewRounds => "too few rounds",
        }
    }
}

/// Compares every figure that both have, in the order of `now`.
pub fn compare(before: &Results, now: &Results) -> Vec<Change> {
    let change = |new: &Measurement| {
        let old = before.figures().find(|old| {
            // With other parameters it is another figure.
            old.id == new.id && old.unit == new.unit && old.parameters == new.parameters
        })?;
        let (was, is) = (old.summary()?, new.summary()?);
        let baselines = old.baseline_summary().zip(new.baseline_summary());
        Some(Change {
            id: new.id.clone(),
            unit: new.unit.clone(),
            before: was,
            now: is,
            ratio: is.median / was.median,
            baseline_ratio: baselines.map(|(was, is)| is.median / was.median),
            verdict: verdict(was, is, new.better, old.ours.len().min(new.ours.len())),
        })
    };
    now.figures().filter_map(change).collect()
}

fn verdict(
    before: MeasurementSummary,
    now: MeasurementSummary,
    better: Better,
    rounds: usize,
) -> Verdict {
    if rounds < ENOUGH_ROUNDS {
        return Verdict::TooFewRounds;
    }
    let (higher, lower) = (now.min > before.max, now.max < before.min);
    match better {
        _ if !higher && !lower => Verdict::Indistinguishable,
        Better::Higher if higher => Verdict::Better,
        Better::Lower if lower => Verdict::Better,
        Better::Higher | Better::Lower => Verdict::Worse,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::BenchOutcome;

    fn results(better: Better, ours: &[f64], bytes: u32) -> Results {
        let figure = Measurement::new("f", "f", "us", better)
            .ours(ours)
            .baseline("baseline", "1", [2.0, 2.0, 2.0])
            .parameter("bytes", bytes);
        let mut results = Results::here();
        results.add(BenchOutcome {
            name: "b".to_owned(),
            about: String::new(),
            began: String::new(),
            commit: None,
            seconds: 0.0,
            error: None,
            figures: vec![figure],
        });
        results
    }

    #[test]
    fn a_verdict_requires_disjoint_ranges() {
        let verdict = |better, before: &[f64], now: &[f64]| {
            let changes = compare(&results(better, before, 1), &results(better, now, 1));
            changes.first().map(|change| change.verdict)
        };
        let (low, mixed, high) = ([1.0, 1.1, 1.2], [1.1, 1.5, 1.9], [2.0, 2.1, 2.2]);
        assert_eq!(verdict(Better::Higher, &low, &high), Some(Verdict::Better));
        assert_eq!(verdict(Better::Lower, &low, &high), Some(Verdict::Worse));
        assert_eq!(verdict(Better::Lower, &high, &low), Some(Verdict::Better));
        assert_eq!(verdict(Better::Lower, &low, &mixed), Some(Verdict::Indistinguishable));
        assert_eq!(verdict(Better::Lower, &low[..2], &high), Some(Verdict::TooFewRounds));
    }

    #[test]
    fn figures_with_other_parameters_are_not_compared() {
        let of = |bytes| results(Better::Lower, &[1.0, 1.0, 1.0], bytes);
        assert_eq!(compare(&of(1), &of(2)), []);
        let same = compare(&of(1), &of(1));
        assert_eq!((same[0].ratio, same[0].baseline_ratio), (1.0, Some(1.0)));
    }
}
