//! What the world tells of an episode that has ended, and what it is told of those that memories have learned from.

use std::collections::{BTreeMap, BTreeSet};

use domain::events::{Requirement, Visit};
use domain::{ActionCode, Pose, Start};
use serde::{Deserialize, Serialize};

/// The facts of an episode that only the world knows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeFacts {
    /// The state in which it began.
    pub start_pose: Pose,
    /// The state in which it ended.
    pub final_pose: Pose,
    /// Every arrival before an item of the task, whether or not it counted.
    pub visits: Vec<Visit>,
    /// For each requirement, the first step whose view showed one of its items.
    pub first_seen: BTreeMap<Requirement, u32>,
    /// The steps at which a move was blocked.
    pub blocked_moves: Vec<u32>,
    /// For an episode that is learned from: the variants of the run's streams in which its actions complete its task.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub completes_in: Option<BTreeSet<u32>>,
}

/// The file, in the folder to which the processes of a run attach, of the episodes that memories have learned from before: a
/// JSON list of [`LearnedEpisode`].
pub const LEARNED_FILE: &str = "learned.json";

/// An episode that a memory has learned from. Acted out, it has the states that the memory may ask views of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnedEpisode {
    /// The sequence.
    pub sequence: u64,
    /// Its position in the sequence.
    pub position: u32,
    /// The index of its case.
    pub case: u32,
    /// Where it began.
    pub start: Start,
    /// The variant that it took place in.
    pub variant: u32,
    /// The action of each step; `None` where there was none and the state stayed what it was.
    pub actions: Vec<Option<ActionCode>>,
}
