//! Scores, from a run's log alone. The crate `report` prints them and writes pages.
//!
//! Pure functions with the formulas of section 7 of the specification and of the paper's section on metrics, a file
//! for each family.
//!
//! Every figure is computed for each run by itself, then averaged over runs ([`Spread`]). A figure that was not
//! measured, or is not defined, is `None`, never zero. Figures are over finished episodes. Where episodes are missing,
//! because they were given up after a fault of the infrastructure, or because the run is not over, [`Bounds`] gives the
//! range that the missing ones allow.
//!
//! | figure | file |
//! |---|---|
//! | SR, SPL, SR by task group | `success.rs` |
//! | follow F, recovery C, change Delta, retention R | `blocked.rs` |
//! | images, tokens, unreadable answers, retrievals from other tasks | `cost.rs` |
//! | tokens, latency and cost of requests to a model | `requests.rs` |
//! | what writing the documents took | `documents.rs` |
//! | what memories supplied and what that took | `memory.rs` |
//! | kinds of failure, the cases that fail most | `failure.rs`, `worst.rs` |
//! | since when an episode failed | `points.rs` |
//! | time of a step by stage, steps per second | `time.rs` |
//! | 95 % intervals | `interval.rs`, `student.rs` |
//! | two configurations on the same cases | `comparison.rs`, by name `compare.rs`, what is left out `unpaired.rs` |
//! | comparisons that conditions ask for | `asked.rs` |
//! | what a comparison shows, and could have shown | `conclusion.rs`, `sign_test.rs`, `holm.rs` |
//! | what a run is required to show | `gate.rs` |
//! | banks of different sizes | `growth.rs` |
//! | mismatches between demonstrations and test | `sensitivity.rs` |
//! | demonstrations from before and after an event | `conflict.rs` |
//! | memories beside right and wrong content, cases that need memory | `controls.rs`, `certify.rs` |
//! | streams | `streams.rs` |
//!
//! Episodes of streams enter the figures of their streams, and those of requests, memories and time. All other figures
//! are of the other episodes.

mod asked;
mod blocked;
mod certify;
pub mod compare;
mod comparison;
mod conclusion;
mod condition;
mod conflict;
mod controls;
mod cost;
mod documents;
mod failure;
pub mod gate;
mod growth;
mod holm;
mod interval;
mod mean;
mod memory;
mod points;
mod requests;
mod sensitivity;
mod sign_test;
mod spread;
mod streams;
mod student;
mod success;
mod time;
mod trial;
mod unpaired;
mod worst;

pub use asked::{AskedComparison, AskedComparisons, Question};
pub use blocked::{BlockedScore, Derived};
pub use comparison::{Comparison, FigureDifference, Pairing, Side, conclude};
pub use conclusion::{ChangedVerdict, ComparisonVerdict, Conclusion, LeftOut, Robustness, p_value};
pub use condition::{Bounds, ConditionScore};
pub use conflict::HISTORIES;
pub use controls::{CertifiedSuccess, ControlCondition, ControlNecessity, ControlScore};
pub use documents::DocumentScore;
pub use failure::{Failures, failure_of};
pub use growth::GrowthScore;
pub use holm::holm;
pub use interval::Interval;
pub use memory::MemoryScore;
pub use points::{
    Divergence, DivergenceScore, FailurePoints, LoopScore, PointScore, Successes, point_scores,
    steps_alike,
};
pub use requests::RequestScore;
pub use sensitivity::Sensitivity;
pub use sign_test::{LEVEL, MOST_CASES, POWER};
pub use spread::Spread;
pub use streams::{
    Estimate, Necessity, NecessitySuccess, OrderScore, RoundScore, StreamCost, StreamDifference,
    StreamScore, StreamScores, TestedDifference,
};
pub use success::GroupScore;
pub use time::StageTimes;
pub use trial::path_weight;
pub use unpaired::{Absence, ComparedSide, Unpaired};
pub use worst::{CaseScore, worst_cases};

use std::collections::BTreeMap;

use serde::Serialize;

use conditions::Condition;
use run_log::policy::PolicyLabel;
use run_log::{Manifest, RunLog};
use trial::Trials;

/// The scores of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scores {
    /// The policy whose scores they are.
    pub policy: PolicyLabel,
    /// One entry for each condition that has a finished episode, ordered by memory, start, route, demonstrations.
    pub conditions: Vec<ConditionScore>,
    /// Episodes of the whole run, finished or not.
    pub planned: usize,
    /// Finished episodes.
    pub finished: usize,
    /// Episodes given up because of a fault that is not the policy's. They are not part of any figure.
    pub errored: usize,
    /// Steps of all finished episodes per second of running time.
    pub steps_per_s: Option<f64>,
    /// Requests to the model; absent when there were none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub requests: Option<RequestScore>,
    /// What writing the documents took of models; absent when none has written any.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub documents: Vec<DocumentScore>,
    /// The conditions with demonstrations from before and after a passage has closed, over the cases whose original
    /// demonstration that invalidates; absent when there is no demonstration from after it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub conflicts: Vec<ConditionScore>,
    /// The comparisons that the run's conditions ask for, by the question that they answer; absent when there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub comparisons: Vec<AskedComparisons>,
    /// The conditions with banks, by memory and size; absent without banks.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub growth: Vec<GrowthScore>,
    /// The memories beside their controls; absent in a run without the arms `oracle` and `wrong`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub controls: Vec<ControlScore>,
    /// What mismatches between demonstrations and test cost; absent without any.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sensitivity: Vec<Sensitivity>,
    /// The run's streams; absent when there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub streams: Option<StreamScores>,
}

impl Scores {
    /// The scores of `condition`; `None` when it has no finished episode.
    pub fn of(&self, condition: &Condition) -> Option<&ConditionScore> {
        self.conditions.iter().find(|score| score.condition == *condition)
    }

    /// Episodes that have not finished.
    pub const fn missing(&self) -> usize {
        self.planned.saturating_sub(self.finished)
    }
}

/// Computes the scores of a run.
pub fn score(log: &RunLog) -> Scores {
    let timings = log.timings_by_key();
    let trials = Trials::by_condition(log);
    let streams = streams::score(log, &timings);
    // The manifest counts the episodes of streams, too, so beside them it says nothing about a condition.
    let planned = if streams.is_some() { Planned::default() } else { Planned::of(&log.manifest) };
    let scored = trials.iter().filter_map(|(condition, trials)| {
        let planned = planned.episodes(condition, planned.cases);
        condition::score_condition(*condition, trials, planned, &timings, &log.world)
    });
    let mut conditions: Vec<ConditionScore> = scored.collect();
    condition::relate(&mut conditions, &trials);
    Scores {
        policy: log.manifest.policy_label(),
        growth: growth::growth(log, &trials, &planned, &timings),
        sensitivity: sensitivity::sensitivity(log),
        conflicts: conflict::conflicts(log, &trials, &planned, &timings),
        comparisons: asked::comparisons(log, &trials),
        controls: controls::controls(log, &trials),
        conditions,
        planned: log.manifest.episodes as usize,
        finished: log.episodes.len(),
        errored: log.errors.len(),
        steps_per_s: time::steps_per_s(&log.timings),
        requests: RequestScore::of_run(log),
        documents: DocumentScore::of_run(&log.manifest),
        streams,
    }
}

/// What the whole run has: every condition has the same cases. Empty where that is not known.
#[derive(Debug, Default)]
struct Planned {
    repetitions: BTreeMap<Condition, usize>,
    cases: usize,
}

impl Planned {
    fn of(manifest: &Manifest) -> Self {
        let runs = manifest.settings.runs().into_iter();
        let repetitions: BTreeMap<Condition, usize> =
            runs.map(|(condition, runs)| (condition, runs as usize)).collect();
        let all = repetitions.values().sum();
        let cases = (manifest.episodes as usize).checked_div(all).unwrap_or(0);
        Self { repetitions, cases }
    }

    /// The episodes of `condition` on so many cases.
    fn episodes(&self, condition: &Condition, cases: usize) -> usize {
        self.repetitions.get(condition).map_or(0, |repetitions| repetitions * cases)
    }
}

#[cfg(test)]
mod tests;
