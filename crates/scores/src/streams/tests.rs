//! Every figure of streams, computed by hand for small logs.

use super::*;
use crate::{ComparisonVerdict, Interval, Scores, score};
use conditions::Start;
use domain::StreamOrder;
use rigs::records::{log, sequence, stream_log};
use run_log::{EpisodeRecord, StreamRecord};

const BLOCKS: [(u32, &[&str]); 3] = [(0, &["a", "b"]), (1, &["a", "b"]), (2, &["a", "b"])];

fn condition(name: &str) -> Condition {
    Condition::logged(name).unwrap()
}

fn episodic(arm: Arm) -> Condition {
    condition("episodic/new/unchanged/original").with_arm(arm)
}

fn none() -> Condition {
    condition("working/new/unchanged/none")
}

/// Stream 0 as drawn: two cases in each of three blocks, learned once.
fn drawn(
    condition: Condition,
    outcome: impl Fn(&StreamRecord, &str) -> bool,
) -> Vec<EpisodeRecord> {
    sequence((condition, 1), (0, StreamOrder::Drawn), &BLOCKS, 1, outcome)
}

/// Whether case a or b succeeds where half of the cases, all or none do.
fn share(percent: u32, case: &str) -> bool {
    percent == 100 || percent == 50 && case == "a"
}

fn scored(episodes: impl IntoIterator<Item = Vec<EpisodeRecord>>) -> Scores {
    let log = stream_log(episodes.into_iter().flatten().collect(), [3, 2, 1]);
    for record in &log.episodes {
        assert_eq!(record.check(200), Ok(()));
    }
    score(&log)
}

fn streams(episodes: impl IntoIterator<Item = Vec<EpisodeRecord>>) -> StreamScores {
    scored(episodes).streams.unwrap()
}

fn of(scores: &StreamScores, condition: Condition) -> &StreamScore {
    scores.conditions.iter().find(|score| score.condition == condition).unwrap()
}

#[track_caller]
fn near(found: Option<Estimate>, expected: f64) {
    let found = found.unwrap().mean;
    assert!((found - expected).abs() < 1e-9, "{found}, expected {expected}");
}

/// R of the tests: a row for each number of blocks learned.
const R: [[u32; 3]; 4] = [[100, 0, 0], [100, 50, 0], [50, 100, 50], [50, 50, 100]];

/// Succeeds as [`R`] says in evaluations; while learning, in both cases of block 0, in b of block 1 and in a of block 2.
fn as_in_r(at: &StreamRecord, case: &str) -> bool {
    match (at.round, at.block, case) {
        (None, ..) => share(R[at.after as usize][at.place as usize], case),
        (Some(_), 0, _) | (Some(_), 1, "b") | (Some(_), 2, "a") => true,
        _ => false,
    }
}

#[test]
fn the_matrix_and_what_follows_from_it() {
    // Without memory: block 1 half, block 2 none, block 3 half, whatever was learned.
    let without = |at: &StreamRecord, case: &str| share([50, 0, 50][at.place as usize], case);
    let scores = streams([drawn(episodic(Arm::Learning), as_in_r), drawn(none(), without)]);
    let score = of(&scores, episodic(Arm::Learning));
    let expected = R.map(|row| row.map(|cell| Some(f64::from(cell))).to_vec()).to_vec();
    assert_eq!(score.matrix, expected);
    // (50 + 50 + 100) / 3
    near(score.average, 200.0 / 3.0);
    // ((50 − 100) + (50 − 100)) / 2: block 1 falls from R[1][1], block 2 from R[2][2].
    near(score.backward, -50.0);
    // (R[1][2] − 0 + R[2][3] − 50) / 2 = (50 + 0) / 2
    near(score.forward, 25.0);
    // Block 1: max(100, 50) − 50; block 2: max(50, 100) − 50.
    near(score.forgetting, 50.0);
    let without = of(&scores, none());
    near(without.average, 100.0 / 3.0);
    assert_eq!(without.forward, None, "not compared with itself");
}

#[test]
fn one_block_has_no_transfer_and_no_forgetting() {
    let one =
        |condition| sequence((condition, 1), (0, StreamOrder::Drawn), &BLOCKS[..1], 1, as_in_r);
    let episodes = [one(episodic(Arm::Learning)), one(none())].concat();
    let scores = score(&stream_log(episodes, [1, 2, 1])).streams.unwrap();
    let score = of(&scores, episodic(Arm::Learning));
    near(score.average, 100.0);
    assert_eq!((score.backward, score.forward, score.forgetting), (None, None, None));
    assert_eq!((score.after, score.lag, score.adapted), (None, None, None), "no event");
}

#[test]
fn success_regret_lag_and_stale_reuse_of_learning_episodes() {
    let scores = streams([
        drawn(episodic(Arm::Learning), as_in_r),
        drawn(episodic(Arm::Oracle), |_, _| true),
    ]);
    let score = of(&scores, episodic(Arm::Learning));
    // Four of six; both before events; two of four after.
    near(score.success, 400.0 / 6.0);
    near(score.before, 100.0);
    near(score.after, 50.0);
    // The oracle succeeds in all six.
    near(score.regret, 2.0);
    // Block 1 succeeds in its second episode, block 2 in its first; all cases there are invalidated.
    near(score.lag, 1.5);
    near(score.adapted, 100.0);
    // One of two sources is stale in four of six episodes.
    near(score.stale, 100.0 / 3.0);
    near(score.stale_after, 50.0);
    let rounds: Vec<(u32, u32, f64, f64)> =
        score.rounds.iter().map(|r| (r.place, r.round, r.success.mean, r.running.mean)).collect();
    let all = [(0, 1, 100.0, 100.0), (1, 1, 50.0, 75.0), (2, 1, 50.0, 400.0 / 6.0)];
    assert_eq!(rounds, all);
    assert_eq!(of(&scores, episodic(Arm::Oracle)).regret, None, "not compared with itself");
    // All six go ten cells north where the reference goes eight: distances 1 + 2, against 3 m for each of its nine cells.
    near(of(&scores, episodic(Arm::Oracle)).t_ndtw, (-6.0 * 3.0 / (3.0 * 6.0 * 9.0_f64)).exp());
    // Two go on for 200 cells: 1 + 2 + ... + 192 each.
    near(score.t_ndtw, (-(4.0 * 3.0 + 2.0 * 18_528.0) / (3.0 * 6.0 * 9.0_f64)).exp());
    let mut earlier = drawn(episodic(Arm::Frozen), as_in_r);
    earlier.iter_mut().for_each(|record| drop(record.world.remove("path")));
    assert_eq!(streams([earlier]).conditions[0].t_ndtw, None, "not told");
}

#[test]
fn a_block_that_is_never_adapted_to_has_no_lag() {
    let only_block_2 = |at: &StreamRecord, _: &str| at.block != 1;
    let scores = streams([drawn(episodic(Arm::Frozen), only_block_2)]);
    let score = of(&scores, episodic(Arm::Frozen));
    near(score.lag, 1.0);
    near(score.adapted, 50.0);
    let scores = streams([drawn(episodic(Arm::Frozen), |at, _| at.block == 0)]);
    let score = of(&scores, episodic(Arm::Frozen));
    assert_eq!(score.lag, None);
    near(score.adapted, 0.0);
    assert_eq!(score.regret, None, "the oracle was not run");
}

#[test]
fn a_success_of_a_case_that_is_not_invalidated_is_no_adaptation() {
    let mut episodes = drawn(episodic(Arm::Frozen), |_, case| case == "a");
    for record in &mut episodes {
        let is_a = record.case == "a";
        let stream = record.stream.as_mut().unwrap();
        stream.invalidated &= !is_a;
        (stream.retrievals, stream.stale) = (0, 0);
    }
    let scores = streams([episodes]);
    let score = of(&scores, episodic(Arm::Frozen));
    assert_eq!(score.lag, None);
    near(score.adapted, 0.0);
    assert_eq!(score.stale, None, "nothing was retrieved");
}

#[test]
fn an_incomplete_sequence_is_counted_and_enters_no_figure() {
    let whole = || drawn(episodic(Arm::Learning), as_in_r);
    let other =
        || sequence((episodic(Arm::Learning), 2), (0, StreamOrder::Drawn), &BLOCKS, 1, as_in_r);
    let expected = streams([whole()]);
    for left_out in [0, 3, 15, 29] {
        let mut cut = other();
        assert_eq!(cut.len(), 30);
        cut.remove(left_out);
        let found = streams([whole(), cut.clone()]);
        assert_eq!(found.sequences, 1, "{left_out}");
        assert_eq!(found.conditions[0].success, expected.conditions[0].success);
        let alone = streams([cut]);
        assert_eq!((alone.sequences, alone.conditions.len()), (0, 0));
    }
    // A pair needs both sides.
    let mut frozen = drawn(episodic(Arm::Frozen), as_in_r);
    frozen.truncate(20);
    assert_eq!(streams([whole(), frozen]).differences, []);
}

#[test]
fn sequences_that_have_not_begun_are_planned() {
    let mut log = stream_log(drawn(episodic(Arm::Frozen), as_in_r), [3, 2, 1]);
    let group = &mut log.manifest.settings.groups[0];
    (group.memory, group.starts) = (vec![Representation::Episodic.into()], vec![Start::New]);
    group.runs = 2;
    // Two repetitions in three orders.
    let scores = score(&log).streams.unwrap();
    assert_eq!((scores.sequences, scores.planned, scores.conditions[0].planned), (1, 6, 6));
}

#[test]
fn without_evaluations_there_is_no_matrix() {
    let mut episodes = drawn(episodic(Arm::Frozen), as_in_r);
    episodes.retain(|record| record.stream.as_ref().unwrap().learns());
    for (position, record) in (0..).zip(&mut episodes) {
        record.stream.as_mut().unwrap().position = position;
    }
    let mut log = stream_log(episodes, [3, 2, 1]);
    log.manifest.settings.stream.as_mut().unwrap().evaluate = false;
    let score = score(&log).streams.unwrap().conditions.remove(0);
    near(score.success, 400.0 / 6.0);
    assert_eq!((score.average, score.backward, score.forgetting), (None, None, None));
    assert_eq!(score.costs, []);
}

/// Stream `stream` in `order`; the first `successes` of its six learning episodes succeed.
fn first(arm: Arm, (stream, order): (u32, StreamOrder), successes: usize) -> Vec<EpisodeRecord> {
    let blocks: Vec<_> = match order {
        StreamOrder::Reversed => BLOCKS.iter().rev().copied().collect(),
        StreamOrder::Drawn | StreamOrder::Shuffled => BLOCKS.to_vec(),
    };
    sequence((episodic(arm), 1), (stream, order), &blocks, 1, |at, case| {
        at.round.is_some() && 2 * at.place as usize + usize::from(case == "b") < successes
    })
}

#[test]
fn order_robustness_needs_three_orders() {
    let orders = [(StreamOrder::Drawn, 6), (StreamOrder::Reversed, 3), (StreamOrder::Shuffled, 0)];
    let all = orders.map(|(order, successes)| first(Arm::Frozen, (0, order), successes));
    let scores = streams(all.clone());
    let score = &scores.conditions[0];
    near(score.order_spread, 100.0);
    near(score.order_spread_average, 0.0);
    near(score.success, 50.0);
    let found: Vec<_> = score.orders.iter().map(|one| (one.order, one.success)).collect();
    assert_eq!(
        found,
        [
            (StreamOrder::Drawn, Some(100.0)),
            (StreamOrder::Reversed, Some(50.0)),
            (StreamOrder::Shuffled, Some(0.0))
        ]
    );
    // Reversed, block 0 is the last: no success before events, three of four after.
    let scores = streams([all[1].clone()]);
    near(scores.conditions[0].before, 0.0);
    near(scores.conditions[0].after, 75.0);
    assert_eq!(streams(all[..2].to_vec()).conditions[0].order_spread, None);
}

#[track_caller]
fn near_p(found: Option<f64>, expected: f64) {
    assert!((found.unwrap() - expected).abs() < 1e-12, "{found:?}, expected {expected}");
}

#[test]
fn differences_of_streams_are_corrected_together_and_have_a_verdict() {
    // Of 4 streams what learns has 6, 6, 5 and 6 successes of 6, the frozen arm none.
    let successes = [6, 6, 5, 6].into_iter().zip(0..);
    let episodes = successes.flat_map(|(count, stream)| {
        let of = |arm, count| first(arm, (stream, StreamOrder::Drawn), count);
        [of(Arm::Learning, count), of(Arm::Frozen, 0)]
    });
    let scores = streams(episodes);
    // Before: 100 in all streams, which has no p. After: 100, 100, 75 and 100.
    let found = &scores.differences[0];
    assert_eq!(found.before.unwrap().p, None);
    let after = found.after.unwrap();
    assert_eq!((scores.tested_differences, after.corrected_p), (1, after.p));
    assert!(after.p.unwrap() < 0.001, "{after:?}");
    assert_eq!(after.verdict, ComparisonVerdict::Better);
}

#[test]
fn differences_are_paired_by_stream_and_all_orders_stay_together() {
    // Stream 0: 6 and 2 more successes of 6 in its two orders; stream 1: 1 more; stream 2 has no pair.
    let episodes = [
        first(Arm::Learning, (0, StreamOrder::Drawn), 6),
        first(Arm::Frozen, (0, StreamOrder::Drawn), 0),
        first(Arm::Learning, (0, StreamOrder::Reversed), 6),
        first(Arm::Frozen, (0, StreamOrder::Reversed), 4),
        first(Arm::Learning, (1, StreamOrder::Drawn), 3),
        first(Arm::Frozen, (1, StreamOrder::Drawn), 2),
        first(Arm::Learning, (2, StreamOrder::Drawn), 6),
    ];
    let scores = streams(episodes);
    let found = &scores.differences[0];
    assert_eq!((found.a, found.b), (episodic(Arm::Learning), episodic(Arm::Frozen)));
    assert_eq!((scores.differences.len(), found.streams), (1, 2));
    // After events: stream 0 as drawn 4 of 4 against 0, reversed 4 of 4 against 4 of 4: 50 points. Stream 1: 1 of 4 against
    // none: 25. The standard error of two values is half their distance, 12.5; t with one degree of freedom 12.7.
    let TestedDifference { difference: after, p, corrected_p, .. } = found.after.unwrap();
    // t = 37.5 / 12.5 = 3 with one degree of freedom, where the distribution is Cauchy's.
    let cauchy = |t: f64| 1.0 - t.atan() / std::f64::consts::FRAC_PI_2;
    near_p(p, cauchy(3.0));
    // Two differences have a p: this one and 50 +- 50, t = 1.
    assert_eq!(scores.tested_differences, 2);
    near_p(corrected_p, 2.0 * cauchy(3.0));
    assert_eq!((after.a, after.b, after.mean), (62.5, 25.0, 37.5));
    assert_eq!(after.interval, Some(Interval { low: -100.0, high: 100.0 }));
    // Before: 100 against 0 and 100 against 0 in stream 0; 100 against 100 in stream 1.
    let TestedDifference { difference: before, p, corrected_p, verdict } = found.before.unwrap();
    near_p(p, cauchy(1.0));
    near_p(corrected_p, 0.5);
    assert_eq!(verdict, ComparisonVerdict::NoDifferenceShown);
    assert_eq!((before.a, before.b, before.mean), (100.0, 50.0, 50.0));
    let average = found.average.unwrap();
    assert_eq!((average.difference.interval, average.p), (None, None), "all streams alike");
    // Stream 2 enters the figures of its own condition: (100 + 50 + 100) / 3, where stream 0 succeeds in both orders.
    near(of(&scores, episodic(Arm::Learning)).success, 250.0 / 3.0);
}

#[test]
fn cost_against_the_number_of_episodes_given() {
    let mut log = stream_log(drawn(episodic(Arm::Learning), as_in_r), [3, 2, 1]);
    for timings in &mut log.timings {
        timings.recalls.requests = timings.steps;
    }
    // The views of the first evaluations are new.
    let first = log.episodes.iter().filter(|record| {
        record.stream.as_ref().is_some_and(|stream| stream.round.is_none() && stream.after == 0)
    });
    let first: Vec<String> = first.map(|record| record.key.clone()).collect();
    for timings in log.timings.iter_mut().filter(|timings| first.contains(&timings.key)) {
        timings.stages.embed *= 1000;
    }
    for record in &mut log.episodes {
        record.memory_tokens = Some(u64::from(record.steps) * 40);
    }
    let costs = score(&log).streams.unwrap().conditions.remove(0).costs;
    // Two demonstrations, and two more episodes after each block.
    let sizes: Vec<(u32, f64)> = costs.iter().map(|cost| (cost.after, cost.episodes)).collect();
    assert_eq!(sizes, [(0, 2.0), (1, 4.0), (2, 6.0), (3, 8.0)]);
    // One microsecond a step in each of embedding, searching and assembling.
    assert!(costs.iter().all(|cost| (cost.search_us, cost.tokens) == (Some(1.0), Some(40.0))));
    let recalls: Vec<Option<f64>> = costs.iter().map(|cost| cost.recall_us).collect();
    assert_eq!(recalls, [1002.0, 3.0, 3.0, 3.0].map(Some), "with the embeddings of new views");
    let bytes: Vec<Option<f64>> = costs.iter().map(|cost| cost.store_bytes).collect();
    assert_eq!(bytes, [1000.0, 2000.0, 3000.0, 4000.0].map(Some));
    log.episodes[0].memory_tokens = None;
    log.timings.clear();
    let costs = score(&log).streams.unwrap().conditions.remove(0).costs;
    assert_eq!((costs[0].tokens, costs[0].recall_us), (None, None), "not measured");
    let frozen = streams([drawn(episodic(Arm::Frozen), as_in_r)]).conditions.remove(0);
    assert!(frozen.costs.iter().all(|cost| cost.episodes == 2.0));
    let oracle = streams([drawn(episodic(Arm::Oracle), as_in_r)]).conditions.remove(0);
    assert_eq!(oracle.costs, []);
}

#[test]
fn a_case_is_certified_if_it_fails_without_memory_and_succeeds_with_the_oracle() {
    // Without memory a succeeds everywhere; with the oracle all but b in block 2.
    let scores = streams([
        drawn(none(), |_, case| case == "a"),
        drawn(episodic(Arm::Oracle), |at, case| (at.block, case) != (2, "b")),
        drawn(episodic(Arm::Learning), as_in_r),
    ]);
    let [found] = &scores.necessity[..] else { panic!("one memory has an oracle") };
    // Of a and b in three blocks, b in blocks 0 and 1.
    assert_eq!((found.cases, found.certified), (6, 2));
    let success: Vec<(String, f64, f64)> = found
        .success
        .iter()
        .map(|one| (one.condition.to_string(), one.all.unwrap().mean, one.certified.unwrap().mean))
        .collect();
    assert_eq!(success.len(), 3);
    assert_eq!(success[0], (none().to_string(), 50.0, 0.0));
    assert_eq!(success[1], (episodic(Arm::Learning).to_string(), 400.0 / 6.0, 100.0));
    assert_eq!(success[2].2, 100.0);
    let unknown = streams([drawn(episodic(Arm::Oracle), as_in_r)]);
    assert_eq!(unknown.necessity, [], "nothing was run without memory");
}

#[test]
fn streams_enter_no_figure_of_other_episodes() {
    let record = rigs::records::record("a", true);
    let scores = scored([vec![record.clone()], drawn(episodic(Arm::Frozen), as_in_r)]);
    assert_eq!(scores.conditions, score(&log(vec![record.clone()])).conditions);
    assert_eq!(scores.finished, 31);
    assert_eq!(score(&log(vec![record])).streams, None);
}
