//! Scores, from a run's log alone.
//!
//! Pure functions with the formulas of SPEC section 7 and of the paper's section on metrics, a file for each
//! family. Nothing is read, drawn or printed here: the log is [`log`](crate::log)'s, the table
//! [`table`](crate::table)'s, the pages [`report`](crate::report)'s.
//!
//! Every figure is computed for each run by itself, then averaged over runs ([`Spread`]). What was not
//! measured, or is not defined, is `None`, never zero. An episode that was given up because of a fault is an
//! attempt that did not succeed; it has no steps, tokens or answers that could enter another figure.
//!
//! | figure | file |
//! |---|---|
//! | SR, SPL, SR by task group | `success.rs` |
//! | follow F, recovery C, change Delta, retention R | `blocked.rs` |
//! | images a request, tokens a hundred cases, unreadable answers, retrievals from other tasks | `cost.rs` |
//! | tokens, latency and cost of questions to a model | `requests.rs` |
//! | why episodes failed | `failure.rs` |
//! | time of a step by stage, steps a second | `time.rs` |
//! | 95 % intervals | `bootstrap.rs` |
//! | two configurations on the same cases | `compare.rs` |

mod blocked;
mod bootstrap;
mod compare;
mod condition;
mod cost;
mod failure;
mod requests;
mod spread;
mod success;
mod time;
mod trial;

pub use blocked::{BlockedScore, Derived};
pub use bootstrap::{Interval, RESAMPLES, SEED, intervals};
pub use compare::{Comparison, Difference, compare};
pub use condition::ConditionScore;
pub use failure::{Failure, Failures, LOOP_STEPS, LOOP_VISITS, NEW_CELLS};
pub use requests::RequestScore;
pub use spread::Spread;
pub use success::{GroupScore, group_of};
pub use time::StageTimes;
pub use trial::{Trial, Trials};

use std::collections::BTreeMap;

use serde::Serialize;

use crate::conditions::Condition;
use crate::log::{EpisodeTimings, RunLog};

/// Everything that is said about a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scores {
    /// One entry for each condition that has an episode, in the order of the words of a condition: so those of a
    /// memory stand together.
    pub conditions: Vec<ConditionScore>,
    /// Episodes of the whole run, finished or not.
    pub planned: usize,
    /// Finished episodes.
    pub finished: usize,
    /// Episodes given up because of a fault that is not the model's. They count as not successful.
    pub errored: usize,
    /// Steps of all finished episodes a second of running time.
    pub steps_per_s: Option<f64>,
    /// What was asked of a model; absent when none was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub requests: Option<RequestScore>,
}

impl Scores {
    /// The scores of `condition`; `None` when it has no episode.
    pub fn of(&self, condition: &Condition) -> Option<&ConditionScore> {
        self.conditions.iter().find(|score| score.condition == *condition)
    }
}

/// The scores of a run.
pub fn score(log: &RunLog) -> Scores {
    let timings: BTreeMap<&str, &EpisodeTimings> =
        log.timings.iter().map(|timings| (timings.key.as_str(), timings)).collect();
    let trials = Trials::by_condition(log);
    let scored = trials
        .iter()
        .filter_map(|(condition, trials)| condition::score_condition(*condition, trials, &timings));
    let mut conditions: Vec<ConditionScore> = scored.collect();
    condition::relate(&mut conditions, &trials);
    Scores {
        conditions,
        planned: log.manifest.episodes as usize,
        finished: log.episodes.len(),
        errored: log.errors.len(),
        steps_per_s: time::steps_per_s(&log.timings),
        requests: RequestScore::of_run(log),
    }
}

#[cfg(test)]
mod tests;
