//! The demonstrations of a case that a set names, and the order in which demonstrations join banks.

use domain::{DemonstrationKind, Demonstrations, Mixture};

use crate::case::{CaseSet, History};
use crate::draw::Draw;

impl CaseSet {
    /// The `demonstrations` of case number `case`: its own in the order of [`DemonstrationKind`], then its histories of other
    /// cases. Empty if there is no such case, and for a bank of more than [`largest_bank`](Self::largest_bank).
    ///
    /// A bank of N demonstrations holds the first N - 1 of an order of all demonstrations of all cases, which is drawn from the
    /// seed, and the case's original one; the N-th if that is among them. So a larger bank holds the smaller ones, and cases
    /// whose original demonstration comes early have the same bank.
    pub fn histories(&self, case: usize, demonstrations: Demonstrations) -> Vec<History> {
        let Some(listed) = self.cases.get(case) else { return Vec::new() };
        if let Some(size) = demonstrations.bank_size() {
            let own = History { case, kind: DemonstrationKind::Original };
            let mut bank = self.common_bank(size);
            if let (false, Some(last)) = (bank.contains(&own), bank.last_mut()) {
                *last = own;
            }
            return if usize::from(size) > self.largest_bank() { Vec::new() } else { bank };
        }
        let own = demonstrations.own().map(|kind| History { case, kind });
        let others = demonstrations.mixture().map(|mixture| listed.mixed(mixture));
        if demonstrations.take_place_elsewhere() {
            return vec![History { case, kind: DemonstrationKind::Elsewhere }];
        }
        if let Some(route) = demonstrations.reference() {
            return vec![History { case, kind: DemonstrationKind::reference(route) }];
        }
        if let Some(count) = demonstrations.wrong() {
            return listed.mixed(Mixture::Irrelevant)[..count].to_vec();
        }
        let after = demonstrations
            .take_place_after()
            .then_some(History { case, kind: DemonstrationKind::After });
        let mut found: Vec<History> =
            own.chain(others.into_iter().flatten()).chain(after).collect();
        if demonstrations == Demonstrations::AFTER_BEFORE {
            found.reverse();
        }
        found
    }

    /// The first `size` of the order of banks: what the bank of each case holds whose original demonstration is among them.
    pub fn common_bank(&self, size: u16) -> Vec<History> {
        let mut order = self.bank_order();
        order.truncate(size.into());
        order
    }

    /// The size of the largest bank: all demonstrations that the cases have.
    pub fn largest_bank(&self) -> usize {
        DemonstrationKind::OWN.len() * self.cases.len()
    }

    /// The demonstrations of all cases in the order in which they join banks, drawn from the seed.
    pub(crate) fn bank_order(&self) -> Vec<History> {
        let of = |case| DemonstrationKind::OWN.map(|kind| History { case, kind });
        let all = (0..self.cases.len()).flat_map(of).collect();
        Draw::new(self.seed, BANK_STREAM).shuffled(all)
    }
}

/// Marks the draws of [`CaseSet::bank_order`].
const BANK_STREAM: u64 = 3 << 56;

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn a_mixed_set_keeps_original_and_opposite() {
        let set = CaseSet::shipped();
        let own = |kind| History { case: 7, kind };
        let histories = |demonstrations| set.histories(7, demonstrations);
        assert_eq!(histories(Demonstrations::NONE), []);
        assert_eq!(histories(Demonstrations::ALL), DemonstrationKind::OWN.map(own));
        let [first, second] = set.cases[7].irrelevant;
        assert_eq!(
            histories(Demonstrations::IRRELEVANT),
            [own(DemonstrationKind::Original), own(DemonstrationKind::Opposite), first, second]
        );
        let [first, second] = set.cases[7].confusable;
        assert_eq!(
            histories(Demonstrations::CONFUSABLE),
            [own(DemonstrationKind::Original), own(DemonstrationKind::Opposite), first, second]
        );
        assert_eq!(set.histories(set.cases.len(), Demonstrations::ALL), []);
        let after = own(DemonstrationKind::After);
        assert_eq!(histories(Demonstrations::AFTER), [after]);
        assert_eq!(histories(Demonstrations::ELSEWHERE), [own(DemonstrationKind::Elsewhere)]);
        assert_eq!(
            histories(Demonstrations::BEFORE_AFTER),
            [own(DemonstrationKind::Original), after]
        );
        assert_eq!(
            histories(Demonstrations::AFTER_BEFORE),
            [after, own(DemonstrationKind::Original)]
        );
    }

    #[test]
    fn a_bank_begins_with_the_smaller_ones_and_holds_the_same_others_for_all_cases() {
        let set = CaseSet::shipped();
        let bank = |case, size| set.histories(case, Demonstrations::bank(size));
        let all: HashSet<History> = bank(0, 400).into_iter().collect();
        assert_eq!(all.len(), 400);
        let mut small = HashSet::new();
        for case in 0..set.cases.len() {
            assert_eq!(bank(case, 400), bank(0, 400));
            let mut smaller = HashSet::new();
            for size in [1, 4, 16, 64, 256, 400] {
                let of: HashSet<History> = bank(case, size).into_iter().collect();
                assert_eq!(of.len(), usize::from(size));
                assert!(of.contains(&History { case, kind: DemonstrationKind::Original }));
                assert!(smaller.is_subset(&of) && of.is_subset(&all));
                assert_eq!(bank(case, size)[..usize::from(size) - 1], set.common_bank(size - 1));
                smaller = of;
            }
            small.extend(bank(case, 16));
        }
        assert_eq!(bank(0, 401), []);
        // Every case's own, and the first fifteen or sixteen of the order.
        assert!((100..=116).contains(&small.len()), "{}", small.len());
    }
}
