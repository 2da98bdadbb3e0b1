//! Scores of streams, from the records that have a place in one (specification, section 9; `docs/streams.md`).
//!
//! A sequence is one stream in one order under one condition and repetition. Only complete sequences enter a figure,
//! beside the number of planned ones. What is undefined for a sequence is left out of the mean of its stream, and what is defined for none
//! is None.
//!
//! | figure | file |
//! |---|---|
//! | R, average success, backward and forward transfer, forgetting | `matrix.rs` |
//! | success, regret, adaptation lag, stale reuse | `online.rs` |
//! | t-nDTW | `path.rs` |
//! | latency, bytes, tokens against the number of episodes given | `cost.rs` |
//! | cases that need memory | `necessity.rs` |
//! | means and intervals over streams, paired differences | `estimate.rs` |

mod cost;
mod estimate;
mod matrix;
mod necessity;
mod online;
mod path;
mod sequence;

#[cfg(test)]
mod tests;

pub use cost::StreamCost;
pub use estimate::{Estimate, TestedDifference};
pub use necessity::{Necessity, NecessitySuccess};

use std::collections::{BTreeMap, BTreeSet};

use domain::{Arm, FeedbackLevel, Representation, StreamOrder};
use serde::Serialize;

use super::interval::Interval;
use super::mean::mean;
use conditions::Condition;
use estimate::{by_stream, correct, difference};
use matrix::ResultMatrix;
use online::part;
use run_log::{EpisodeTimings, RunLog};
use sequence::{CompleteSequences, Sequence, SequenceId, success_rate};

/// The scores of a run's streams.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StreamScores {
    /// Streams that have a complete sequence.
    pub streams: usize,
    /// Complete sequences.
    pub sequences: usize,
    /// Sequences of the whole run. Those that are not complete enter no figure.
    pub planned: usize,
    /// What memories that learn are told at the end of an episode.
    pub feedback: Vec<FeedbackLevel>,
    /// One entry for each condition that has a complete sequence.
    pub conditions: Vec<StreamScore>,
    /// Pairs of conditions on the same sequences.
    pub differences: Vec<StreamDifference>,
    /// Differences that have a p: so many tests are corrected for.
    pub tested_differences: usize,
    /// Which cases need memory, for each memory that was run with an oracle.
    pub necessity: Vec<Necessity>,
}

/// The scores of one condition. Success rates and shares are in percent, their differences in percentage points.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StreamScore {
    /// The condition.
    #[serde(flatten)]
    pub condition: Condition,
    /// Streams that have a complete sequence.
    pub streams: usize,
    /// Complete sequences.
    pub sequences: usize,
    /// Sequences of the condition in the whole run.
    pub planned: usize,
    /// Success over all learning episodes: stream success at the end of the stream.
    pub success: Option<Estimate>,
    /// Success of learning episodes before events: in block 0, as drawn.
    pub before: Option<Estimate>,
    /// Success of learning episodes after events: in the other blocks.
    pub after: Option<Estimate>,
    /// Average success, ACC.
    pub average: Option<Estimate>,
    /// Backward transfer, BWT.
    pub backward: Option<Estimate>,
    /// Forward transfer, FWT.
    pub forward: Option<Estimate>,
    /// Forgetting.
    pub forgetting: Option<Estimate>,
    /// t-nDTW, from 0 to 1.
    pub t_ndtw: Option<Estimate>,
    /// Regret against the oracle arm of the same memory, in episodes.
    pub regret: Option<Estimate>,
    /// Learning episodes from an event to the first success of a case that it invalidated.
    pub lag: Option<Estimate>,
    /// Share of the blocks with an invalidated case in which one succeeded.
    pub adapted: Option<Estimate>,
    /// Share of retrieved sources that are stale.
    pub stale: Option<Estimate>,
    /// The same after events.
    pub stale_after: Option<Estimate>,
    /// Success and average success in each order.
    pub orders: Vec<OrderScore>,
    /// The range of success over orders, in percentage points; only of streams that were run in at least three.
    pub order_spread: Option<Estimate>,
    /// The range of average success over orders, likewise.
    pub order_spread_average: Option<Estimate>,
    /// R: a row for each number of blocks learned, from 0; a column for each block.
    pub matrix: Vec<Vec<Option<f64>>>,
    /// Success by learning round, in the order as drawn.
    pub rounds: Vec<RoundScore>,
    /// What memory costs. Only for the arms `frozen` and `learning`.
    pub costs: Vec<StreamCost>,
}

/// Figures of one order.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OrderScore {
    /// The order.
    pub order: StreamOrder,
    /// Success over all learning episodes.
    pub success: Option<f64>,
    /// Average success, ACC.
    pub average: Option<f64>,
}

/// Success in one learning round, a mean over streams.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RoundScore {
    /// The place of the block, from 0.
    pub place: u32,
    /// The round in it, from 1.
    pub round: u32,
    /// Success in the round.
    pub success: Estimate,
    /// Success over all learning episodes up to its end.
    pub running: Estimate,
}

/// Two conditions on the same sequences.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StreamDifference {
    /// The first condition.
    pub a: Condition,
    /// The second.
    pub b: Condition,
    /// Streams that both have.
    pub streams: usize,
    /// Success of learning episodes before events.
    pub before: Option<TestedDifference>,
    /// Success of learning episodes after events.
    pub after: Option<TestedDifference>,
    /// Average success, ACC.
    pub average: Option<TestedDifference>,
}

/// The complete sequences of a run, by condition.
type SequencesByCondition<'a> = BTreeMap<Condition, CompleteSequences<'a>>;

/// Computes the scores of a run's streams; None if it has none.
pub(super) fn score(
    log: &RunLog,
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> Option<StreamScores> {
    let by_condition = CompleteSequences::by_condition(log);
    if by_condition.is_empty() {
        return None;
    }
    let complete: Vec<&SequenceId> =
        by_condition.values().flat_map(|sequences| sequences.complete.keys()).collect();
    let streams: BTreeSet<u32> = complete.iter().map(|id| id.stream).collect();
    let records = log.episodes.iter().filter_map(|record| record.stream.as_ref());
    let feedback: BTreeSet<FeedbackLevel> = records.map(|stream| stream.feedback).collect();
    let conditions = by_condition
        .iter()
        .filter(|(_, sequences)| !sequences.complete.is_empty())
        .map(|(condition, _)| score_condition(*condition, &by_condition, timings));
    let mut differences: Vec<StreamDifference> = pairs(&by_condition)
        .into_iter()
        .filter_map(|(a, b)| compare(&by_condition, a, b))
        .collect();
    let tested = differences
        .iter_mut()
        .flat_map(|found| [&mut found.before, &mut found.after, &mut found.average])
        .flatten();
    let tested_differences = correct(tested);
    Some(StreamScores {
        streams: streams.len(),
        sequences: complete.len(),
        planned: planned(log),
        feedback: feedback.into_iter().collect(),
        conditions: conditions.collect(),
        differences,
        tested_differences,
        necessity: necessity::necessity(&by_condition),
    })
}

/// The sequences of the whole run.
fn planned(log: &RunLog) -> usize {
    let settings = &log.manifest.settings;
    let runs: usize = settings.runs().into_iter().map(|(_, runs)| runs as usize).sum();
    settings.stream.as_ref().map_or(0, |streams| runs * streams.sequences())
}

fn score_condition(
    condition: Condition,
    by_condition: &SequencesByCondition<'_>,
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> StreamScore {
    let sequences = &by_condition[&condition];
    let streams: BTreeSet<u32> = sequences.complete.keys().map(|id| id.stream).collect();
    let (percent, points) = (Interval::PERCENT, Interval::POINTS);
    let estimate = |range, figure: &dyn Fn(&Sequence<'_>) -> Option<f64>| {
        Estimate::of(&by_stream(sequences, |_, sequence| figure(sequence)), range)
    };
    let of_matrix = |range, figure: fn(&ResultMatrix) -> Option<f64>| {
        estimate(range, &|sequence| figure(&ResultMatrix::of(sequence)))
    };
    let against = |reference: Option<Condition>,
                   range,
                   figure: fn(&Sequence<'_>, &Sequence<'_>) -> Option<f64>| {
        // A condition is not compared with itself: that is 0 by definition, not by measurement.
        let reference = by_condition.get(&reference.filter(|other| *other != condition)?)?;
        let paired = |id, sequence: &Sequence<'_>| figure(sequence, reference.complete.get(&id)?);
        Estimate::of(&by_stream(sequences, paired), range)
    };
    let forward = |sequence: &Sequence<'_>, without_memory: &Sequence<'_>| {
        ResultMatrix::of(sequence).forward(&ResultMatrix::of(without_memory))
    };
    let costs = match condition.arm {
        Arm::Frozen | Arm::Learning => cost::costs(sequences, condition.arm, timings),
        Arm::Oracle | Arm::Wrong => Vec::new(),
    };
    StreamScore {
        condition,
        streams: streams.len(),
        sequences: sequences.complete.len(),
        planned: sequences.planned,
        success: estimate(percent, &|sequence| success_rate(sequence.learning())),
        before: estimate(percent, &|sequence| success_rate(part(sequence, false))),
        after: estimate(percent, &|sequence| success_rate(part(sequence, true))),
        average: of_matrix(percent, ResultMatrix::average),
        backward: of_matrix(points, ResultMatrix::backward),
        forward: against(condition.without_memory(), points, forward),
        forgetting: of_matrix(points, ResultMatrix::forgetting),
        t_ndtw: estimate(Interval::SHARE, &path::t_ndtw),
        regret: against(Some(condition.with_arm(Arm::Oracle)), Interval::ANY, online::regret),
        lag: estimate(Interval::POSITIVE, &online::lag),
        adapted: estimate(percent, &online::adapted),
        stale: estimate(percent, &|sequence| online::stale(sequence.learning())),
        stale_after: estimate(percent, &|sequence| online::stale(part(sequence, true))),
        orders: orders(sequences),
        order_spread: order_spread(sequences, &|sequence| success_rate(sequence.learning())),
        order_spread_average: order_spread(sequences, &|sequence| {
            ResultMatrix::of(sequence).average()
        }),
        matrix: mean_matrix(sequences),
        rounds: rounds(sequences),
        costs,
    }
}

/// The sequences in `order`.
fn in_order<'a>(sequences: &CompleteSequences<'a>, order: StreamOrder) -> CompleteSequences<'a> {
    let of_order = sequences.complete.iter().filter(|(id, _)| id.order == order);
    CompleteSequences { complete: of_order.map(|(id, s)| (*id, s.clone())).collect(), planned: 0 }
}

fn orders(sequences: &CompleteSequences<'_>) -> Vec<OrderScore> {
    let mut scores = Vec::new();
    for order in StreamOrder::ALL {
        let sequences = in_order(sequences, order);
        if sequences.complete.is_empty() {
            continue;
        }
        let success = by_stream(&sequences, |_, sequence| success_rate(sequence.learning()));
        let average = by_stream(&sequences, |_, sequence| ResultMatrix::of(sequence).average());
        scores.push(OrderScore {
            order,
            success: mean(success.into_values()),
            average: mean(average.into_values()),
        });
    }
    scores
}

/// Robustness against the order: the largest minus the smallest of `figure` over the orders of a stream, each a mean over its
/// repetitions. Only of streams that have it in at least three orders (at least three, one of them reversed: as Evo-Memory,
/// arXiv 2511.20857, varies the order of tasks).
fn order_spread(
    sequences: &CompleteSequences<'_>,
    figure: &dyn Fn(&Sequence<'_>) -> Option<f64>,
) -> Option<Estimate> {
    let mut streams: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for order in StreamOrder::ALL {
        for (stream, value) in by_stream(&in_order(sequences, order), |_, s| figure(s)) {
            streams.entry(stream).or_default().push(value);
        }
    }
    streams.retain(|_, values| values.len() >= 3);
    let range = |values: Vec<f64>| {
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        high - low
    };
    let ranges = streams.into_iter().map(|(stream, values)| (stream, range(values))).collect();
    Estimate::of(&ranges, Interval::PERCENT)
}

/// R, each cell a mean over the streams that have it.
fn mean_matrix(sequences: &CompleteSequences<'_>) -> Vec<Vec<Option<f64>>> {
    let blocks = sequences.complete.values().map(|s| s.blocks() as usize).max().unwrap_or(0);
    let cell = |i, j| mean(by_stream(sequences, |_, s| ResultMatrix::of(s).at(i, j)).into_values());
    (0..=blocks).map(|i| (1..=blocks).map(|j| cell(i, j)).collect()).collect()
}

fn rounds(sequences: &CompleteSequences<'_>) -> Vec<RoundScore> {
    let drawn = in_order(sequences, StreamOrder::Drawn);
    let rounds: BTreeSet<(u32, u32)> =
        drawn.complete.values().flat_map(|sequence| online::rounds(sequence).into_keys()).collect();
    let score = |(place, round)| {
        let over_streams = |value: fn((f64, f64)) -> f64| {
            let of_sequence = |_, sequence: &Sequence<'_>| {
                online::rounds(sequence).get(&(place, round)).copied().map(value)
            };
            Estimate::of(&by_stream(&drawn, of_sequence), Interval::PERCENT)
        };
        let success = over_streams(|(in_round, _)| in_round)?;
        let running = over_streams(|(_, so_far)| so_far)?;
        Some(RoundScore { place, round, success, running })
    };
    rounds.into_iter().filter_map(score).collect()
}

/// The pairs to compare, first minus second: what learns with the frozen Episodic memory and with its own frozen arm; the
/// oracle with what learns; the frozen arm with no memory and with wrong histories.
fn pairs(by_condition: &SequencesByCondition<'_>) -> Vec<(Condition, Condition)> {
    let mut pairs = Vec::new();
    for condition in by_condition.keys() {
        let arm = |arm| condition.with_arm(arm);
        let episodic = Condition { memory: Representation::Episodic.into(), ..arm(Arm::Frozen) };
        match condition.arm {
            Arm::Learning => {
                pairs.extend([(*condition, episodic), (*condition, arm(Arm::Frozen))]);
                pairs.push((arm(Arm::Oracle), *condition));
            }
            Arm::Frozen => {
                pairs.extend(condition.without_memory().map(|without| (*condition, without)));
                pairs.push((*condition, arm(Arm::Wrong)));
            }
            Arm::Oracle | Arm::Wrong => {}
        }
    }
    let mut seen = BTreeSet::new();
    pairs.retain(|(a, b)| a != b && seen.insert((*a, *b)));
    pairs
}

fn compare(
    by_condition: &SequencesByCondition<'_>,
    a: Condition,
    b: Condition,
) -> Option<StreamDifference> {
    let (first, second) = (by_condition.get(&a)?, by_condition.get(&b)?);
    let streams: BTreeSet<u32> = first
        .complete
        .keys()
        .filter(|id| second.complete.contains_key(id))
        .map(|id| id.stream)
        .collect();
    (!streams.is_empty()).then(|| StreamDifference {
        a,
        b,
        streams: streams.len(),
        before: difference(first, second, |s| success_rate(part(s, false))),
        after: difference(first, second, |s| success_rate(part(s, true))),
        average: difference(first, second, |s| ResultMatrix::of(s).average()),
    })
}
