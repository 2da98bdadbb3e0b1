//! Latencies of the stages of steps, as histograms.
//!
//! Recording a step allocates nothing, except for the first step with a memory.

use domain::{ExternalName, MemoryKind};
use hdrhistogram::Histogram;
use run_log::Stages;
use run_log::latency::{LatencyRecord, LatencySummary};

use crate::lanes::Stamps;
use crate::status::MemoryStatus;

/// The longest time that is recorded, in nanoseconds: an hour.
const LONGEST_NS: u64 = 3_600_000_000_000;

/// Significant decimal digits of a recorded time.
const DIGITS: u8 = 2;

const STAGES: usize = Stages::NAMES.len();

/// Histograms of `N` times for each `K`.
#[derive(Debug)]
struct TimesOf<K, const N: usize>(Vec<(K, [Histogram<u64>; N])>);

impl<K, const N: usize> Default for TimesOf<K, N> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<K: PartialEq, const N: usize> TimesOf<K, N> {
    fn of(&mut self, key: K) -> &mut [Histogram<u64>; N] {
        let at = self.0.iter().position(|(known, _)| *known == key);
        let at = at.unwrap_or_else(|| {
            self.0.push((key, std::array::from_fn(|_| histogram(DIGITS))));
            self.0.len() - 1
        });
        &mut self.0[at].1
    }

    fn record(&mut self, key: K, times_ns: [u64; N]) {
        for (histogram, time_ns) in self.of(key).iter_mut().zip(times_ns) {
            histogram.saturating_record(time_ns);
        }
    }

    /// Removes everything that was recorded, and keeps the allocations.
    fn clear(&mut self) {
        self.0.iter_mut().flat_map(|(_, histograms)| histograms).for_each(Histogram::reset);
    }
}

/// Histograms of every stage and, after them, of whole steps, by memory.
#[derive(Debug, Default)]
pub(crate) struct StepLatencies(TimesOf<MemoryKind, { STAGES + 1 }>);

impl StepLatencies {
    /// Adds a step.
    pub(crate) fn record(&mut self, stamps: &Stamps) {
        let stages = stamps.stages().values();
        let mut times = [0; STAGES + 1];
        times[..STAGES].copy_from_slice(&stages);
        // A policy may send any stamps.
        times[STAGES] = stages.into_iter().fold(0, u64::saturating_add);
        self.0.record(stamps.memory, times);
    }

    /// Adds what `other` recorded.
    pub(crate) fn add(&mut self, other: &Self) {
        for (memory, theirs) in &other.0.0 {
            for (ours, theirs) in self.0.of(*memory).iter_mut().zip(theirs) {
                if let Err(impossible) = ours.add(theirs) {
                    unreachable!("all histograms have the same bounds: {impossible}");
                }
            }
        }
    }

    /// Removes everything that was recorded, and keeps the allocations.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    /// Every stage of every memory, and `step` for all stages together, in order.
    pub(crate) fn summaries(
        &self,
    ) -> impl Iterator<Item = (MemoryKind, &'static str, LatencySummary)> + '_ {
        let recorded = self.0.0.iter().filter(|(_, histograms)| !histograms[STAGES].is_empty());
        recorded.flat_map(|(memory, histograms)| {
            let names = Stages::NAMES.into_iter().chain(["step"]);
            names.zip(histograms).map(|(name, times)| (*memory, name, summarize(times)))
        })
    }

    /// The lines of `latency.jsonl` for `session`.
    pub(crate) fn records(&self, session: u32) -> impl Iterator<Item = LatencyRecord> + '_ {
        self.summaries().map(move |(memory, stage, summary)| LatencyRecord {
            session,
            memory,
            stage: stage.to_owned(),
            summary,
        })
    }
}

/// Histograms of the recalls of external memories, of what they compute, and of the messages to them and back.
#[derive(Debug, Default)]
pub(crate) struct RecallLatencies(TimesOf<ExternalName, 3>);

impl RecallLatencies {
    /// Adds a step, if its memory is an external one.
    pub(crate) fn record(&mut self, stamps: &Stamps) {
        let MemoryKind::External(name) = stamps.memory else { return };
        let Stamps { received_ns, embedded_ns, searched_ns, recalled_ns, method_ns, .. } = *stamps;
        let recall_ns = recalled_ns.saturating_sub(received_ns);
        let wire_ns = searched_ns.saturating_sub(embedded_ns).saturating_sub(method_ns);
        self.0.record(name, [recall_ns, method_ns, wire_ns]);
    }

    /// The status of the memory called `name`, which is in `state`.
    pub(crate) fn status(&self, name: ExternalName, state: &str) -> MemoryStatus {
        let found = self.0.0.iter().find(|(known, _)| *known == name);
        let [recall, method, wire] = std::array::from_fn(|time| {
            let times = found.map(|(_, histograms)| &histograms[time]);
            times.filter(|times| !times.is_empty()).map(summarize)
        });
        MemoryStatus { name, state: state.to_owned(), recall, method, wire }
    }

    /// Removes everything that was recorded, and keeps the allocations.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }
}

/// An empty histogram of times in nanoseconds, to so many significant decimal digits (at most 5).
pub(crate) fn histogram(digits: u8) -> Histogram<u64> {
    match Histogram::new_with_bounds(1, LONGEST_NS, digits) {
        Ok(histogram) => histogram,
        Err(impossible) => unreachable!("the bounds are valid constants: {impossible}"),
    }
}

/// Summarizes a histogram of nanoseconds.
pub(crate) fn summarize(histogram: &Histogram<u64>) -> LatencySummary {
    let us = |ns: u64| ns as f64 / 1000.0;
    let quantile = |q| us(histogram.value_at_quantile(q));
    LatencySummary {
        count: histogram.len(),
        mean_us: histogram.mean() / 1000.0,
        p50_us: quantile(0.5),
        p90_us: quantile(0.9),
        p99_us: quantile(0.99),
        p999_us: quantile(0.999),
        max_us: us(histogram.max()),
    }
}

#[cfg(test)]
mod tests {
    use domain::Representation;

    use super::*;

    #[test]
    fn percentiles_are_by_memory_and_stage_and_known_to_one_per_cent() {
        let mut latency = StepLatencies::default();
        assert!(latency.0.0.is_empty());
        for n in 1..=1000 {
            let mut stamps = Stamps::new(1, 0, Representation::Episodic.into());
            (stamps.commanded_ns, stamps.woken_ns) = (1, 1 + n * 1000);
            latency.record(&stamps);
        }
        let of = |latency: &StepLatencies, name: &str| {
            let mut all = latency.summaries();
            all.find(|&(memory, stage, _)| memory == Representation::Episodic && stage == name)
                .map(|(_, _, summary)| summary)
        };
        let command = of(&latency, "command").unwrap();
        assert_eq!(command.count, 1000);
        for (found, expected) in
            [(command.p50_us, 500.0), (command.p99_us, 990.0), (command.max_us, 1000.0)]
        {
            assert!((found / expected - 1.0_f64).abs() < 0.01, "{found} for {expected}");
        }
        assert_eq!(of(&latency, "step").unwrap(), command);
        assert_eq!(of(&latency, "embed").unwrap().max_us, 0.0);
        assert_eq!(latency.records(3).count(), STAGES + 1);
        let mut sum = StepLatencies::default();
        sum.add(&latency);
        sum.add(&latency);
        assert_eq!(of(&sum, "command").unwrap().count, 2000);
        latency.clear();
        assert_eq!(latency.summaries().count(), 0);
    }

    #[test]
    fn any_stamps_of_a_policy_are_added_up() {
        let mut stamps = Stamps::new(1, 0, Representation::Episodic.into());
        (stamps.assembled_ns, stamps.joined_ns) = (1, u64::MAX);
        (stamps.started_ns, stamps.decided_ns) = (1, u64::MAX);
        let mut latency = StepLatencies::default();
        latency.record(&stamps);
        assert!(!latency.0.0.is_empty());
    }
}
