//! Two configurations on the same episodes: both figures, the mean difference with its interval, and a test of whether one
//! succeeds in more cases than the other.
//!
//! Episodes are paired by case and repetition, and only pairs are compared. So both sides have as many repetitions of a case,
//! and where the configurations do not differ, a case is as likely to succeed more often under the one as under the other:
//! that is what the sign test supposes. With more repetitions on one side it would not hold.

use std::collections::BTreeMap;

use serde::Serialize;

use super::interval::{Interval, Units};
use super::mean::mean;
use super::trial::{Trials, path_weight};
use run_log::EpisodeRecord;

/// How configuration A compares with configuration B on the episodes of the same case and repetition.
///
/// Figures are means over cases of each case's mean over its pairs of episodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The name of the first configuration.
    pub a: String,
    /// The name of the second.
    pub b: String,
    /// Cases of which there is a pair.
    pub cases: usize,
    /// Pairs of episodes: of one case and one repetition, finished under both.
    pub pairs: usize,
    /// Finished episodes of A without one of B. They enter nothing here.
    pub unpaired_a: usize,
    /// Finished episodes of B without one of A.
    pub unpaired_b: usize,
    /// Success rates in percent, their difference in percentage points.
    pub sr: FigureDifference,
    /// SPL.
    pub spl: FigureDifference,
    /// Cases with more successes under A than under B.
    pub more_under_a: usize,
    /// Cases with more successes under B.
    pub more_under_b: usize,
    /// Two-sided p of the exact sign test on those two counts; with one pair of each case this is McNemar's exact test.
    /// 1 when the counts are equal. Not corrected for the number of comparisons.
    pub p: f64,
}

/// A figure of both configurations, and the mean difference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FigureDifference {
    /// The figure of A.
    pub a: f64,
    /// The figure of B.
    pub b: f64,
    /// A minus B.
    pub mean: f64,
    /// The 95 % interval of the difference over the cases, or over the streams. `None` for one case or stream, and for
    /// streams that all differ by the same.
    pub interval: Option<Interval>,
}

/// The pairs of one case.
#[derive(Debug, Clone, Copy, Default)]
struct PairedCase {
    pairs: u32,
    /// Successes under each side, counted: means of counts may differ by rounding where they are equal.
    successes: [u32; 2],
    /// The sum of `s_i l_i / max(p_i, l_i)` under each side.
    path_weight: [f64; 2],
}

impl PairedCase {
    fn add(&mut self, pair: [&EpisodeRecord; 2]) {
        self.pairs += 1;
        for (side, record) in pair.into_iter().enumerate() {
            self.successes[side] += u32::from(record.is_success());
            self.path_weight[side] += path_weight(record);
        }
    }

    fn success_rates(&self) -> [f64; 2] {
        self.successes.map(|count| 100.0 * f64::from(count) / f64::from(self.pairs))
    }

    fn path_weighted(&self) -> [f64; 2] {
        self.path_weight.map(|sum| sum / f64::from(self.pairs))
    }
}

/// Compares `a` with `b`, each with its name; `None` when they have no episode of the same case and repetition.
pub fn compare(a: (&str, &Trials<'_>), b: (&str, &Trials<'_>)) -> Option<Comparison> {
    let others: BTreeMap<(&str, u32), &EpisodeRecord> =
        b.1.iter().map(|record| ((record.case.as_str(), record.run), record)).collect();
    let mut by_case: BTreeMap<&str, PairedCase> = BTreeMap::new();
    for record in a.1.iter() {
        if let Some(other) = others.get(&(record.case.as_str(), record.run)) {
            by_case.entry(&record.case).or_default().add([record, other]);
        }
    }
    let cases: Vec<PairedCase> = by_case.into_values().collect();
    let pairs = cases.iter().map(|case| case.pairs as usize).sum();
    let more = |first: usize, second: usize| {
        cases.iter().filter(|case| case.successes[first] > case.successes[second]).count()
    };
    let (more_under_a, more_under_b) = (more(0, 1), more(1, 0));
    Some(Comparison {
        a: a.0.to_owned(),
        b: b.0.to_owned(),
        cases: cases.len(),
        pairs,
        unpaired_a: a.1.count() - pairs,
        unpaired_b: b.1.count() - pairs,
        sr: difference(&cases, PairedCase::success_rates, Interval::POINTS)?,
        spl: difference(&cases, PairedCase::path_weighted, Interval::SHARE_DIFFERENCE)?,
        more_under_a,
        more_under_b,
        p: sign_test(more_under_a, more_under_b),
    })
}

/// The difference of a figure, which lies in `range`; `None` without cases.
fn difference(
    cases: &[PairedCase],
    figure: fn(&PairedCase) -> [f64; 2],
    range: Interval,
) -> Option<FigureDifference> {
    let side = |side: usize| mean(cases.iter().map(|case| figure(case)[side]));
    let differences: Vec<f64> = cases
        .iter()
        .map(|case| {
            let [a, b] = figure(case);
            a - b
        })
        .collect();
    Some(FigureDifference {
        a: side(0)?,
        b: side(1)?,
        mean: mean(differences.iter().copied())?,
        interval: Units::alike(differences).interval(range),
    })
}

/// Two-sided p of `plus` against `minus` under a fair coin: twice the binomial tail, at most 1.
fn sign_test(plus: usize, minus: usize) -> f64 {
    let throws = (plus + minus) as f64;
    // The logarithm of the probability of k heads, from that of k - 1; a product would underflow.
    let mut log_probability = -throws * std::f64::consts::LN_2;
    let mut tail = log_probability.exp();
    for heads in 1..=plus.min(minus) {
        let heads = heads as f64;
        log_probability += ((throws - heads + 1.0) / heads).ln();
        tail += log_probability.exp();
    }
    (2.0 * tail).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sign_test_is_the_binomial_tail() {
        for (plus, minus, expected) in [
            (0, 0, 1.0),
            (3, 3, 1.0),
            // 2 * (1 + 5) / 2^5
            (4, 1, 0.375),
            // 2 * 1 / 2^6
            (0, 6, 0.03125),
            // 2 * (1 + 10 + 45) / 2^10
            (8, 2, 0.109_375),
        ] {
            assert!((sign_test(plus, minus) - expected).abs() < 1e-12, "{plus} {minus}");
        }
    }
}
