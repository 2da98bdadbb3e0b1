//! Two configurations on the same cases: the mean difference with its interval, and a test of whether more
//! cases went better than worse.

use serde::Serialize;
use statrs::distribution::{Binomial, DiscreteCDF};

use super::bootstrap::{Interval, intervals};
use super::condition::{Outcome, paired, rate, weight};
use super::spread::mean;
use super::trial::Trials;

/// How configuration A compares with configuration B on the cases that both have.
///
/// A difference is A minus B, of the means over cases of each case's mean over its repetitions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The first configuration, as it is written.
    pub a: String,
    /// The second.
    pub b: String,
    /// Cases that both have.
    pub cases: usize,
    /// Difference of the success rates, in percentage points.
    pub sr: Difference,
    /// Difference of SPL.
    pub spl: Difference,
    /// Cases that succeed more often under A. With one run each: that succeed under A alone.
    pub more_under_a: usize,
    /// Cases that succeed more often under B.
    pub more_under_b: usize,
    /// Two-sided p of the exact sign test on those two counts; with one run each this is McNemar's exact test.
    /// 1 when the counts are equal. Not corrected for the number of comparisons.
    pub p: f64,
}

/// A mean difference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Difference {
    /// The mean over cases.
    pub mean: f64,
    /// Its 95 % bootstrap interval, cases paired.
    pub interval: Option<Interval>,
}

/// Compares `a` with `b`; `None` when they have no case in common. The names are for the reader.
pub fn compare(a: (&str, &Trials<'_>), b: (&str, &Trials<'_>)) -> Option<Comparison> {
    let cases: Vec<Vec<Vec<Outcome>>> = paired(&[a.1, b.1]).into_values().collect();
    let difference = |figure: fn(&[Outcome]) -> Option<f64>| {
        mean(cases.iter().filter_map(|arms| Some(figure(&arms[0])? - figure(&arms[1])?)))
    };
    let (sr, spl) = (difference(rate)?, difference(weight)?);
    let [sr_interval, spl_interval] = intervals(&cases, |arms| {
        [rate, weight].map(|figure| Some(figure(&arms[0])? - figure(&arms[1])?))
    });
    let more = |first: usize, second: usize| {
        cases.iter().filter(|arms| rate(&arms[first]) > rate(&arms[second])).count()
    };
    let (more_under_a, more_under_b) = (more(0, 1), more(1, 0));
    Some(Comparison {
        a: a.0.to_owned(),
        b: b.0.to_owned(),
        cases: cases.len(),
        sr: Difference { mean: sr, interval: sr_interval },
        spl: Difference { mean: spl, interval: spl_interval },
        more_under_a,
        more_under_b,
        p: sign_test(more_under_a, more_under_b),
    })
}

/// Two-sided p of `plus` against `minus` under a fair coin: twice the binomial tail, at most 1.
fn sign_test(plus: usize, minus: usize) -> f64 {
    // A fair coin is a distribution for any number of throws, none included.
    Binomial::new(0.5, (plus + minus) as u64)
        .map_or(1.0, |coin| (2.0 * coin.cdf(plus.min(minus) as u64)).min(1.0))
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
