//! Every figure, computed by hand for small logs.

use super::*;
use crate::conclusion::p_value;
use conditions::{Demonstrations, Route, SegmentContent, Start};
use domain::Representation;
use rigs::records::{keyed, log, record};
use run_log::{EpisodeError, EpisodeRecord, Stages, Unread};

fn only(log: &RunLog) -> ConditionScore {
    let mut scores = score(log).conditions;
    assert_eq!(scores.len(), 1);
    scores.remove(0)
}

#[track_caller]
fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9, "{found}, expected {expected}");
}

fn in_run(run: u32, record: EpisodeRecord) -> EpisodeRecord {
    keyed(EpisodeRecord { run, ..record })
}

#[test]
fn success_and_path_length_per_run_then_over_runs() {
    // Successes take 10 steps for a reference of 8: 8 / max(10, 8) = 0.8 each. Run 1 has 2 of 4, run 2 1 of 3.
    let run1 = [("a", true), ("b", false), ("c", true), ("d", false)];
    let run2 = [("a", true), ("b", false), ("c", false)];
    let mut records: Vec<_> = run1.map(|(id, success)| record(id, success)).into();
    records.extend(run2.map(|(id, success)| in_run(2, record(id, success))));
    let found = only(&log(records));
    // SR: 100 * 2/4 = 50 and 100 * 1/3 = 33.33; mean 41.67; deviations +-8.33, so std = 8.33 * sqrt(2).
    near(found.sr.mean, (50.0 + 100.0 / 3.0) / 2.0);
    near(found.sr.std.unwrap(), 50.0 / 6.0 * 2.0_f64.sqrt());
    // SPL: (0.8 + 0 + 0.8 + 0) / 4 = 0.4 and 0.8 / 3 = 0.2667; their half difference is 0.0667.
    near(found.spl.mean, (0.4 + 0.8 / 3.0) / 2.0);
    near(found.spl.std.unwrap(), (0.4 - 0.8 / 3.0) / 2.0 * 2.0_f64.sqrt());
    assert_eq!((found.episodes, found.runs, found.cases), (7, 2, 4));
    // 3 successes of 10 steps, 4 failures of 200.
    near(found.mean_steps.unwrap(), 830.0 / 7.0);
    let interval = found.sr.interval.unwrap();
    assert!((0.0..40.0).contains(&interval.low) && (50.0..=100.0).contains(&interval.high));
    assert_eq!(score(&log(vec![record("a", true)])).conditions[0].sr.interval, None, "one case");
}

#[test]
fn intervals_are_of_the_mean_over_runs_also_where_a_run_has_fewer_episodes() {
    // Run 1 has 40 cases, all successes with SPL 0.8; run 2 was stopped after one case, a failure.
    let ids: Vec<String> = (0..40).map(|case| format!("c{case:02}")).collect();
    let blocked =
        |id: &str, run, success| episode(Representation::Episodic, id, run, success, Some(success));
    let mut records: Vec<_> = ids.iter().map(|id| blocked(id, 1, true)).collect();
    records.push(blocked("c00", 2, false));
    let found = only(&log(records));
    let follow = found.blocked.unwrap().follow.unwrap();
    near(found.sr.mean, 50.0);
    near(found.spl.mean, 0.4);
    near(follow.mean, 50.0);
    // Half of the weight rests on one case: its successes say no more than those of about two episodes.
    for (figure, scale) in [(found.sr, 1.0), (found.spl, 125.0), (follow, 1.0)] {
        let Interval { low, high } = figure.interval.unwrap();
        assert!(low * scale < 30.0 && high * scale > 70.0, "{figure:?}");
    }
}

#[test]
fn recovery_is_of_the_mean_over_runs_where_runs_try_the_closed_cell_unequally_often() {
    // Run 1 tries it in 40 cases and always recovers; run 2 tries it in the first case alone, and fails.
    let ids: Vec<String> = (0..40).map(|case| format!("c{case:02}")).collect();
    let mut records = Vec::new();
    for (index, id) in ids.iter().enumerate() {
        records.push(episode(Representation::Episodic, id, 1, true, Some(true)));
        records.push(episode(Representation::Episodic, id, 2, false, Some(index == 0)));
    }
    let recovery = blocked_score(&log(records), Representation::Episodic).recovery.unwrap();
    near(recovery.mean, 50.0);
    let Interval { low, high } = recovery.interval.unwrap();
    assert!(low < 50.0 && high > 50.0, "{recovery:?}");
}

#[test]
fn an_episode_shorter_than_its_reference_is_worth_no_more_than_one() {
    // l / max(p, l): 8/8, 8/max(4, 8), 8/16, failure, 0/0 taken as 1.
    for (success, steps, reference, expected) in [
        (true, 8, 8, 1.0),
        (true, 4, 8, 1.0),
        (true, 16, 8, 0.5),
        (false, 8, 8, 0.0),
        (true, 0, 0, 1.0),
    ] {
        let mut record = record("a", success);
        (record.steps, record.reference) = (steps, reference);
        assert_eq!(only(&log(vec![record])).spl.mean, expected);
    }
}

#[test]
fn task_groups_are_scored_by_themselves_per_run() {
    let of_task = |task, id, success, run| {
        let mut record = record(id, success);
        record.task = task;
        in_run(run, record)
    };
    let found = only(&log(vec![
        // Basic: run 1 has 1 of 2, run 2 has 1 of 1: mean 75, std = 25 * sqrt(2).
        of_task(1, "a", true, 1),
        of_task(2, "b", false, 1),
        of_task(1, "a", true, 2),
        // Multi-object: 1 of 3. Return loop: none of 2. Revisit: 1 of 1.
        of_task(3, "c", true, 1),
        of_task(4, "d", false, 1),
        of_task(6, "e", false, 1),
        of_task(7, "f", false, 1),
        of_task(10, "g", false, 1),
        of_task(9, "h", true, 1),
    ]));
    let means: Vec<_> =
        found.groups.iter().map(|score| (score.group.as_str(), score.sr.mean)).collect();
    let expected =
        [("basic", 75.0), ("multi-object", 100.0 / 3.0), ("return loops", 0.0), ("revisit", 100.0)];
    assert_eq!(means, expected);
    near(found.groups[0].sr.std.unwrap(), 25.0 * 2.0_f64.sqrt());
    // Over the cases of the group: revisit has one.
    let has_interval: Vec<bool> =
        found.groups.iter().map(|score| score.sr.interval.is_some()).collect();
    assert_eq!(has_interval, [true, true, true, false]);
    assert_eq!(found.groups[1].sr.std, None);
}

/// A record from the new start under `memory`, blocked when `tried` says whether it tried the closed cell.
fn episode(
    memory: Representation,
    id: &str,
    run: u32,
    success: bool,
    tried: Option<bool>,
) -> EpisodeRecord {
    let mut record = record(id, success);
    (record.memory, record.start) = (memory.into(), Start::New);
    if memory == Representation::Working {
        record.demonstrations = Demonstrations::NONE;
    }
    record.route = if tried.is_some() { Route::Blocked } else { Route::Unchanged };
    record.conflict_at = tried.filter(|tried| *tried).map(|_| 3);
    in_run(run, record)
}

fn blocked_score(log: &RunLog, memory: Representation) -> BlockedScore {
    let blocked = |score: &&ConditionScore| {
        score.condition.memory == memory && score.condition.route == Route::Blocked
    };
    score(log).conditions.iter().find(blocked).unwrap().blocked.unwrap()
}

#[test]
fn follow_and_recovery_per_run_and_undefined_is_not_zero() {
    let blocked =
        |id, run, success, tried| episode(Representation::Episodic, id, run, success, Some(tried));
    let mut records = vec![
        // Run 1: b = 1, 1, 1, 0 and s = 1, 0, 0, 1. F = 100 * 3/4 = 75, C = 100 * 1/3 = 33.33.
        blocked("a", 1, true, true),
        blocked("b", 1, false, true),
        blocked("c", 1, false, true),
        blocked("d", 1, true, false),
        // Run 2: b = 1, 0 and s = 1, 0. F = 50, C = 100.
        blocked("a", 2, true, true),
        blocked("b", 2, false, false),
        // Run 3: b = 0, 0. F = 0, C undefined: it does not enter the mean of C.
        blocked("a", 3, true, false),
        blocked("b", 3, false, false),
    ];
    let found = blocked_score(&log(records.clone()), Representation::Episodic);
    let (follow, recovery) = (found.follow.unwrap(), found.recovery.unwrap());
    near(follow.mean, (75.0 + 50.0 + 0.0) / 3.0);
    // Deviations from 41.67: 33.33, 8.33, -41.67; squares 1111.1 + 69.4 + 1736.1 = 2916.67; / 2.
    near(follow.std.unwrap(), (17_500.0_f64 / 6.0 / 2.0).sqrt());
    near(recovery.mean, (100.0 / 3.0 + 100.0) / 2.0);
    near(recovery.std.unwrap(), 100.0 / 3.0 * 2.0_f64.sqrt());
    assert_eq!((follow.runs, recovery.runs), (3, 2));
    assert_eq!((found.change, found.retention), (None, None), "nothing to compare with was run");
    records.iter_mut().for_each(|record| record.conflict_at = None);
    let found = blocked_score(&log(records), Representation::Episodic);
    assert_eq!((found.follow.unwrap().mean, found.recovery), (0.0, None));
}

#[test]
fn change_and_retention_from_the_mean_success_rates() {
    let four = |memory, route: Option<bool>, successes: usize| {
        let ids = ["a", "b", "c", "d"].into_iter().enumerate();
        ids.map(move |(i, id)| episode(memory, id, 1, i < successes, route)).collect::<Vec<_>>()
    };
    // Episodic: 75 unchanged, 25 blocked. Working: 50 unchanged, 25 blocked.
    let mut records = four(Representation::Episodic, None, 3);
    records.extend(four(Representation::Episodic, Some(false), 1));
    records.extend(four(Representation::Working, None, 2));
    records.extend(four(Representation::Working, Some(false), 1));
    let all = log(records);
    let episodic = blocked_score(&all, Representation::Episodic);
    // Delta = (25 - 75) - (25 - 50) = -25; R = 25 / 75.
    near(episodic.change.unwrap().value, -25.0);
    near(episodic.retention.unwrap().value, 1.0 / 3.0);
    let working = blocked_score(&all, Representation::Working);
    // The baseline against itself: 0 by definition. R = 25 / 50.
    assert_eq!(working.change, Some(Derived { value: 0.0, interval: None }));
    near(working.retention.unwrap().value, 0.5);
    // Working memory has no segments: what supplies their images only is compared with the same runs of it.
    let mut images = all.episodes;
    for record in images.iter_mut().filter(|one| one.memory == Representation::Episodic) {
        record.segment = SegmentContent::Images;
    }
    let images = blocked_score(&log(images), Representation::Episodic);
    near(images.change.unwrap().value, -25.0);

    // Case d has not been run on blocked routes yet: 1 of 3 blocked, 3 of 3 unchanged, and 1 and 2 of 3 with working memory.
    let mut partial = four(Representation::Episodic, None, 3);
    partial.extend(four(Representation::Episodic, Some(false), 1).into_iter().take(3));
    partial.extend(four(Representation::Working, None, 2));
    partial.extend(four(Representation::Working, Some(false), 1));
    let partial = blocked_score(&log(partial), Representation::Episodic);
    near(partial.change.unwrap().value, (100.0 / 3.0 - 100.0) - (100.0 / 3.0 - 200.0 / 3.0));
    near(partial.retention.unwrap().value, 1.0 / 3.0);

    // Nothing succeeds on the unchanged route: R is 0 / 0, which is undefined; Delta is still a difference.
    let mut records = four(Representation::Working, None, 0);
    records.extend(four(Representation::Working, Some(false), 0));
    let none = blocked_score(&log(records), Representation::Working);
    assert_eq!((none.change.unwrap().value, none.retention), (0.0, None));
}

#[test]
fn images_tokens_answers_and_retrievals_per_run() {
    let measured = |id, run, requests, images, tokens: u64, unread, retrieved: &str| {
        let mut record = record(id, true);
        (record.requests, record.images) = (Some(requests), Some(images));
        (record.prompt_tokens, record.completion_tokens) = (Some(tokens - 1), Some(1));
        record.unread = Unread { unreadable: unread, empty: 0, refused: 0, cut_off: 0 };
        record.retrieved = Some(retrieved.to_owned());
        in_run(run, record)
    };
    let mut records = vec![
        // Run 1: (70 + 20) images / (10 + 5) requests = 6; (100 + 300) / 2 * 100 = 20,000 tokens;
        // 3 of 15 answers not read: 20 %; of 4 matches (`-` is none) 1 from another case: 25 %.
        measured("a", 1, 10, 70, 100, 3, "o0 o1 - t03-07:d4"),
        measured("b", 1, 5, 20, 300, 0, "n3"),
        // Run 2: 40 / 5 = 8; 500 * 100 = 50,000; 0 of 5: 0 %; 1 of 2: 50 %.
        measured("a", 2, 5, 40, 500, 0, "o0+t03-07:o1 -"),
    ];
    let found = only(&log(records.clone()));
    let images = found.images_per_request.unwrap();
    // Mean of 6 and 8, deviations +-1.
    assert_eq!((images.mean, images.std), (7.0, Some(2.0_f64.sqrt())));
    near(found.tokens_per_100.unwrap().mean, 35_000.0);
    near(found.tokens_per_100.unwrap().std.unwrap(), 15_000.0 * 2.0_f64.sqrt());
    near(found.unread.unwrap().mean, 10.0);
    near(found.from_other_cases.unwrap().mean, 37.5);
    near(found.from_other_cases.unwrap().std.unwrap(), 12.5 * 2.0_f64.sqrt());

    // One episode without a count: no sum at all, whether its run has others or not.
    records[2].prompt_tokens = None;
    assert_eq!(only(&log(records.clone())).tokens_per_100, None);
    records[2].prompt_tokens = Some(0);
    records[0].completion_tokens = None;
    assert_eq!(only(&log(records)).tokens_per_100, None);
}

#[test]
fn what_was_not_measured_is_absent() {
    let found = only(&log(vec![record("a", true)]));
    assert_eq!(found.sr.std, None, "one run has no spread");
    assert_eq!((found.tokens_per_100, found.blocked, found.from_other_cases), (None, None, None));

    let mut expert = record("a", true);
    (expert.requests, expert.images) = (None, None);
    let mut without = log(vec![expert]);
    let stages = only(&without).stage_us.unwrap();
    assert_eq!((stages.stage("render"), stages.stage("embed")), (Some(1.0), None));
    without.timings.clear();
    let found = only(&without);
    assert_eq!((found.images_per_request, found.unread, found.stage_us), (None, None, None));
    assert_eq!(score(&without).steps_per_s, None);
}

#[test]
fn an_episode_that_was_given_up_is_not_scored_and_bounds_what_is() {
    let mut log = log(vec![record("a", true), record("b", false), in_run(2, record("a", true))]);
    // One condition of two runs on two cases: four episodes, one of them given up.
    log.manifest.episodes = 4;
    let group = &mut log.manifest.settings.groups[0];
    group.memory = vec![Representation::Episodic.into()];
    (group.starts, group.runs) = (vec![Start::Original], 2);
    let key = in_run(2, record("b", true)).key;
    log.errors.push(EpisodeError { key, session: 1, error: "overdue".into() });
    let found = only(&log);
    // Run 1 has 1 of 2, run 2 has 1 of 1.
    assert_eq!((found.episodes, found.planned, found.sr.mean), (3, 4, 75.0));
    let bounds = found.bounds.unwrap();
    // 2 of 4 succeed if the missing one fails, 3 of 4 if it succeeds; SPL 2 x 0.8 / 4, or 2.6 / 4.
    assert_eq!((bounds.sr.low, bounds.sr.high), (50.0, 75.0));
    near(bounds.spl.low, 0.4);
    near(bounds.spl.high, 0.65);
    assert_eq!(score(&log).missing(), 1);
    // Finished later: nothing is missing, and there are no bounds.
    log.episodes.push(in_run(2, record("b", true)));
    log.errors.clear();
    assert_eq!((only(&log).bounds, only(&log).sr.mean), (None, 75.0));
}

#[test]
fn time_is_a_mean_over_steps() {
    let log = log(vec![record("a", true)]);
    let stages = Stages::NAMES.map(|name| (name, 1.0)).to_vec();
    assert_eq!(only(&log).stage_us, Some(StageTimes { sum: 12.0, stages }));
    // 10 steps in the 2 seconds that the test's timings say.
    assert_eq!(score(&log).steps_per_s, Some(5.0));
}

/// The comparison of episodic memory with working memory.
fn compared(records: Vec<EpisodeRecord>) -> Option<Comparison> {
    let log = log(records);
    let of = |memory: Representation| {
        let own = log.episodes.iter().find(|record| record.memory == memory)?;
        Some(Side { name: memory.to_string(), log: &log, condition: own.condition() })
    };
    Pairing::of(of(Representation::Episodic)?, of(Representation::Working)?).map(Pairing::alone)
}

#[test]
fn two_configurations_are_compared_case_by_case() {
    let side = |memory, successes: [[bool; 2]; 4]| {
        let cases = ["a", "b", "c", "d"].into_iter().zip(successes);
        let both = |(id, runs): (&'static str, [bool; 2])| {
            [1, 2].map(|run| episode(memory, id, run, runs[run as usize - 1], None))
        };
        cases.flat_map(both).collect::<Vec<_>>()
    };
    let (yes, no, half) = ([true, true], [false, false], [true, false]);
    let mut records = side(Representation::Episodic, [yes, half, yes, no]);
    records.extend(side(Representation::Working, [no, no, yes, half]));
    // A fifth case that only one side has does not enter.
    records.push(episode(Representation::Working, "e", 1, true, None));
    let found = compared(records).unwrap();
    // Differences of the cases' means: 100 - 0, 50 - 0, 100 - 100, 0 - 50; their mean is 25. SPL: 0.8 of that.
    assert_eq!((found.cases, found.pairs, found.sr.mean), (4, 8, 25.0));
    assert_eq!((found.unpaired_a, found.unpaired_b), (0, 1));
    assert_eq!((found.sr.a, found.sr.b), (62.5, 37.5));
    near(found.spl.mean, 0.2);
    // Two cases better, one worse, one equal: p = 2 * (1 + 3) / 2^3 = 1.
    assert_eq!((found.more_under_a, found.more_under_b, found.p), (2, 1, 1.0));
    // Mean 25 * 4/6; squares 10,000 + 2500 + 0 + 2500 + 2 * 10,000 about 0.
    let interval = found.sr.interval.unwrap();
    near(interval.low, -69.019_394_521_210_49);
    near(interval.high, 100.0);
}

/// `runs` repetitions of `cases` cases under `memory`.
fn repeated(
    memory: Representation,
    cases: usize,
    runs: u32,
    success: impl Fn(usize, u32) -> bool,
) -> Vec<EpisodeRecord> {
    let ids = (0..cases).map(|case| (case, format!("c{case:02}")));
    let of_case = |(case, id): (usize, String)| {
        (1..=runs)
            .map(|run| episode(memory, &id, run, success(case, run), None))
            .collect::<Vec<_>>()
    };
    ids.flat_map(of_case).collect()
}

#[test]
fn conditions_that_always_succeed_are_equal_however_often_they_were_repeated() {
    // As means of floats 3 of 3 and 5 of 5 may differ, and 50 cases would be better in one of them.
    let mut records = repeated(Representation::Episodic, 50, 3, |_, _| true);
    records.extend(repeated(Representation::Working, 50, 5, |_, _| true));
    let found = compared(records).unwrap();
    assert_eq!((found.more_under_a, found.more_under_b, found.p), (0, 0, 1.0));
    assert_eq!((found.cases, found.pairs, found.unpaired_a, found.unpaired_b), (50, 150, 0, 100));
    assert_eq!((found.sr.a, found.sr.b, found.sr.mean, found.spl.mean), (100.0, 100.0, 0.0, 0.0));
}

#[test]
fn only_repetitions_that_both_have_are_compared() {
    // Of three repetitions the first fails everywhere; the other side has the first alone.
    let mut records = repeated(Representation::Episodic, 50, 3, |_, run| run > 1);
    records.extend(repeated(Representation::Working, 50, 1, |case, _| case == 0));
    let found = compared(records.clone()).unwrap();
    assert_eq!((found.pairs, found.unpaired_a, found.unpaired_b), (50, 100, 0));
    assert_eq!((found.sr.a, found.sr.b), (0.0, 2.0));
    assert_eq!((found.more_under_a, found.more_under_b, found.p), (0, 1, 1.0));
    // A case without a common repetition is no pair, and without pairs there is no comparison.
    let (case, run) = ("c07", 1);
    records.retain(|record| {
        record.case != case || record.run != run || record.memory != Representation::Episodic
    });
    let found = compared(records.clone()).unwrap();
    assert_eq!((found.cases, found.pairs, found.unpaired_a, found.unpaired_b), (49, 49, 100, 1));
    records.retain(|record| record.run > 1 || record.memory == Representation::Working);
    assert_eq!(compared(records), None);
}

#[test]
fn cases_weigh_the_same_in_a_comparison_however_many_pairs_they_have() {
    // One case has 40 pairs of failures, 39 have one of a success and a failure.
    let mut records = Vec::new();
    for memory in [Representation::Episodic, Representation::Working] {
        records.extend(repeated(memory, 1, 40, |_, _| false));
        let others = repeated(memory, 40, 1, |_, _| memory == Representation::Episodic);
        records.extend(others.into_iter().filter(|record| record.case != "c00"));
    }
    let found = compared(records).unwrap();
    near(found.sr.mean, 97.5);
    assert_eq!((found.pairs, found.more_under_a), (79, 39));
    for (figure, scale) in [(found.sr, 1.0), (found.spl, 125.0)] {
        let Interval { low, high } = figure.interval.unwrap();
        assert!(low * scale > 75.0 && low * scale < 97.5 && high * scale > 97.0, "{figure:?}");
    }
}

/// 20 cases, ten of task 1 and ten of task 9, in two repetitions: better in `better` cases of task 1, equal in the others.
fn robust_pair(better: usize) -> Vec<EpisodeRecord> {
    let mut records = repeated(Representation::Episodic, 20, 2, |case, _| case < better);
    records.extend(repeated(Representation::Working, 20, 2, |_, _| false));
    for record in &mut records {
        record.task = if record.case.as_str() < "c10" { 1 } else { 9 };
    }
    records
}

#[test]
fn a_conclusion_says_what_it_rests_on() {
    // 6 cases better: p = 2 / 2^6 = 0.03. With one of them less, 2 / 2^5 = 0.06.
    let found = compared(robust_pair(6)).unwrap().conclusion;
    assert_eq!(found.verdict, ComparisonVerdict::Better);
    near(found.corrected_p, 0.03125);
    let Robustness { groups, tasks, repetitions, cases } = &found.robustness;
    let changed = |left_out: &LeftOut| {
        left_out.changes.iter().map(|one| one.without.clone()).collect::<Vec<_>>()
    };
    assert_eq!((groups.parts, changed(groups)), (2, vec!["basic".to_owned()]));
    assert_eq!((tasks.parts, changed(tasks)), (2, vec!["1".to_owned()]));
    assert_eq!((repetitions.parts, changed(repetitions)), (2, vec![]));
    assert_eq!((cases.parts, changed(cases).len()), (20, 6));
    insta::assert_snapshot!(found.robustness.in_words(), @"This holds except without basic, task 1, any of 6 of 20 cases.");
    insta::assert_snapshot!(found.sentence, @"Better: +30.0 points, p = 0.031.");

    // 7 better: one case less is enough still.
    let found = compared(robust_pair(7)).unwrap().conclusion;
    insta::assert_snapshot!(found.robustness.in_words(), @"This holds except without basic, task 1.");
}

#[test]
fn where_no_difference_is_shown_the_conclusion_says_what_could_have_been() {
    let conclusion = |better, worse, cases| {
        let mut records = repeated(Representation::Episodic, cases, 1, |case, _| case < better);
        let is_worse = |case: usize| (better..better + worse).contains(&case);
        records.extend(repeated(Representation::Working, cases, 1, |case, _| is_worse(case)));
        compared(records).unwrap().conclusion
    };
    let conclusions =
        [(12, 6, 100), (3, 3, 100), (51, 50, 300), (2, 0, 5), (0, 0, 6), (0, 9, 9), (1, 0, 1)];
    let shown = conclusions.map(|(better, worse, cases)| {
        let Conclusion { sentence, robustness, .. } = conclusion(better, worse, cases);
        format!("{sentence}\n    {}", robustness.in_words())
    });
    insta::assert_snapshot!(shown.join("\n"), @"
    No difference shown: +6.0 points, p = 0.238. With a probability of 80 %, 12.1 points would be shown; to show this difference would take about 315 more cases.
        This holds without any one case.
    No difference shown: 0.0 points, p = 1.000. With a probability of 80 %, 7.8 points would be shown; as many cases are better as worse.
        This holds without any one case.
    No difference shown: +0.3 points, p = 1.000. With a probability of 80 %, 9.6 points would be shown; to show this difference would take more than 10000 cases.
        This holds without any one case.
    No difference shown: +40.0 points, p = 0.500. At least 6 cases are needed to show any difference; to show this difference would take about 14 more cases.
        This holds without any one case.
    No difference shown: 0.0 points, p = 1.000. With a probability of 80 %, 96.3 points would be shown; as many cases are better as worse.
        This holds without any one case.
    Worse: −100.0 points, p = 0.004.
        This holds without any one case.
    No difference shown: +100.0 points, p = 1.000. At least 6 cases are needed to show any difference; to show this difference would take about 5 more cases.
        Nothing can be left out: there is one case only.
    ");
}

#[test]
fn where_the_cases_and_their_mean_disagree_the_conclusion_says_so() {
    let opposed = |better: usize, cases: usize| {
        // Better by one repetition of three, and worse by all three.
        let mut records =
            repeated(Representation::Episodic, cases, 3, |case, run| case < better && run == 1);
        records.extend(repeated(Representation::Working, cases, 3, |case, _| case >= better));
        compared(records).unwrap().conclusion.sentence
    };
    // (18/3 - 7) / 25 = -4 points; p of 7 among 25 throws: 2 * 726206 / 2^25.
    insta::assert_snapshot!(opposed(18, 25), @"Better: 18 cases are better and 7 worse, although the mean difference is −4.0 points; p = 0.043.");
    // (10/3 - 4) / 14, and 2 * 1471 / 2^14.
    let sentence = opposed(10, 14);
    let found = "No difference shown: 10 cases are better and 4 worse, although the mean difference is −4.8 points; p = 0.180. ";
    assert!(sentence.starts_with(found), "{sentence}");
    assert!(sentence.contains("; to show what the cases say would take about "), "{sentence}");
}

#[test]
fn a_p_below_5_percent_is_never_printed_as_5_percent() {
    let shown = [0.0004, 0.001, 0.0494, 0.04951, 0.05, 0.0504, 1.0].map(p_value);
    assert_eq!(shown, ["<0.001", "0.001", "0.049", "<0.050", "0.050", "0.050", "1.000"]);
}

#[test]
fn p_decides_where_it_and_the_interval_disagree() {
    // Of 100 cases 11 are better and 3 worse: 2 (1 + 14 + 91 + 364) / 2^14.
    let mut records = repeated(Representation::Episodic, 100, 1, |case, _| case < 11);
    let is_worse = |case: usize| (11..14).contains(&case);
    records.extend(repeated(Representation::Working, 100, 1, |case, _| is_worse(case)));
    let found = compared(records).unwrap();
    near(found.p, 940.0 / 16_384.0);
    let Interval { low, high } = found.sr.interval.unwrap();
    assert_eq!([low, high].map(|end| format!("{end:.1}")), ["0.2", "15.5"]);
    assert_eq!(found.conclusion.verdict, ComparisonVerdict::NoDifferenceShown);
}

/// The conditions of the first and of the 21st episode, paired.
fn first_and_21st(log: &RunLog) -> Pairing<'_> {
    let side = |index: usize| {
        let condition = log.episodes[index].condition();
        Side { name: condition.to_string(), log, condition }
    };
    Pairing::of(side(0), side(20)).unwrap()
}

#[test]
fn a_family_is_corrected_together() {
    // p of 2 / 2^6 and of 2 / 2^10, of two and of one comparison.
    let cases = |better: usize| {
        let mut records = repeated(Representation::Episodic, 20, 1, |case, _| case < better);
        records.extend(repeated(Representation::Working, 20, 1, |_, _| false));
        log(records)
    };
    let logs = [cases(6), cases(10)];
    let both = conclude(logs.iter().map(first_and_21st).collect());
    // The second is shown at 2 p, so the first is not multiplied.
    for (found, p, corrected, factor) in
        [(&both[0], 1.0 / 32.0, 1.0 / 32.0, 1), (&both[1], 1.0 / 512.0, 1.0 / 256.0, 2)]
    {
        near(found.p, p);
        near(found.conclusion.corrected_p, corrected);
        assert_eq!((found.conclusion.factor, found.conclusion.family), (factor, 2));
    }
}

#[test]
fn what_is_not_paired_is_listed_with_the_reason() {
    let mut a = log(repeated(Representation::Episodic, 3, 2, |_, _| true));
    let mut b = log(repeated(Representation::Episodic, 2, 1, |_, _| false));
    // The second run has three cases in one repetition: c02 was given up. The first has a fourth that is not finished.
    for (log, runs, planned) in [(&mut a, 2, 8), (&mut b, 1, 3)] {
        let group = &mut log.manifest.settings.groups[0];
        group.memory = vec![Representation::Episodic.into()];
        (group.starts, group.runs) = (vec![log.episodes[0].start], runs);
        (group.routes, group.demos) = (vec![log.episodes[0].route], vec![Demonstrations::ORIGINAL]);
        log.manifest.episodes = planned;
    }
    let condition = a.episodes[0].condition();
    let error = |case: &str, run| {
        let key = format!("{condition}/run{run}/{case}");
        EpisodeError { key, session: 1, error: "overdue".into() }
    };
    b.errors = vec![error("c02", 1)];
    b.episodes.push(episode(Representation::Episodic, "c03", 1, true, None));
    b.manifest.episodes = 5;
    let [found] = &compare::compare_runs(&a, &b).unwrap()[..] else { panic!("one condition") };
    assert_eq!((found.episodes_a, found.episodes_b, found.pairs), (6, 3, 2));
    let shown: Vec<_> = found
        .unpaired
        .iter()
        .map(|one| (one.finished_in, one.case.as_str(), one.repetition, one.absence))
        .collect();
    assert_eq!(
        shown,
        [
            (ComparedSide::A, "c00", 2, Absence::NotRun),
            (ComparedSide::A, "c01", 2, Absence::NotRun),
            (ComparedSide::A, "c02", 1, Absence::GivenUp),
            (ComparedSide::A, "c02", 2, Absence::NotRun),
            (ComparedSide::B, "c03", 1, Absence::NotFinished),
        ]
    );
    insta::assert_snapshot!(found.unpaired_in_words(["A", "B"]), @"1 of A, given up in B (c02/run1); 3 of A, not run in B (c00/run2, c01/run2, c02/run2); 1 of B, not finished in A (c03/run1)");
}

#[test]
fn runs_without_a_common_condition_or_case_are_refused_with_what_each_has() {
    let of = |name: &str, memory, case: &str| {
        let log = log(vec![episode(memory, case, 1, true, None)]);
        RunLog { name: name.to_owned(), ..log }
    };
    let episodic = of("a", Representation::Episodic, "c01");
    let refused = |other: &RunLog| compare::compare_runs(&episodic, other).unwrap_err().to_string();
    insta::assert_snapshot!(refused(&of("b", Representation::Working, "c01")), @"a and b have no condition in common: a has episodic/new/unchanged/original, b has working/new/unchanged/none. `--compare A B` compares a condition A of a with a condition B of b");
    insta::assert_snapshot!(refused(&of("b", Representation::Episodic, "c02")), @"a and b have finished no case in the same repetition: a has c01 in repetition 1, b has c02 in repetition 1; run one of them with the other's --cases, --limit and --runs");
    let mut both = of("b", Representation::Working, "c01");
    both.episodes.extend(of("b", Representation::Episodic, "c01").episodes);
    let paired = compare::pair_runs(&episodic, &both).unwrap();
    insta::assert_snapshot!(paired.left_out.sentences("a", "b").join("\n"), @"Not compared, only b has an episode of them: working/new/unchanged/none.");
}
