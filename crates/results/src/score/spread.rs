//! A figure over runs: mean, standard deviation, interval.

use serde::Serialize;

use super::interval::Interval;

/// A figure computed for each run by itself, over the runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Its mean over the runs that have it.
    pub mean: f64,
    /// Its sample standard deviation over them (n - 1 in the denominator); `None` for one run.
    pub std: Option<f64>,
    /// Number of runs that have it: fewer than the condition's runs where the figure is undefined in some.
    pub runs: u32,
    /// The 95 % interval of the mean, where one is computed.
    pub interval: Option<Interval>,
}

impl Spread {
    /// Mean and sample standard deviation of `values`, one a run; `None` of none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mean = mean(values.iter().copied())?;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let std = (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt());
        Some(Self { mean, std, runs: values.len() as u32, interval: None })
    }

    /// Sets the interval.
    pub(super) fn within(self, interval: Option<Interval>) -> Self {
        Self { interval, ..self }
    }
}

/// Returns the mean; `None` of no values.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// Returns the mean of values with their weights; `None` where these are none, or 0.
pub(super) fn weighted_mean(values: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let add = |(sum, weights), (value, weight)| (sum + value * weight, weights + weight);
    let (sum, weights) = values.fold((0.0, 0.0), add);
    (weights > 0.0).then(|| sum / weights)
}

/// Returns the percentage of true values; `None` of no values.
pub(super) fn percentage(values: impl Iterator<Item = bool>) -> Option<f64> {
    mean(values.map(|value| if value { 100.0 } else { 0.0 }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_sample_deviation_by_hand() {
        assert_eq!(Spread::of(&[]), None);
        let one = Spread::of(&[4.0]).unwrap();
        assert_eq!((one.mean, one.std, one.runs), (4.0, None, 1));
        // Mean 4; squares 4 + 0 + 4 = 8; 8 / (3 - 1) = 4; root 2.
        let three = Spread::of(&[2.0, 4.0, 6.0]).unwrap();
        assert_eq!((three.mean, three.std, three.runs), (4.0, Some(2.0), 3));
    }
}
