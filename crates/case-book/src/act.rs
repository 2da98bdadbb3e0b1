//! What `sim-proc act` is asked outside of a run, and what it answers: a line of JSON each.
//!
//! Everything that shows or checks an episode asks here for what only the world knows. The world is named by the number of
//! one of its variants, as in the rest of the case book.

use domain::{
    ActionCode, Cell, DemonstrationKind, Demonstrations, FeedbackCode, Route, Start, State,
    StreamOrder,
};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::cases::{CaseFacts, WorldFacts};

/// A request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActRequest {
    /// What the world is, and its cases: [`ActAnswer::World`].
    World,
    /// Act out an episode: [`ActAnswer::Episode`].
    Episode(EpisodeRequest),
    /// Act out demonstrations: [`ActAnswer::Demonstrations`].
    Demonstrations(DemonstrationsRequest),
    /// The floor of a variant, from above: [`ActAnswer::Scene`].
    Scene(u32),
    /// For each of these states in a variant, the one whose view the control `swapped` shows: [`ActAnswer::Swapped`].
    Swapped(u32, Vec<State>),
}

/// An answer.
#[expect(clippy::large_enum_variant, reason = "there is one at a time")]
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActAnswer {
    /// To [`ActRequest::World`].
    World(WorldDescription),
    /// To [`ActRequest::Episode`].
    Episode(Box<ActedEpisode>),
    /// To [`ActRequest::Demonstrations`]. One that the case does not have is left out.
    Demonstrations(Vec<ActedDemonstration>),
    /// To [`ActRequest::Scene`].
    Scene(Scene),
    /// To [`ActRequest::Swapped`].
    Swapped(Vec<State>),
    /// The request cannot be met, and why.
    Error(String),
}

/// A world and its cases.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldDescription {
    /// The world.
    pub world: WorldFacts,
    /// The cases, in their order.
    pub cases: Vec<CaseFacts>,
    /// The variant of each case on the blocked route, by the index of the case.
    pub blocked: Vec<u32>,
    /// The variant of each world state of the streams, by its number.
    pub states: Vec<u32>,
}

impl WorldDescription {
    /// The ids of all cases, in their order.
    pub fn case_ids(&self) -> Vec<&str> {
        self.cases.iter().map(|case| case.id.as_str()).collect()
    }
}

/// A recorded episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeRequest {
    /// The id of the case.
    pub case: String,
    /// The variant in which it takes place.
    pub variant: u32,
    /// Its start and route, of which the case has a reference; absent in streams, where the expert plans one from `begin`.
    pub reference: Option<(Start, Route)>,
    /// Where the agent begins; absent: where the reference does.
    pub begin: Option<State>,
    /// The action of each step; `None` where no answer could be read, and the agent stayed.
    pub actions: Vec<Option<ActionCode>>,
    /// Where it stands in its stream.
    pub stream: Option<StreamBlockPlace>,
    /// What is answered beside the steps.
    pub parts: EpisodeParts,
}

/// What an answer about an episode has beside its steps. The default is nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EpisodeParts {
    /// [`ActedEpisode::facts`].
    pub facts: bool,
    /// [`ActedEpisode::reference`].
    pub reference: bool,
    /// [`ActedEpisode::scenery`].
    pub scenery: bool,
}

/// A block of a sequence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamBlockPlace {
    /// The stream.
    pub stream: u32,
    /// The order of its blocks.
    pub order: StreamOrder,
    /// The place of the block in this order.
    pub place: u32,
    /// The block, as drawn.
    pub block: u32,
}

/// An episode that was acted out. Index 0 of lists by step is its begin, index `t` the state after step `t`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActedEpisode {
    /// The number of the task's type.
    pub task: u8,
    /// The instruction.
    pub instruction: String,
    /// The states.
    pub states: Vec<State>,
    /// The feedback to action `t`; [`FeedbackCode::START`] first.
    pub feedback: Vec<FeedbackCode>,
    /// The steps at which sub-goals were completed, in order.
    pub sub_goals: Vec<u32>,
    /// Sub-goals of the whole task.
    pub required: u32,
    /// Its facts, as the world tells them when an episode ends; without those of what is learned.
    pub facts: Option<Map<String, Value>>,
    /// The first step at which the agent ran into what the variant changed.
    pub conflict_at: Option<u32>,
    /// What the expert does from the same begin; absent if the task cannot be completed.
    pub reference: Option<ActedReference>,
    /// What a map of it shows.
    pub scenery: Option<EpisodeScenery>,
}

/// The reference of an episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActedReference {
    /// The actions. They may go on after the task is complete.
    pub actions: Vec<ActionCode>,
    /// The states, the begin first.
    pub states: Vec<State>,
    /// The steps in which they complete the task, l_i.
    pub length: u32,
    /// Whether the case's original demonstration does not complete the task in this variant.
    pub invalidated: bool,
}

/// What a map of an episode shows.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeScenery {
    /// By step, the cells that came into view for the first time.
    pub came_into_view: Vec<Vec<Cell>>,
    /// The closed cells.
    pub closed: Vec<Cell>,
    /// The items that the task is about.
    pub targets: Vec<Target>,
    /// In a stream: how the world differs from that of the block before in the order of the sequence, in words; for the first
    /// block, from the unchanged world.
    pub changes: Vec<String>,
}

/// An item that a task is about.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Its letter in the task.
    pub letter: char,
    /// Its name.
    pub name: String,
    /// The cell in front of it.
    pub cell: Cell,
}

/// Demonstrations of which an episode's memory was made, or that it named.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DemonstrationsRequest {
    /// The id of the episode's case.
    pub case: String,
    /// The set of its demonstrations.
    pub set: Demonstrations,
    /// More demonstrations: the ids of their cases, and which.
    pub more: Vec<(String, DemonstrationKind)>,
    /// The variant in which the episode takes place.
    pub variant: u32,
    /// Whether an expert planned the demonstrations in that variant.
    pub planned: bool,
}

/// A demonstration that was acted out. Lists by step as in [`ActedEpisode`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActedDemonstration {
    /// The id of its case.
    pub case: String,
    /// Which of the case's demonstrations.
    pub kind: DemonstrationKind,
    /// The variant in which it takes place.
    pub variant: u32,
    /// The number of the task's type.
    pub task: u8,
    /// The instruction.
    pub instruction: String,
    /// The states.
    pub states: Vec<State>,
    /// The feedback.
    pub feedback: Vec<FeedbackCode>,
    /// The actions.
    pub actions: Vec<ActionCode>,
    /// The steps at which sub-goals were completed, in order.
    pub sub_goals: Vec<u32>,
    /// The steps that complete the task; `None` if they do not.
    pub length: Option<u32>,
    /// Whether it is no longer valid: its actions do not complete its task in the variant of the episode. `false` for one of
    /// another world, and for one that was planned in that variant.
    pub is_stale: bool,
    /// The closed cells of its variant.
    pub closed: Vec<Cell>,
    /// The items that its task is about.
    pub targets: Vec<Target>,
}

/// A variant of the world, from above.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// A text for each row from row 0, the most southern: `.` is free floor, `x` is floor that is closed, `#` anything else.
    pub floor: Vec<String>,
    /// The drawing of the floor with its items, as SVG.
    pub svg: String,
    /// Side of a cell and width of the border in the drawing.
    pub measures: (u32, u32),
}

impl Scene {
    /// The mark of a cell; `None` outside of the floor plan.
    fn mark(&self, cell: Cell) -> Option<u8> {
        self.floor.get(usize::from(cell.y))?.as_bytes().get(usize::from(cell.x)).copied()
    }

    /// Whether the cell is floor, closed or not.
    pub fn is_floor(&self, cell: Cell) -> bool {
        matches!(self.mark(cell), Some(b'.' | b'x'))
    }

    /// Columns and rows.
    pub fn size(&self) -> (u8, u8) {
        let columns = self.floor.first().map_or(0, String::len);
        (columns as u8, self.floor.len() as u8)
    }
}
