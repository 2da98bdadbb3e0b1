//! The scores of one condition: every figure of section 7 of the specification, put together.

use std::collections::{BTreeMap, BTreeSet};

use domain::Representation;
use serde::Serialize;

use super::blocked::{self, BlockedScore, Derived};
use super::bootstrap::intervals;
use super::cost;
use super::failure::Failures;
use super::interval::{Interval, rate_interval, wilson};
use super::spread::{Spread, mean, weighted_mean};
use super::success::{self, GroupScore};
use super::time::{StageTimes, exists};
use super::trial::{Trials, path_weight};
use crate::conditions::{Condition, Demonstrations, Route};
use crate::log::{EpisodeRecord, EpisodeTimings};

/// The scores of one condition. What was not measured, or is not defined, is `None`, never zero.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ConditionScore {
    /// The condition.
    #[serde(flatten)]
    pub condition: Condition,
    /// Finished episodes, from which the figures are computed.
    pub episodes: usize,
    /// Episodes of the condition in the whole run.
    pub planned: usize,
    /// The bounds that missing episodes allow; `None` when none is missing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bounds: Option<Bounds>,
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
    /// Mean steps of an episode.
    pub mean_steps: Option<f64>,
    /// Mean images of a request.
    pub images_per_request: Option<Spread>,
    /// Prompt and completion tokens of a hundred cases.
    pub tokens_per_100: Option<Spread>,
    /// Percentage of answers in which no action could be read.
    pub unread: Option<Spread>,
    /// Percentage of retrievals that came from another task's history.
    pub from_other_cases: Option<Spread>,
    /// The episodes that failed, by kind.
    pub failures: Failures,
    /// Mean microseconds of a step in each stage that exists.
    pub stage_us: Option<StageTimes>,
}

/// What the success rate and SPL are when all missing episodes fail, and when all succeed (with SPL 1).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bounds {
    /// Of the success rate, in percent.
    pub sr: Interval,
    /// Of SPL.
    pub spl: Interval,
}

impl Bounds {
    fn of(trials: &Trials<'_>, planned: usize) -> Option<Self> {
        let missing = planned.saturating_sub(trials.count());
        let between = |sum: f64, unit: f64| Interval {
            low: unit * sum / planned as f64,
            high: unit * (sum + missing as f64) / planned as f64,
        };
        let successes = trials.iter().filter(|record| record.is_success()).count();
        (missing > 0).then(|| Self {
            sr: between(successes as f64, 100.0),
            spl: between(trials.iter().map(path_weight).sum(), 1.0),
        })
    }
}

/// The figures of an episode that the intervals need.
#[derive(Debug, Clone, Copy)]
pub(super) struct EpisodeSample {
    pub(super) success: bool,
    pub(super) path_weight: f64,
    tried_closed: Option<bool>,
    /// Its weight in a figure of all episodes.
    pub(super) weight: f64,
    /// Its weight in a figure of those that tried the closed cell.
    weight_of_tried: f64,
}

/// The weights of the episodes of each run with which the mean over all episodes that `counts` is the mean over runs: 1
/// where every run has as many, less in a run that has more.
fn run_weights(
    trials: &Trials<'_>,
    counts: impl Fn(&EpisodeRecord) -> bool,
) -> impl Fn(&EpisodeRecord) -> f64 {
    let mut counted: BTreeMap<u32, usize> = BTreeMap::new();
    for record in trials.iter().filter(|record| counts(record)) {
        *counted.entry(record.run).or_default() += 1;
    }
    let (all, runs) = (counted.values().sum::<usize>(), counted.len());
    move |record| counted.get(&record.run).map_or(0.0, |count| all as f64 / (runs * count) as f64)
}

/// The repetitions of each case under each of the `arms`, for the cases that all arms have.
pub(super) fn paired<'a>(arms: &[&Trials<'a>]) -> BTreeMap<&'a str, Vec<Vec<EpisodeSample>>> {
    let samples = |trials: &&Trials<'a>| {
        let weight = run_weights(trials, |_| true);
        let weight_of_tried = run_weights(trials, |record| record.tried_closed == Some(true));
        let sample = |record: &EpisodeRecord| EpisodeSample {
            success: record.is_success(),
            path_weight: path_weight(record),
            tried_closed: record.tried_closed,
            weight: weight(record),
            weight_of_tried: weight_of_tried(record),
        };
        let cases = trials.cases().into_iter();
        cases
            .map(|(case, records)| (case, records.into_iter().map(sample).collect()))
            .collect::<BTreeMap<&str, Vec<EpisodeSample>>>()
    };
    let by_case: Vec<_> = arms.iter().map(samples).collect();
    let Some(first) = by_case.first() else { return BTreeMap::new() };
    let repetitions = |case: &str| {
        let arm = |cases: &BTreeMap<&str, Vec<EpisodeSample>>| cases.get(case).cloned();
        by_case.iter().map(arm).collect::<Option<Vec<Vec<EpisodeSample>>>>()
    };
    first.keys().filter_map(|case| Some((*case, repetitions(case)?))).collect()
}

/// The success rate, in percent.
pub(super) fn rate(samples: &[EpisodeSample]) -> Option<f64> {
    weighted_mean(samples.iter().map(|sample| (percent(sample.success), sample.weight)))
}

/// SPL.
pub(super) fn path_weighted(samples: &[EpisodeSample]) -> Option<f64> {
    weighted_mean(samples.iter().map(|sample| (sample.path_weight, sample.weight)))
}

fn percent(holds: bool) -> f64 {
    if holds { 100.0 } else { 0.0 }
}

/// The scores of `condition` from its `trials`, of which the run has `planned`; `None` when there are none. What
/// needs other conditions is added by [`relate`].
pub(super) fn score_condition(
    condition: Condition,
    trials: &Trials<'_>,
    planned: usize,
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> Option<ConditionScore> {
    let planned = planned.max(trials.count());
    let intervals = Intervals::of(trials);
    Some(ConditionScore {
        condition,
        episodes: trials.count(),
        planned,
        bounds: Bounds::of(trials, planned),
        runs: trials.runs().len(),
        cases: trials.cases().len(),
        sr: trials.over_runs(success::success_rate)?.within(intervals.sr),
        spl: trials.over_runs(success::path_weighted)?.within(intervals.spl),
        groups: success::groups(trials),
        blocked: (condition.route == Route::Blocked).then(|| {
            let within = |spread: Option<Spread>, interval| spread.map(|s| s.within(interval));
            BlockedScore {
                follow: within(trials.over_runs(blocked::follow), intervals.follow),
                recovery: within(trials.over_runs(blocked::recovery), intervals.recovery),
                stale: trials.over_runs(blocked::stale),
                change: None,
                retention: None,
            }
        }),
        mean_steps: mean(trials.iter().map(|record| f64::from(record.steps))),
        images_per_request: trials.over_runs(cost::images_per_request),
        tokens_per_100: tokens(trials),
        unread: trials.over_runs(cost::unread),
        from_other_cases: trials.over_runs(cost::from_other_cases),
        failures: Failures::of(trials.iter()),
        stage_us: stage_us(condition, trials, timings),
    })
}

/// The intervals of a condition's own figures.
struct Intervals {
    sr: Option<Interval>,
    spl: Option<Interval>,
    follow: Option<Interval>,
    recovery: Option<Interval>,
}

impl Intervals {
    fn of(trials: &Trials<'_>) -> Self {
        let cases: Vec<_> = paired(&[trials]).into_values().collect();
        let of_rate = |value: fn(&EpisodeSample) -> Option<bool>| {
            let weighted = |sample: &EpisodeSample| Some((value(sample)?, sample.weight));
            let by_case = cases.iter().map(|arms| arms[0].iter().filter_map(weighted).collect());
            rate_interval(&by_case.collect::<Vec<_>>())
        };
        let tried = |samples: &[EpisodeSample]| {
            let tried = samples.iter().filter(|sample| sample.tried_closed == Some(true));
            weighted_mean(tried.map(|sample| (percent(sample.success), sample.weight_of_tried)))
        };
        let [spl, recovery] = intervals(&cases, |arms| [path_weighted(&arms[0]), tried(&arms[0])]);
        let counted = cases.iter().filter(|arms| tried(&arms[0]).is_some()).count();
        Self {
            sr: of_rate(|sample| Some(sample.success)),
            spl: spl.map(|found| with_width(found, cases.len(), 1.0)),
            follow: of_rate(|sample| sample.tried_closed),
            recovery: recovery.map(|found| with_width(found, counted, 100.0)),
        }
    }
}

/// The bootstrap interval `found` of a mean of values from 0 to `most` over `cases`; Wilson's where all cases are
/// alike, so that the bootstrap has no width. (The variance of such a mean is at most that of a rate.)
fn with_width(found: Interval, cases: usize, most: f64) -> Interval {
    if found.is_point() { wilson(found.low / most, cases as f64).scaled(most) } else { found }
}

/// `None` unless every run was measured.
fn tokens(trials: &Trials<'_>) -> Option<Spread> {
    let spread = trials.over_runs(cost::tokens_per_100)?;
    (spread.runs as usize == trials.runs().len()).then_some(spread)
}

fn stage_us(
    condition: Condition,
    trials: &Trials<'_>,
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> Option<StageTimes> {
    let timed = trials.iter().filter_map(|record| timings.get(record.key.as_str()).copied());
    let asked = trials.iter().any(|record| record.requests.is_some());
    StageTimes::of(timed, |stage| exists(stage, condition.memory, asked))
}

/// Adds change and retention of each blocked condition, from its own unchanged route and working memory's two.
pub(super) fn relate(scores: &mut [ConditionScore], trials: &BTreeMap<Condition, Trials<'_>>) {
    for score in scores {
        let Some(found) = &mut score.blocked else { continue };
        let own = [score.condition, Condition { route: Route::Unchanged, ..score.condition }];
        let [Some(after), Some(before)] = own.map(|condition| trials.get(&condition)) else {
            continue;
        };
        found.retention =
            derived([after, before], |[after, before]| blocked::retention(after, before));
        let baseline = own.map(|Condition { start, route, variation, arm, .. }| {
            let none = Demonstrations::NONE;
            let working = Condition::new(Representation::Working, start, route, none, variation);
            working.map(|condition| condition.with_arm(arm))
        });
        let [Some(baseline_after), Some(baseline_before)] =
            baseline.map(|condition| trials.get(&condition?))
        else {
            continue;
        };
        let change = |[after, before, baseline @ ..]: [f64; 4]| {
            Some(blocked::change(after, before, baseline))
        };
        found.change = derived([after, before, baseline_after, baseline_before], change);
        if let Some(change) = found.change.as_mut().filter(|_| Some(own[0]) == baseline[0]) {
            // The baseline against itself is 0 by definition, not by measurement.
            change.interval = None;
        }
    }
}

/// What `figure` makes of the success rates of the `arms` on the cases that all of them have, with its bootstrap interval, if
/// not all cases are alike. `None` when they have no case in common.
fn derived<const N: usize>(
    arms: [&Trials<'_>; N],
    figure: impl Fn([f64; N]) -> Option<f64>,
) -> Option<Derived> {
    let cases = arms.map(|arm| arm.cases().into_keys().collect::<BTreeSet<_>>());
    let common = cases.into_iter().reduce(|some, more| &some & &more)?;
    let arms = arms.map(|arm| arm.of_cases(&common));
    let rates = arms.each_ref().map(|arm| arm.over_runs(success::success_rate));
    let value = figure(all(rates)?.map(|rate| rate.mean))?;
    let cases: Vec<_> = paired(&arms.each_ref()).into_values().collect();
    let [interval] = intervals(&cases, |arms| {
        let rates = arms.iter().map(|arm| rate(arm)).collect::<Option<Vec<f64>>>();
        [rates.and_then(|rates| figure(rates.try_into().ok()?))]
    });
    Some(Derived { value, interval: interval.filter(|interval| !interval.is_point()) })
}

/// All of these values; `None` when one is missing.
fn all<T, const N: usize>(values: [Option<T>; N]) -> Option<[T; N]> {
    values.into_iter().collect::<Option<Vec<T>>>()?.try_into().ok()
}
