//! Two configurations on the same cases: both figures, the mean difference with its interval, and a test of whether one
//! succeeds in more cases than the other.

use serde::Serialize;

use super::bootstrap::intervals;
use super::condition::{EpisodeSample, paired, path_weighted, rate};
use super::interval::{Interval, difference_interval, rate_interval};
use super::spread::mean;
use super::trial::Trials;

/// How configuration A compares with configuration B on the cases that both have.
///
/// Figures are means over cases of each case's mean over its repetitions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The name of the first configuration.
    pub a: String,
    /// The name of the second.
    pub b: String,
    /// Cases that both have.
    pub cases: usize,
    /// Success rates in percent, their difference in percentage points.
    pub sr: FigureDifference,
    /// SPL.
    pub spl: FigureDifference,
    /// Cases that succeed more often under A. With one run each: that succeed under A alone.
    pub more_under_a: usize,
    /// Cases that succeed more often under B.
    pub more_under_b: usize,
    /// Two-sided p of the exact sign test on those two counts; with one run each this is McNemar's exact test.
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
    /// The 95 % interval of the difference: bootstrap, cases paired. Where every case differs by the same amount,
    /// so that the bootstrap has no width, that of the success rate is Newcombe's, and SPL has none.
    pub interval: Option<Interval>,
}

/// Compares `a` with `b`, each with its name; `None` when they have no case in common.
pub fn compare(a: (&str, &Trials<'_>), b: (&str, &Trials<'_>)) -> Option<Comparison> {
    let mut cases: Vec<Vec<Vec<EpisodeSample>>> = paired(&[a.1, b.1]).into_values().collect();
    // A case weighs the same however often it was repeated.
    for repetitions in cases.iter_mut().flatten() {
        let weight = 1.0 / repetitions.len() as f64;
        repetitions.iter_mut().for_each(|sample| sample.weight = weight);
    }
    let [sr, spl] = intervals(&cases, |arms| {
        [rate, path_weighted].map(|figure| Some(figure(&arms[0])? - figure(&arms[1])?))
    });
    let difference = |figure: fn(&[EpisodeSample]) -> Option<f64>, interval: Option<Interval>| {
        let side = |arm: usize| mean(cases.iter().filter_map(|arms| figure(&arms[arm])));
        let of_case = |arms: &Vec<Vec<EpisodeSample>>| Some(figure(&arms[0])? - figure(&arms[1])?);
        let interval = interval.filter(|interval| !interval.is_point());
        let mean = mean(cases.iter().filter_map(of_case))?;
        Some(FigureDifference { a: side(0)?, b: side(1)?, mean, interval })
    };
    let (mut sr, spl) = (difference(rate, sr)?, difference(path_weighted, spl)?);
    sr.interval = sr.interval.or_else(|| rate_difference(&cases, &sr));
    let more = |first: usize, second: usize| {
        cases.iter().filter(|arms| rate(&arms[first]) > rate(&arms[second])).count()
    };
    let (more_under_a, more_under_b) = (more(0, 1), more(1, 0));
    Some(Comparison {
        a: a.0.to_owned(),
        b: b.0.to_owned(),
        cases: cases.len(),
        sr,
        spl,
        more_under_a,
        more_under_b,
        p: sign_test(more_under_a, more_under_b),
    })
}

/// Newcombe's interval of the difference of two success rates.
fn rate_difference(cases: &[Vec<Vec<EpisodeSample>>], sr: &FigureDifference) -> Option<Interval> {
    let interval = |arm: usize| {
        let successes = |arms: &Vec<Vec<EpisodeSample>>| {
            arms[arm].iter().map(|s| (s.success, s.weight)).collect()
        };
        rate_interval(&cases.iter().map(successes).collect::<Vec<_>>())
    };
    Some(difference_interval((sr.a, interval(0)?), (sr.b, interval(1)?)))
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
