//! What memories have learned from, and where an interrupted run goes on.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, Result, bail};
use case_book::{CaseBook, LearnedEpisode, WorldDeclaration};
use domain::Start;
use run_log::EpisodeRecord;
use shm_types::message::SnapshotId;

use crate::plan::{PlannedEpisode, StreamPart};

/// An episode that a memory has learned from, as a source of what it recalls.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Experience {
    case_index: usize,
    start: Start,
    variant: u32,
    actions: String,
    /// Whether it completed its task.
    pub is_complete: bool,
    /// The variants of the run's streams in which its actions complete its task.
    pub completes_in: BTreeSet<u32>,
}

impl Experience {
    /// The episode of case number `case_index` in `variant` with this record. `None` if that does not say where its actions
    /// complete its task.
    pub fn of(case_index: usize, variant: u32, record: &EpisodeRecord) -> Option<Self> {
        Some(Self {
            case_index,
            start: record.start,
            variant,
            actions: record.actions.clone(),
            is_complete: record.is_success(),
            completes_in: record.shared_facts().completes_in?,
        })
    }

    /// As the simulator is told of it.
    pub fn as_learned(
        &self,
        world: &WorldDeclaration,
        sequence: u64,
        position: u32,
    ) -> LearnedEpisode {
        LearnedEpisode {
            sequence,
            position,
            case: self.case_index as u32,
            start: self.start,
            variant: self.variant,
            actions: self.actions.chars().map(|letter| world.action_of(letter)).collect(),
        }
    }
}

/// What is left of a run whose folder has some of its episodes.
#[derive(Debug, Default)]
pub struct Remaining {
    /// The episodes that are missing, in their order. The first of each sequence continues from the last snapshot in the log.
    pub missing: Vec<PlannedEpisode>,
    /// The episodes in the log that memories have learned from: sequence, position, and what they were.
    pub learned: Vec<(u64, u32, Experience)>,
}

impl Remaining {
    /// What is left of `planned`, of the cases in `book`, beside the records `finished`.
    ///
    /// # Errors
    /// When the log lacks an episode of a sequence and has a later one, or an earlier version has written it.
    pub fn of(
        book: &CaseBook,
        planned: &[PlannedEpisode],
        finished: &[EpisodeRecord],
    ) -> Result<Self> {
        let finished: BTreeMap<&str, &EpisodeRecord> =
            finished.iter().map(|record| (record.key.as_str(), record)).collect();
        let mut remaining = Self::default();
        // By sequence: its last snapshot, and the first of its episodes that is missing.
        let mut sequences: BTreeMap<u64, (SnapshotId, Option<&PlannedEpisode>)> = BTreeMap::new();
        for episode in planned {
            let record = finished.get(episode.key.to_string().as_str());
            let Some(part) = episode.part else {
                remaining.missing.extend(record.is_none().then(|| episode.clone()));
                continue;
            };
            let (snapshot, gap) = sequences.entry(part.sequence).or_default();
            let Some(record) = record else {
                gap.get_or_insert(episode);
                let part = Some(StreamPart { snapshot: *snapshot, ..part });
                remaining.missing.push(PlannedEpisode { part, ..episode.clone() });
                continue;
            };
            if let Some(gap) = gap {
                bail!(
                    "the log lacks {} and has {}, which comes later in the same sequence: delete the lines of the sequence \
                     {} in episodes.jsonl, or remove the folder to start over (as `run --fresh` does)",
                    gap.key,
                    record.key,
                    gap.key.sequence().unwrap_or_default()
                );
            }
            let Some(stream) = record.stream.as_ref().filter(|_| episode.learns()) else {
                continue;
            };
            if let Some(found) = stream.snapshot.as_deref().and_then(read_snapshot) {
                *snapshot = found;
            }
            let experience = Experience::of(episode.case_index, episode.variant(book), record);
            let experience = experience.with_context(|| {
                format!(
                    "{} does not say where its actions complete its task, because an earlier version has written it: remove \
                     the folder to start over (as `run --fresh` does)",
                    record.key
                )
            })?;
            remaining.learned.push((part.sequence, stream.position, experience));
        }
        Ok(remaining)
    }
}

/// The snapshot with this name in the log: 32 hexadecimal digits.
fn read_snapshot(name: &str) -> Option<SnapshotId> {
    let number = u128::from_str_radix(name, 16).ok()?;
    (name.len() == 32).then(|| number.to_be_bytes())
}
