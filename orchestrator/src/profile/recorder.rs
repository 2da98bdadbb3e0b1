//! Takes every step's access to memory apart, while episodes are walked.
//!
//! Nothing is allocated for a step: its parts are counted into histograms that are there from the beginning.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use domain::Representation;
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use shm_types::message::Role;

use crate::lanes::{Spent, Stamps, Walked};
use crate::pipeline::{Facts, Observer};
use results::names::named;

/// Longest time that is told apart: an hour.
const LONGEST_NS: u64 = 3_600_000_000_000;

/// Digits of a time that are kept.
const DIGITS: u8 = 3;

named! {
    /// A part of an access.
    Part, "part" {
        /// From the observation's sending to memory, and from memory to the policy.
        Wire = "wire",
        /// Until the embeddings were there.
        Embedding = "embedding",
        /// Until the nearest view was found.
        Search = "search",
        /// Until the recall was put together.
        Assembly = "assembly",
        /// All of it.
        Total = "total",
    }
}

named! {
    /// Which step of an episode.
    StepKind, "step" {
        /// The first: before it is answered, the episode's memory is built.
        First = "first",
        /// Any other.
        Later = "later",
    }
}

/// How long a part of the accesses to one representation took.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Latency {
    /// Of which.
    pub representation: Representation,
    /// In which steps.
    pub step: StepKind,
    /// Which part.
    pub part: Part,
    /// How long.
    #[serde(flatten)]
    pub times: Times,
}

/// A distribution of times, in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Times {
    /// How many.
    pub count: u64,
    /// Their mean.
    pub mean: f64,
    /// Half took no longer.
    pub p50: u64,
    /// Of ten, nine took no longer.
    pub p90: u64,
    /// Of a hundred, 99.
    pub p99: u64,
    /// Of a thousand, 999.
    pub p999: u64,
    /// The longest.
    pub max: u64,
}

/// Histograms of the parts, in the order of [`Part::ALL`].
#[derive(Debug, Clone)]
struct Parts(Vec<Histogram<u64>>);

impl Parts {
    fn new() -> Self {
        let histogram = Histogram::new_with_bounds(1, LONGEST_NS, DIGITS)
            .unwrap_or_else(|_| unreachable!("an hour in three digits can be kept"));
        Self(vec![histogram; Part::ALL.len()])
    }

    fn record(&mut self, times: [u64; Part::ALL.len()]) {
        for (histogram, time) in self.0.iter_mut().zip(times) {
            histogram.saturating_record(time);
        }
    }
}

/// The parts of one access; `None` where nobody but the expert decided, or somebody stamps nonsense.
fn parts(stamps: &Stamps) -> Option<[u64; Part::ALL.len()]> {
    let Stamps {
        published_ns, received_ns, embedded_ns, searched_ns, assembled_ns, joined_ns, ..
    } = *stamps;
    let times = [published_ns, received_ns, embedded_ns, searched_ns, assembled_ns, joined_ns];
    if published_ns == 0 || !times.is_sorted() {
        return None;
    }
    Some([
        (received_ns - published_ns) + (joined_ns - assembled_ns),
        embedded_ns - received_ns,
        searched_ns - embedded_ns,
        assembled_ns - searched_ns,
        joined_ns - published_ns,
    ])
}

/// An [`Observer`] that counts accesses, and nothing else.
#[derive(Debug)]
pub struct Recorder {
    /// By representation, in the order of [`Representation::ALL`], and by kind of step.
    counted: Vec<[Parts; 2]>,
    /// Episodes that were finished.
    pub episodes: u32,
    /// Steps that were taken.
    pub steps: u64,
    /// Steps whose stamps make no sense.
    pub senseless: u64,
    began_ns: u64,
    ended_ns: u64,
    /// What went wrong.
    pub troubles: Vec<String>,
}

impl Default for Recorder {
    fn default() -> Self {
        Self {
            counted: vec![[Parts::new(), Parts::new()]; Representation::ALL.len()],
            episodes: 0,
            steps: 0,
            senseless: 0,
            began_ns: 0,
            ended_ns: 0,
            troubles: Vec::new(),
        }
    }
}

impl Recorder {
    /// Counts one step.
    pub fn record(&mut self, stamps: &Stamps) {
        self.steps += 1;
        if self.began_ns == 0 {
            self.began_ns = stamps.commanded_ns;
        }
        self.ended_ns = self.ended_ns.max(stamps.decided_ns);
        let Some(times) = parts(stamps) else {
            self.senseless += 1;
            return;
        };
        if let Some(kinds) = self.counted.get_mut(stamps.memory as usize) {
            kinds[usize::from(stamps.step > 0)].record(times);
        }
    }

    /// Seconds from the first command to the last decision.
    pub fn seconds(&self) -> f64 {
        self.ended_ns.saturating_sub(self.began_ns) as f64 / 1e9
    }

    /// What was counted; nothing of what did not occur.
    pub fn latencies(&self) -> Vec<Latency> {
        let mut latencies = Vec::new();
        for (&representation, kinds) in Representation::ALL.iter().zip(&self.counted) {
            for (&step, Parts(parts)) in StepKind::ALL.iter().zip(kinds) {
                for (&part, histogram) in Part::ALL.iter().zip(parts) {
                    if histogram.is_empty() {
                        continue;
                    }
                    let at = |quantile| histogram.value_at_quantile(quantile);
                    let times = Times {
                        count: histogram.len(),
                        mean: histogram.mean(),
                        p50: at(0.5),
                        p90: at(0.9),
                        p99: at(0.99),
                        p999: at(0.999),
                        max: histogram.max(),
                    };
                    latencies.push(Latency { representation, step, part, times });
                }
            }
        }
        latencies
    }
}

impl Observer for Recorder {
    fn starting(&mut self, _generation: u32) {}

    fn awaiting(&mut self, _folder: &Path) {}

    fn ready(&mut self, _facts: &BTreeMap<Role, Facts>) -> Result<()> {
        Ok(())
    }

    fn spent(&mut self, _spent: &Spent) -> Result<Option<String>> {
        Ok(None)
    }

    fn finished(&mut self, _walked: &Walked, _attempt: u32) -> Result<()> {
        self.episodes += 1;
        Ok(())
    }

    fn stepped(&mut self, stamps: &Stamps) -> Result<()> {
        self.record(stamps);
        Ok(())
    }

    fn progress(&mut self, _steps: u64) {}

    fn trouble(&mut self, what: &str) {
        self.troubles.push(what.to_owned());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step whose stages end at these times.
    fn stamps(step: u32, memory: Representation, times: [u64; 6]) -> Stamps {
        let [published_ns, received_ns, embedded_ns, searched_ns, assembled_ns, joined_ns] = times;
        Stamps {
            ticket: 1,
            lane: 0,
            step,
            memory,
            commanded_ns: 5,
            woken_ns: 6,
            stepped_ns: 7,
            rendered_ns: 8,
            published_ns,
            received_ns,
            embedded_ns,
            searched_ns,
            assembled_ns,
            recalled_ns: assembled_ns,
            joined_ns,
            started_ns: joined_ns,
            prompted_ns: 0,
            requested_ns: 0,
            decided_ns: joined_ns + 5,
            logged_ns: joined_ns + 9,
        }
    }

    #[test]
    fn an_access_is_taken_apart_and_the_parts_add_up() {
        let mut recorder = Recorder::default();
        recorder.record(&stamps(0, Representation::Episodic, [10, 20, 120, 150, 155, 175]));
        recorder.record(&stamps(1, Representation::Episodic, [10, 20, 20, 50, 55, 75]));
        recorder.record(&stamps(1, Representation::Working, [10, 5, 20, 50, 55, 75]));
        recorder.record(&stamps(1, Representation::Working, [0; 6]));
        assert_eq!((recorder.steps, recorder.senseless), (4, 2));
        let latencies = recorder.latencies();
        let p50s = |step| -> Vec<u64> {
            latencies
                .iter()
                .filter(|found| found.step == step)
                .map(|found| found.times.p50)
                .collect()
        };
        assert_eq!(p50s(StepKind::First), [30, 100, 30, 5, 165]);
        assert_eq!(p50s(StepKind::Later), [30, 0, 30, 5, 65]);
        assert!(latencies.iter().all(|found| found.representation == Representation::Episodic));
        assert_eq!(recorder.seconds(), 175e-9);
    }
}
