//! Which cases need memory, and success on those.

use std::collections::{BTreeMap, BTreeSet};

use domain::Arm;
use serde::Serialize;

use super::estimate::{Estimate, by_stream};
use super::sequence::{CompleteSequences, StreamEpisode, success_rate};
use crate::certify::CertifiedCases;
use crate::interval::Interval;
use conditions::Condition;

/// The cases of the streams that certify that memory matters, with the oracle arm of one memory.
///
/// A case in a block is certified if the policy fails it without memory and succeeds with the oracle: in most of its learning
/// episodes each. Certification takes these two arms as they are, so their own success on certified cases is so by selection.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Necessity {
    /// The condition in the arm `oracle`.
    pub oracle: Condition,
    /// Cases in blocks that were run both without memory and with the oracle.
    pub cases: usize,
    /// Those that are certified.
    pub certified: usize,
    /// Success of each condition of this memory, and of no memory.
    pub success: Vec<NecessitySuccess>,
}

/// Success rates over learning episodes, in percent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NecessitySuccess {
    /// The condition.
    pub condition: Condition,
    /// On all cases.
    pub all: Option<Estimate>,
    /// On certified cases.
    pub certified: Option<Estimate>,
}

/// A case in a block of a stream.
type BlockCase<'a> = (u32, u32, &'a str);

fn place<'a>(episode: &StreamEpisode<'a>) -> BlockCase<'a> {
    (episode.stream.stream, episode.stream.block, &episode.record.case)
}

/// Certifies the cases of every memory that has an oracle arm and was run beside no memory.
pub(super) fn necessity(conditions: &BTreeMap<Condition, CompleteSequences<'_>>) -> Vec<Necessity> {
    let oracles = conditions.iter().filter(|(condition, _)| condition.arm == Arm::Oracle);
    let of = |(oracle, sequences): (&Condition, &CompleteSequences<'_>)| {
        let without = conditions.get(&oracle.without_memory()?)?;
        let CertifiedCases { all: both, certified } =
            CertifiedCases::of(&rates(without), &rates(sequences));
        let is_shown = |condition: &Condition| {
            let memory = Condition { arm: Arm::Oracle, ..*condition };
            memory == *oracle || Some(*condition) == oracle.without_memory()
        };
        let shown = conditions.iter().filter(|(condition, _)| is_shown(condition));
        let success = shown.map(|(condition, sequences)| NecessitySuccess {
            condition: *condition,
            all: on(sequences, &both),
            certified: on(sequences, &certified),
        });
        (!both.is_empty()).then(|| Necessity {
            oracle: *oracle,
            cases: both.len(),
            certified: certified.len(),
            success: success.collect(),
        })
    };
    oracles.filter_map(of).collect()
}

/// The success rate in percent of each case in each block, over learning episodes.
fn rates<'a>(sequences: &CompleteSequences<'a>) -> BTreeMap<BlockCase<'a>, f64> {
    let mut episodes: BTreeMap<BlockCase<'_>, Vec<StreamEpisode<'_>>> = BTreeMap::new();
    for episode in sequences.complete.values().flat_map(|sequence| sequence.learning()) {
        episodes.entry(place(&episode)).or_default().push(episode);
    }
    let rates = episodes.into_iter();
    rates
        .filter_map(|(place, episodes)| Some((place, success_rate(episodes.into_iter())?)))
        .collect()
}

fn on(sequences: &CompleteSequences<'_>, places: &BTreeSet<BlockCase<'_>>) -> Option<Estimate> {
    let streams = by_stream(sequences, |_, sequence| {
        success_rate(sequence.learning().filter(|episode| places.contains(&place(episode))))
    });
    Estimate::of(&streams, Interval::PERCENT)
}
