//! The scores of one condition: every figure of section 7 of the specification, put together.

use std::collections::{BTreeMap, BTreeSet};

use case_book::WorldFacts;
use serde::Serialize;

use super::blocked::{self, BlockedScore, Derived};
use super::cost;
use super::failure::Failures;
use super::interval::{Interval, Units};
use super::mean::{mean, weighted_mean};
use super::spread::Spread;
use super::success::{self, GroupScore};
use super::time::{StageTimes, exists};
use super::trial::{Trials, path_weight};
use conditions::{Condition, Route};
use run_log::{EpisodeRecord, EpisodeTimings};

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

/// The cases as units of the mean over runs of each run's mean of `value`, over the episodes that have one.
pub(super) fn cases(trials: &Trials<'_>, value: impl Fn(&EpisodeRecord) -> Option<f64>) -> Units {
    let mut by_run: BTreeMap<u32, u32> = BTreeMap::new();
    let mut by_case: BTreeMap<&str, Vec<(f64, u32)>> = BTreeMap::new();
    for record in trials.iter() {
        if let Some(value) = value(record) {
            *by_run.entry(record.run).or_default() += 1;
            by_case.entry(&record.case).or_default().push((value, record.run));
        }
    }
    // Every run weighs the same, however many episodes it has.
    let weigh = |&(value, run): &(f64, u32)| (value, 1.0 / f64::from(by_run[&run]));
    let unit = |values: &Vec<(f64, u32)>| {
        let weight = values.iter().map(|value| weigh(value).1).sum();
        Some((weighted_mean(values.iter().map(weigh))?, weight))
    };
    Units::weighted(&by_case.values().filter_map(unit).collect::<Vec<_>>())
}

/// The success rate in percent, with its interval over cases; `None` without episodes.
pub(super) fn success_of(trials: &Trials<'_>) -> Option<Spread> {
    let interval = cases(trials, |record| Some(succeeded(record))).interval(Interval::PERCENT);
    Some(trials.over_runs(success::success_rate)?.within(interval))
}

/// The success of an episode in percent.
pub(super) fn succeeded(record: &EpisodeRecord) -> f64 {
    percent(record.is_success())
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
    world: &WorldFacts,
) -> Option<ConditionScore> {
    let planned = planned.max(trials.count());
    Some(ConditionScore {
        condition,
        episodes: trials.count(),
        planned,
        bounds: Bounds::of(trials, planned),
        runs: trials.runs().len(),
        cases: trials.cases().len(),
        sr: success_of(trials)?,
        spl: trials
            .over_runs(success::path_weighted)?
            .within(cases(trials, |record| Some(path_weight(record))).interval(Interval::SHARE)),
        groups: success::groups(trials, world),
        blocked: (condition.route == Route::Blocked).then(|| {
            let within = |spread: Option<Spread>, units: Units| {
                spread.map(|spread| spread.within(units.interval(Interval::PERCENT)))
            };
            let tried = |record: &EpisodeRecord| record.had_conflict().map(percent);
            let recovered = |record: &EpisodeRecord| {
                (record.had_conflict() == Some(true)).then(|| succeeded(record))
            };
            BlockedScore {
                follow: within(trials.over_runs(blocked::follow), cases(trials, tried)),
                recovery: within(trials.over_runs(blocked::recovery), cases(trials, recovered)),
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
        failures: Failures::of(trials.iter(), world),
        stage_us: stage_us(condition, trials, timings),
    })
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
        found.retention = common([after, before]).and_then(|found| {
            let [after, before] = &found.units;
            let value = blocked::retention(found.rates[0], found.rates[1])?;
            Some(Derived { value, interval: after.interval_of_ratio(before, 100.0) })
        });
        let baseline = own.map(|condition| condition.without_memory());
        let [Some(baseline_after), Some(baseline_before)] =
            baseline.map(|condition| trials.get(&condition?))
        else {
            continue;
        };
        // The baseline against itself is 0 by definition, not by measurement.
        let is_baseline = Some(own[0]) == baseline[0];
        found.change = common([after, before, baseline_after, baseline_before]).map(|found| {
            let units = Units::combined(found.units.each_ref(), blocked::change);
            let interval = units.interval(Interval::POINTS).filter(|_| !is_baseline);
            Derived { value: blocked::change(found.rates), interval }
        });
    }
}

/// Conditions on the cases that all of them have.
struct Common<const N: usize> {
    /// The mean success rate over runs of each condition.
    rates: [f64; N],
    /// The same cases in the same order for each condition.
    units: [Units; N],
}

/// `None` when the `arms` have no case in common.
fn common<const N: usize>(arms: [&Trials<'_>; N]) -> Option<Common<N>> {
    let ids = arms.map(|arm| arm.cases().into_keys().collect::<BTreeSet<_>>());
    let shared = ids.into_iter().reduce(|some, more| &some & &more)?;
    let arms = arms.map(|arm| arm.of_cases(&shared));
    let rates = all(arms.each_ref().map(|arm| arm.over_runs(success::success_rate)))?;
    let units = arms.each_ref().map(|arm| cases(arm, |record| Some(succeeded(record))));
    Some(Common { rates: rates.map(|rate| rate.mean), units })
}

/// All of these values; `None` when one is missing.
fn all<T, const N: usize>(values: [Option<T>; N]) -> Option<[T; N]> {
    values.into_iter().collect::<Option<Vec<T>>>()?.try_into().ok()
}
