//! What memories supplied and what that took, from `timings.jsonl` and the records.

use std::collections::{BTreeMap, BTreeSet};

use domain::MemoryKind;
use serde::Serialize;

use crate::log::{EpisodeTimings, RecallTotals, RunLog};

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
    /// The figures of each memory that answered a request.
    pub fn by_memory(log: &RunLog) -> Vec<(MemoryKind, Self)> {
        let timings: BTreeMap<&str, &EpisodeTimings> =
            log.timings.iter().map(|timings| (timings.key.as_str(), timings)).collect();
        let memories: BTreeSet<MemoryKind> =
            log.episodes.iter().map(|record| record.memory).collect();
        let of = |memory| Some((memory, Self::of(log, memory, &timings)?));
        memories.into_iter().filter_map(of).collect()
    }

    fn of(
        log: &RunLog,
        memory: MemoryKind,
        timings: &BTreeMap<&str, &EpisodeTimings>,
    ) -> Option<Self> {
        let (mut sum, mut recall_ns) = (RecallTotals::default(), 0);
        let (mut items_dropped, mut images_dropped, mut text_dropped) = (0, 0, 0);
        let more = |sum: Option<u64>, more: Option<u64>| {
            more.map_or(sum, |more| Some(sum.unwrap_or(0).saturating_add(more)))
        };
        for record in log.episodes.iter().filter(|record| record.memory == memory) {
            items_dropped = u64::saturating_add(items_dropped, record.memory_items_dropped);
            images_dropped = u64::saturating_add(images_dropped, record.memory_images_dropped);
            text_dropped = u64::saturating_add(text_dropped, record.memory_text_dropped);
            let Some(timings) = timings.get(record.key.as_str()) else { continue };
            let RecallTotals { requests, items, images, text, .. } = timings.recalls;
            if requests == 0 {
                continue;
            }
            sum.requests = sum.requests.saturating_add(requests);
            sum.items = sum.items.saturating_add(items);
            sum.images = sum.images.saturating_add(images);
            sum.text = sum.text.saturating_add(text);
            sum.store_bytes = sum.store_bytes.max(timings.recalls.store_bytes);
            sum.method_ns = more(sum.method_ns, timings.recalls.method_ns);
            sum.answer_ns = more(sum.answer_ns, timings.recalls.answer_ns);
            sum.tokens = more(sum.tokens, timings.recalls.tokens);
            let stages = &timings.stages;
            for ns in [stages.embed, stages.search, stages.assemble] {
                recall_ns = u64::saturating_add(recall_ns, ns);
            }
        }
        let requests = f64::from(sum.requests);
        let us = |ns: u64| ns as f64 / 1000.0 / requests;
        let wire_ns = sum.answer_ns.zip(sum.method_ns).map(|(all, own)| all.saturating_sub(own));
        (sum.requests > 0).then(|| Self {
            requests: sum.requests.into(),
            items_each: sum.items as f64 / requests,
            images_each: sum.images as f64 / requests,
            text_each: sum.text as f64 / requests,
            items_dropped,
            images_dropped,
            text_dropped,
            recall_us: us(recall_ns),
            method_us: sum.method_ns.map(us),
            wire_us: wire_ns.map(us),
            store_bytes: sum.store_bytes,
            tokens_each: sum.tokens.map(|tokens| tokens as f64 / requests),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::testing::{log, record};

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
