//! What memories supplied and what that took, from `timings.jsonl` and the records.

use std::collections::{BTreeMap, BTreeSet};

use domain::{Arm, MemoryKind};
use serde::Serialize;

use run_log::{EpisodeRecord, EpisodeTimings, RecallTotals, RunLog};

/// Figures of the recalls of one memory, over its finished episodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MemoryScore {
    /// Requests that it answered.
    pub requests: u64,
    /// Mean items of an answer.
    pub items_each: f64,
    /// Mean images of an answer.
    pub images_each: f64,
    /// Mean bytes of text of an answer.
    pub text_each: f64,
    /// Items that it wanted to supply and that exceeded its budgets.
    pub items_dropped: u64,
    /// Images in them.
    pub images_dropped: u64,
    /// Bytes of text in them.
    pub text_dropped: u64,
    /// Mean microseconds from the observation to the recall.
    pub recall_us: f64,
    /// Mean microseconds that an external memory computed, by its own clock. Absent for a built-in one.
    pub method_us: Option<f64>,
    /// Mean microseconds of the messages to an external memory and back. Absent for a built-in one.
    pub wire_us: Option<f64>,
    /// The largest size that it told for its store, in bytes. Absent if it told none.
    pub store_bytes: Option<u64>,
    /// Mean tokens of its own requests to a model. Absent if it told none.
    pub tokens_each: Option<f64>,
}

impl MemoryScore {
    /// The figures of each memory that answered a request, outside of streams in the arm `frozen`.
    pub fn by_memory(log: &RunLog) -> Vec<(MemoryKind, Self)> {
        let timings = log.timings_by_key();
        let memories: BTreeSet<MemoryKind> =
            log.episodes.iter().map(|record| record.memory).collect();
        let of = |memory| {
            // Controls supply something else.
            let is_control =
                |record: &EpisodeRecord| record.stream.is_none() && record.arm != Arm::Frozen;
            let of_memory = log.episodes.iter().filter(|record| record.memory == memory);
            let of_memory = of_memory.filter(|record| !is_control(record));
            Some((memory, Self::of(&of_memory.collect::<Vec<_>>(), &timings)?))
        };
        memories.into_iter().filter_map(of).collect()
    }

    fn of(records: &[&EpisodeRecord], timings: &BTreeMap<&str, &EpisodeTimings>) -> Option<Self> {
        let timed = records.iter().filter_map(|record| timings.get(record.key.as_str()));
        let answered: Vec<&EpisodeTimings> =
            timed.copied().filter(|timings| !timings.recalls.is_none()).collect();
        let told = |count: fn(&RecallTotals) -> Option<u64>| {
            let counts = answered.iter().filter_map(|timings| count(&timings.recalls));
            counts.reduce(u64::saturating_add)
        };
        let dropped = |count: fn(&EpisodeRecord) -> u64| {
            records.iter().map(|record| count(record)).fold(0, u64::saturating_add)
        };
        let requests = told(|recalls| Some(recalls.requests.into()))?;
        let each = |sum: u64| sum as f64 / requests as f64;
        let us = |ns: u64| ns as f64 / 1000.0 / requests as f64;
        let (method_ns, answer_ns) = (told(|one| one.method_ns), told(|one| one.answer_ns));
        let recall_ns = answered.iter().map(|timings| timings.stages.recalling());
        Some(Self {
            requests,
            items_each: each(told(|recalls| Some(recalls.items))?),
            images_each: each(told(|recalls| Some(recalls.images))?),
            text_each: each(told(|recalls| Some(recalls.text))?),
            items_dropped: dropped(|record| record.memory_items_dropped),
            images_dropped: dropped(|record| record.memory_images_dropped),
            text_dropped: dropped(|record| record.memory_text_dropped),
            recall_us: us(recall_ns.fold(0, u64::saturating_add)),
            method_us: method_ns.map(us),
            wire_us: answer_ns.zip(method_ns).map(|(all, own)| us(all.saturating_sub(own))),
            store_bytes: answered.iter().filter_map(|timings| timings.recalls.store_bytes).max(),
            tokens_each: told(|recalls| recalls.tokens).map(each),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigs::records::{log, record};

    #[test]
    fn means_are_over_requests_and_what_was_not_told_is_absent() {
        let mut log = log(vec![record("a", true), record("b", true)]);
        assert_eq!(MemoryScore::by_memory(&log), [], "an earlier log");
        for (timings, requests) in log.timings.iter_mut().zip([10, 30]) {
            timings.recalls = RecallTotals {
                requests,
                items: 40,
                images: 280,
                text: 800,
                store_bytes: Some(u64::from(requests)),
                ..RecallTotals::default()
            };
        }
        log.episodes[1].memory_items_dropped = 3;
        let found = MemoryScore::by_memory(&log).remove(0).1;
        assert_eq!((found.requests, found.items_each, found.images_each), (40, 2.0, 14.0));
        assert_eq!((found.text_each, found.items_dropped), (40.0, 3));
        assert_eq!((found.method_us, found.wire_us, found.tokens_each), (None, None, None));
        assert_eq!(found.store_bytes, Some(30));
        // 10 steps of 1 us in each of three stages, twice, over 40 requests.
        assert_eq!(found.recall_us, 1.5);
        log.timings[0].recalls.method_ns = Some(20_000);
        log.timings[0].recalls.answer_ns = Some(100_000);
        let found = MemoryScore::by_memory(&log).remove(0).1;
        assert_eq!((found.method_us, found.wire_us), (Some(0.5), Some(2.0)));
    }
}
