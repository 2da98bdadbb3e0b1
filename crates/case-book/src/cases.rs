//! Cases, streams and what is stale: for those who run, score and show episodes.

use std::collections::{BTreeMap, BTreeSet};

use domain::{ActionCode, Mismatch, Route, Start, State, StreamOrder};
use serde::{Deserialize, Serialize};

use crate::WorldDeclaration;

/// The cases of a run's world.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaseBook {
    /// The world.
    pub world: WorldFacts,
    /// The cases, in the order of the world's own file; no two have the same id. Everything else names them by their index.
    pub cases: Vec<CaseFacts>,
    /// The streams, for a run that consists of some.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub streams: Option<StreamsFacts>,
    /// For each variant that episodes of the run can take place in, and that demonstrations can be stale in: the
    /// demonstrations, as indices into the [`DemonstrationBook`](crate::DemonstrationBook), that do not complete their task
    /// there. One that took place in another world is never stale.
    pub stale: BTreeMap<u32, BTreeSet<u32>>,
}

/// What identifies a world, and the words of its own that figures are named with.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldFacts {
    /// What it says of itself to every process.
    pub declaration: WorldDeclaration,
    /// Hashes of what it was made from, by name, in hexadecimal digits.
    pub hashes: BTreeMap<String, String>,
    /// The number of different views that a variant has, at most.
    pub views: u32,
    /// The same of the other world in which tasks are demonstrated; 0 if there is none.
    pub elsewhere_views: u32,
    /// The groups of tasks in results, in the order of tables.
    pub groups: Vec<TaskGroupFacts>,
    /// The types of tasks.
    pub tasks: Vec<TaskFacts>,
    /// Every kind of failure, those of [`HARNESS_FAILURES`] among them. An episode has the first that applies.
    pub failures: Vec<FailureKind>,
    /// In what its episodes can differ from the demonstrations, beside start and route. Without [`Mismatch::None`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mismatches: Vec<Mismatch>,
}

/// A group of tasks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskGroupFacts {
    /// The name.
    pub name: String,
    /// The heading of its columns in tables.
    pub heading: String,
}

/// A type of tasks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskFacts {
    /// The number, by which cases name it.
    pub number: u8,
    /// The name.
    pub name: String,
    /// The name of its group.
    pub group: String,
}

/// A kind of failure.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FailureKind {
    /// The name.
    pub name: String,
    /// What it means, for a legend.
    pub words: String,
}

/// The kind of failure of an episode in which no action could be read in at least half of the answers.
pub const UNREADABLE: &str = "unreadable";
/// The kind of failure of an episode that ended in a [loop](crate::looped_at).
pub const LOOPED: &str = "looped";
/// The kind of failure to which no other kind applies.
pub const OUT_OF_STEPS: &str = "out-of-steps";

/// The kinds of failure that episodes in every world have: name and meaning.
pub const HARNESS_FAILURES: [(&str, &str); 3] = [
    (UNREADABLE, "in at least half of the answers no action could be read"),
    (LOOPED, "at least 5 times in the same state within the last 60 steps"),
    (OUT_OF_STEPS, "none of the other kinds"),
];

impl FailureKind {
    /// The kind with this name and meaning.
    pub fn new((name, words): (&str, &str)) -> Self {
        Self { name: name.to_owned(), words: words.to_owned() }
    }
}

impl WorldFacts {
    /// The type of tasks with this number.
    pub fn task(&self, number: u8) -> Option<&TaskFacts> {
        self.tasks.iter().find(|task| task.number == number)
    }

    /// The name of the group of the type of tasks with this number.
    pub fn group_of(&self, task: u8) -> Option<&str> {
        self.task(task).map(|task| task.group.as_str())
    }

    /// The index of the kind of failure with this name.
    pub fn failure_index(&self, name: &str) -> Option<usize> {
        self.failures.iter().position(|kind| kind.name == name)
    }

    /// The meaning of the kind of failure with this name; for one that the world does not list, the name itself.
    pub fn failure_words<'a>(&'a self, name: &'a str) -> &'a str {
        self.failure_index(name).map_or(name, |index| &self.failures[index].words)
    }
}

/// A case: a task with its starts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaseFacts {
    /// The id.
    pub id: String,
    /// The number of the task's type.
    pub task: u8,
    /// The instruction for the policy.
    pub instruction: String,
    /// The same in other words, for [`Mismatch::Wording`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paraphrase: Option<String>,
    /// What the expert does, from each start in each variant in which the case is tested.
    pub references: Vec<Reference>,
    /// Whether the blocked variant invalidates the case's original demonstration: acted out there, it does not complete the
    /// task.
    pub invalidated_when_blocked: bool,
}

impl CaseFacts {
    /// Whether `other` is the same task from the same starts, as far as both are tested there.
    pub fn is_same_case(&self, other: &Self) -> bool {
        let is_same_reference = |reference: &Reference| {
            let tested = other
                .references
                .iter()
                .find(|theirs| (theirs.start, theirs.route) == (reference.start, reference.route));
            tested.is_none_or(|theirs| theirs == reference)
        };
        self.task == other.task
            && self.instruction == other.instruction
            && self.references.iter().all(is_same_reference)
    }
}

/// The expert's trajectory of a case.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// The start.
    pub start: Start,
    /// The route.
    pub route: Route,
    /// The state in which it begins.
    pub begin: State,
    /// The actions. They may go on after the task is complete.
    pub actions: Vec<ActionCode>,
    /// The steps in which they complete the task, l_i.
    pub length: u32,
}

/// The streams of a run (specification, section 9).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamsFacts {
    /// BLAKE3 of the world's own file of them, in hexadecimal digits.
    pub hash: String,
    /// The streams.
    pub streams: Vec<StreamFacts>,
    /// The variant of each world state that blocks name.
    pub variants: Vec<u32>,
    /// By world state, the cases that take place in it.
    pub states: Vec<BTreeMap<u32, CaseInState>>,
}

/// A stream.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamFacts {
    /// The blocks, as drawn.
    pub blocks: Vec<StreamBlock>,
    /// The indices of the blocks in the shuffled order.
    pub shuffled: Vec<u32>,
}

/// Cases that take place in one state of the world.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamBlock {
    /// The world state.
    pub world: u32,
    /// The cases.
    pub cases: Vec<u32>,
}

/// A case in a world state of a stream.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaseInState {
    /// The state in which the reference begins.
    pub begin: State,
    /// The actions of the expert, who knows the state.
    pub actions: Vec<ActionCode>,
    /// The steps in which they complete the task, l_i.
    pub length: u32,
    /// Whether the case's original demonstration, acted out here, does not complete the task.
    pub invalidated: bool,
}

impl CaseBook {
    /// The index of the case with this id.
    pub fn index(&self, id: &str) -> Option<usize> {
        self.cases.iter().position(|case| case.id == id)
    }

    /// The ids of all cases, in their order.
    pub fn ids(&self) -> Vec<&str> {
        self.cases.iter().map(|case| case.id.as_str()).collect()
    }

    /// Whether the demonstration is stale in the variant. `false` for a variant in which none can be.
    pub fn is_stale(&self, variant: u32, demonstration: u32) -> bool {
        self.stale.get(&variant).is_some_and(|stale| stale.contains(&demonstration))
    }
}

impl CaseFacts {
    /// The instruction of an episode with this mismatch. A world that offers wording has a paraphrase of every case.
    pub fn instruction_with(&self, mismatch: Mismatch) -> &str {
        let paraphrase = self.paraphrase.as_deref().filter(|_| mismatch == Mismatch::Wording);
        paraphrase.unwrap_or(&self.instruction)
    }

    /// The reference of an episode from `start` on `route`. On a blocked route an episode always begins at the new start.
    pub fn reference(&self, start: Start, route: Route) -> Option<&Reference> {
        let start = match route {
            Route::Blocked => Start::New,
            Route::Unchanged => start,
        };
        self.references.iter().find(|of| (of.start, of.route) == (start, route))
    }
}

impl StreamsFacts {
    /// A case in a world state; `None` if no block has it there.
    pub fn case(&self, world: u32, case: u32) -> Option<&CaseInState> {
        self.states.get(world as usize)?.get(&case)
    }

    /// The variant of a world state.
    pub fn variant(&self, world: u32) -> Option<u32> {
        self.variants.get(world as usize).copied()
    }
}

impl StreamFacts {
    /// The indices of its blocks in `order`.
    pub fn order(&self, order: StreamOrder) -> Vec<u32> {
        let drawn = 0..self.blocks.len() as u32;
        match order {
            StreamOrder::Drawn => drawn.collect(),
            StreamOrder::Reversed => drawn.rev().collect(),
            StreamOrder::Shuffled => self.shuffled.clone(),
        }
    }

    /// The cases of all blocks, sorted, each once.
    pub fn cases(&self) -> BTreeSet<u32> {
        self.blocks.iter().flat_map(|block| block.cases.iter().copied()).collect()
    }
}
