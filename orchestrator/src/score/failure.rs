//! Why an episode failed, from its record alone.

use serde::Serialize;

use crate::log::EpisodeRecord;
use crate::names::named;

named! {
    /// Why an episode failed: the first of these that applies, in this order.
    Failure, "kind of failure" {
        /// Nothing else applies.
        Other = "other",
    }
}

impl Failure {
    /// Why `record` failed; `None` when it did not.
    pub fn of(record: &EpisodeRecord) -> Option<Self> {
        (!record.is_success()).then_some(Self::Other)
    }
}

/// How many failures there are of each kind.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Failures(Vec<(Failure, usize)>);

impl Failures {
    /// Of `records`.
    pub fn of<'a>(records: impl Iterator<Item = &'a EpisodeRecord>) -> Self {
        let mut counts: Vec<(Failure, usize)> =
            Failure::ALL.iter().map(|&failure| (failure, 0)).collect();
        for failure in records.filter_map(Failure::of) {
            counts
                .iter_mut()
                .filter(|(kind, _)| *kind == failure)
                .for_each(|(_, count)| *count += 1);
        }
        Self(counts)
    }

    /// Each kind with its count, in the order of the kinds.
    pub fn iter(&self) -> impl Iterator<Item = (Failure, usize)> {
        self.0.iter().copied()
    }

    /// All of them.
    pub fn total(&self) -> usize {
        self.0.iter().map(|(_, count)| count).sum()
    }
}
