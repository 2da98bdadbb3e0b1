//! Figures over streams, with their intervals.
//!
//! Episodes of a stream depend on each other, so the stream is the unit: a figure is computed for every sequence by itself,
//! then averaged over the sequences of each stream (its orders and repetitions), then over streams. Intervals are Student's t
//! over the streams' means ([`interval`](crate::interval)).

use std::collections::BTreeMap;

use serde::Serialize;

use super::sequence::{CompleteSequences, Sequence, SequenceId};
use crate::comparison::FigureDifference;
use crate::interval::{Interval, Units};
use crate::mean::mean;

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
) -> Option<FigureDifference> {
    let both = |id: SequenceId, sequence: &Sequence<'a>| {
        Some((figure(sequence)?, figure(b.complete.get(&id)?)?))
    };
    let side =
        |value: fn((f64, f64)) -> f64| by_stream(a, |id, sequence| both(id, sequence).map(value));
    let [first, second, differences] = [|(a, _)| a, |(_, b)| b, |(a, b)| a - b].map(side);
    let Estimate { mean: difference, interval, .. } = Estimate::of(&differences, Interval::POINTS)?;
    Some(FigureDifference {
        a: mean(first.into_values())?,
        b: mean(second.into_values())?,
        mean: difference,
        interval,
    })
}
