//! Bootstrap intervals over cases and runs.
//!
//! The outcome of an evaluation depends on which cases were chosen and on chance in each repetition. A resample
//! therefore draws as many cases as there are, with replacement, and for each case drawn as many of its repetitions as
//! it has, again with replacement; the interval runs from the 2.5th to the 97.5th percentile of the figure over all
//! resamples (the percentile method). An episode keeps the weight that it has in the figure: where runs have different
//! numbers of episodes, the figure is still the mean over runs, or in a comparison the mean over cases. Conditions that enter one figure together, such as the two of a comparison, are
//! resampled with the same cases.
//!
//! Deterministic: the draws come from ChaCha8 with a fixed seed, restarted for each interval, over cases in the
//! order of their ids.
//!
//! A figure that is the same in every episode is the same in every resample. Rates therefore have
//! [another interval](super::interval).

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::interval::Interval;

/// Number of resamples.
pub const RESAMPLES: usize = 2000;

/// Seed of the draws.
pub const SEED: u64 = 20_260_801;

/// The intervals of `figures`, which are `N` numbers made of the same resample.
///
/// `cases[i][arm]` are the repetitions of case i under each of the arms that enter the figures together;
/// `figures` gets the resampled repetitions of each arm. `None` for fewer than two cases, and for a figure
/// that is undefined in more than one resample of twenty.
pub(super) fn intervals<T: Copy, const N: usize>(
    cases: &[Vec<Vec<T>>],
    figures: impl Fn(&[Vec<T>]) -> [Option<f64>; N],
) -> [Option<Interval>; N] {
    let mut found: [Vec<f64>; N] = std::array::from_fn(|_| Vec::with_capacity(RESAMPLES));
    let Some(arms) = cases.first().map(Vec::len).filter(|_| cases.len() > 1) else {
        return [None; N];
    };
    let mut draws = ChaCha8Rng::seed_from_u64(SEED);
    // Multiplying instead of dividing: biased by less than one in ten million for any log there can be.
    let mut draw = |below: usize| ((u64::from(draws.next_u32()) * below as u64) >> 32) as usize;
    let mut drawn: Vec<Vec<T>> = vec![Vec::new(); arms];
    for _ in 0..RESAMPLES {
        drawn.iter_mut().for_each(Vec::clear);
        for _ in cases {
            let case = &cases[draw(cases.len())];
            for (repetitions, drawn) in case.iter().zip(&mut drawn) {
                drawn.extend(repetitions.iter().map(|_| repetitions[draw(repetitions.len())]));
            }
        }
        for (value, found) in figures(&drawn).into_iter().zip(&mut found) {
            found.extend(value);
        }
    }
    found.map(|mut values| {
        values.sort_by(f64::total_cmp);
        let enough = values.len() * 20 >= RESAMPLES * 19;
        enough
            .then(|| Interval { low: percentile(&values, 0.025), high: percentile(&values, 0.975) })
    })
}

/// The value below which `share` of the sorted `values` lie, between neighbours in proportion.
fn percentile(values: &[f64], share: f64) -> f64 {
    let place = share * (values.len() - 1) as f64;
    let (below, part) = (place.floor() as usize, place.fract());
    let above = (below + 1).min(values.len() - 1);
    values[below] + (values[above] - values[below]) * part
}

#[cfg(test)]
mod tests {
    use super::*;

    fn means(drawn: &[Vec<f64>]) -> [Option<f64>; 1] {
        let values = &drawn[0];
        [Some(values.iter().sum::<f64>() / values.len() as f64)]
    }

    fn single(cases: &[Vec<f64>]) -> Option<Interval> {
        let cases: Vec<_> = cases.iter().map(|runs| vec![runs.clone()]).collect();
        intervals(&cases, means)[0]
    }

    #[test]
    fn percentiles_by_hand() {
        // Places 0.1 and 3.9 of five values: a tenth of the way from 0 to 10, and from 30 nine tenths to 40.
        let values = [0.0, 10.0, 20.0, 30.0, 40.0];
        assert!((percentile(&values, 0.025) - 1.0).abs() < 1e-9);
        assert!((percentile(&values, 0.975) - 39.0).abs() < 1e-9);
    }

    #[test]
    fn a_rate_of_a_half_over_a_hundred_cases_is_known_to_about_ten_points() {
        let cases: Vec<Vec<f64>> = (0..100).map(|case| vec![f64::from(case % 2) * 100.0]).collect();
        let Interval { low, high } = single(&cases).unwrap();
        // The normal approximation: 50 +- 1.96 * sqrt(50 * 50 / 100) = 50 +- 9.8.
        assert!((low - 40.2).abs() < 1.5 && (high - 59.8).abs() < 1.5, "{low} {high}");
        assert_eq!(single(&cases), Some(Interval { low, high }), "the same each time");
    }

    #[test]
    fn runs_vary_within_cases_and_certainty_has_no_width() {
        // All cases alike: only the repetitions vary.
        let Interval { low, high } = single(&vec![vec![0.0, 100.0]; 100]).unwrap();
        assert!(low < 50.0 && high > 50.0 && high - low < 20.0, "{low} {high}");
        assert_eq!(single(&vec![vec![100.0]; 9]), Some(Interval { low: 100.0, high: 100.0 }));
        assert_eq!(single(&[vec![0.0, 100.0]]), None, "one case says nothing about others");
        assert_eq!(single(&[]), None);
    }

    #[test]
    fn arms_share_their_cases_and_undefined_stays_undefined() {
        // The second arm is the first plus 10 in every case: their difference is certain.
        let cases: Vec<_> =
            (0..20).map(|i| vec![vec![f64::from(i)], vec![f64::from(i) + 10.0]]).collect();
        let found = intervals(&cases, |arms| {
            let mean = |arm: &[f64]| arm.iter().sum::<f64>() / arm.len() as f64;
            [Some(mean(&arms[1]) - mean(&arms[0])), None]
        });
        let difference = found[0].unwrap();
        assert!((difference.low - 10.0).abs() < 1e-9 && (difference.high - 10.0).abs() < 1e-9);
        assert_eq!(found[1], None);
    }
}
