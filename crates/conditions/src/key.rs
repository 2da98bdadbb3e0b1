//! The name of an episode in the log.

use std::fmt;

use domain::StreamOrder;

use crate::{Condition, Mismatch};

/// Where an episode stands in a stream. Written `s2-reversed-017`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct StreamPlace {
    /// The stream.
    pub stream: u32,
    /// The order of its blocks.
    pub order: StreamOrder,
    /// The position of the episode in its sequence, from 0.
    pub position: u32,
}

impl fmt::Display for StreamPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { stream, order, position } = self;
        write!(f, "s{stream}-{}-{position:03}", order.word())
    }
}

impl StreamPlace {
    /// Parses what [`Display`](fmt::Display) writes; `None` for any other text.
    fn read(text: &str) -> Option<Self> {
        let (stream, rest) = text.strip_prefix('s')?.split_once('-')?;
        let (order, position) = rest.split_once('-')?;
        let order = *StreamOrder::ALL.iter().find(|known| known.word() == order)?;
        let place = Self { stream: stream.parse().ok()?, order, position: position.parse().ok()? };
        (place.to_string() == text).then_some(place)
    }
}

/// Names an episode: `memory/start/route/demonstrations/run/case`, for example
/// `episodic/new/unchanged/4/run2/t03-07`; in a stream, with its place before the case:
/// `episodic/new/unchanged/original/learning/run1/s2-reversed-017/t03-07`. Unique in a run.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct EpisodeKey {
    /// The condition.
    pub condition: Condition,
    /// The repetition, from 1.
    pub run: u32,
    /// Its place, if it is part of a stream.
    pub place: Option<StreamPlace>,
    /// The case's id.
    pub case: String,
}

impl fmt::Display for EpisodeKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { condition, run, place, case } = self;
        write!(f, "{condition}/run{run}/")?;
        match place {
            Some(place) => write!(f, "{place}/{case}"),
            None => f.write_str(case),
        }
    }
}

impl EpisodeKey {
    /// Parses what [`Display`](fmt::Display) writes, with any memory; `None` for any other text.
    pub fn read(text: &str) -> Option<Self> {
        let (before, case) = text.rsplit_once('/')?;
        let place = before
            .rsplit_once('/')
            .and_then(|(before, place)| Some((before, StreamPlace::read(place)?)));
        let (before, place) = place.map_or((before, None), |(before, place)| (before, Some(place)));
        let (condition, run) = before.rsplit_once("/run")?;
        let (condition, run) = (Condition::logged(condition).ok()?, run.parse().ok()?);
        Some(Self { condition, run, place, case: case.to_owned() })
    }

    /// The seed of the episode in a run with this master seed: the first 8 bytes, as a little-endian number, of the BLAKE3
    /// hash of `memtransfer episode seed v1`, a zero byte, the master seed as 8 little-endian bytes, and the key as it is
    /// written, without its mismatch: with it and without it an episode draws the same.
    ///
    /// It depends on nothing but these, so neither the number of lanes nor which other episodes are run changes what an
    /// episode draws.
    pub fn seed(&self, master_seed: u64) -> u64 {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"memtransfer episode seed v1\0");
        hasher.update(&master_seed.to_le_bytes());
        let condition = self.condition.with_mismatch(Mismatch::None);
        hasher.update(Self { condition, ..self.clone() }.to_string().as_bytes());
        let hash = hasher.finalize();
        let first = hash.as_bytes().first_chunk::<8>();
        first.copied().map_or(0, u64::from_le_bytes)
    }

    /// The name of the sequence that the episode is part of: one stream in one order under one condition and
    /// repetition, for example `episodic/new/unchanged/original/learning/run1/s2-reversed`. `None` outside of streams.
    pub fn sequence(&self) -> Option<String> {
        let Self { condition, run, place, .. } = self;
        let StreamPlace { stream, order, .. } = place.as_ref()?;
        Some(format!("{condition}/run{run}/s{stream}-{}", order.word()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_read_as_it_is_written() {
        for text in [
            "working/original/unchanged/none/run1/t01-01",
            "episodic/new/unchanged/4/run12/t03-07",
            "episodic/original/unchanged/original/h20/images/no-hint/run1/a",
            "run1/new/unchanged/4/run1/run2",
            "working/new/unchanged/none/run1/s0-drawn-000/t01-01",
            "episodic/new/unchanged/original/h20/learning/run1/s2-reversed-017/t03-07",
            "adaptive/new/unchanged/original/oracle/run2/s12-shuffled-1017/s0-drawn-000",
        ] {
            assert_eq!(EpisodeKey::read(text).unwrap().to_string(), text);
        }
        for text in [
            "",
            "episodic/new/unchanged/4/t03-07",
            "episodic/new/unchanged/4/run/t03-07",
            "episodic/new/unchanged/4/run1/s2-drawn/t03-07",
            "episodic/new/unchanged/4/run1/s2-drawn-17/t03-07",
            "episodic/new/unchanged/4/run1/s2-backwards-017/t03-07",
            "episodic/new/unchanged/4/frozen/run1/s2-drawn-017/t03-07",
            "working/new/unchanged/none/learning/run1/s2-drawn-017/t03-07",
        ] {
            assert_eq!(EpisodeKey::read(text), None, "{text}");
        }
    }

    #[test]
    fn an_episode_draws_the_same_with_a_mismatch() {
        let seed = |text: &str| EpisodeKey::read(text).unwrap().seed(7);
        let standard = seed("episodic/new/unchanged/4/run1/t03-07");
        assert_eq!(seed("episodic/new/unchanged/4/light/run1/t03-07"), standard);
        assert_eq!(seed("episodic/new/unchanged/4/stock/run1/t03-07"), standard);
        assert_ne!(seed("episodic/new/unchanged/4/light/run2/t03-07"), standard);
    }

    #[test]
    fn a_sequence_is_named_like_its_episodes() {
        let key = |text: &str| EpisodeKey::read(text).unwrap().sequence();
        let learning = "episodic/new/unchanged/original/learning/run1";
        assert_eq!(
            key(&format!("{learning}/s2-reversed-017/t03-07")),
            Some(format!("{learning}/s2-reversed"))
        );
        assert_eq!(key("episodic/new/unchanged/4/run1/t03-07"), None);
    }
}
