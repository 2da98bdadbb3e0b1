//! Demonstrations that contradict each other: from before and from after a passage has closed.

use std::collections::{BTreeMap, BTreeSet};

use super::condition::{ConditionScore, relate, score_condition};
use super::trial::Trials;
use crate::conditions::{Condition, Demonstrations};
use crate::log::{EpisodeTimings, RunLog};

/// The demonstrations that are compared.
pub const HISTORIES: [Demonstrations; 4] = [
    Demonstrations::ORIGINAL,
    Demonstrations::AFTER,
    Demonstrations::BEFORE_AFTER,
    Demonstrations::AFTER_BEFORE,
];

/// The scores of the conditions with [`HISTORIES`], and of working memory, over the cases whose original demonstration the
/// closed passage invalidates. Empty unless there is a demonstration from after the event.
pub(super) fn conflicts(
    log: &RunLog,
    trials: &BTreeMap<Condition, Trials<'_>>,
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> Vec<ConditionScore> {
    if !trials.keys().any(|condition| condition.demonstrations.take_place_after()) {
        return Vec::new();
    }
    let is_invalidated = |record: &&crate::log::EpisodeRecord| {
        record.blocked.is_some_and(|blocked| blocked.invalidated)
    };
    let invalidated: BTreeSet<&str> =
        log.episodes.iter().filter(is_invalidated).map(|record| record.case.as_str()).collect();
    let is_compared = |condition: &Condition| {
        let set = condition.demonstrations;
        HISTORIES.contains(&set) || set == Demonstrations::NONE
    };
    let of_cases: BTreeMap<Condition, Trials<'_>> = trials
        .iter()
        .filter(|(condition, _)| is_compared(condition))
        .map(|(condition, trials)| (*condition, trials.of_cases(&invalidated)))
        .collect();
    let scored = of_cases
        .iter()
        .filter_map(|(condition, trials)| score_condition(*condition, trials, 0, timings));
    let mut scores: Vec<ConditionScore> = scored.collect();
    relate(&mut scores, &of_cases);
    scores
}
