//! The cases that fail most.

use std::collections::BTreeMap;

use serde::Serialize;

use super::failure::Failure;
use run_log::{EpisodeRecord, RunLog};

/// A case over all conditions and runs.
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
    /// The most frequent kind of failure; the first of equals.
    pub failure: Failure,
    /// An episode that failed in this way, for `memtransfer show`.
    pub example: String,
}

/// The cases with a failed episode outside of streams, those with the largest share of failures first, at most `most`.
pub fn worst_cases(log: &RunLog, most: usize) -> Vec<CaseScore> {
    let mut by_case: BTreeMap<&str, Vec<&EpisodeRecord>> = BTreeMap::new();
    for record in log.episodes.iter().filter(|record| record.stream.is_none()) {
        by_case.entry(&record.case).or_default().push(record);
    }
    let mut cases: Vec<CaseScore> =
        by_case.values().filter_map(|records| case_score(records)).collect();
    // Stable: equals stay in the order of their ids.
    cases.sort_by(|a, b| (b.failed * a.episodes).cmp(&(a.failed * b.episodes)));
    cases.truncate(most);
    cases
}

fn case_score(records: &[&EpisodeRecord]) -> Option<CaseScore> {
    let mut kinds: BTreeMap<Failure, Vec<&EpisodeRecord>> = BTreeMap::new();
    for record in records {
        if let Some(kind) = Failure::of(record) {
            kinds.entry(kind).or_default().push(record);
        }
    }
    let failed = kinds.values().map(Vec::len).sum();
    let (failure, examples) =
        kinds.into_iter().max_by_key(|(kind, of)| (of.len(), std::cmp::Reverse(*kind)))?;
    let first = records.first()?;
    Some(CaseScore {
        case: first.case.clone(),
        task: first.task,
        episodes: records.len(),
        failed,
        failure,
        example: examples.first()?.key.clone(),
    })
}
