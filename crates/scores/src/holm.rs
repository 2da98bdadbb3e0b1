//! Several comparisons made together: p corrected so that all of them find a difference where there is none in at most 5 % of
//! such families.
//!
//! S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6, 1979. It needs no
//! assumption about how the comparisons depend on each other; those with the same baseline do.

use super::sign_test::is_shown;

/// The corrected p of each: with the m values in ascending order, `max over j <= i of (m - j + 1) p_j`, at most 1.
pub fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|&a, &b| p[a].total_cmp(&p[b]));
    let mut corrected = vec![1.0; p.len()];
    let mut largest: f64 = 0.0;
    for (place, index) in order.into_iter().enumerate() {
        largest = largest.max((p.len() - place) as f64 * p[index]).min(1.0);
        corrected[index] = largest;
    }
    corrected
}

/// By what the correction multiplies each p to decide whether its difference is shown: the number of comparisons less those of
/// the others that are shown without it. So it is shown where p times this is below 5 %, which is where the corrected p is.
pub(super) fn factors(p: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|&a, &b| p[a].total_cmp(&p[b]));
    let shown_without = |own: usize| {
        let others = order.iter().filter(|index| **index != own).enumerate();
        others.take_while(|(place, index)| is_shown(p[**index], p.len() - place)).count()
    };
    (0..p.len()).map(|own| p.len() - shown_without(own)).collect()
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;
    use crate::sign_test::LEVEL;

    #[test]
    fn holm_by_hand() {
        // In order 0.01, 0.02, 0.03, 0.04: 4 x 0.01, 3 x 0.02, then 2 x 0.03 and 1 x 0.04, which may not fall below.
        let found = holm(&[0.04, 0.01, 0.03, 0.02]);
        let expected = [0.06, 0.04, 0.06, 0.06];
        assert!(
            found.iter().zip(expected).all(|(found, p)| (found - p).abs() < 1e-12),
            "{found:?}"
        );
        assert_eq!(holm(&[0.4, 0.9]), [0.8, 0.9]);
        assert_eq!((holm(&[0.03]), holm(&[])), (vec![0.03], vec![]));
        // 0.01 is shown at 4 p; without it none is, and it leaves 3 for the others.
        assert_eq!(factors(&[0.04, 0.01, 0.03, 0.02]), [3, 4, 3, 3]);
    }

    #[test]
    fn a_difference_is_shown_where_the_corrected_p_is_below_the_level() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..2000 {
            let count = 1 + random.next_u32() % 12;
            let draw = |_| (f64::from(random.next_u32()) / f64::from(u32::MAX)).powi(4);
            let p: Vec<f64> = (0..count).map(draw).collect();
            let shown = holm(&p).into_iter().map(|corrected| corrected < LEVEL);
            let by_factor = factors(&p).into_iter().zip(&p).map(|(factor, p)| is_shown(*p, factor));
            assert!(shown.eq(by_factor), "{p:?}");
        }
    }
}
