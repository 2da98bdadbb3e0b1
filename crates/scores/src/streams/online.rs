//! What happens while a memory learns: figures of the learning episodes of one sequence.

use std::collections::BTreeMap;

use super::sequence::{Sequence, StreamEpisode, success_rate};
use crate::mean::mean;

/// The episodes before or after events, as the blocks were drawn: those of block 0, or of all others.
pub(super) fn part<'a>(
    sequence: &Sequence<'a>,
    after_events: bool,
) -> impl Iterator<Item = StreamEpisode<'a>> + Clone {
    sequence.learning().filter(move |episode| episode.is_after_events() == after_events)
}

/// Regret: the sum over learning episodes t of the oracle's success minus the sequence's, in episodes. `oracle` is the
/// paired sequence in the arm `oracle`. None if the two differ in their episodes.
pub(super) fn regret(sequence: &Sequence<'_>, oracle: &Sequence<'_>) -> Option<f64> {
    let pairs: Vec<_> = sequence.learning().zip(oracle.learning()).collect();
    let is_paired = pairs.len() == sequence.learning().count()
        && pairs.len() == oracle.learning().count()
        && pairs.iter().all(|(own, best)| own.record.case == best.record.case);
    let more = |(own, best): &(StreamEpisode<'_>, StreamEpisode<'_>)| {
        f64::from(best.is_success()) - f64::from(own.is_success())
    };
    is_paired.then(|| pairs.iter().map(more).sum())
}

/// For each block with an invalidated case: the number of learning episodes from the start of the block to the first success
/// of an invalidated case, that one included; None where there is no such success.
pub(super) fn lags(sequence: &Sequence<'_>) -> Vec<Option<u32>> {
    let mut blocks: BTreeMap<u32, Vec<StreamEpisode<'_>>> = BTreeMap::new();
    for episode in sequence.learning() {
        blocks.entry(episode.stream.place).or_default().push(episode);
    }
    let of_block = |episodes: Vec<StreamEpisode<'_>>| {
        episodes.iter().any(|e| e.stream.invalidated).then(|| {
            let found = episodes.iter().position(|e| e.stream.invalidated && e.is_success());
            found.map(|before| before as u32 + 1)
        })
    };
    blocks.into_values().filter_map(of_block).collect()
}

/// Adaptation lag: the mean of [`lags`] over the blocks in which an invalidated case succeeded. None if there is none.
pub(super) fn lag(sequence: &Sequence<'_>) -> Option<f64> {
    mean(lags(sequence).into_iter().flatten().map(f64::from))
}

/// The percentage of the blocks with an invalidated case in which one succeeded. None without such a block.
pub(super) fn adapted(sequence: &Sequence<'_>) -> Option<f64> {
    mean(lags(sequence).into_iter().map(|lag| if lag.is_some() { 100.0 } else { 0.0 }))
}

/// Stale reuse: the percentage of the sources retrieved in `episodes` that are stale. None if nothing was retrieved.
pub(super) fn stale<'a>(episodes: impl Iterator<Item = StreamEpisode<'a>>) -> Option<f64> {
    let (stale, all) = episodes.fold((0_u64, 0_u64), |(stale, all), episode| {
        (stale + u64::from(episode.stream.stale), all + u64::from(episode.stream.retrievals))
    });
    (all > 0).then(|| 100.0 * stale as f64 / all as f64)
}

/// The success rate in each learning round, and over all learning episodes up to its end (stream success; C.-K. Wu et al.,
/// "StreamBench", NeurIPS 2024): by place of the block and round, in percent.
pub(super) fn rounds(sequence: &Sequence<'_>) -> BTreeMap<(u32, u32), (f64, f64)> {
    let mut rounds: BTreeMap<(u32, u32), Vec<StreamEpisode<'_>>> = BTreeMap::new();
    for episode in sequence.learning() {
        let round = episode.stream.round.unwrap_or(0);
        rounds.entry((episode.stream.place, round)).or_default().push(episode);
    }
    let mut so_far = Vec::new();
    let mut found = BTreeMap::new();
    for (at, episodes) in rounds {
        so_far.extend(episodes.iter().copied());
        let own = success_rate(episodes.into_iter());
        found.extend(own.zip(success_rate(so_far.iter().copied())).map(|rates| (at, rates)));
    }
    found
}
