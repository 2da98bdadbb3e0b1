//! 95 % intervals of figures: one method for all of them.
//!
//! A figure is a mean over independent *units*: cases, or streams. Its interval is that of Student's t over the units, after two
//! units are added where a unit's value has a smallest and a largest value, one at each end. These keep the interval from
//! collapsing where all units are alike, as the two successes and two failures of A. Agresti and B. A. Coull ("Approximate is
//! better than 'exact' for interval estimation of binomial proportions", The American Statistician 52, 1998) and the added
//! pairs of D. G. Bonett and R. M. Price ("Adjusted Wald confidence interval for a difference of binomial proportions based on
//! paired data", J. Educational and Behavioral Statistics 37, 2012) do. Everything else comes from how the units differ,
//! so figures that vary less than a coin have narrower intervals, and repetitions count as far as they tell more.
//!
//! One unit at each end and t with as many degrees of freedom as there are units, added ones included, less one, were chosen
//! by simulation: `cargo run --release -p scores --example intervals` prints how often the intervals hold the true figure.
//!
//! Units may weigh differently, where a figure is a mean over runs with different numbers of episodes. With weights
//! `W_c` of 1 in all, means `m_c` and the figure `p = sum W_c m_c`, the variance of `p` is the linearized one,
//! `V = sum W_c^2 (m_c - p)^2`, and the number of units is Kish's effective one, `n = 1 / sum W_c^2` (L. Kish, "Survey
//! Sampling", 1965). With equal weights both are what they are for a plain mean.

use serde::Serialize;

use super::mean::{mean, weighted_mean};
use super::student;

/// An interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// The lower end.
    pub low: f64,
    /// The upper end.
    pub high: f64,
}

impl Interval {
    /// Percentages.
    pub(super) const PERCENT: Self = Self { low: 0.0, high: 100.0 };
    /// Differences of percentages.
    pub(super) const POINTS: Self = Self { low: -100.0, high: 100.0 };
    /// Shares.
    pub(super) const SHARE: Self = Self { low: 0.0, high: 1.0 };
    /// Differences of shares.
    pub(super) const SHARE_DIFFERENCE: Self = Self { low: -1.0, high: 1.0 };
    /// Numbers from 0 without an upper end.
    pub(super) const POSITIVE: Self = Self { low: 0.0, high: f64::INFINITY };
    /// Numbers without ends.
    pub(super) const ANY: Self = Self { low: f64::NEG_INFINITY, high: f64::INFINITY };

    /// The interval of this `half` width around `middle`, as far as it is in `range`, and extended to `figure`.
    fn around(middle: f64, half: f64, figure: f64, range: Self) -> Self {
        Self {
            low: (middle - half).max(range.low).min(figure),
            high: (middle + half).min(range.high).max(figure),
        }
    }
}

/// The values of independent units, whose mean is a figure.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Units {
    /// One value for each unit. Where units have weights, the linearized values: their plain mean is the figure, and the
    /// variance of it is that of the weighted mean.
    values: Vec<f64>,
    /// The number of equally weighted units that tell as much.
    effective: f64,
}

impl Units {
    /// Units that weigh the same.
    pub(super) fn alike(values: Vec<f64>) -> Self {
        let effective = values.len() as f64;
        Self { values, effective }
    }

    /// Units from the mean and the weight of each. Those without weight are left out.
    pub(super) fn weighted(units: &[(f64, f64)]) -> Self {
        let counted = || units.iter().copied().filter(|(_, weight)| *weight > 0.0);
        let figure = weighted_mean(counted()).unwrap_or(f64::NAN);
        let (count, sum, squares) =
            counted().fold((0.0, 0.0, 0.0), |(count, sum, squares), (_, weight)| {
                (count + 1.0, sum + weight, squares + weight * weight)
            });
        let values =
            counted().map(|(mean, weight)| figure + count * weight / sum * (mean - figure));
        Self { values: values.collect(), effective: sum * sum / squares }
    }

    /// What `figure` makes of the values of the same units in each of `arms`; it must be linear.
    pub(super) fn combined<const N: usize>(
        arms: [&Self; N],
        figure: impl Fn([f64; N]) -> f64,
    ) -> Self {
        let count = arms.iter().map(|arm| arm.values.len()).min().unwrap_or(0);
        let value = |unit: usize| figure(arms.map(|arm| arm.values[unit]));
        let effective = arms.iter().map(|arm| arm.effective).fold(f64::INFINITY, f64::min);
        Self { values: (0..count).map(value).collect(), effective }
    }

    /// The mean; `None` for fewer than two units: one says nothing about others.
    fn figure(&self) -> Option<f64> {
        mean(self.values.iter().copied()).filter(|_| self.values.len() > 1)
    }

    /// The variance of the mean as a sum of squares over the effective number of units, for means `p` and `q` of these units
    /// and of `other` ones: `n^2 V` for the units themselves.
    fn squares(&self, p: f64, other: &Self, q: f64, effective: f64) -> f64 {
        let products = self.values.iter().zip(&other.values).map(|(x, y)| (x - p) * (y - q));
        let share = effective / self.values.len() as f64;
        share * share * products.sum::<f64>()
    }

    /// The interval of the mean of values that a unit has from `range.low` to `range.high`. `None` for fewer than two units.
    pub(super) fn interval(&self, range: Interval) -> Option<Interval> {
        let (figure, n) = (self.figure()?, self.effective);
        let middle = (n * figure + range.low + range.high) / (n + 2.0);
        let squares = self.squares(figure, self, figure, n)
            + n * (figure - middle).powi(2)
            + (range.low - middle).powi(2)
            + (range.high - middle).powi(2);
        let half = student::quantile(n + 1.0) * (squares / ((n + 1.0) * (n + 2.0))).sqrt();
        Some(Interval::around(middle, half, figure, range))
    }

    /// The mean and its standard error without added units. `None` for fewer than two units, and where all have the same value.
    fn standard_error(&self) -> Option<(f64, f64)> {
        let (figure, n) = (self.figure()?, self.effective);
        let first = *self.values.first()?;
        // Values that are the same on paper differ by rounding, figures of different episodes by far more than this.
        let differs = |value: &f64| (value - first).abs() > 1e-9;
        let squares = self.squares(figure, self, figure, n);
        self.values.iter().any(differs).then(|| (figure, (squares / (n * (n - 1.0))).sqrt()))
    }

    /// Two-sided p of Student's t test of a mean of 0, without added units: below 5 % where [`Self::interval_of_means`] without
    /// a range does not hold 0. `None` where there is no such interval.
    pub(super) fn p_of_means(&self) -> Option<f64> {
        let (figure, error) = self.standard_error()?;
        Some(student::two_sided(figure / error, self.effective - 1.0))
    }

    /// The interval of the mean without added units, for units that are themselves means over many episodes, so that no unit
    /// comes near the ends of `range`. `None` for fewer than two units, and where all have the same value.
    pub(super) fn interval_of_means(&self, range: Interval) -> Option<Interval> {
        let (figure, error) = self.standard_error()?;
        let half = student::quantile(self.effective - 1.0) * error;
        Some(Interval::around(figure, half, figure, range))
    }

    /// The interval of the mean of these units divided by that of `denominator`, the same units with values from 0 to `most`.
    ///
    /// It has every ratio `r` for which the interval of the mean of `x - r y` holds 0 (E. C. Fieller, "Some problems in interval
    /// estimation", J. Royal Statistical Society B 16, 1954), after one unit with the values `most` and 0 and one with 0 and
    /// `most` are added. `None` for fewer than two units, and where the denominator may be 0, so that no ratio is too large.
    pub(super) fn interval_of_ratio(&self, denominator: &Self, most: f64) -> Option<Interval> {
        let (x, y) = (self.figure()?, denominator.figure()?);
        let n = self.effective.min(denominator.effective);
        let middle = |figure: f64| (n * figure + most) / (n + 2.0);
        let (middle_x, middle_y) = (middle(x), middle(y));
        // The sums of squares and products around the middles, added units included, as squares of the mean's error.
        let scale = student::quantile(n + 1.0).powi(2) / ((n + 1.0) * (n + 2.0));
        let own = |units: &Self, figure: f64, middle: f64| {
            let ends = (most - middle).powi(2) + middle.powi(2);
            scale * (units.squares(figure, units, figure, n) + n * (figure - middle).powi(2) + ends)
        };
        let (error_x, error_y) = (own(self, x, middle_x), own(denominator, y, middle_y));
        let both = self.squares(x, denominator, y, n) + n * (x - middle_x) * (y - middle_y)
            - (most - middle_x) * middle_y
            - middle_x * (most - middle_y);
        // (X - r Y)^2 = error: a r^2 - 2 b r + c = 0.
        let a = middle_y * middle_y - error_y;
        let b = middle_x * middle_y - scale * both;
        let c = middle_x * middle_x - error_x;
        let half = (b * b - a * c).max(0.0).sqrt() / a;
        (a > 0.0 && y > 0.0).then(|| Interval::around(b / a, half, x / y, Interval::POSITIVE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn near(found: Option<Interval>, low: f64, high: f64) {
        let found = found.unwrap();
        let error = (found.low - low).abs().max((found.high - high).abs());
        assert!(error < 1e-9, "{found:?}, expected {low} to {high}: {error:e}");
    }

    fn rate(successes: usize, cases: usize) -> Units {
        Units::alike((0..cases).map(|case| if case < successes { 100.0 } else { 0.0 }).collect())
    }

    // The expected values are those of the formulas in NumPy with `scipy.stats.t`.

    #[test]
    fn a_rate_has_an_interval_also_at_its_ends() {
        near(rate(50, 50).interval(Interval::PERCENT), 94.216_185_057_084_91, 100.0);
        near(rate(0, 50).interval(Interval::PERCENT), 0.0, 5.783_814_942_915_07);
        let some = rate(81, 263).interval(Interval::PERCENT);
        near(some, 25.341_587_783_835_188, 36.545_204_668_995_01);
        assert_eq!(rate(1, 1).interval(Interval::PERCENT), None, "one case");
        assert_eq!(rate(0, 0).interval(Interval::PERCENT), None);
    }

    #[test]
    fn values_that_are_nearly_alike_have_nearly_the_same_interval() {
        let alike = |value| Units::alike(vec![value; 5]).interval(Interval::SHARE);
        near(alike(0.996), 0.505_889_346_654_241_8, 1.0);
        near(alike(1.0), 0.507_584_021_265_004_2, 1.0);
        let difference = Units::alike(vec![0.0; 50]).interval(Interval::POINTS);
        near(difference, -5.513_176_725_637_517, 5.513_176_725_637_517);
    }

    #[test]
    fn repetitions_count_as_far_as_they_differ() {
        // Each case succeeds in one of two repetitions: only the added cases vary.
        let mixed = Units::alike(vec![50.0; 50]).interval(Interval::PERCENT);
        near(mixed, 47.243_411_637_181_24, 52.756_588_362_818_76);
        // Each case always has one outcome: repetitions tell nothing.
        let weighted: Vec<(f64, f64)> =
            (0..50).map(|case| (if case < 25 { 100.0 } else { 0.0 }, 3.0)).collect();
        let Interval { low, high } = rate(25, 50).interval(Interval::PERCENT).unwrap();
        near(Units::weighted(&weighted).interval(Interval::PERCENT), low, high);
    }

    #[test]
    fn weights_count_as_that_many_units() {
        // Half of the weight on one case of 41 leaves 3.9 of them.
        let mut units = vec![(100.0, 1.0); 40];
        units.push((0.0, 40.0));
        let found = Units::weighted(&units);
        assert!((found.effective - 6400.0 / 1640.0).abs() < 1e-9, "{found:?}");
        near(found.interval(Interval::PERCENT), 0.0, 100.0);
        // Only the ratio of weights counts, and a case without weight does not.
        let mut scaled: Vec<_> =
            units.iter().map(|(mean, weight)| (*mean, weight * 0.25)).collect();
        scaled.push((50.0, 0.0));
        assert_eq!(Units::weighted(&scaled), found);
    }

    #[test]
    fn means_over_streams_have_students_interval() {
        let found = Units::alike(vec![80.0, 85.0, 82.0, 78.0]).interval_of_means(Interval::PERCENT);
        near(found, 76.498_482_260_013_55, 86.001_517_739_986_45);
        // Two streams tell little: 12.7 times the standard error.
        let two = Units::alike(vec![50.0, 25.0]);
        near(two.interval_of_means(Interval::ANY), -121.327_559_202_183_66, 196.327_559_202_183_66);
        near(two.interval_of_means(Interval::PERCENT), 0.0, 100.0);
        let alike = |values: &[f64]| Units::alike(values.to_vec()).interval_of_means(Interval::ANY);
        assert_eq!(alike(&[100.0, 100.0 * (1.0 - f64::EPSILON)]), None);
        assert_eq!((alike(&[0.0, 0.0]), alike(&[5.0])), (None, None));
        // `scipy.stats.ttest_1samp([8.0, -1.0, 5.0, 6.0], 0.0).pvalue`
        let p = Units::alike(vec![8.0, -1.0, 5.0, 6.0]).p_of_means().unwrap();
        assert!((p - 0.10272807885839899).abs() < 1e-12, "{p}");
        assert_eq!(Units::alike(vec![3.0, 3.0]).p_of_means(), None);
    }

    #[test]
    fn a_ratio_has_every_value_that_the_paired_test_allows() {
        // The ends were found by bisection of the test itself.
        let ratio = |of: &Units, by: &Units| of.interval_of_ratio(by, 100.0);
        let after = [0.0, 100.0, 50.0, 0.0, 0.0, 100.0, 0.0, 0.0, 100.0 / 3.0, 100.0];
        let before = [100.0, 100.0, 100.0, 0.0, 100.0, 50.0, 100.0, 100.0, 100.0, 100.0];
        let found = ratio(&Units::alike(after.to_vec()), &Units::alike(before.to_vec()));
        near(found, 0.121_608_374_813_093_85, 1.074_822_213_619_120_3);
        near(ratio(&rate(10, 30), &rate(20, 30)), 0.277_499_611_592_193_16, 0.791_064_571_053_397);
        // All are retained, and nothing is.
        let all = ratio(&rate(50, 50), &rate(50, 50)).unwrap();
        assert!(all.low < 0.95 && (1.0..1.07).contains(&all.high), "{all:?}");
        let none = ratio(&rate(0, 50), &rate(50, 50)).unwrap();
        assert!(none.low == 0.0 && (0.02..0.08).contains(&none.high), "{none:?}");
        // Where the denominator may be 0 there is no largest ratio.
        assert_eq!(ratio(&rate(1, 50), &rate(1, 50)), None);
        assert_eq!(ratio(&rate(0, 50), &rate(0, 50)), None);
    }

    #[test]
    fn arms_are_combined_case_by_case() {
        let found = Units::combined([&rate(3, 4), &rate(1, 4)], |[a, b]| a - b);
        assert_eq!(found, Units::alike(vec![0.0, 100.0, 100.0, 0.0]));
    }
}
