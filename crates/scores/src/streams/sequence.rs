//! The sequences of a log: one stream in one order, under one condition and repetition.

use std::collections::BTreeMap;

use domain::StreamOrder;

use crate::mean::percentage;
use conditions::Condition;
use run_log::{EpisodeRecord, RunLog, StreamRecord};

/// Which sequence of its condition. Sequences of two conditions with the same one are paired.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct SequenceId {
    pub(super) stream: u32,
    pub(super) order: StreamOrder,
    pub(super) run: u32,
}

/// An episode of a stream.
#[derive(Debug, Clone, Copy)]
pub(super) struct StreamEpisode<'a> {
    pub(super) record: &'a EpisodeRecord,
    pub(super) stream: &'a StreamRecord,
}

/// The finished episodes of a sequence, by position.
#[derive(Debug, Clone, Default)]
pub(super) struct Sequence<'a> {
    episodes: Vec<StreamEpisode<'a>>,
}

/// The complete sequences of a condition, and the number of all, those that have not begun included.
#[derive(Debug, Clone, Default)]
pub(super) struct CompleteSequences<'a> {
    pub(super) complete: BTreeMap<SequenceId, Sequence<'a>>,
    pub(super) planned: usize,
}

impl<'a> CompleteSequences<'a> {
    /// The sequences of each condition that has an episode of a stream in `log`.
    ///
    /// A sequence is complete if it has every position, as many as the settings of the run say.
    pub(super) fn by_condition(log: &'a RunLog) -> BTreeMap<Condition, Self> {
        let settings = &log.manifest.settings;
        let Some(streams) = &settings.stream else { return BTreeMap::new() };
        let mut found: BTreeMap<(Condition, SequenceId), Sequence<'a>> = BTreeMap::new();
        for record in &log.episodes {
            let Some(stream) = &record.stream else { continue };
            let id = SequenceId { stream: stream.stream, order: stream.order, run: record.run };
            let sequence = found.entry((record.condition(), id)).or_default();
            sequence.episodes.push(StreamEpisode { record, stream });
        }
        let runs: BTreeMap<Condition, u32> = settings.runs().into_iter().collect();
        let mut conditions: BTreeMap<Condition, Self> = BTreeMap::new();
        for ((condition, id), mut sequence) in found {
            sequence.episodes.sort_by_key(|episode| episode.stream.position);
            let of = conditions.entry(condition).or_default();
            let runs = runs.get(&condition).copied().unwrap_or(0);
            of.planned = runs as usize * streams.sequences();
            if sequence.is_complete(streams.sequence_episodes()) {
                of.complete.insert(id, sequence);
            }
        }
        conditions
    }
}

impl<'a> Sequence<'a> {
    fn is_complete(&self, length: usize) -> bool {
        let mut positions = (0..).zip(&self.episodes);
        self.episodes.len() == length
            && positions.all(|(position, e)| e.stream.position == position)
    }

    /// The number of blocks, T.
    pub(super) fn blocks(&self) -> u32 {
        self.episodes.iter().map(|episode| episode.stream.place + 1).max().unwrap_or(0)
    }

    /// The learning episodes, in order.
    pub(super) fn learning(&self) -> impl Iterator<Item = StreamEpisode<'a>> + Clone {
        self.episodes.iter().copied().filter(|episode| episode.stream.learns())
    }

    /// The evaluation episodes, in order.
    pub(super) fn evaluations(&self) -> impl Iterator<Item = StreamEpisode<'a>> + Clone {
        self.episodes.iter().copied().filter(|episode| !episode.stream.learns())
    }
}

impl StreamEpisode<'_> {
    pub(super) fn is_success(&self) -> bool {
        self.record.is_success()
    }

    /// Whether it takes place in a block that follows an event, as the blocks were drawn.
    pub(super) fn is_after_events(&self) -> bool {
        self.stream.block > 0
    }
}

/// The success rate of `episodes` in percent.
pub(super) fn success_rate<'a>(episodes: impl Iterator<Item = StreamEpisode<'a>>) -> Option<f64> {
    percentage(episodes.map(|episode| episode.is_success()))
}
