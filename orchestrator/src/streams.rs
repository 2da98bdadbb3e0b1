//! The streams of a run: world states, what follows from them for the cases that take place there, and where an interrupted
//! run goes on.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail};
use results::log::EpisodeRecord;
use shm_types::message::SnapshotId;
use warehouse::{CaseSet, StreamSet, Trajectory, Warehouse, WorldState};

use crate::lanes::Experience;
use crate::plan::{PlannedEpisode, StreamPart};

/// The streams of a run and their worlds.
#[derive(Debug, Clone)]
pub struct Streams {
    /// The streams, as drawn.
    pub set: StreamSet,
    states: Vec<WorldState>,
    /// By world and case, for the cases of each world's blocks.
    cases: BTreeMap<(u32, u32), CaseInWorld>,
}

/// A case in a world state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CaseInWorld {
    /// The expert's trajectory from the test start.
    pub reference: Trajectory,
    /// The steps in which it completes the task.
    pub length: u32,
    /// Whether the case's original demonstration, replayed here, does not complete the task.
    pub invalidated: bool,
}

impl Streams {
    /// The streams of `set`.
    ///
    /// # Errors
    /// When they do not fit the warehouse and the cases, or a case cannot be solved.
    pub fn new(warehouse: &Warehouse, cases: &CaseSet, set: StreamSet) -> Result<Self> {
        set.check(warehouse, cases)?;
        let states = set.states(warehouse)?;
        let mut listed: Vec<(u32, u32)> = Vec::new();
        for block in set.streams.iter().flat_map(|stream| &stream.blocks) {
            listed.extend(block.cases.iter().map(|&case| (block.world, case)));
        }
        listed.sort_unstable();
        let mut known = BTreeMap::new();
        for of_world in listed.chunk_by(|one, next| one.0 == next.0) {
            let state = &states[of_world[0].0 as usize];
            let expert = state.expert();
            for &(world, case) in of_world {
                let found = &cases.cases[case as usize];
                let reference = state.reference(&expert, &found.task, found.test.start);
                let (reference, length) = reference.with_context(|| {
                    format!("case {} cannot be solved in world {world} of the streams", found.id)
                })?;
                let invalidated = !state.completes(&found.original, &found.task);
                known.insert((world, case), CaseInWorld { reference, length, invalidated });
            }
        }
        Ok(Self { set, states, cases: known })
    }

    /// The state of world `world`.
    pub fn state(&self, world: u32) -> &WorldState {
        &self.states[world as usize]
    }

    /// A case in a world that has a block with it.
    pub fn case(&self, world: u32, case: usize) -> &CaseInWorld {
        &self.cases[&(world, case as u32)]
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
    /// What is left of `planned` beside the records `finished`.
    ///
    /// # Errors
    /// When the log lacks an episode of a sequence and has a later one.
    pub fn of(planned: &[PlannedEpisode], finished: &[EpisodeRecord]) -> Result<Self> {
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
            let experience = Experience::of(episode.case_index, record);
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
