//! Means and percentages.

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
