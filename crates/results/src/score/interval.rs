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
//!
//! `p` is the weighted mean that the figure is. Where weights differ, `s^2 / N` is the linearized
//! variance of that mean, `N / (N - 1) * sum (W_c (m_c - p))^2` over cases of weight `W_c` (of 1 in all) and mean
//! `m_c`, and the numbers of cases and of episodes are Kish's effective ones, `1 / sum W^2` (L. Kish, "Survey
//! Sampling", 1965). With equal weights all of these are what they are above.

use serde::Serialize;

use super::spread::weighted_mean;

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

/// The interval in percent of a rate whose repetitions by case, each with its weight, are `cases`. `None` for fewer than
/// two cases: one case says nothing about others.
pub(super) fn rate_interval(cases: &[Vec<(bool, f64)>]) -> Option<Interval> {
    let cases: Vec<_> = cases.iter().filter(|case| !case.is_empty()).collect();
    let count = cases.len() as f64;
    if cases.len() < 2 {
        return None;
    }
    let all = || cases.iter().copied().flatten().copied();
    let sum: f64 = all().map(|(_, weight)| weight).sum();
    let p = weighted_mean(all().map(indicator))?;
    // A case's weight is 1 on average.
    let of_cases: Vec<f64> = cases
        .iter()
        .map(|case| case.iter().map(|(_, weight)| weight).sum::<f64>() * count / sum)
        .collect();
    let deviation = |(case, weight): (&&Vec<(bool, f64)>, &f64)| {
        let mean = weighted_mean(case.iter().copied().map(indicator))?;
        Some((weight * (mean - p)).powi(2))
    };
    let deviations: f64 = cases.iter().zip(&of_cases).filter_map(deviation).sum();
    let variance = deviations / (count - 1.0);
    let effective = p * (1.0 - p) * count / variance;
    // 0 / 0 where every episode has the same outcome.
    let n = if effective.is_nan() { 0.0 } else { effective };
    let least = kish(of_cases.iter().copied());
    let n = n.clamp(least, kish(all().map(|(_, weight)| weight)).max(least));
    Some(wilson(p, n).scaled(100.0))
}

/// The number of equally weighted samples whose mean varies as much as that of samples with these weights.
fn kish(weights: impl Iterator<Item = f64>) -> f64 {
    let (sum, squares) = weights
        .fold((0.0, 0.0), |(sum, squares), weight| (sum + weight, squares + weight * weight));
    sum * sum / squares
}

fn indicator((success, weight): (bool, f64)) -> (f64, f64) {
    (if success { 1.0 } else { 0.0 }, weight)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn near(found: Interval, low: f64, high: f64) {
        assert!((found.low - low).abs() < 0.005 && (found.high - high).abs() < 0.005, "{found:?}");
    }

    /// The interval of cases whose episodes weigh the same.
    fn rate_interval(cases: &[Vec<bool>]) -> Option<Interval> {
        let weighted = |case: &Vec<bool>| case.iter().map(|&success| (success, 1.0)).collect();
        super::rate_interval(&cases.iter().map(weighted).collect::<Vec<_>>())
    }

    #[test]
    fn weights_count_as_that_many_episodes() {
        // Two runs of 50 cases; the second weighs nothing.
        let halves = |weight| {
            let case = |case| vec![(case % 2 == 0, 1.0), (case < 25, weight)];
            super::rate_interval(&(0..50).map(case).collect::<Vec<_>>()).unwrap()
        };
        let alone: Vec<_> = (0..50).map(|case| vec![case % 2 == 0]).collect();
        assert_eq!(halves(0.0), rate_interval(&alone).unwrap());
        assert_ne!(halves(1.0), halves(0.0));
        // Only the ratio of weights counts, and half of the weight on one case leaves about four of 41.
        let one = |scale: f64| {
            let mut cases = vec![vec![(true, scale)]; 40];
            cases.push(vec![(false, 40.0 * scale)]);
            super::rate_interval(&cases).unwrap()
        };
        assert_eq!(one(1.0), one(0.25));
        // Kish's number of cases is 80^2 / (40 + 40^2) = 3.9.
        let expected = wilson(0.5, 6400.0 / 1640.0).scaled(100.0);
        near(one(1.0), expected.low, expected.high);
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
