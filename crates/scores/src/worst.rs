//! The cases that fail most.

use std::collections::BTreeMap;

use case_book::WorldFacts;
use domain::Arm;
use serde::Serialize;

use super::failure::{Failures, failure_of};
use run_log::{EpisodeRecord, RunLog};

/// A case over all conditions and runs, those of control arms left out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CaseScore {
    /// The case's id.
    pub case: String,
    /// The number of its task.
    pub task: u8,
    /// Finished episodes.
    pub episodes: usize,
    /// Episodes that failed.
    pub failed: usize,
    /// The name of the most frequent kind of failure; the first of equals.
    pub failure: String,
    /// An episode that failed in this way, for `memtransfer show`.
    pub example: String,
}

/// The cases with a failed episode outside of streams, those with the largest share of failures first, at most `most`.
pub fn worst_cases(log: &RunLog, most: usize) -> Vec<CaseScore> {
    let mut by_case: BTreeMap<&str, Vec<&EpisodeRecord>> = BTreeMap::new();
    // A control arm fails for its own reasons.
    let is_of_memory =
        |record: &&EpisodeRecord| record.stream.is_none() && record.arm == Arm::Frozen;
    for record in log.episodes.iter().filter(is_of_memory) {
        by_case.entry(&record.case).or_default().push(record);
    }
    let mut cases: Vec<CaseScore> =
        by_case.values().filter_map(|records| case_score(records, &log.world)).collect();
    // Stable: equals stay in the order of their ids.
    cases.sort_by(|a, b| (b.failed * a.episodes).cmp(&(a.failed * b.episodes)));
    cases.truncate(most);
    cases
}

fn case_score(records: &[&EpisodeRecord], world: &WorldFacts) -> Option<CaseScore> {
    let failures = Failures::of(records.iter().copied(), world);
    let most = failures.iter().map(|(_, count)| count).max()?;
    let (failure, _) = failures.iter().find(|(_, count)| *count == most && most > 0)?;
    let is_example = |record: &&&EpisodeRecord| {
        failure_of(record, world).is_some_and(|found| found.kind == failure)
    };
    let example = records.iter().find(is_example)?;
    Some(CaseScore {
        case: example.case.clone(),
        task: example.task,
        episodes: records.len(),
        failed: failures.total(),
        failure: failure.to_owned(),
        example: example.key.clone(),
    })
}
