//! The world variants in which the episodes of a case take place, outside of streams.

use domain::Mismatch;

/// Bits of a variant's number below those of its mismatch.
const MISMATCH_SHIFT: u32 = 24;

/// Maximum number of cases and world states, so that every variant has a number.
pub(crate) const MAX_VARIANTS: usize = 1 << (MISMATCH_SHIFT - 1);

/// A world variant of a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct CaseVariant {
    /// The index of the case.
    pub case: u32,
    /// Whether its way is blocked.
    pub is_blocked: bool,
    /// What differs from the demonstrations beside that.
    pub mismatch: Mismatch,
}

impl CaseVariant {
    /// Its number on the wire: 0 for the unchanged world, 1 + case where the way of the case is blocked. One with a mismatch that
    /// changes the world is of a single case: code of the mismatch << 24 | case << 1 | whether the way is blocked.
    pub const fn number(self) -> u32 {
        let Self { case, is_blocked, mismatch } = self;
        match (mismatch.changes_world(), is_blocked) {
            (true, _) => (mismatch as u32) << MISMATCH_SHIFT | case << 1 | is_blocked as u32,
            (false, true) => 1 + case,
            (false, false) => 0,
        }
    }

    /// The variant with a mismatch that has this number; `None` if this is no such number.
    pub fn with_mismatch(number: u32) -> Option<Self> {
        let code = (number >> MISMATCH_SHIFT) as usize;
        let mismatch = Mismatch::ALL.get(code).copied().filter(|mismatch| mismatch.changes_world());
        let of_case = number & ((1 << MISMATCH_SHIFT) - 1);
        let (case, is_blocked) = (of_case >> 1, of_case & 1 == 1);
        mismatch.map(|mismatch| Self { case, is_blocked, mismatch })
    }

    /// The number of the variant with this number without its mismatch, if it has one.
    pub fn without_mismatch(number: u32) -> u32 {
        Self::with_mismatch(number)
            .map_or(number, |of| Self { mismatch: Mismatch::None, ..of }.number())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ELSEWHERE_VARIANT, GREY_VARIANT};

    #[test]
    fn a_variant_with_a_mismatch_is_found_by_its_number() {
        let mut numbers = Vec::new();
        for &mismatch in Mismatch::ALL {
            for (case, is_blocked) in [(0, false), (0, true), (77, false), (77, true)] {
                let variant = CaseVariant { case, is_blocked, mismatch };
                let without = if is_blocked { 1 + case } else { 0 };
                assert_eq!(CaseVariant::without_mismatch(variant.number()), without);
                let read_back = CaseVariant::with_mismatch(variant.number());
                assert_eq!(read_back, mismatch.changes_world().then_some(variant));
                numbers.extend(read_back.map(CaseVariant::number));
            }
        }
        let count = numbers.len();
        numbers.sort_unstable();
        numbers.dedup();
        assert_eq!((numbers.len(), count), (20, 20));
        for other in [0, 1, 700, ELSEWHERE_VARIANT, GREY_VARIANT] {
            assert_eq!(CaseVariant::with_mismatch(other), None);
            assert_eq!(CaseVariant::without_mismatch(other), other);
        }
        let light = CaseVariant { case: 7, is_blocked: true, mismatch: Mismatch::Light };
        assert_eq!(light.number(), 0x0100_000f);
        let words = CaseVariant { mismatch: Mismatch::Wording, ..light };
        assert_eq!(words.number(), 8, "other words are no other world");
    }
}
