//! What the world tells of an episode that has ended, and what it is told of those that memories have learned from.

use std::collections::{BTreeMap, BTreeSet};

use domain::events::{Requirement, Visit};
use domain::{ActionCode, Pose, Start};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// Of the facts of an episode, those that scores of every world need. A world leaves out what it does not know.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct SharedFacts {
    /// Why the episode failed, as far as the world has a word for it.
    pub failure: Option<FailureFact>,
    /// See [`looped_at`].
    pub looped_at: Option<u32>,
    /// For an episode of a stream: how closely its path follows the reference.
    pub path: Option<PathFact>,
    /// For an episode that is learned from: the variants of the run's streams in which its actions complete its task.
    pub completes_in: Option<BTreeSet<u32>>,
}

impl SharedFacts {
    /// Those in the JSON object of all facts.
    ///
    /// # Errors
    /// What is wrong with one of them.
    pub fn of(facts: &Map<String, Value>) -> Result<Self, serde_json::Error> {
        Self::deserialize(facts)
    }
}

/// A failure, in a word of the world.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FailureFact {
    /// The name of its [kind](crate::FailureKind).
    pub kind: String,
    /// The number of steps after which it was decided.
    pub step: u32,
}

/// How closely a path follows that of the reference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PathFact {
    /// The distance of the two under dynamic time warping, in metres.
    pub distance_m: f64,
    /// The number of places that the reference goes through.
    pub length: u32,
}

/// Number of steps at the end of an episode in which a loop is looked for.
pub const LOOP_STEPS: usize = 60;
/// Number of times in one state that count as a loop.
pub const LOOP_VISITS: usize = 5;

/// The step of the [`LOOP_VISITS`]th visit to a state within the last [`LOOP_STEPS`] steps, the first such. `states` are those
/// of the episode, its begin first.
pub fn looped_at<S: Ord>(states: &[S]) -> Option<u32> {
    let first = states.len().saturating_sub(LOOP_STEPS);
    let mut visits: BTreeMap<&S, usize> = BTreeMap::new();
    for (step, state) in (0..).zip(states).skip(first) {
        let count = visits.entry(state).or_default();
        *count += 1;
        if *count == LOOP_VISITS {
            return Some(step);
        }
    }
    None
}

/// The facts of an episode that only the world knows: of ours, a warehouse.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// As in [`SharedFacts`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<FailureFact>,
    /// As in [`SharedFacts`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub looped_at: Option<u32>,
    /// As in [`SharedFacts`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<PathFact>,
    /// As in [`SharedFacts`].
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_is_five_visits_to_a_state_within_the_last_sixty_steps() {
        let states = |turns: u32| (0..180).chain((0..turns).map(|turn| 179 + turn % 4));
        let found = |turns| looped_at(&states(turns).collect::<Vec<u32>>());
        // The state 179 at step 179, and then every fourth step from 180 on.
        assert_eq!((found(13), found(12), found(20)), (Some(192), None, Some(192)));
        let early: Vec<u32> = (0..20).map(|_| 0).chain(1..=60).collect();
        assert_eq!((looped_at(&early), looped_at::<u32>(&[])), (None, None));
    }

    #[test]
    fn shared_facts_are_found_among_those_of_a_world() {
        let facts = serde_json::json!({
            "visits": 3, "looped_at": 7, "failure": {"kind": "fell", "step": 4},
        });
        let shared = SharedFacts::of(facts.as_object().unwrap()).unwrap();
        let failure = Some(FailureFact { kind: "fell".to_owned(), step: 4 });
        assert_eq!(shared, SharedFacts { failure, looped_at: Some(7), ..SharedFacts::default() });
        let bad = serde_json::json!({"looped_at": "soon"});
        assert!(SharedFacts::of(bad.as_object().unwrap()).is_err());
    }
}
