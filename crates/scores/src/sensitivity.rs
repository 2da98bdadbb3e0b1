//! What each mismatch between demonstrations and test costs: the same episodes without it and with it.

use conditions::{Condition, Mismatch};
use run_log::RunLog;
use serde::Serialize;

use super::compare::pair_conditions;
use super::comparison::{Comparison, conclude};
use super::trial::Trials;

/// What a mismatch costs under a condition.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sensitivity {
    /// The condition without the mismatch.
    pub condition: Condition,
    /// The mismatch.
    pub mismatch: Mismatch,
    /// Without it, minus with it: what is lost (specification, section 7).
    pub loss: Comparison,
}

/// Of each condition with a mismatch, by memory and the rest of the condition, what the mismatch costs; none where the run has no
/// pair of episodes without it and with it.
pub(super) fn sensitivity(log: &RunLog) -> Vec<Sensitivity> {
    let trials = Trials::by_condition(log);
    let of = |mismatched: &Condition| {
        let condition = mismatched.with_mismatch(Mismatch::None);
        let names = [condition, *mismatched].map(|condition| condition.to_string());
        let pairing = pair_conditions((log, &names[0]), (log, &names[1])).ok()?;
        Some(((condition, mismatched.mismatch), pairing))
    };
    let mismatched = trials.keys().filter(|condition| condition.mismatch != Mismatch::None);
    let mut losses: Vec<_> = mismatched.filter_map(of).collect();
    losses.sort_by_key(|(key, _)| *key);
    let (keys, pairings): (Vec<_>, Vec<_>) = losses.into_iter().unzip();
    keys.into_iter()
        .zip(conclude(pairings))
        .map(|((condition, mismatch), loss)| Sensitivity { condition, mismatch, loss })
        .collect()
}

#[cfg(test)]
mod tests {
    use rigs::records::{log, record, under};

    use super::*;
    use crate::{ComparisonVerdict, score};

    /// Three pairs, of which two are lost: the values 0, 100 and 100 with -100 and 100 added have the mean 40 and, with
    /// Q = 32000 and 4 degrees of freedom, t = 2.776445, the half-width 111.06.
    #[test]
    fn a_loss_is_that_of_pairs_with_its_interval() {
        let standard: Condition = "episodic/new/unchanged/original".parse().unwrap();
        let light = standard.with_mismatch(Mismatch::Light);
        let mut records = Vec::new();
        for (case, without, with) in [
            ("t01-01", true, Some(true)),
            ("t01-02", true, Some(false)),
            ("t01-03", true, Some(false)),
            ("t01-04", false, None),
        ] {
            records.push(under(standard, record(case, without)));
            records.extend(with.map(|success| under(light, record(case, success))));
        }
        // A mismatch without the same condition beside it costs nothing that is known.
        let alone: Condition = "summary/new/unchanged/original/stock".parse().unwrap();
        records.push(under(alone, record("t01-01", true)));
        let scores = score(&log(records));
        let [found] = &scores.sensitivity[..] else { panic!("{:?}", scores.sensitivity) };
        assert_eq!((found.condition, found.mismatch), (standard, Mismatch::Light));
        assert_eq!((found.loss.cases, found.loss.pairs), (3, 3));
        let near = |found: f64, expected: f64| {
            assert!((found - expected).abs() < 0.01, "{found}, not {expected}");
        };
        near(found.loss.sr.a, 100.0);
        near(found.loss.sr.b, 33.33);
        near(found.loss.sr.mean, 66.67);
        let interval = found.loss.sr.interval.unwrap();
        near(interval.low, -71.06);
        near(interval.high, 100.0);
    }

    #[test]
    fn the_losses_of_a_run_are_one_family() {
        // Six of six cases are lost to each of two mismatches: 2 / 2^6 alone, twice that together, which shows neither.
        let standard: Condition = "episodic/new/unchanged/original".parse().unwrap();
        let mut records = Vec::new();
        for case in ["t01-01", "t01-02", "t01-03", "t01-04", "t01-05", "t01-06"] {
            records.push(under(standard, record(case, true)));
            for mismatch in [Mismatch::Light, Mismatch::Labels] {
                records.push(under(standard.with_mismatch(mismatch), record(case, false)));
            }
        }
        let scores = score(&log(records));
        for one in &scores.sensitivity {
            let conclusion = &one.loss.conclusion;
            assert_eq!(conclusion.family, 2);
            assert!((one.loss.p - 0.03125).abs() < 1e-12, "{}", one.loss.p);
            assert!((conclusion.corrected_p - 0.0625).abs() < 1e-12, "{}", conclusion.corrected_p);
            assert_eq!(conclusion.verdict, ComparisonVerdict::NoDifferenceShown);
        }
        assert_eq!(scores.sensitivity.len(), 2);
    }
}
