//! Embeddings, and the distance between two of them.

use std::sync::Arc;

/// Identifies an image's content: the first 16 bytes of BLAKE3 over its RGBA bytes.
pub type ContentHash = [u8; 16];

/// An encoder's vector for an image, scaled to length 1. Cheap to clone.
#[derive(Debug, Clone, PartialEq)]
pub struct Embedding(Arc<[f32]>);

impl Embedding {
    /// Scales `raw` to length 1. `None` when it is all zeros or not finite.
    pub fn normalised(raw: &[f32]) -> Option<Self> {
        let squared: f64 = raw.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
        let length = squared.sqrt();
        let scaled = || raw.iter().map(|&x| (f64::from(x) / length) as f32).collect();
        (length.is_finite() && length > 0.0).then(|| Self(scaled()))
    }

    /// Restores a vector that [`Self::normalised`] returned, bit for bit. `None` when its length is not 1.
    pub fn restored(values: Vec<f32>) -> Option<Self> {
        let squared: f64 = values.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
        ((squared - 1.0).abs() < 1e-4).then(|| Self(values.into()))
    }

    /// The numbers.
    pub fn as_slice(&self) -> &[f32] {
        &self.0
    }
}

/// The cosine distance, 1 - cos, of two vectors of length 1 and equal dimension: 0 to 2.
///
/// Computed as half the squared length of the difference. For unit vectors that is the same quantity, but exactly 0
/// for equal vectors and precise for nearly equal ones, where `1 - a.b` loses its digits to rounding. The order of the
/// sum is fixed (16 partial sums, added pairwise), so every machine computes the same bits.
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

/// The number of partial sums.
pub(crate) const LANES: usize = 16;

/// Adds squared differences to the partial sums.
#[inline(always)]
pub(crate) fn add_squares(sums: &mut [f32; LANES], a: &[f32; LANES], b: &[f32; LANES]) {
    for lane in 0..LANES {
        let difference = a[lane] - b[lane];
        sums[lane] += difference * difference;
    }
}

/// Half of the partial sums' sum, added pairwise.
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
    fn a_vector_without_direction_is_no_embedding() {
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
