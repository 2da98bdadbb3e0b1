//! Controls outside of streams: each memory beside the same memory with the right content, with a wrong one, and beside none.

use std::collections::{BTreeMap, BTreeSet};

use domain::Arm;
use run_log::RunLog;
use serde::Serialize;

use super::certify::CertifiedCases;
use super::comparison::{Comparison, Pairing, Side, conclude};
use super::condition::success_of;
use super::mean::mean;
use super::spread::Spread;
use super::trial::Trials;
use conditions::Condition;

/// A memory in one setting beside its controls. A control that was not run has no figure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControlScore {
    /// The condition, in the arm `frozen`.
    pub condition: Condition,
    /// Its success rate in percent.
    pub sr: Spread,
    /// Its oracle. From the original start that is the condition with the original demonstration, which may be this one.
    pub oracle: Option<ControlCondition>,
    /// The memory with wrong content.
    pub wrong: Option<ControlCondition>,
    /// Working memory.
    pub working: Option<ControlCondition>,
    /// What its content is worth: the condition against wrong content.
    pub content: Option<Comparison>,
    /// What is left to gain: the oracle against the condition. None where the condition is its own oracle.
    pub headroom: Option<Comparison>,
    /// Which cases need memory; measured where working memory and the oracle were run on a common case.
    pub necessity: Option<ControlNecessity>,
}

/// A control.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ControlCondition {
    /// The condition.
    pub condition: Condition,
    /// Its success rate in percent.
    pub sr: Spread,
}

/// The cases that certify that memory matters, and success on those.
///
/// Working memory and the oracle decide which cases are certified, so their own success on those is so by selection.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControlNecessity {
    /// Cases with an episode with working memory and one with the oracle.
    pub cases: usize,
    /// Those of which most episodes fail with working memory and most succeed with the oracle.
    pub certified: usize,
    /// Success on these cases: of the condition, its oracle, wrong content and working memory, as far as they were run.
    pub success: Vec<CertifiedSuccess>,
}

/// Success rates in percent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CertifiedSuccess {
    /// The condition.
    pub condition: Condition,
    /// On all cases of [`ControlNecessity`].
    pub all: Option<Spread>,
    /// On those that are certified.
    pub certified: Option<Spread>,
}

/// Each condition in the arm `frozen` that has a control in the run, in the order of conditions. Empty for a run without control
/// arms. p is corrected for all their comparisons.
pub(super) fn controls(
    log: &RunLog,
    trials: &BTreeMap<Condition, Trials<'_>>,
) -> Vec<ControlScore> {
    if trials.keys().all(|condition| condition.arm == Arm::Frozen) {
        return Vec::new();
    }
    let frozen = trials.keys().filter(|condition| condition.arm == Arm::Frozen);
    let remembering = frozen.filter(|condition| condition.memory.uses_demonstrations());
    let scores = remembering.filter_map(|condition| of_condition(*condition, log, trials));
    let (mut scores, pairings): (Vec<ControlScore>, Vec<[Option<Pairing<'_>>; 2]>) = scores.unzip();
    let is_made =
        pairings.iter().map(|both| both.each_ref().map(Option::is_some)).collect::<Vec<_>>();
    let mut compared = conclude(pairings.into_iter().flatten().flatten().collect()).into_iter();
    for (score, [content, headroom]) in scores.iter_mut().zip(is_made) {
        score.content = content.then(|| compared.next()).flatten();
        score.headroom = headroom.then(|| compared.next()).flatten();
    }
    scores
}

/// The score of a condition, without its comparisons, and the pairs of these: content and headroom.
fn of_condition<'a>(
    condition: Condition,
    log: &'a RunLog,
    trials: &BTreeMap<Condition, Trials<'a>>,
) -> Option<(ControlScore, [Option<Pairing<'a>>; 2])> {
    let [oracle, wrong] = [Arm::Oracle, Arm::Wrong].map(|arm| condition.with_arm(arm));
    let working = condition.without_memory();
    let control = |condition: Condition| {
        let sr = success_of(trials.get(&condition)?)?;
        Some(ControlCondition { condition, sr })
    };
    let controls = [control(oracle), control(wrong), working.and_then(control)];
    let [of_oracle, of_wrong, of_working] = controls;
    let is_own_oracle = oracle == condition;
    let has_control = (of_oracle.is_some() && !is_own_oracle)
        || of_wrong.is_some()
        || (is_own_oracle && of_working.is_some());
    let side = |condition: Condition| Side { name: condition.to_string(), log, condition };
    let pairing =
        |a: Condition, b: Condition| (a != b).then(|| Pairing::of(side(a), side(b))).flatten();
    let shown = [Some(condition), (!is_own_oracle).then_some(oracle), Some(wrong), working];
    let shown: Vec<Condition> = shown.into_iter().flatten().collect();
    let score = ControlScore {
        condition,
        sr: success_of(trials.get(&condition)?)?,
        oracle: of_oracle,
        wrong: of_wrong,
        working: of_working,
        content: None,
        headroom: None,
        necessity: working.and_then(|working| necessity(trials, working, oracle, &shown)),
    };
    let pairings = [pairing(condition, wrong), pairing(oracle, condition)];
    has_control.then_some((score, pairings))
}

/// Certifies cases with `working` and `oracle`, and computes the success of the conditions `shown` on them.
fn necessity(
    trials: &BTreeMap<Condition, Trials<'_>>,
    working: Condition,
    oracle: Condition,
    shown: &[Condition],
) -> Option<ControlNecessity> {
    let (without, with) = (rates(trials.get(&working)?), rates(trials.get(&oracle)?));
    let CertifiedCases { all, certified } = CertifiedCases::of(&without, &with);
    let on = |condition: &Condition, cases: &BTreeSet<&str>| {
        success_of(&trials.get(condition)?.of_cases(cases))
    };
    let shown = shown.iter().filter(|condition| trials.contains_key(*condition));
    let success = shown.map(|condition| CertifiedSuccess {
        condition: *condition,
        all: on(condition, &all),
        certified: on(condition, &certified),
    });
    (!all.is_empty()).then(|| ControlNecessity {
        cases: all.len(),
        certified: certified.len(),
        success: success.collect(),
    })
}

/// The success rate of each case in percent, over its repetitions.
fn rates<'a>(trials: &Trials<'a>) -> BTreeMap<&'a str, f64> {
    let rate = |records: Vec<&run_log::EpisodeRecord>| {
        mean(records.into_iter().map(|record| if record.is_success() { 100.0 } else { 0.0 }))
    };
    trials.cases().into_iter().filter_map(|(case, records)| Some((case, rate(records)?))).collect()
}

#[cfg(test)]
mod tests {
    use crate::score;
    use conditions::Condition;
    use rigs::records::{log, record, under};
    use run_log::EpisodeRecord;

    use super::*;

    const MEMORY: &str = "episodic/new/unchanged/4";
    const ORACLE: &str = "episodic/new/unchanged/original/oracle";
    const WRONG: &str = "episodic/new/unchanged/4/wrong";
    const WORKING: &str = "working/new/unchanged/none";

    /// Episodes of a condition: for each case a character for each repetition, `+` for a success.
    fn episodes(condition: &str, cases: [&str; 4]) -> Vec<EpisodeRecord> {
        let condition: Condition = condition.parse().unwrap();
        let of_case = |(case, outcomes): (u32, &str)| -> Vec<EpisodeRecord> {
            let numbered = (1..).zip(outcomes.chars());
            let episode = |(run, outcome)| {
                let record = record(&format!("t01-0{case}"), outcome == '+');
                under(condition, EpisodeRecord { run, ..record })
            };
            numbered.map(episode).collect()
        };
        (1..).zip(cases).flat_map(of_case).collect()
    }

    /// Of four cases with three repetitions, the memory solves 3, 2, 0 and 3; the others as written.
    #[test]
    fn content_headroom_and_necessity_are_those_computed_by_hand() {
        let all = [
            episodes(MEMORY, ["+++", "++-", "---", "+++"]),
            episodes(ORACLE, ["+++", "+++", "++-", "+++"]),
            episodes(WRONG, ["+--", "---", "---", "+++"]),
            episodes(WORKING, ["---", "+--", "--+", "++-"]),
        ];
        let scores = score(&log(all.concat()));
        let [found] = &scores.controls[..] else { panic!("{:?}", scores.controls) };
        assert_eq!(found.condition.to_string(), MEMORY);
        let near = |value: f64, expected: f64| assert!((value - expected).abs() < 1e-9, "{value}");
        // 8, 11, 4 and 4 of 12 episodes.
        near(found.sr.mean, 100.0 * 8.0 / 12.0);
        near(found.oracle.unwrap().sr.mean, 100.0 * 11.0 / 12.0);
        near(found.wrong.unwrap().sr.mean, 100.0 * 4.0 / 12.0);
        near(found.working.unwrap().sr.mean, 100.0 * 4.0 / 12.0);
        let content = found.content.as_ref().unwrap();
        assert_eq!((content.a.as_str(), content.b.as_str(), content.pairs), (MEMORY, WRONG, 12));
        // By case 2/3, 2/3, 0 and 0.
        near(content.sr.mean, 100.0 / 3.0);
        assert_eq!((content.more_under_a, content.more_under_b), (2, 0));
        let headroom = found.headroom.as_ref().unwrap();
        assert_eq!((headroom.a.as_str(), headroom.b.as_str()), (ORACLE, MEMORY));
        // By case 0, 1/3, 2/3 and 0.
        near(headroom.sr.mean, 25.0);
        // The fourth case is solved without memory, in two of three repetitions.
        let necessity = found.necessity.as_ref().unwrap();
        assert_eq!((necessity.cases, necessity.certified), (4, 3));
        let on_certified = |condition: &str| {
            let is_it = |one: &&CertifiedSuccess| one.condition.to_string() == condition;
            necessity.success.iter().find(is_it).unwrap().certified.unwrap().mean
        };
        near(on_certified(MEMORY), 100.0 * 5.0 / 9.0);
        near(on_certified(ORACLE), 100.0 * 8.0 / 9.0);
        near(on_certified(WRONG), 100.0 / 9.0);
        near(on_certified(WORKING), 100.0 * 2.0 / 9.0);
    }

    #[test]
    fn from_the_original_start_the_original_demonstration_is_the_oracle() {
        let [original, distant, working] = [
            "episodic/original/unchanged/original",
            "episodic/original/unchanged/distant",
            "working/original/unchanged/none",
        ];
        let frozen = [
            episodes(original, ["+", "+", "-", "+"]),
            episodes(distant, ["+", "-", "-", "-"]),
            episodes(working, ["-", "-", "-", "+"]),
        ];
        assert!(score(&log(frozen.concat())).controls.is_empty(), "no control arm was run");
        let wrong = episodes("episodic/original/unchanged/original/wrong", ["-", "-", "-", "+"]);
        let scores = score(&log([frozen.concat(), wrong].concat()));
        let [first, second] = &scores.controls[..] else { panic!("{:?}", scores.controls) };
        let shown = |one: &ControlScore| {
            let of = |one: &Option<Comparison>| one.as_ref().map(|one| one.sr.mean);
            (one.condition.to_string(), of(&one.content), of(&one.headroom))
        };
        assert_eq!(shown(first), (original.to_owned(), Some(50.0), None));
        assert_eq!(shown(second), (distant.to_owned(), Some(0.0), Some(50.0)));
        for one in [first, second] {
            let necessity = one.necessity.as_ref().unwrap();
            assert_eq!((necessity.cases, necessity.certified), (4, 2));
        }
        let rows = first.necessity.as_ref().unwrap().success.len();
        assert_eq!(rows, 3, "the condition is its own oracle");
    }

    #[test]
    fn a_control_that_was_not_run_has_no_figure() {
        let outcomes = ["+", "+", "-", "-"];
        let all = [episodes(MEMORY, outcomes), episodes(WRONG, outcomes)].concat();
        let scores = score(&log(all));
        let [found] = &scores.controls[..] else { panic!("{:?}", scores.controls) };
        assert_eq!((found.oracle, found.working), (None, None));
        assert!(found.headroom.is_none() && found.necessity.is_none());
        assert_eq!(found.content.as_ref().unwrap().sr.mean, 0.0);
    }
}
