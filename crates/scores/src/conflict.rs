//! Demonstrations that contradict each other: from before and from after a passage has closed.

use std::collections::{BTreeMap, BTreeSet};

use super::Planned;
use super::condition::{ConditionScore, relate, score_condition};
use super::trial::Trials;
use conditions::{Condition, Demonstrations};
use domain::Arm;
use run_log::{EpisodeRecord, EpisodeTimings, RunLog};

/// The demonstrations that are compared.
pub const HISTORIES: [Demonstrations; 4] = [
    Demonstrations::ORIGINAL,
    Demonstrations::AFTER,
    Demonstrations::BEFORE_AFTER,
    Demonstrations::AFTER_BEFORE,
];

/// The cases whose original demonstration the closed passage invalidates, as far as a finished episode tells of them.
pub(super) fn invalidated(log: &RunLog) -> BTreeSet<&str> {
    let is_invalidated =
        |record: &&EpisodeRecord| record.blocked.is_some_and(|blocked| blocked.invalidated);
    log.episodes.iter().filter(is_invalidated).map(|record| record.case.as_str()).collect()
}

/// The scores of the conditions with [`HISTORIES`], and of working memory, over the cases whose original demonstration the
/// closed passage invalidates. Empty unless there is a demonstration from after the event.
pub(super) fn conflicts(
    log: &RunLog,
    trials: &BTreeMap<Condition, Trials<'_>>,
    planned: &Planned,
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> Vec<ConditionScore> {
    if !trials.keys().any(|condition| condition.demonstrations.take_place_after()) {
        return Vec::new();
    }
    let invalidated = invalidated(log);
    let is_compared = |condition: &Condition| {
        let set = condition.demonstrations;
        condition.arm == Arm::Frozen && (HISTORIES.contains(&set) || set == Demonstrations::NONE)
    };
    let of_cases: BTreeMap<Condition, Trials<'_>> = trials
        .iter()
        .filter(|(condition, _)| is_compared(condition))
        .map(|(condition, trials)| (*condition, trials.of_cases(&invalidated)))
        .collect();
    let scored = of_cases.iter().filter_map(|(condition, trials)| {
        let planned = planned.episodes(condition, invalidated.len());
        score_condition(*condition, trials, planned, timings, &log.world)
    });
    let mut scores: Vec<ConditionScore> = scored.collect();
    relate(&mut scores, &of_cases);
    scores
}

#[cfg(test)]
mod tests {
    use domain::Representation;

    use crate::score;
    use conditions::{Condition, Demonstrations, Route, Start};
    use rigs::records::{log, record, under};
    use run_log::{BlockedRecord, EpisodeRecord};

    #[test]
    fn a_run_that_is_not_over_has_bounds_over_the_invalidated_cases() {
        let condition: Condition = "episodic/new/blocked/after".parse().unwrap();
        let episode = |case: &str, invalidated| {
            let blocked = Some(BlockedRecord { invalidated, ..BlockedRecord::default() });
            under(condition, EpisodeRecord { blocked, ..record(case, true) })
        };
        // Two repetitions of two cases, the first of each finished.
        let mut log = log(vec![episode("t01-01", true), episode("t01-02", false)]);
        let group = &mut log.manifest.settings.groups[0];
        group.memory = vec![Representation::Episodic.into()];
        (group.starts, group.routes) = (vec![Start::New], vec![Route::Blocked]);
        (group.demos, group.runs) = (vec![Demonstrations::AFTER], 2);
        log.manifest.episodes = 4;
        let scores = score(&log);
        let [found] = &scores.conflicts[..] else { panic!("{:?}", scores.conflicts) };
        assert_eq!((found.episodes, found.planned), (1, 2));
        assert_eq!(found.bounds.map(|bounds| bounds.sr.low), Some(50.0));
    }
}
