//! What memory costs against the number of episodes that it was given.
//!
//! From the evaluations, during which a memory does not change.

use std::collections::{BTreeMap, BTreeSet};

use domain::Arm;
use serde::Serialize;

use super::estimate::by_stream;
use super::sequence::{CompleteSequences, StreamEpisode};
use crate::mean::mean;
use run_log::{EpisodeTimings, Stages};

/// What memory cost after some blocks were learned: means over evaluation episodes, then over sequences and streams.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StreamCost {
    /// Blocks learned before.
    pub after: u32,
    /// Episodes that the memory was given: a demonstration of each case of the stream, and in the arm `learning` every
    /// learning episode so far. A memory with a budget may hold fewer.
    pub episodes: f64,
    /// Microseconds of a search. Embedding the view is not part of it.
    pub search_us: Option<f64>,
    /// Microseconds of a recall: embedding the view, searching, putting the answer together. A view is embedded when it is
    /// first seen, by whichever sequence sees it, so this falls as a run goes on, whatever the memory holds.
    pub recall_us: Option<f64>,
    /// Bytes of the memory's store. None if it told none.
    pub store_bytes: Option<f64>,
    /// Tokens of a request that are injected memory, an estimate. None if any request was not measured.
    pub tokens: Option<f64>,
}

/// The cost of the condition with these `sequences`, in `arm`, after each number of blocks.
pub(super) fn costs(
    sequences: &CompleteSequences<'_>,
    arm: Arm,
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> Vec<StreamCost> {
    let most = sequences.complete.values().map(|sequence| sequence.blocks()).max();
    let at = |after: u32| {
        let figure = |value: &dyn Fn(&StreamEpisode<'_>) -> Option<f64>| {
            let streams = by_stream(sequences, |_, sequence| {
                let evaluated = sequence.evaluations().filter(|e| e.stream.after == after);
                let values: Option<Vec<f64>> = evaluated.map(|e| value(&e)).collect();
                mean(values?.into_iter())
            });
            mean(streams.into_values())
        };
        let given = by_stream(sequences, |_, sequence| {
            let is_evaluated = sequence.evaluations().any(|e| e.stream.after == after);
            let cases: BTreeSet<&str> =
                sequence.evaluations().map(|e| e.record.case.as_str()).collect();
            let learned = sequence.learning().filter(|e| e.stream.after < after).count();
            let learned = if arm == Arm::Learning { learned } else { 0 };
            is_evaluated.then_some((cases.len() + learned) as f64)
        });
        let per_recall = |e: &StreamEpisode<'_>, ns: fn(&Stages) -> u64| {
            let timings = timings.get(e.record.key.as_str())?;
            let requests = timings.recalls.requests;
            (requests > 0).then(|| ns(&timings.stages) as f64 / 1000.0 / f64::from(requests))
        };
        let tokens = |e: &StreamEpisode<'_>| {
            let (tokens, requests) = (e.record.memory_tokens?, e.record.requests?);
            (requests > 0).then(|| tokens as f64 / f64::from(requests))
        };
        Some(StreamCost {
            after,
            episodes: mean(given.into_values())?,
            search_us: figure(&|e| per_recall(e, |stages| stages.search)),
            recall_us: figure(&|e| per_recall(e, Stages::recalling)),
            store_bytes: figure(&|e| e.stream.store_bytes.map(|bytes| bytes as f64)),
            tokens: figure(&tokens),
        })
    };
    most.map_or_else(Vec::new, |most| (0..=most).filter_map(at).collect())
}
