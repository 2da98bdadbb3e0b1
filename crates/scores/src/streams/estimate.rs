//! Figures over streams, with their intervals.
//!
//! Episodes of a stream depend on each other, so the stream is the unit: a figure is computed for every sequence by itself,
//! then averaged over the sequences of each stream (its orders and repetitions), then over streams. Intervals are Student's t
//! over the streams' means ([`interval`](crate::interval)).

use std::collections::BTreeMap;

use serde::Serialize;

use super::sequence::{CompleteSequences, Sequence, SequenceId};
use crate::comparison::FigureDifference;
use crate::conclusion::ComparisonVerdict;
use crate::holm::holm;
use crate::interval::{Interval, Units};
use crate::mean::mean;
use crate::sign_test::LEVEL;

/// A figure over streams.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Its mean over the streams in which it is defined.
    pub mean: f64,
    /// The 95 % interval: Student's t over streams. None for fewer than two streams, and where all are alike.
    pub interval: Option<Interval>,
    /// Number of streams in which it is defined.
    pub streams: usize,
}

impl Estimate {
    /// Of values by stream that lie in `range`; None if there are none.
    pub(super) fn of(streams: &BTreeMap<u32, f64>, range: Interval) -> Option<Self> {
        let values: Vec<f64> = streams.values().copied().collect();
        let (found, streams) = (mean(values.iter().copied())?, values.len());
        let interval = Units::alike(values).interval_of_means(range);
        Some(Self { mean: found, interval, streams })
    }
}

/// A difference over streams, tested.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TestedDifference {
    /// The figures, their difference and its interval.
    #[serde(flatten)]
    pub difference: FigureDifference,
    /// Two-sided p of Student's t test over streams, which is below 5 % where the interval does not hold 0. `None` where there
    /// is no interval. Not corrected for the number of differences.
    pub p: Option<f64>,
    /// p after the correction for all differences of the run's streams that have one (Holm).
    pub corrected_p: Option<f64>,
    /// Whether the first is better or worse: the corrected p is below 5 %.
    pub verdict: ComparisonVerdict,
}

/// The mean of `figure` over the sequences of each stream in which it is defined.
pub(super) fn by_stream<'a>(
    sequences: &CompleteSequences<'a>,
    figure: impl Fn(SequenceId, &Sequence<'a>) -> Option<f64>,
) -> BTreeMap<u32, f64> {
    let mut values: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for (id, sequence) in &sequences.complete {
        if let Some(value) = figure(*id, sequence) {
            values.entry(id.stream).or_default().push(value);
        }
    }
    let means = values.into_iter();
    means.filter_map(|(stream, values)| Some((stream, mean(values.into_iter())?))).collect()
}

/// The difference of `figure`, a percentage, between the sequences of `a` and the paired ones of `b`, over the pairs in which
/// both are defined; None if there are none.
pub(super) fn difference<'a>(
    a: &CompleteSequences<'a>,
    b: &CompleteSequences<'a>,
    figure: impl Fn(&Sequence<'a>) -> Option<f64>,
) -> Option<TestedDifference> {
    let both = |id: SequenceId, sequence: &Sequence<'a>| {
        Some((figure(sequence)?, figure(b.complete.get(&id)?)?))
    };
    let side =
        |value: fn((f64, f64)) -> f64| by_stream(a, |id, sequence| both(id, sequence).map(value));
    let [first, second, differences] = [|(a, _)| a, |(_, b)| b, |(a, b)| a - b].map(side);
    let Estimate { mean: difference, interval, .. } = Estimate::of(&differences, Interval::POINTS)?;
    let difference = FigureDifference {
        a: mean(first.into_values())?,
        b: mean(second.into_values())?,
        mean: difference,
        interval,
    };
    let p = Units::alike(differences.into_values().collect()).p_of_means();
    let verdict = ComparisonVerdict::NoDifferenceShown;
    Some(TestedDifference { difference, p, corrected_p: p, verdict })
}

/// Corrects the p of differences that are made together, and sets their verdicts. Returns the number of those with a p.
pub(super) fn correct<'a>(differences: impl Iterator<Item = &'a mut TestedDifference>) -> usize {
    let tested: Vec<(f64, &mut TestedDifference)> =
        differences.filter_map(|found| Some((found.p?, found))).collect();
    let p: Vec<f64> = tested.iter().map(|(p, _)| *p).collect();
    for ((_, found), corrected) in tested.into_iter().zip(holm(&p)) {
        found.corrected_p = Some(corrected);
        found.verdict = match corrected < LEVEL {
            true if found.difference.mean > 0.0 => ComparisonVerdict::Better,
            true => ComparisonVerdict::Worse,
            false => ComparisonVerdict::NoDifferenceShown,
        };
    }
    p.len()
}
