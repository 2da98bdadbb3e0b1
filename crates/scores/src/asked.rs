//! Comparisons that the conditions of a run ask for: they are made unasked, and those that answer one question together.

use std::collections::{BTreeMap, BTreeSet};

use conditions::{Condition, Demonstrations};
use domain::{Arm, MemoryKind};
use run_log::RunLog;
use serde::Serialize;

use super::comparison::{Comparison, Pairing, Side, conclude};
use super::conflict::invalidated;
use super::trial::Trials;

/// The question that comparisons answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Question {
    /// What demonstrations from after an event are worth against those from before it, what it costs to hold both, and whether
    /// their order matters: over the cases whose original demonstration the event invalidates.
    Conflict,
    /// What demonstrations in another warehouse are worth against those in the tested one, and against no memory.
    Elsewhere,
}

/// The comparisons that answer a question, made together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AskedComparisons {
    /// The question.
    pub question: Question,
    /// The comparisons, by memory.
    pub comparisons: Vec<AskedComparison>,
}

/// A comparison that answers a question.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AskedComparison {
    /// The memory that it is about.
    pub memory: MemoryKind,
    /// What is subtracted from what: `after − before`.
    pub label: String,
    /// The condition of the first side.
    pub condition: Condition,
    /// The comparison.
    #[serde(flatten)]
    pub comparison: Comparison,
}

/// The demonstrations of both sides, and the label. No demonstrations: working memory.
type Contrast = (Demonstrations, Demonstrations, &'static str);

const CONFLICT: [Contrast; 3] = [
    (Demonstrations::AFTER, Demonstrations::ORIGINAL, "after − before"),
    (Demonstrations::BEFORE_AFTER, Demonstrations::AFTER, "before, after − after"),
    (Demonstrations::BEFORE_AFTER, Demonstrations::AFTER_BEFORE, "before, after − after, before"),
];

const ELSEWHERE: [Contrast; 3] = [
    (Demonstrations::ORIGINAL, Demonstrations::ELSEWHERE, "1 demo here − elsewhere"),
    (Demonstrations::ALL, Demonstrations::ELSEWHERE, "4 demos here − elsewhere"),
    (Demonstrations::ELSEWHERE, Demonstrations::NONE, "elsewhere − working memory"),
];

/// The comparisons that the conditions of `log` ask for. A question without one is left out.
pub(super) fn comparisons(
    log: &RunLog,
    trials: &BTreeMap<Condition, Trials<'_>>,
) -> Vec<AskedComparisons> {
    let of_cases = invalidated(log);
    let found = [
        (Question::Conflict, contrasts(log, trials, &CONFLICT, |case| of_cases.contains(case))),
        (Question::Elsewhere, contrasts(log, trials, &ELSEWHERE, |_| true)),
    ];
    let found = found.into_iter().filter(|(_, comparisons)| !comparisons.is_empty());
    found.map(|(question, comparisons)| AskedComparisons { question, comparisons }).collect()
}

/// The comparisons of `contrasts` over the selected cases, of every condition that has them.
fn contrasts(
    log: &RunLog,
    trials: &BTreeMap<Condition, Trials<'_>>,
    contrasts: &[Contrast],
    is_selected: impl Fn(&str) -> bool,
) -> Vec<AskedComparison> {
    let is_asked = |condition: &Condition| {
        let set = condition.demonstrations;
        condition.arm == Arm::Frozen && contrasts.iter().any(|(a, _, _)| set == *a)
    };
    // Conditions that differ in their demonstrations alone, once.
    let settings: BTreeSet<Condition> = trials
        .keys()
        .filter(|condition| is_asked(condition))
        .map(|condition| Condition { demonstrations: Demonstrations::NONE, ..*condition })
        .collect();
    let side = |setting: Condition, demonstrations: Demonstrations| {
        let condition = match demonstrations {
            Demonstrations::NONE => setting.without_memory()?,
            _ => Condition { demonstrations, ..setting },
        };
        let is_run = trials.contains_key(&condition);
        is_run.then(|| Side { name: condition.to_string(), log, condition })
    };
    let (mut labels, mut pairings) = (Vec::new(), Vec::new());
    for setting in settings {
        for &(a, b, label) in contrasts {
            let (Some(first), Some(second)) = (side(setting, a), side(setting, b)) else {
                continue;
            };
            let condition = first.condition;
            if let Some(pairing) = Pairing::of_cases(first, second, &is_selected) {
                labels.push((condition, label));
                pairings.push(pairing);
            }
        }
    }
    let labelled = labels.into_iter().zip(conclude(pairings));
    let asked = |((condition, label), comparison): ((Condition, &str), Comparison)| {
        let (memory, label) = (condition.memory, label.to_owned());
        AskedComparison { memory, label, condition, comparison }
    };
    labelled.map(asked).collect()
}

#[cfg(test)]
mod tests {
    use rigs::records::{log, record, under};
    use run_log::{BlockedRecord, EpisodeRecord};

    use super::*;
    use crate::{ComparisonVerdict, score};

    fn episodes(condition: &str, success: impl Fn(usize) -> bool) -> Vec<EpisodeRecord> {
        let condition: Condition = condition.parse().unwrap();
        let episode = |case: usize| {
            let blocked = Some(BlockedRecord { invalidated: case < 8, ..BlockedRecord::default() });
            let record = record(&format!("t01-{case:02}"), success(case));
            under(condition, EpisodeRecord { blocked, ..record })
        };
        (0..10).map(episode).collect()
    }

    #[test]
    fn conflicts_are_compared_over_the_invalidated_cases_and_corrected_together() {
        let mut records = episodes("episodic/new/blocked/original", |_| false);
        records.extend(episodes("episodic/new/blocked/after", |_| true));
        records.extend(episodes("episodic/new/blocked/before-after", |case| case % 2 == 0));
        let found = score(&log(records)).comparisons;
        let [AskedComparisons { question: Question::Conflict, comparisons }] = &found[..] else {
            panic!("{found:?}")
        };
        // Without `after-before` there are two. 8 of 10 cases are invalidated: 8 better, p = 2 / 2^8, twice that of two;
        // 4 worse: p = 2 / 2^4.
        let shown: Vec<_> = comparisons
            .iter()
            .map(|one| (one.label.as_str(), one.comparison.cases, one.comparison.sr.mean))
            .collect();
        assert_eq!(shown, [("after − before", 8, 100.0), ("before, after − after", 8, -50.0)]);
        for (one, p, verdict) in [
            (0, 4.0 / 256.0, ComparisonVerdict::Better),
            (1, 2.0 / 16.0, ComparisonVerdict::NoDifferenceShown),
        ] {
            let found = &comparisons[one].comparison.conclusion;
            assert_eq!((found.family, found.verdict), (2, verdict));
            assert!((found.corrected_p - p).abs() < 1e-12, "{found:?}");
        }
    }

    #[test]
    fn demonstrations_elsewhere_are_compared_with_those_here_and_with_none() {
        let mut records = episodes("episodic/new/unchanged/elsewhere", |_| false);
        records.extend(episodes("episodic/new/unchanged/original", |_| true));
        records.extend(episodes("working/new/unchanged/none", |case| case == 0));
        let found = score(&log(records)).comparisons;
        let [AskedComparisons { question: Question::Elsewhere, comparisons }] = &found[..] else {
            panic!("{found:?}")
        };
        let shown: Vec<_> =
            comparisons.iter().map(|one| (one.label.as_str(), one.comparison.sr.mean)).collect();
        let expected = [("1 demo here − elsewhere", 100.0), ("elsewhere − working memory", -10.0)];
        assert_eq!(shown, expected);
        let plain = log(episodes("episodic/new/unchanged/original", |_| true));
        assert_eq!(score(&plain).comparisons, []);
    }
}
