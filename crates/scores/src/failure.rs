//! Why an episode failed.
//!
//! The kinds of failure are words of the world, in the order of its case book: an episode has the first that applies. Which of
//! the world's own applies is among the facts of the episode; the harness adds those of its own
//! ([`HARNESS_FAILURES`](case_book::HARNESS_FAILURES)), which the case book places among them.

use case_book::{FailureFact, LOOPED, OUT_OF_STEPS, UNREADABLE, WorldFacts};
use run_log::EpisodeRecord;
use serde::Serialize;

/// The failure of `record` in the words of `world`, and the step of the event that the rule of its kind is about; `None` for a
/// success. Since when it failed: [`FailurePoints`](crate::FailurePoints).
pub fn failure_of(record: &EpisodeRecord, world: &WorldFacts) -> Option<FailureFact> {
    if record.is_success() {
        return None;
    }
    let facts = record.shared_facts();
    let of_harness = |kind: &str, step: Option<u32>| {
        step.map(|step| FailureFact { kind: kind.to_owned(), step })
    };
    let applying = [
        of_harness(UNREADABLE, became_unreadable_at(record)),
        of_harness(LOOPED, facts.looped_at),
        facts.failure,
    ];
    let rank = |failure: &FailureFact| world.failure_index(&failure.kind).unwrap_or(usize::MAX);
    let first = applying.into_iter().flatten().min_by_key(rank);
    first.or_else(|| of_harness(OUT_OF_STEPS, Some(record.steps)))
}

/// The step at which half of all answers had no action, if so many had none.
fn became_unreadable_at(record: &EpisodeRecord) -> Option<u32> {
    let answers = record.requests.filter(|&answers| answers > 0)?;
    if record.unread.total() * 2 < answers {
        return None;
    }
    let unread_steps = (1..).zip(record.actions.chars()).filter(|(_, letter)| *letter == '?');
    let step = unread_steps.map(|(step, _)| step).nth(answers.div_ceil(2) as usize - 1);
    Some(step.unwrap_or(record.steps))
}

/// Counts of failures by the name of their kind.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Failures(Vec<(String, usize)>);

impl Failures {
    /// Counts the failures of `records`. Every kind of `world` is among them, in its order.
    pub fn of<'a>(records: impl Iterator<Item = &'a EpisodeRecord>, world: &WorldFacts) -> Self {
        let mut counts: Vec<(String, usize)> =
            world.failures.iter().map(|kind| (kind.name.clone(), 0)).collect();
        for FailureFact { kind, .. } in records.filter_map(|record| failure_of(record, world)) {
            match counts.iter_mut().find(|(known, _)| *known == kind) {
                Some((_, count)) => *count += 1,
                None => counts.push((kind, 1)),
            }
        }
        Self(counts)
    }

    /// Each kind with its count, in the order of the kinds.
    pub fn iter(&self) -> impl Iterator<Item = (&str, usize)> {
        self.0.iter().map(|(kind, count)| (kind.as_str(), *count))
    }

    /// The number of failures.
    pub fn total(&self) -> usize {
        self.0.iter().map(|(_, count)| count).sum()
    }
}

#[cfg(test)]
mod tests {
    use rigs::records::{record, tell, tell_failure, world};
    use run_log::Unread;

    use super::*;

    fn unread(unread: Unread) -> EpisodeRecord {
        EpisodeRecord { unread, ..record("a", false) }
    }

    fn told(kind: &str, step: u32, looped_at: Option<u32>) -> EpisodeRecord {
        let mut record = record("a", false);
        tell_failure(&mut record, kind, step);
        if let Some(step) = looped_at {
            tell(&mut record, "looped_at", step);
        }
        record
    }

    #[test]
    fn the_first_kind_of_the_case_book_that_applies_is_taken() {
        let most = Unread { unreadable: 60, empty: 30, refused: 10, cut_off: 0 };
        let fewer = Unread { refused: 9, ..most };
        let mut answers = unread(Unread { unreadable: 3, empty: 0, refused: 0, cut_off: 0 });
        (answers.actions, answers.steps, answers.requests) = ("f?f??".to_owned(), 5, Some(5));
        let silent = EpisodeRecord { world: [].into_iter().collect(), ..record("a", false) };
        for ((kind, step), record) in [
            // 100 of 200 answers; then 99.
            ((UNREADABLE, 200), unread(most)),
            (("never-saw", 200), unread(fewer)),
            ((UNREADABLE, 5), answers),
            (("blocked", 5), told("blocked", 5, Some(190))),
            ((LOOPED, 190), told("wrong-order", 5, Some(190))),
            (("wrong-order", 5), told("wrong-order", 5, None)),
            (("fell", 4), told("fell", 4, None)),
            ((LOOPED, 190), told("fell", 4, Some(190))),
            ((OUT_OF_STEPS, 200), silent),
        ] {
            let expected = FailureFact { kind: kind.to_owned(), step };
            assert_eq!(failure_of(&record, &world()), Some(expected));
        }
        assert_eq!(failure_of(&record("a", true), &world()), None);
    }

    #[test]
    fn every_failure_is_counted_once() {
        let records = [
            told("no-return", 50, None),
            told("no-return", 50, None),
            told("never-saw", 200, None),
            told("fell", 4, None),
            record("a", true),
        ];
        let failures = Failures::of(records.iter(), &world());
        let some: Vec<_> = failures.iter().filter(|(_, count)| *count > 0).collect();
        assert_eq!(some, [("no-return", 2), ("never-saw", 1), ("fell", 1)]);
        assert_eq!(failures.total(), 4);
    }
}
