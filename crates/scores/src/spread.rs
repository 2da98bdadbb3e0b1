//! A figure over runs: mean, standard deviation, interval.

use serde::Serialize;

use super::interval::Interval;
use super::mean::mean;

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
