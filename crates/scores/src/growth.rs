//! The same cases with banks of different sizes: what a growing memory gains and costs.

use std::collections::BTreeMap;

use case_book::WorldFacts;
use serde::Serialize;

use super::Planned;
use super::condition::{ConditionScore, score_condition};
use super::mean::percentage;
use super::trial::Trials;
use conditions::Condition;
use run_log::source::{SourceStep, sources};
use run_log::{EpisodeRecord, EpisodeTimings, RunLog};

/// A memory with a bank of one size.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GrowthScore {
    /// Demonstrations in the bank; 0 for working memory.
    pub size: u16,
    /// The scores of the condition.
    #[serde(flatten)]
    pub score: ConditionScore,
    /// Percentage of the retrieved sources that are demonstrations of the episode's own case. `None` where nothing was
    /// retrieved.
    pub from_own_case: Option<f64>,
    /// Percentage of the retrieved sources whose case has a task of the same type. `None` also where the log does not tell
    /// the type of one of them, as those of earlier versions do not.
    pub from_same_type: Option<f64>,
    /// Mean microseconds of a search.
    pub search_us: Option<f64>,
    /// Mean microseconds of a recall: embedding the view, searching, putting the answer together.
    pub recall_us: Option<f64>,
    /// The largest size that the memory reported for its store, in bytes.
    pub store_bytes: Option<u64>,
    /// Mean images of an answer.
    pub images: Option<f64>,
    /// Mean tokens of a request that are injected memory, an estimate. `None` if any request was not measured.
    pub tokens: Option<f64>,
}

/// The scores of the conditions with banks, by memory and size, each after working memory on the same start and route. Empty
/// without a bank.
pub(super) fn growth(
    log: &RunLog,
    trials: &BTreeMap<Condition, Trials<'_>>,
    planned: &Planned,
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> Vec<GrowthScore> {
    // The type of the task of every case that the log tells.
    let tasks = log.tasks();
    let has_bank = |condition: &Condition| condition.demonstrations.bank_size().is_some();
    if !trials.keys().any(has_bank) {
        return Vec::new();
    }
    let is_shown =
        |condition: &Condition| has_bank(condition) || !condition.memory.uses_demonstrations();
    let mut found: Vec<GrowthScore> = trials
        .iter()
        .filter(|(condition, _)| is_shown(condition))
        .filter_map(|(condition, trials)| {
            let planned = planned.episodes(condition, planned.cases);
            of_condition(*condition, trials, planned, timings, (&log.world, &tasks))
        })
        .collect();
    found.sort_by_key(|one| {
        let Condition { memory, start, route, variation, mismatch, .. } = one.score.condition;
        (memory, start, route, variation, mismatch, one.size)
    });
    found
}

fn of_condition(
    condition: Condition,
    trials: &Trials<'_>,
    planned: usize,
    timings: &BTreeMap<&str, &EpisodeTimings>,
    (world, tasks): (&WorldFacts, &BTreeMap<&str, u8>),
) -> Option<GrowthScore> {
    let sources: Vec<(&EpisodeRecord, Option<String>)> = trials
        .iter()
        .flat_map(|record| {
            let words = record.retrieved.as_deref().unwrap_or_default().split(' ');
            words.flat_map(sources).filter_map(move |source| match source {
                SourceStep::Demonstration { case, .. } => Some((record, case)),
                SourceStep::Experience { .. } => None,
            })
        })
        .collect();
    let same_type: Option<Vec<bool>> = sources
        .iter()
        .map(|(record, other)| match other {
            None => Some(true),
            Some(case) => Some(*tasks.get(case.as_str())? == record.task),
        })
        .collect();
    let timed = || trials.iter().filter_map(|record| timings.get(record.key.as_str()).copied());
    let per_recall = |value: &dyn Fn(&EpisodeTimings) -> u64| {
        let (sum, recalls) = timed().fold((0.0, 0), |(sum, recalls), of| {
            (sum + value(of) as f64, recalls + u64::from(of.recalls.requests))
        });
        (recalls > 0).then(|| sum / recalls as f64)
    };
    let us = |ns: Option<f64>| ns.map(|ns| ns / 1000.0);
    let sum =
        |count: fn(&EpisodeRecord) -> Option<u64>| trials.iter().map(count).sum::<Option<u64>>();
    let asked = sum(|record| record.requests.map(u64::from)).filter(|requests| *requests > 0);
    let tokens = sum(|record| record.memory_tokens).zip(asked);
    Some(GrowthScore {
        size: condition.demonstrations.bank_size().unwrap_or(0),
        score: score_condition(condition, trials, planned, timings, world)?,
        from_own_case: percentage(sources.iter().map(|(_, other)| other.is_none())),
        from_same_type: same_type.and_then(|same| percentage(same.into_iter())),
        search_us: us(per_recall(&|of| of.stages.search)),
        recall_us: us(per_recall(&|of| of.stages.recalling())),
        store_bytes: timed().filter_map(|of| of.recalls.store_bytes).max(),
        images: per_recall(&|of| of.recalls.images),
        tokens: tokens.map(|(tokens, requests)| tokens as f64 / requests as f64),
    })
}

#[cfg(test)]
mod tests {
    use domain::Representation;

    use super::*;
    use crate::score;
    use conditions::Start;
    use rigs::records::{log, record};

    #[test]
    fn sources_and_costs_by_hand() {
        let of = |demonstrations: &str, words: &str| {
            let mut record = EpisodeRecord {
                demonstrations: demonstrations.parse().unwrap(),
                retrieved: Some(words.to_owned()),
                memory_tokens: Some(400),
                ..record("t01-02", true)
            };
            record.key = format!("{}/r1/t01-02", record.condition());
            record
        };
        // Of four sources one is of the case, and two others are of its type.
        let mut log = log(vec![
            of("bank-16", "o1 - t01-07:n2+t09-01:o3 t01-01:p4"),
            of("bank-4", "- -"),
            record("t01-02", false),
        ]);
        for timings in &mut log.timings {
            timings.recalls.requests = timings.steps;
            timings.recalls.images = u64::from(timings.steps) * 7;
            timings.recalls.store_bytes = Some(1000);
        }
        assert_eq!(score(&log).growth[1].from_same_type, None, "the types are not known");
        // An id says nothing about the type.
        let tasks = [("t01-01", 1), ("t01-07", 9), ("t09-01", 1)];
        log.manifest.tasks = tasks.map(|(case, task)| (case.to_owned(), task)).into();
        let scores = score(&log).growth;
        let sizes: Vec<u16> = scores.iter().map(|score| score.size).collect();
        assert_eq!(sizes, [4, 16]);
        let [four, sixteen] = &scores[..] else { panic!() };
        assert_eq!((four.from_own_case, four.from_same_type), (None, None));
        assert_eq!((sixteen.from_own_case, sixteen.from_same_type), (Some(25.0), Some(75.0)));
        // One microsecond a step in each stage; ten steps, 400 tokens.
        assert_eq!((sixteen.search_us, sixteen.recall_us), (Some(1.0), Some(3.0)));
        assert_eq!(
            (sixteen.store_bytes, sixteen.images, sixteen.tokens),
            (Some(1000), Some(7.0), Some(40.0))
        );
        assert_eq!(sixteen.score.sr.mean, 100.0);

        log.episodes[0].retrieved = Some("mine:o1".to_owned());
        log.episodes[0].memory_tokens = None;
        let sixteen = score(&log).growth.remove(1);
        assert_eq!((sixteen.from_own_case, sixteen.from_same_type), (Some(0.0), None));
        assert_eq!(sixteen.tokens, None);
        // The run has both banks on two cases.
        let bank = |size: &str| size.parse().unwrap();
        let group = &mut log.manifest.settings.groups[0];
        group.memory = vec![Representation::Episodic.into()];
        (group.starts, group.demos) =
            (vec![Start::Original], vec![bank("bank-4"), bank("bank-16")]);
        log.manifest.episodes = 4;
        let sixteen = score(&log).growth.remove(1).score;
        assert_eq!((sixteen.episodes, sixteen.planned), (1, 2));
        assert_eq!(sixteen.bounds.map(|bounds| bounds.sr.low), Some(50.0));
        log.episodes.truncate(0);
        assert_eq!(score(&log).growth, []);
    }
}
