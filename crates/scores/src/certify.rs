//! Which cases need memory: those that the policy fails without it and solves with the right content (specification, section 9).

use std::collections::{BTreeMap, BTreeSet};

/// Cases, and those of them that certify that memory matters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct CertifiedCases<K> {
    /// Those with an episode both with working memory and with the oracle.
    pub(super) all: BTreeSet<K>,
    /// Those of which most episodes fail with working memory, and most succeed with the oracle.
    pub(super) certified: BTreeSet<K>,
}

impl<K: Ord + Copy> CertifiedCases<K> {
    /// Certifies cases by their success rates in percent, without memory and with the oracle.
    pub(super) fn of(without: &BTreeMap<K, f64>, oracle: &BTreeMap<K, f64>) -> Self {
        let all: BTreeSet<K> =
            oracle.keys().filter(|case| without.contains_key(*case)).copied().collect();
        let is_certified = |case: &&K| oracle[*case] > 50.0 && without[*case] < 50.0;
        let certified = all.iter().filter(is_certified).copied().collect();
        Self { all, certified }
    }
}
