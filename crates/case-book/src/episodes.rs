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
    /// See [`loops`]. `None`: not recorded; empty: there was none.
    pub loops: Option<Vec<LoopFact>>,
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
    /// The step of the event that the rule of its kind is about, such as an arrival or a sight; the end of the episode where it is
    /// about none.
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

/// A stretch of an episode in which the agent is only in situations in which it was before: see [`loops`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopFact {
    /// The step of the first repetition.
    pub from: u32,
    /// The last step before the agent comes into a situation that is new to it: the end of the episode if it never does.
    pub to: u32,
}

/// Fewest steps that a loop goes on for after its first repetition.
pub const LOOP_LEAST: usize = 20;

/// The loops of an episode, in order. `situations` are those after each step, the begin first: the agent's state and the number of
/// sub-goals completed.
///
/// A situation is *known* at a step if the agent was in it before. A loop begins at the first step whose situation is known and
/// comes again before the agent is in one that is not known. It goes on until then, and for at least [`LOOP_LEAST`] steps. So a
/// place that is passed again on the way to another is none, and neither is a way back that completes a sub-goal.
pub fn loops<S: Ord>(situations: &[S]) -> Vec<LoopFact> {
    let mut before = BTreeSet::new();
    let known: Vec<bool> = situations.iter().map(|situation| !before.insert(situation)).collect();
    let mut found = Vec::new();
    let mut end = 0;
    for run in known.chunk_by(|one, next| one == next) {
        let steps = end..end + run.len();
        end = steps.end;
        if !run[0] {
            continue;
        }
        let last_visits: BTreeMap<&S, usize> =
            steps.clone().map(|step| (&situations[step], step)).collect();
        let to = steps.end - 1;
        let repeated = steps.clone().find(|&step| last_visits[&situations[step]] > step);
        if let Some(from) = repeated.filter(|from| to - from >= LOOP_LEAST) {
            found.push(LoopFact { from: from as u32, to: to as u32 });
        }
    }
    found
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
    pub loops: Option<Vec<LoopFact>>,
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

    /// The loops of an episode whose situations are letters, as `from-to`.
    fn looped(situations: &str) -> String {
        let letters: Vec<char> = situations.chars().collect();
        let loops = loops(&letters);
        let ranges = loops.iter().map(|LoopFact { from, to }| format!("{from}-{to}"));
        ranges.collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn a_loop_begins_with_the_first_repetition_of_what_is_then_repeated() {
        // 15 steps, then seven situations over and over: the first of them comes again at step 22.
        let seven = "abcdefghijklmno".to_owned() + &"pqrstuv".repeat(5);
        assert_eq!(looped(&seven), "22-49");
        // It has to go on for 20 steps: two situations in turn; and a step that changes nothing, again and again.
        assert_eq!(looped(&("x".to_owned() + &"ab".repeat(12))), "3-24");
        assert_eq!(looped(&("x".to_owned() + &"ab".repeat(11))), "");
        assert_eq!(
            (looped(&"a".repeat(22)).as_str(), looped(&"a".repeat(21)).as_str()),
            ("1-21", "")
        );
        // A long way that is gone twice, and then leads to something new. Gone a third time it is a loop.
        let way = "abcdefghijklmnopqrstuvwxyz";
        assert_eq!(looped(&format!("{way}{way}A{way}B")), "");
        assert_eq!(looped(&way.repeat(3)), "26-77");
        // A known way into a loop in no strict order, which the agent leaves; then another, until the end.
        let left = format!("uvabcXuv{}Y", "abcab".repeat(5));
        assert_eq!(looped(&format!("{left}{}", "uv".repeat(12))), "8-32 34-57");
        assert_eq!(looped(""), "");
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
