//! The exact sign test on cases: its p, and what it can show with how many cases.
//!
//! A case is better, worse or equal. Under no difference a case that is not equal is as likely better as worse, so given their
//! number `d`, the number of better ones is that of heads among `d` throws of a fair coin. A test of several comparisons made
//! together multiplies p by a [factor](super::holm); a difference is shown where the product is below 5 %.
//!
//! The power of the test is exact and not conditional on `d` (S. W. Duffy, "Asymptotic and exact power for the McNemar test and
//! its analogue with R controls per case", Biometrics 40, 1984): with `n` cases, of which each is better with the probability
//! `b` and worse with `w`,
//!
//! `sum over d of Bin(d; n, b + w) P(Bin(d, b / (b + w)) >= k_d)`
//!
//! where `k_d` is the smallest number of better cases among `d` that shows a difference.

use std::sync::LazyLock;

/// A difference is shown where the corrected p is below this.
pub const LEVEL: f64 = 0.05;

/// The probability with which a difference that is called detectable would be shown.
pub const POWER: f64 = 0.8;

/// The largest number of cases for which power is computed.
pub const MOST_CASES: u32 = 10_000;

/// Two-sided p of `plus` against `minus` under a fair coin: twice the binomial tail, at most 1.
pub(super) fn sign_test(plus: usize, minus: usize) -> f64 {
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

/// The logarithms of the factorials up to [`MOST_CASES`].
static LOG_FACTORIALS: LazyLock<Vec<f64>> = LazyLock::new(|| {
    let mut sum = 0.0;
    let next = |number: u32| {
        sum += f64::from(number.max(1)).ln();
        sum
    };
    (0..=MOST_CASES).map(next).collect()
});

/// The probability of `heads` among `throws`, each of which is one with the probability `share`.
fn binomial(heads: u32, throws: u32, share: f64) -> f64 {
    let log_factorial = |number: u32| LOG_FACTORIALS[number as usize];
    // 0 ln 0 is 0 here.
    let log_power = |base: f64, exponent: u32| match exponent {
        0 => 0.0,
        _ => f64::from(exponent) * base.ln(),
    };
    let tails = throws - heads;
    let ways = log_factorial(throws) - log_factorial(heads) - log_factorial(tails);
    (ways + log_power(share, heads) + log_power(1.0 - share, tails)).exp()
}

/// The probability of at least some number of heads, throw by throw.
struct Tail {
    throws: u32,
    share: f64,
    /// The number of heads; one more than throws where no number is enough.
    heads: u32,
    probability: f64,
}

impl Tail {
    /// That of one head in no throw.
    const fn new(share: f64) -> Self {
        Self { throws: 0, share, heads: 1, probability: 0.0 }
    }

    fn at(&self, heads: u32) -> f64 {
        match heads > self.throws {
            true => 0.0,
            false => binomial(heads, self.throws, self.share),
        }
    }

    /// Adds a throw and a head to reach.
    fn grow(&mut self) {
        self.probability -= (1.0 - self.share) * self.at(self.heads);
        self.throws += 1;
        self.heads += 1;
    }

    /// Takes one head less.
    fn lower(&mut self) {
        self.heads -= 1;
        self.probability += self.at(self.heads);
    }
}

/// The sign test of a comparison whose p is multiplied by a factor.
#[derive(Debug)]
pub(super) struct CorrectedSignTest {
    pub(super) factor: usize,
    /// For each number of cases that are not equal: the smallest number of better ones that shows a difference.
    least_better: Vec<u32>,
}

impl CorrectedSignTest {
    /// For p multiplied by `factor`, at least 1.
    pub(super) fn new(factor: usize) -> Self {
        let mut tail = Tail::new(0.5);
        let mut least_better = vec![tail.heads];
        for _ in 0..MOST_CASES {
            // With one throw more the least number is the same or one more.
            tail.grow();
            if is_shown(2.0 * (tail.probability + tail.at(tail.heads - 1)), factor) {
                tail.lower();
            }
            least_better.push(tail.heads);
        }
        Self { factor, least_better }
    }

    /// The smallest number of cases that can show a difference: all of them better.
    pub(super) fn least_cases(&self) -> Option<u32> {
        let can_show = |(cases, better): (u32, &u32)| *better <= cases;
        (0..).zip(&self.least_better).find(|found| can_show(*found)).map(|(cases, _)| cases)
    }

    /// The probability that the first side is shown to be better with so many cases, each of which is better with the one
    /// probability, and worse with the other.
    fn power(&self, cases: u32, better: f64, worse: f64) -> f64 {
        let unequal = (better + worse).min(1.0);
        let mut tail = Tail::new(better / (better + worse));
        let mut power = 0.0;
        for count in 1..=cases {
            tail.grow();
            if tail.heads > self.least_better[count as usize] {
                tail.lower();
            }
            power += binomial(count, cases, unequal) * tail.probability;
        }
        power
    }

    /// The smallest excess of better over worse cases, as a share of all, that would be shown with the probability [`POWER`] in
    /// so many cases, if as large a share of them is unequal as `unequal`, or all better where the excess is larger. `None` where
    /// no excess would, because there are too few cases, or more than [`MOST_CASES`].
    pub(super) fn detectable(&self, cases: u32, unequal: f64) -> Option<f64> {
        let is_detected = |excess: f64| {
            let unequal = unequal.max(excess);
            self.power(cases, 0.5 * (unequal + excess), 0.5 * (unequal - excess)) >= POWER
        };
        let (mut low, mut high) = (0.0, 1.0);
        if cases > MOST_CASES || !is_detected(high) {
            return None;
        }
        // The power grows with the excess.
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if is_detected(middle) { high = middle } else { low = middle }
        }
        Some(high)
    }

    /// The number of cases, more than `cases`, with which a difference would be shown with the probability [`POWER`] if cases
    /// were better and worse as often as in these; with one case less it would not. `None` where as many are better as worse,
    /// and where it would take more than [`MOST_CASES`].
    pub(super) fn cases_needed(&self, cases: u32, better: u32, worse: u32) -> Option<u32> {
        let share = |count: u32| f64::from(count) / f64::from(cases);
        let (more, less) = (share(better.max(worse)), share(better.min(worse)));
        let is_enough = |cases: u32| self.power(cases, more, less) >= POWER;
        let mut low = cases;
        if better == worse {
            return None;
        }
        let mut high = loop {
            let high = low.saturating_mul(2).min(MOST_CASES);
            match (is_enough(high), high > low) {
                (true, true) => break high,
                (_, false) => return None,
                (false, true) => low = high,
            }
        };
        while high - low > 1 {
            let middle = low.midpoint(high);
            if is_enough(middle) { high = middle } else { low = middle }
        }
        Some(high)
    }
}

/// Whether `p`, multiplied by `factor`, shows a difference.
pub(super) fn is_shown(p: f64, factor: usize) -> bool {
    p * (factor as f64) < LEVEL
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn near(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-9, "{found}, expected {expected}");
    }

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

    #[test]
    fn the_least_number_of_better_cases_is_that_of_the_test() {
        for factor in [1, 7, 40] {
            let test = CorrectedSignTest::new(factor);
            for cases in 0..200 {
                let shows = |better: &usize| is_shown(sign_test(*better, cases - better), factor);
                let least = (cases / 2 + 1..=cases).find(shows).unwrap_or(cases + 1);
                assert_eq!(test.least_better[cases], least as u32, "{cases} cases, {factor}");
            }
        }
        // 2 / 2^6 < 0.05; 40 * 2 / 2^11 < 0.05.
        let least = |factor| CorrectedSignTest::new(factor).least_cases();
        assert_eq!((least(1), least(40)), (Some(6), Some(11)));
    }

    #[test]
    fn power_is_that_of_all_outcomes_by_hand() {
        let test = CorrectedSignTest::new(1);
        // 6 of 6 cases: all better. 7 cases: all better, or 6 better and one equal.
        near(test.power(6, 0.9, 0.1), 0.9_f64.powi(6));
        near(test.power(7, 0.8, 0.0), 0.8_f64.powi(7) + 7.0 * 0.8_f64.powi(6) * 0.2);
        // With worse cases: 7 : 0 and 6 : 0 are shown, 6 : 1 is not (p = 2 * 8 / 2^7).
        near(test.power(7, 0.7, 0.2), 0.7_f64.powi(7) + 7.0 * 0.7_f64.powi(6) * 0.1);
        // 6 cases: the sixth root of 0.8.
        near(test.detectable(6, 0.5).unwrap(), 0.8_f64.powf(1.0 / 6.0));
        assert_eq!(test.detectable(5, 0.5), None);
    }

    #[test]
    fn the_detectable_difference_shrinks_with_more_cases_and_agreement() {
        let test = CorrectedSignTest::new(1);
        let of = |cases, unequal| test.detectable(cases, unequal).unwrap();
        assert!(of(100, 0.3) < of(50, 0.3) && of(100, 0.1) < of(100, 0.5));
        assert!(CorrectedSignTest::new(10).detectable(100, 0.3).unwrap() > of(100, 0.3));
        // Where all cases agree, 80 % of draws must have 6 better cases or more.
        assert!((0.07..0.08).contains(&of(100, 0.0)), "{}", of(100, 0.0));
    }

    #[test]
    fn the_cases_needed_are_enough_and_one_less_is_not() {
        let test = CorrectedSignTest::new(3);
        for (cases, better, worse) in [(100, 12, 6), (20, 1, 0), (50, 20, 16), (10, 9, 0)] {
            let needed = test.cases_needed(cases, better, worse).unwrap();
            let power = |n| test.power(n, share(better, cases), share(worse, cases));
            assert!(needed > cases && power(needed) >= POWER, "{cases} {better} {worse}");
            assert!(power(needed - 1) < POWER || needed == cases + 1, "{cases} {better} {worse}");
        }
        assert_eq!(test.cases_needed(100, 8, 8), None);
        // 50 of 1000 are unequal and one more is better: hundreds of thousands of cases.
        assert_eq!(test.cases_needed(1000, 26, 25), None);
    }

    fn share(count: u32, cases: u32) -> f64 {
        f64::from(count) / f64::from(cases)
    }
}
