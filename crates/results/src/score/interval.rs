//! 95 % intervals of proportions that do not collapse at 0 and 100 %.
//!
//! The score interval of E. B. Wilson ("Probable inference, the law of succession, and statistical inference",
//! JASA 22, 1927) for the success rate of one run. For a mean over repetitions of the same cases the episodes are
//! not independent, so the interval is computed for the *effective sample size* `n = p (1 - p) / (s^2 / N)`, where
//! `s^2` is the sample variance of the cases' means and `N` the number of cases, as for clustered surveys (E. L.
//! Korn and B. I. Graubard, "Confidence intervals for proportions with small expected number of positive counts
//! estimated from survey data", Survey Methodology 24, 1998; Wilson's interval in that place: N. Dean and M.
//! Pagano, "Evaluating confidence interval methods for binomial proportions in clustered surveys", J. Survey Stat.
//! Methodol. 3, 2015). It is limited to the range from the number of cases (repetitions add no information) to the
//! number of episodes (they are independent). With one run, and where every episode has the same outcome, it is the
//! number of cases.

use serde::Serialize;

/// The 97.5th percentile of the standard normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// An interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// The lower end.
    pub low: f64,
    /// The upper end.
    pub high: f64,
}

/// Wilson's interval of the share `p`, from 0 to 1, of a sample of `n`.
pub(super) fn wilson(p: f64, n: f64) -> Interval {
    let squared = Z * Z;
    let middle = p + squared / (2.0 * n);
    let half = Z * ((p * (1.0 - p) + squared / (4.0 * n)) / n).sqrt();
    let scale = 1.0 + squared / n;
    Interval {
        low: ((middle - half) / scale).clamp(0.0, p),
        high: ((middle + half) / scale).clamp(p, 1.0),
    }
}

/// The interval in percent of a rate whose repetitions by case are `cases`. `None` for fewer than two cases: one
/// case says nothing about others.
pub(super) fn rate_interval(cases: &[Vec<bool>]) -> Option<Interval> {
    let means: Vec<f64> =
        cases.iter().filter(|case| !case.is_empty()).map(|case| share(case)).collect();
    let count = means.len();
    if count < 2 {
        return None;
    }
    let episodes: usize = cases.iter().map(Vec::len).sum();
    let successes: usize = cases.iter().flatten().filter(|success| **success).count();
    let p = successes as f64 / episodes as f64;
    let centre = means.iter().sum::<f64>() / count as f64;
    let variance =
        means.iter().map(|mean| (mean - centre).powi(2)).sum::<f64>() / (count - 1) as f64;
    let effective = p * (1.0 - p) * count as f64 / variance;
    // 0 / 0 where every episode has the same outcome.
    let n = if effective.is_nan() { 0.0 } else { effective };
    let n = n.clamp(count as f64, episodes as f64);
    Some(wilson(p, n).scaled(100.0))
}

/// The interval of the difference `a - b` of two rates in percent from the intervals of both (R. G. Newcombe,
/// "Interval estimation for the difference between independent proportions", Statistics in Medicine 17, 1998,
/// method 10). Paired cases are taken as independent, which makes it wider.
pub(super) fn difference_interval(a: (f64, Interval), b: (f64, Interval)) -> Interval {
    let root = |x: f64, y: f64| (x * x + y * y).sqrt();
    let difference = a.0 - b.0;
    Interval {
        low: difference - root(a.0 - a.1.low, b.1.high - b.0),
        high: difference + root(a.1.high - a.0, b.0 - b.1.low),
    }
}

impl Interval {
    /// Both ends times `factor`.
    pub(super) fn scaled(self, factor: f64) -> Self {
        Self { low: self.low * factor, high: self.high * factor }
    }

    /// Whether both ends are the same, but for rounding in sums of many values.
    pub(super) fn is_point(&self) -> bool {
        self.high - self.low <= 1e-12 * self.high.abs().max(self.low.abs())
    }
}

fn share(case: &[bool]) -> f64 {
    case.iter().filter(|success| **success).count() as f64 / case.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn near(found: Interval, low: f64, high: f64) {
        assert!((found.low - low).abs() < 0.005 && (found.high - high).abs() < 0.005, "{found:?}");
    }

    #[test]
    fn one_run_has_wilsons_interval_and_certainty_has_a_width() {
        // Published values of Wilson's interval: 50 of 50, 0 of 50, 81 of 263 (Newcombe 1998: 0.2553 to 0.3662).
        near(rate_interval(&vec![vec![true]; 50]).unwrap(), 92.87, 100.0);
        near(rate_interval(&vec![vec![false]; 50]).unwrap(), 0.0, 7.13);
        let some: Vec<Vec<bool>> = (0..263).map(|case| vec![case < 81]).collect();
        near(rate_interval(&some).unwrap(), 25.53, 36.62);
        assert_eq!(rate_interval(&[vec![true, false]]), None);
        assert_eq!(rate_interval(&[]), None);
    }

    #[test]
    fn repetitions_count_as_far_as_they_differ() {
        // Each case always has one outcome: three runs tell no more than one.
        let alike = |runs| (0..100).map(|case| vec![case % 2 == 0; runs]).collect::<Vec<_>>();
        let one = rate_interval(&alike(1)).unwrap();
        assert_eq!(rate_interval(&alike(3)), Some(one));
        near(one, 40.38, 59.62);
        // Each case succeeds in one of two runs: as good as 200 independent episodes.
        let mixed = rate_interval(&vec![vec![true, false]; 100]).unwrap();
        near(mixed, 43.14, 56.86);
        // Three runs without a failure: still no more than the cases.
        assert_eq!(rate_interval(&vec![vec![true; 3]; 50]), rate_interval(&vec![vec![true]; 50]));
    }

    #[test]
    fn two_certain_rates_differ_by_no_certain_amount() {
        let all = wilson(1.0, 50.0).scaled(100.0);
        near(difference_interval((100.0, all), (100.0, all)), -7.13, 7.13);
        // Newcombe's table II (a): 56/70 - 48/80 = 0.2000, 0.0524 to 0.3339.
        let (a, b) = (wilson(0.8, 70.0).scaled(100.0), wilson(0.6, 80.0).scaled(100.0));
        near(difference_interval((80.0, a), (60.0, b)), 5.24, 33.39);
    }
}
