//! What an encoder makes of an image: a direction, and how far two of them are apart.

use std::sync::Arc;

/// An image's content: the first 16 bytes of BLAKE3 over its RGBA bytes, as the frame store computes it.
pub type ContentHash = [u8; 16];

/// A vector of length 1, cheap to hand around.
#[derive(Debug, Clone, PartialEq)]
pub struct Embedding(Arc<[f32]>);

impl Embedding {
    /// Scales `raw` to length 1. `None` when it has no direction: all zeros, or not finite.
    pub fn normalised(raw: &[f32]) -> Option<Self> {
        let squared: f64 = raw.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
        let length = squared.sqrt();
        let scaled = || raw.iter().map(|&x| (f64::from(x) / length) as f32).collect();
        (length.is_finite() && length > 0.0).then(|| Self(scaled()))
    }

    /// Takes a vector that [`Self::normalised`] made earlier, bit for bit. `None` when it cannot be one.
    pub fn restored(values: Vec<f32>) -> Option<Self> {
        let squared: f64 = values.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
        ((squared - 1.0).abs() < 1e-4).then(|| Self(values.into()))
    }

    /// The numbers.
    pub fn as_slice(&self) -> &[f32] {
        &self.0
    }
}

/// The cosine distance, 1 - cos, of two vectors of length 1 and of equal dimension: 0 to 2.
///
/// Computed as half the squared length of their difference, which is the same quantity for unit
/// vectors but exactly 0 for equal ones and precise for nearly equal ones, where `1 - a.b` would drown in
/// rounding. The order of the sum is fixed (16 partial sums, then pairwise), so it is the same on every
/// machine, and the compiler turns it into vector code.
pub fn distance(a: &[f32], b: &[f32]) -> f32 {
    debug_assert_eq!(a.len(), b.len());
    let mut sums = [0.0_f32; LANES];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        add_squares(&mut sums, a, b);
    }
    for ((sum, a), b) in sums.iter_mut().zip(a_rest).zip(b_rest) {
        let difference = a - b;
        *sum += difference * difference;
    }
    half_total(sums)
}

/// Partial sums of a distance.
pub(crate) const LANES: usize = 16;

/// Adds the squares of the differences to the partial sums.
#[inline(always)]
pub(crate) fn add_squares(sums: &mut [f32; LANES], a: &[f32; LANES], b: &[f32; LANES]) {
    for lane in 0..LANES {
        let difference = a[lane] - b[lane];
        sums[lane] += difference * difference;
    }
}

/// Half the sum of the partial sums, added pairwise.
#[inline(always)]
pub(crate) fn half_total(mut sums: [f32; LANES]) -> f32 {
    let mut width = LANES / 2;
    while width > 0 {
        for lane in 0..width {
            sums[lane] += sums[lane + width];
        }
        width /= 2;
    }
    0.5 * sums[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(dimension: usize) -> impl Strategy<Value = Embedding> {
        prop::collection::vec(-1.0_f32..1.0, dimension)
            .prop_filter_map("no direction", |raw| Embedding::normalised(&raw))
    }

    proptest! {
        #[test]
        fn distance_is_one_minus_cosine(
            (a, b) in (1_usize..200).prop_flat_map(|n| (vector(n), vector(n)))
        ) {
            let pairs = a.as_slice().iter().zip(b.as_slice());
            let cosine: f64 = pairs.map(|(&x, &y)| f64::from(x) * f64::from(y)).sum();
            prop_assert!((f64::from(distance(a.as_slice(), b.as_slice())) - (1.0 - cosine)).abs() < 1e-5);
            prop_assert_eq!(distance(a.as_slice(), a.as_slice()).to_bits(), 0);
            prop_assert_eq!(
                distance(a.as_slice(), b.as_slice()).to_bits(),
                distance(b.as_slice(), a.as_slice()).to_bits()
            );
        }
    }

    #[test]
    fn what_has_no_direction_is_no_embedding() {
        assert!(Embedding::normalised(&[0.0, 0.0]).is_none());
        assert!(Embedding::normalised(&[f32::NAN, 1.0]).is_none());
        assert!(Embedding::normalised(&[f32::INFINITY, 1.0]).is_none());
        assert!(Embedding::restored(vec![0.5, 0.5]).is_none());
        assert!(Embedding::restored(vec![f32::NAN, 1.0]).is_none());
        let made = Embedding::normalised(&[3.0, 4.0]).unwrap();
        assert_eq!(made.as_slice(), [0.6, 0.8]);
        assert_eq!(Embedding::restored(made.as_slice().to_vec()), Some(made));
    }
}
