//! The scores of one condition: every figure of SPEC section 7, put together.

use std::collections::BTreeMap;

use serde::Serialize;

use super::blocked::{self, BlockedScore, Derived, Quartet};
use super::bootstrap::{Interval, intervals};
use super::cost;
use super::failure::Failures;
use super::spread::{Spread, mean, percentage};
use super::success::{self, GroupScore};
use super::time::{StageTimes, exists};
use super::trial::{Trial, Trials};
use crate::conditions::{Condition, Demonstrations, Route};
use crate::log::EpisodeTimings;
use domain::Representation;

/// The scores of one condition. What was not measured, or is not defined, is `None`, never zero.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ConditionScore {
    /// Which.
    #[serde(flatten)]
    pub condition: Condition,
    /// Episodes, those given up included.
    pub episodes: usize,
    /// Those given up because of a fault that is not the model's. They count as not successful.
    pub errored: usize,
    /// Repetitions of which there is an episode.
    pub runs: usize,
    /// Cases of which there is an episode.
    pub cases: usize,
    /// Success rate in percent.
    pub sr: Spread,
    /// Success weighted by path length, from 0 to 1.
    pub spl: Spread,
    /// Success rate of each group of tasks that has an episode.
    pub groups: Vec<GroupScore>,
    /// Follow, recovery, change and retention. Blocked routes only.
    pub blocked: Option<BlockedScore>,
    /// Mean steps of a finished episode.
    pub mean_steps: Option<f64>,
    /// Images in a request, on average.
    pub images_per_request: Option<Spread>,
    /// Tokens of prompts and completions, a hundred cases.
    pub tokens_per_100: Option<Spread>,
    /// Percentage of answers in which no action could be read.
    pub unread: Option<Spread>,
    /// Percentage of retrievals that came from another task's history.
    pub from_other_cases: Option<Spread>,
    /// Why the finished episodes that failed did. With `errored` these are all that did not succeed.
    pub failures: Failures,
    /// Mean microseconds of a step in each stage that there was.
    pub stage_us: Option<StageTimes>,
}

/// What the intervals need of an episode.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outcome {
    pub(super) success: bool,
    pub(super) path_weight: f64,
    tried_closed: Option<bool>,
}

impl From<&Trial<'_>> for Outcome {
    fn from(trial: &Trial<'_>) -> Self {
        Self {
            success: trial.is_success(),
            path_weight: trial.path_weight(),
            tried_closed: trial.tried_closed(),
        }
    }
}

/// The repetitions of each case under each of the `arms`, of the cases that all arms have.
pub(super) fn paired<'a>(arms: &[&Trials<'a>]) -> BTreeMap<&'a str, Vec<Vec<Outcome>>> {
    let by_case: Vec<_> = arms.iter().map(|trials| trials.cases()).collect();
    let Some(first) = by_case.first() else { return BTreeMap::new() };
    let repetitions = |case: &str| {
        let arm = |cases: &BTreeMap<&str, Vec<&Trial<'_>>>| {
            Some(cases.get(case)?.iter().map(|trial| Outcome::from(*trial)).collect())
        };
        by_case.iter().map(arm).collect::<Option<Vec<Vec<Outcome>>>>()
    };
    first.keys().filter_map(|case| Some((*case, repetitions(case)?))).collect()
}

pub(super) fn rate(outcomes: &[Outcome]) -> Option<f64> {
    percentage(outcomes.iter().map(|outcome| outcome.success))
}

pub(super) fn weight(outcomes: &[Outcome]) -> Option<f64> {
    mean(outcomes.iter().map(|outcome| outcome.path_weight))
}

/// The scores of `condition` from its `trials`; `None` when there are none. What takes other conditions to
/// compute is added by [`relate`].
pub(super) fn score_condition(
    condition: Condition,
    trials: &Trials<'_>,
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> Option<ConditionScore> {
    let cases: Vec<_> = paired(&[trials]).into_values().collect();
    let [sr, spl, follow, recovery] = intervals(&cases, |arms| {
        let outcomes = &arms[0];
        let tried = || outcomes.iter().filter(|outcome| outcome.tried_closed == Some(true));
        [
            rate(outcomes),
            weight(outcomes),
            percentage(outcomes.iter().filter_map(|outcome| outcome.tried_closed)),
            percentage(tried().map(|outcome| outcome.success)),
        ]
    });
    let within = |spread: Option<Spread>, interval: Option<Interval>| {
        spread.map(|spread| spread.within(interval))
    };
    let errored = trials.iter().filter(|trial| trial.record.is_none()).count();
    Some(ConditionScore {
        condition,
        episodes: trials.iter().count(),
        errored,
        runs: trials.runs().len(),
        cases: cases.len(),
        sr: trials.over_runs(success::success_rate)?.within(sr),
        spl: trials.over_runs(success::path_weighted)?.within(spl),
        groups: success::groups(trials),
        blocked: (condition.route == Route::Blocked).then(|| BlockedScore {
            follow: within(trials.over_runs(blocked::follow), follow),
            recovery: within(trials.over_runs(blocked::recovery), recovery),
            change: None,
            retention: None,
        }),
        mean_steps: mean(trials.records().map(|record| f64::from(record.steps))),
        images_per_request: trials.over_runs(cost::images_per_request),
        tokens_per_100: tokens(trials),
        unread: trials.over_runs(cost::unread),
        from_other_cases: trials.over_runs(cost::from_other_cases),
        failures: Failures::of(trials.records()),
        stage_us: stage_us(condition, trials, timings),
    })
}

/// Absent unless every run was measured.
fn tokens(trials: &Trials<'_>) -> Option<Spread> {
    let spread = trials.over_runs(cost::tokens_per_100)?;
    (spread.runs as usize == trials.runs().len()).then_some(spread)
}

fn stage_us(
    condition: Condition,
    trials: &Trials<'_>,
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> Option<StageTimes> {
    let timed = trials.records().filter_map(|record| timings.get(record.key.as_str()).copied());
    let asked = trials.records().any(|record| record.requests.is_some());
    StageTimes::of(timed, |stage| exists(stage, condition.memory, asked))
}

/// Change and retention of each blocked condition, from its own unchanged route and working memory's two.
pub(super) fn relate(scores: &mut [ConditionScore], trials: &BTreeMap<Condition, Trials<'_>>) {
    let rates: BTreeMap<Condition, f64> =
        scores.iter().map(|score| (score.condition, score.sr.mean)).collect();
    for score in scores {
        let Some(found) = &mut score.blocked else { continue };
        let blocked = score.condition;
        let unchanged = Condition { route: Route::Unchanged, ..blocked };
        let baseline = [blocked, unchanged].map(|condition| Condition {
            memory: Representation::Working,
            demonstrations: Demonstrations::NONE,
            ..condition
        });
        let reported = |condition: &Condition| rates.get(condition).copied();
        let (Some(after), Some(before)) = (reported(&blocked), reported(&unchanged)) else {
            continue;
        };
        let quartet = Quartet {
            blocked: &trials[&blocked],
            unchanged: &trials[&unchanged],
            baseline: match baseline.each_ref().map(|condition| trials.get(condition)) {
                [Some(blocked), Some(unchanged)] => Some([blocked, unchanged]),
                _ => None,
            },
        };
        let [change, retention] = related_intervals(quartet);
        // The baseline against itself is 0 by definition, not by measurement.
        let change = change.filter(|_| blocked != baseline[0]);
        found.change = match baseline.each_ref().map(reported) {
            [Some(baseline_after), Some(baseline_before)] => Some(Derived {
                value: blocked::change(after, before, [baseline_after, baseline_before]),
                interval: change,
            }),
            _ => None,
        };
        found.retention =
            blocked::retention(after, before).map(|value| Derived { value, interval: retention });
    }
}

fn related_intervals(quartet: Quartet<'_, '_>) -> [Option<Interval>; 2] {
    let mut arms = vec![quartet.blocked, quartet.unchanged];
    arms.extend(quartet.baseline.into_iter().flatten());
    let cases: Vec<_> = paired(&arms).into_values().collect();
    intervals(&cases, |arms| {
        let rates: Option<Vec<f64>> = arms.iter().map(|arm| rate(arm)).collect();
        match rates.as_deref() {
            Some(&[after, before]) => [None, blocked::retention(after, before)],
            Some(&[after, before, baseline_after, baseline_before]) => [
                Some(blocked::change(after, before, [baseline_after, baseline_before])),
                blocked::retention(after, before),
            ],
            _ => [None, None],
        }
    })
}
