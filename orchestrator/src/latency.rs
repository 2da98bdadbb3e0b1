//! Latencies of the stages of steps, as histograms.
//!
//! Recording a step allocates nothing, except for the first step with a memory.

use domain::{ExternalName, MemoryKind};
use hdrhistogram::Histogram;
use results::latency::{LatencyRecord, LatencySummary};
use results::log::Stages;

use crate::lanes::Stamps;
use crate::status::MemoryStatus;

/// The longest time that is recorded, in nanoseconds: an hour.
const LONGEST_NS: u64 = 3_600_000_000_000;

/// Significant decimal digits of a recorded time.
const DIGITS: u8 = 2;

const STAGES: usize = Stages::NAMES.len();

/// Histograms of every stage, and of whole steps, by memory.
#[derive(Debug, Default)]
pub struct StepLatencies {
    memories: Vec<(MemoryKind, StageHistograms)>,
}

/// The histograms of one memory.
#[derive(Debug)]
struct StageHistograms {
    stages: [Histogram<u64>; STAGES],
    step: Histogram<u64>,
}

impl StepLatencies {
    /// Adds a step.
    pub fn record(&mut self, stamps: &Stamps) {
        let memory = self.of(stamps.memory);
        let values = stamps.stages().values();
        let mut sum = 0_u64;
        for (histogram, value) in memory.stages.iter_mut().zip(values) {
            histogram.saturating_record(value);
            // A policy may send any stamps.
            sum = sum.saturating_add(value);
        }
        memory.step.saturating_record(sum);
    }

    /// Whether nothing was recorded.
    pub fn is_empty(&self) -> bool {
        self.memories.is_empty()
    }

    /// Adds what `other` recorded.
    pub fn add(&mut self, other: &Self) {
        for (memory, theirs) in &other.memories {
            let ours = self.of(*memory);
            let pairs = ours.stages.iter_mut().zip(&theirs.stages);
            for (ours, theirs) in pairs.chain([(&mut ours.step, &theirs.step)]) {
                if let Err(impossible) = ours.add(theirs) {
                    unreachable!("all histograms have the same bounds: {impossible}");
                }
            }
        }
    }

    /// Removes everything that was recorded, and keeps the allocations.
    pub fn clear(&mut self) {
        for (_, memory) in &mut self.memories {
            memory.stages.iter_mut().chain([&mut memory.step]).for_each(Histogram::reset);
        }
    }

    /// Every stage of every memory, and `step` for all stages together, in order.
    pub fn summaries(
        &self,
    ) -> impl Iterator<Item = (MemoryKind, &'static str, LatencySummary)> + '_ {
        self.memories.iter().filter(|(_, memory)| !memory.step.is_empty()).flat_map(
            |(memory, histograms)| {
                let stages = Stages::NAMES.into_iter().zip(&histograms.stages);
                stages
                    .chain([("step", &histograms.step)])
                    .map(|(stage, histogram)| (*memory, stage, summarize(histogram)))
            },
        )
    }

    /// The lines of `latency.jsonl` for `session`.
    pub fn records(&self, session: u32) -> impl Iterator<Item = LatencyRecord> + '_ {
        self.summaries().map(move |(memory, stage, summary)| LatencyRecord {
            session,
            memory,
            stage: stage.to_owned(),
            summary,
        })
    }

    fn of(&mut self, memory: MemoryKind) -> &mut StageHistograms {
        let at = self.memories.iter().position(|(known, _)| *known == memory);
        let at = at.unwrap_or_else(|| {
            self.memories.push((memory, StageHistograms::new()));
            self.memories.len() - 1
        });
        &mut self.memories[at].1
    }
}

/// Histograms of the recalls of external memories, apart from what they compute.
#[derive(Debug, Default)]
pub struct RecallLatencies {
    memories: Vec<(ExternalName, RecallHistograms)>,
}

#[derive(Debug)]
struct RecallHistograms {
    recall: Histogram<u64>,
    method: Histogram<u64>,
    wire: Histogram<u64>,
}

impl RecallLatencies {
    /// Adds a step, if its memory is an external one.
    pub fn record(&mut self, stamps: &Stamps) {
        let MemoryKind::External(name) = stamps.memory else { return };
        let at = self.memories.iter().position(|(known, _)| *known == name);
        let at = at.unwrap_or_else(|| {
            let [recall, method, wire] = std::array::from_fn(|_| histogram(DIGITS));
            self.memories.push((name, RecallHistograms { recall, method, wire }));
            self.memories.len() - 1
        });
        let Stamps { received_ns, embedded_ns, searched_ns, recalled_ns, method_ns, .. } = *stamps;
        let histograms = &mut self.memories[at].1;
        histograms.recall.saturating_record(recalled_ns.saturating_sub(received_ns));
        histograms.method.saturating_record(method_ns);
        let answer_ns = searched_ns.saturating_sub(embedded_ns);
        histograms.wire.saturating_record(answer_ns.saturating_sub(method_ns));
    }

    /// The status of the memory called `name`, which is in `state`.
    pub fn status(&self, name: ExternalName, state: &str) -> MemoryStatus {
        let of = |histogram: fn(&RecallHistograms) -> &Histogram<u64>| {
            let (_, found) = self.memories.iter().find(|(known, _)| *known == name)?;
            Some(histogram(found)).filter(|times| !times.is_empty()).map(summarize)
        };
        MemoryStatus {
            name,
            state: state.to_owned(),
            recall: of(|found| &found.recall),
            method: of(|found| &found.method),
            wire: of(|found| &found.wire),
        }
    }

    /// Removes everything that was recorded, and keeps the allocations.
    pub fn clear(&mut self) {
        for (_, RecallHistograms { recall, method, wire }) in &mut self.memories {
            [recall, method, wire].into_iter().for_each(Histogram::reset);
        }
    }
}

impl StageHistograms {
    fn new() -> Self {
        Self { stages: std::array::from_fn(|_| histogram(DIGITS)), step: histogram(DIGITS) }
    }
}

/// An empty histogram of times in nanoseconds, to so many significant decimal digits (at most 5).
pub fn histogram(digits: u8) -> Histogram<u64> {
    match Histogram::new_with_bounds(1, LONGEST_NS, digits) {
        Ok(histogram) => histogram,
        Err(impossible) => unreachable!("the bounds are valid constants: {impossible}"),
    }
}

/// Summarizes a histogram of nanoseconds.
pub fn summarize(histogram: &Histogram<u64>) -> LatencySummary {
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
        assert!(latency.is_empty());
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
        assert!(!latency.is_empty());
    }
}
