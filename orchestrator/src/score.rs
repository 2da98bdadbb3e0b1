//! Scores, from a run's log alone.
//!
//! Pure functions with the formulas of SPEC section 7. Nothing is read, drawn or printed here: the log is
//! [`log`](crate::log)'s, the table [`table`](crate::table)'s. What was not measured is `None`, never zero.

use std::collections::BTreeMap;

use serde::Serialize;
use warehouse::Group;

use crate::conditions::{Condition, Route};
use crate::log::{EpisodeRecord, EpisodeTimings, RunLog, Stages};

/// Everything a table says about a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scores {
    /// One entry for each condition that has an episode, in the order of the settings.
    pub conditions: Vec<ConditionScore>,
    /// Episodes of the whole run, finished or not.
    pub planned: usize,
    /// Finished episodes.
    pub finished: usize,
    /// Episodes given up because of a fault that is not the model's. They count as not successful.
    pub errored: usize,
    /// Steps of all finished episodes a second of running time.
    pub steps_per_s: Option<f64>,
}

/// The scores of one condition.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ConditionScore {
    /// Which.
    #[serde(flatten)]
    pub condition: Condition,
    /// Episodes, errored ones included.
    pub episodes: usize,
    /// Those given up.
    pub errored: usize,
    /// Success rate in percent over runs.
    pub sr: Spread,
    /// Success weighted by path length over runs.
    pub spl: Spread,
    /// F: percentage of episodes in which the agent tried to enter a newly closed cell. Blocked routes only.
    pub tried_closed: Option<Spread>,
    /// C: percentage of those that succeeded all the same. `None` when there are none.
    pub recovered: Option<f64>,
    /// Success rate in percent of each group of tasks, over all runs, where it has an episode.
    pub groups: Vec<(&'static str, f64)>,
    /// Mean steps of an episode.
    pub mean_steps: Option<f64>,
    /// Images in a request, on average.
    pub images_per_request: Option<f64>,
    /// Tokens of prompts and completions, a hundred episodes.
    pub tokens_per_100: Option<f64>,
    /// Percentage of answers in which no action could be read.
    pub unread: Option<f64>,
    /// Percentage of retrievals that came from another case's demonstrations.
    pub from_other_cases: Option<f64>,
    /// Mean microseconds of a step in each stage that there was, by the names of [`Stages::NAMES`], and in
    /// all of them together.
    pub stage_us: Option<StageTimes>,
}

/// Where the time of a step went, in microseconds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageTimes {
    /// From a command to the next one.
    pub sum: f64,
    /// The stages, in order.
    pub stages: Vec<(&'static str, f64)>,
}

impl StageTimes {
    /// The stage called `name`; `None` when the episodes have no such stage.
    pub fn of(&self, name: &str) -> Option<f64> {
        self.stages.iter().find(|(stage, _)| *stage == name).map(|(_, us)| *us)
    }
}

/// A figure over runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Its mean.
    pub mean: f64,
    /// Its sample standard deviation; `None` for one run.
    pub std: Option<f64>,
}

impl Spread {
    /// Mean and sample standard deviation of `values`; `None` of none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mean = mean(values.iter().copied())?;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let std = (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt());
        Some(Self { mean, std })
    }
}

/// One episode as the formulas see it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sample {
    run: u32,
    /// s_i.
    success: bool,
    /// p_i.
    steps: u32,
    /// l_i.
    reference: u32,
}

impl Sample {
    /// s_i * l_i / max(p_i, l_i), and 0 / 0 taken as 1: an episode that begins done is done best.
    fn spl(self) -> f64 {
        match (self.success, self.steps.max(self.reference)) {
            (false, _) => 0.0,
            (true, 0) => 1.0,
            (true, longest) => f64::from(self.reference) / f64::from(longest),
        }
    }
}

/// Success rate of one run: `SR = 100 / N * sum s_i` (SPEC section 7).
fn success_rate(samples: &[Sample]) -> Option<f64> {
    percentage(samples.iter().map(|sample| sample.success))
}

/// Success weighted by path length of one run: `SPL = 1 / N * sum s_i * l_i / max(p_i, l_i)`.
fn path_weighted(samples: &[Sample]) -> Option<f64> {
    mean(samples.iter().map(|sample| sample.spl()))
}

/// The scores of a run.
pub fn score(log: &RunLog) -> Scores {
    let mut conditions = log.manifest.settings.conditions();
    // Of an episode that was given up the key says all that is counted.
    let errored_in = |condition: &Condition| {
        let prefix = format!("{condition}/run");
        let runs = log.errors.iter().filter_map(|error| {
            let (run, _case) = error.key.strip_prefix(&prefix)?.split_once('/')?;
            run.parse::<u32>().ok()
        });
        runs.collect::<Vec<_>>()
    };
    conditions.retain(|condition| {
        log.episodes.iter().any(|record| record.condition() == *condition)
            || !errored_in(condition).is_empty()
    });
    let timings: BTreeMap<&str, &EpisodeTimings> =
        log.timings.iter().map(|timings| (timings.key.as_str(), timings)).collect();
    let conditions = conditions.into_iter().filter_map(|condition| {
        let records: Vec<&EpisodeRecord> =
            log.episodes.iter().filter(|record| record.condition() == condition).collect();
        score_condition(condition, &records, &errored_in(&condition), &timings)
    });
    Scores {
        conditions: conditions.collect(),
        planned: log.manifest.episodes as usize,
        finished: log.episodes.len(),
        errored: log.errors.len(),
        steps_per_s: steps_per_s(&log.timings),
    }
}

/// The scores of `condition`; `errored` holds the run of each episode that was given up.
fn score_condition(
    condition: Condition,
    records: &[&EpisodeRecord],
    errored: &[u32],
    timings: &BTreeMap<&str, &EpisodeTimings>,
) -> Option<ConditionScore> {
    let finished = records.iter().map(|record| Sample {
        run: record.run,
        success: record.is_success(),
        steps: record.steps,
        reference: record.reference,
    });
    // Given up: not a success, whatever its length would have been.
    let given_up =
        errored.iter().map(|&run| Sample { run, success: false, steps: 0, reference: 0 });
    let mut by_run: BTreeMap<u32, Vec<Sample>> = BTreeMap::new();
    for sample in finished.chain(given_up) {
        by_run.entry(sample.run).or_default().push(sample);
    }
    let over_runs = |figure: fn(&[Sample]) -> Option<f64>| {
        let values: Vec<f64> = by_run.values().filter_map(|samples| figure(samples)).collect();
        Spread::of(&values)
    };
    let timed: Vec<&EpisodeTimings> =
        records.iter().filter_map(|record| timings.get(record.key.as_str()).copied()).collect();
    // The expert is not asked, so there is nothing to wait for after the view.
    let asked = records.iter().any(|record| record.requests.is_some());
    Some(ConditionScore {
        condition,
        episodes: records.len() + errored.len(),
        errored: errored.len(),
        sr: over_runs(success_rate)?,
        spl: over_runs(path_weighted)?,
        tried_closed: tried_closed(condition, records),
        recovered: percentage(
            records.iter().filter(|r| r.tried_closed == Some(true)).map(|r| r.is_success()),
        ),
        groups: groups(records),
        mean_steps: mean(records.iter().map(|record| f64::from(record.steps))),
        images_per_request: images_per_request(records),
        tokens_per_100: tokens_per_100(records),
        unread: unread(records),
        from_other_cases: from_other_cases(records),
        stage_us: stage_us(&timed, |stage| match stage {
            "command" | "dynamics" | "render" => true,
            "embed" | "search" => asked && condition.memory.uses_demonstrations(),
            _ => asked,
        }),
    })
}

/// F of each run, over runs: `F = 100 / N * sum b_i`.
fn tried_closed(condition: Condition, records: &[&EpisodeRecord]) -> Option<Spread> {
    if condition.route != Route::Blocked {
        return None;
    }
    let mut by_run: BTreeMap<u32, Vec<bool>> = BTreeMap::new();
    for record in records {
        by_run.entry(record.run).or_default().push(record.tried_closed == Some(true));
    }
    let values: Vec<f64> =
        by_run.values().filter_map(|tried| percentage(tried.iter().copied())).collect();
    Spread::of(&values)
}

fn groups(records: &[&EpisodeRecord]) -> Vec<(&'static str, f64)> {
    let of = |group: Group| records.iter().filter(move |record| group_of(record.task) == group);
    let rate = |group: Group| percentage(of(group).map(|record| record.is_success()));
    Group::ALL.into_iter().filter_map(|group| Some((group.name(), rate(group)?))).collect()
}

/// The group of task `number` (SPEC section 3).
const fn group_of(number: u8) -> Group {
    match number {
        1 | 2 => Group::Basic,
        7 | 8 | 10 => Group::ReturnLoop,
        9 => Group::Revisit,
        _ => Group::MultiObject,
    }
}

fn images_per_request(records: &[&EpisodeRecord]) -> Option<f64> {
    let measured: Vec<(u64, u32)> =
        records.iter().filter_map(|record| Some((record.images?, record.requests?))).collect();
    let requests: u32 = measured.iter().map(|(_, requests)| requests).sum();
    let images: u64 = measured.iter().map(|(images, _)| images).sum();
    (requests > 0).then(|| images as f64 / f64::from(requests))
}

/// Absent as soon as one episode was not measured: a sum over some would look like one over all.
fn tokens_per_100(records: &[&EpisodeRecord]) -> Option<f64> {
    let tokens: Option<Vec<f64>> = records
        .iter()
        .map(|record| Some((record.prompt_tokens? + record.completion_tokens?) as f64))
        .collect();
    Some(mean(tokens?.into_iter())? * 100.0)
}

fn unread(records: &[&EpisodeRecord]) -> Option<f64> {
    let requests: u32 = records.iter().filter_map(|record| record.requests).sum();
    let unread: u32 = records.iter().map(|record| record.unread.total()).sum();
    (requests > 0).then(|| 100.0 * f64::from(unread) / f64::from(requests))
}

fn from_other_cases(records: &[&EpisodeRecord]) -> Option<f64> {
    let retrieved = records.iter().filter_map(|record| record.retrieved.as_deref());
    let matches = retrieved.flat_map(str::split_whitespace).filter(|word| *word != "-");
    percentage(matches.map(|word| word.contains(':')))
}

/// Means over all steps, of the stages that there are.
fn stage_us(timings: &[&EpisodeTimings], exists: impl Fn(&str) -> bool) -> Option<StageTimes> {
    let steps: u64 = timings.iter().map(|timings| u64::from(timings.steps)).sum();
    let mut sum = Stages::default();
    timings.iter().for_each(|timings| sum += timings.stages);
    let means = sum.values().map(|ns| ns as f64 / 1000.0 / steps as f64);
    let named = Stages::NAMES.into_iter().zip(means);
    (steps > 0).then(|| StageTimes {
        sum: means.iter().sum(),
        stages: named.filter(|(stage, _)| exists(stage)).collect(),
    })
}

/// Steps over running time, which is for each session from its first episode's start to its last one's end.
fn steps_per_s(timings: &[EpisodeTimings]) -> Option<f64> {
    let mut sessions: BTreeMap<u32, (u64, u64)> = BTreeMap::new();
    for timings in timings {
        let (start, end) = sessions.entry(timings.session).or_insert((u64::MAX, 0));
        *start = timings.started_ns.min(*start);
        *end = timings.ended_ns.max(*end);
    }
    let ns: u64 = sessions.values().map(|(start, end)| end.saturating_sub(*start)).sum();
    let steps: u64 = timings.iter().map(|timings| u64::from(timings.steps)).sum();
    (ns > 0).then(|| steps as f64 * 1e9 / ns as f64)
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

fn percentage(values: impl Iterator<Item = bool>) -> Option<f64> {
    mean(values.map(|value| if value { 100.0 } else { 0.0 }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::Start;
    use crate::log::testing::{manifest, record, timings};
    use crate::log::{EpisodeError, Unread};
    use crate::plan::EpisodeKey;

    fn log(records: Vec<EpisodeRecord>) -> RunLog {
        RunLog {
            dir: "run".into(),
            manifest: manifest(),
            timings: records.iter().map(timings).collect(),
            episodes: records,
            errors: Vec::new(),
            sessions: Vec::new(),
        }
    }

    fn only(log: &RunLog) -> ConditionScore {
        let mut scores = score(log).conditions;
        assert_eq!(scores.len(), 1);
        scores.remove(0)
    }

    /// Puts a record under another condition or run.
    fn moved(mut record: EpisodeRecord, start: Start, route: Route, run: u32) -> EpisodeRecord {
        (record.start, record.route, record.run) = (start, route, run);
        let key = EpisodeKey { condition: record.condition(), run, case: record.case.clone() };
        record.key = key.to_string();
        record
    }

    #[test]
    fn rates_are_what_one_reckons_by_hand() {
        // Successes of 10 steps for a reference of 8: 0.8 each. Run 1 has 2 of 4, run 2 has 1 of 2.
        let run1 = [("a", true), ("b", false), ("c", true), ("d", false)];
        let mut records: Vec<_> =
            run1.into_iter().map(|(id, success)| record(id, success)).collect();
        let run2 = [("a", true), ("b", false), ("c", false)];
        let second =
            |(id, success)| moved(record(id, success), Start::Original, Route::Unchanged, 2);
        records.extend(run2.into_iter().map(second));
        let found = only(&log(records));
        let (sr1, sr2) = (50.0, 100.0 / 3.0);
        let mean = (sr1 + sr2) / 2.0;
        let std = ((sr1 - mean) * (sr1 - mean) * 2.0_f64).sqrt();
        assert!((found.sr.mean - mean).abs() < 1e-9);
        assert!((found.sr.std.unwrap() - std).abs() < 1e-9);
        assert!((found.spl.mean - (0.4 + 0.8 / 3.0) / 2.0).abs() < 1e-9);
        assert_eq!((found.episodes, found.images_per_request), (7, Some(14.0)));
        assert!((found.mean_steps.unwrap() - (3.0 * 10.0 + 4.0 * 200.0) / 7.0).abs() < 1e-9);
        assert_eq!(found.groups.len(), 1, "every case is of task 1");
        assert!((found.groups[0].1 - 300.0 / 7.0).abs() < 1e-9);
    }

    #[test]
    fn a_walk_shorter_than_its_reference_is_worth_no_more_than_one() {
        let sample = |success, steps, reference| Sample { run: 1, success, steps, reference };
        for (sample, expected) in [
            (sample(true, 8, 8), 1.0),
            (sample(true, 4, 8), 1.0),
            (sample(true, 16, 8), 0.5),
            (sample(false, 8, 8), 0.0),
            (sample(true, 0, 0), 1.0),
        ] {
            assert_eq!(sample.spl(), expected, "{sample:?}");
        }
    }

    #[test]
    fn what_was_not_measured_is_absent() {
        let found = only(&log(vec![record("a", true)]));
        assert_eq!(found.sr.std, None, "one run has no spread");
        assert_eq!((found.tokens_per_100, found.tried_closed, found.recovered), (None, None, None));
        assert_eq!(found.from_other_cases, None);

        let mut expert = record("a", true);
        (expert.requests, expert.images) = (None, None);
        let mut without = log(vec![expert]);
        let stages = only(&without).stage_us.unwrap();
        assert_eq!((stages.of("render"), stages.of("embed")), (Some(1.0), None));
        without.timings.clear();
        let found = only(&without);
        assert_eq!((found.images_per_request, found.unread, found.stage_us), (None, None, None));
        assert_eq!(score(&without).steps_per_s, None);

        let mut counted = record("a", true);
        (counted.prompt_tokens, counted.completion_tokens) = (Some(90), Some(10));
        assert_eq!(only(&log(vec![counted.clone()])).tokens_per_100, Some(10_000.0));
        assert_eq!(only(&log(vec![counted, record("b", true)])).tokens_per_100, None);
    }

    #[test]
    fn an_episode_that_was_given_up_does_not_leave_the_mean() {
        let mut log = log(vec![record("a", true)]);
        log.errors.push(EpisodeError {
            key: record("b", true).key,
            session: 1,
            error: "overdue".into(),
        });
        let found = only(&log);
        assert_eq!(
            (found.episodes, found.errored, found.sr.mean, found.spl.mean),
            (2, 1, 50.0, 0.4)
        );
    }

    #[test]
    fn blocked_routes_say_who_ran_into_the_barricade_and_who_recovered() {
        let blocked = |id, success, tried| {
            let mut record = moved(record(id, success), Start::New, Route::Blocked, 1);
            record.tried_closed = Some(tried);
            record
        };
        let mut log = log(vec![
            blocked("a", true, true),
            blocked("b", false, true),
            blocked("c", false, true),
            blocked("d", true, false),
        ]);
        log.manifest.settings.routes = vec![Route::Blocked];
        let found = only(&log);
        assert_eq!(found.tried_closed, Some(Spread { mean: 75.0, std: None }));
        assert!((found.recovered.unwrap() - 100.0 / 3.0).abs() < 1e-9);
        log.episodes.iter_mut().for_each(|record| record.tried_closed = Some(false));
        assert_eq!(only(&log).recovered, None, "undefined, not zero");
    }

    #[test]
    fn answers_retrievals_and_time_are_counted() {
        let mut first = record("a", true);
        first.retrieved = Some("o0 o1 - t03-07:d4".into());
        first.unread = Unread { unreadable: 1, empty: 1, refused: 0 };
        let log = log(vec![first]);
        let found = only(&log);
        assert!((found.from_other_cases.unwrap() - 100.0 / 3.0).abs() < 1e-9);
        assert_eq!(found.unread, Some(20.0));
        let stages = Stages::NAMES.map(|name| (name, 1.0)).to_vec();
        assert_eq!(found.stage_us, Some(StageTimes { sum: 10.0, stages }));
        // 10 steps in the 2 seconds that the test's timings say.
        assert_eq!(score(&log).steps_per_s, Some(5.0));
    }
}
