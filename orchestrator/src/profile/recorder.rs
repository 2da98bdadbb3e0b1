//! Splits every step's access to memory into its parts, while episodes run.
//!
//! Recording a step allocates nothing, except for the first step with a memory.

use std::collections::BTreeMap;

use anyhow::Result;
use domain::MemoryKind;
use domain::names::named;
use hdrhistogram::Histogram;
use run_log::latency::LatencySummary;
use serde::{Deserialize, Serialize};

use crate::lanes::{FinishedEpisode, Stamps};
use crate::latency::{histogram, summarize};
use crate::pipeline::Observer;

/// Significant decimal digits of a recorded time.
const DIGITS: u8 = 3;

named! {
    /// A part of an access.
    AccessPart, "part" {
        /// From the simulator to memory, and from memory to the policy; to an external memory and back, too.
        Wire = "wire",
        /// Computing embeddings, or finding them in the cache.
        Embedding = "embedding",
        /// Finding the nearest view; what an external memory computes.
        Search = "search",
        /// Assembling the recall.
        Assembly = "assembly",
        /// All parts together.
        Total = "total",
    }
}

named! {
    /// A class of steps of an episode.
    StepClass, "step" {
        /// The first: the episode's memory is built before it is answered.
        First = "first",
        /// Any other.
        Later = "later",
    }
}

/// The latency of one part of the accesses to one memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AccessLatency {
    /// The memory.
    pub memory: MemoryKind,
    /// The steps.
    pub step: StepClass,
    /// The part.
    pub part: AccessPart,
    /// The latency.
    #[serde(flatten)]
    pub times: LatencySummary,
}

/// Histograms of the parts, in the order of [`AccessPart::ALL`].
type PartHistograms = [Histogram<u64>; AccessPart::ALL.len()];

/// The parts of one access; `None` where the expert decided, or stamps are out of order.
fn parts(stamps: &Stamps) -> Option<[u64; AccessPart::ALL.len()]> {
    let Stamps { published_ns, received_ns, embedded_ns, searched_ns, .. } = *stamps;
    let Stamps { assembled_ns, joined_ns, method_ns, memory, .. } = *stamps;
    let times = [published_ns, received_ns, embedded_ns, searched_ns, assembled_ns, joined_ns];
    if published_ns == 0 || !times.is_sorted() {
        return None;
    }
    let searched = searched_ns - embedded_ns;
    let search = if memory.external().is_some() { method_ns.min(searched) } else { searched };
    Some([
        (received_ns - published_ns) + (joined_ns - assembled_ns) + (searched - search),
        embedded_ns - received_ns,
        search,
        assembled_ns - searched_ns,
        joined_ns - published_ns,
    ])
}

/// An [`Observer`] that records the latency of accesses, and nothing else.
#[derive(Debug, Default)]
pub struct AccessRecorder {
    /// By memory and by class of steps.
    histograms: BTreeMap<MemoryKind, [PartHistograms; 2]>,
    /// Finished episodes.
    pub episodes: u32,
    /// Steps.
    pub steps: u64,
    /// Steps whose stamps are out of order.
    pub unordered: u64,
    began_ns: u64,
    ended_ns: u64,
    /// Problems that occurred.
    pub problems: Vec<String>,
}

impl AccessRecorder {
    /// Records one step.
    pub fn record(&mut self, stamps: &Stamps) {
        self.steps += 1;
        if self.began_ns == 0 {
            self.began_ns = stamps.commanded_ns;
        }
        self.ended_ns = self.ended_ns.max(stamps.decided_ns);
        let Some(times) = parts(stamps) else {
            self.unordered += 1;
            return;
        };
        let new = || std::array::from_fn(|_| std::array::from_fn(|_| histogram(DIGITS)));
        let classes = self.histograms.entry(stamps.memory).or_insert_with(new);
        for (part, time) in classes[usize::from(stamps.step > 0)].iter_mut().zip(times) {
            part.saturating_record(time);
        }
    }

    /// Seconds from the first command to the last decision.
    pub fn seconds(&self) -> f64 {
        self.ended_ns.saturating_sub(self.began_ns) as f64 / 1e9
    }

    /// The latencies of all accesses that occurred.
    pub fn latencies(&self) -> Vec<AccessLatency> {
        let mut latencies = Vec::new();
        for (&memory, classes) in &self.histograms {
            for (&step, parts) in StepClass::ALL.iter().zip(classes) {
                let parts = AccessPart::ALL.iter().zip(parts);
                latencies.extend(parts.filter(|(_, times)| !times.is_empty()).map(
                    |(&part, times)| AccessLatency { memory, step, part, times: summarize(times) },
                ));
            }
        }
        latencies
    }
}

impl Observer for AccessRecorder {
    fn finished(&mut self, _finished: &FinishedEpisode, _attempt: u32) -> Result<()> {
        self.episodes += 1;
        Ok(())
    }

    fn stepped(&mut self, stamps: &Stamps) -> Result<()> {
        self.record(stamps);
        Ok(())
    }

    fn problem(&mut self, what: &str) {
        self.problems.push(what.to_owned());
    }
}

#[cfg(test)]
mod tests {
    use domain::Representation;

    use super::*;

    /// The stamps of a step.
    fn stamps(step: u32, memory: Representation, times: [u64; 6]) -> Stamps {
        let [published_ns, received_ns, embedded_ns, searched_ns, assembled_ns, joined_ns] = times;
        Stamps {
            step,
            commanded_ns: 5,
            published_ns,
            received_ns,
            embedded_ns,
            searched_ns,
            assembled_ns,
            joined_ns,
            decided_ns: joined_ns + 5,
            ..Stamps::new(1, 0, memory.into())
        }
    }

    #[test]
    fn the_parts_of_an_access_add_up() {
        let mut recorder = AccessRecorder::default();
        recorder.record(&stamps(0, Representation::Episodic, [10, 20, 120, 150, 155, 175]));
        recorder.record(&stamps(1, Representation::Episodic, [10, 20, 20, 50, 55, 75]));
        recorder.record(&stamps(1, Representation::Working, [10, 5, 20, 50, 55, 75]));
        recorder.record(&stamps(1, Representation::Working, [0; 6]));
        assert_eq!((recorder.steps, recorder.unordered), (4, 2));
        let latencies = recorder.latencies();
        let p50s = |step| -> Vec<u64> {
            latencies
                .iter()
                .filter(|found| found.step == step)
                .map(|found| (found.times.p50_us * 1000.0).round() as u64)
                .collect()
        };
        assert_eq!(p50s(StepClass::First), [30, 100, 30, 5, 165]);
        assert_eq!(p50s(StepClass::Later), [30, 0, 30, 5, 65]);
        assert!(latencies.iter().all(|found| found.memory == Representation::Episodic));
        assert_eq!(recorder.seconds(), 175e-9);
    }
}
