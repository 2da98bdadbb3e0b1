//! The world and its tasks as pure values: nothing here renders, communicates or waits.
//!
//! - [`layout`]: the floor plan; [`catalogue`]: the items on the racks; [`Warehouse`]: both, checked.
//! - [`dynamics`]: one function from pose, action and variant to pose and feedback.
//! - [`task`]: the ten task types; [`progress`]: the checker that decides which sub-goals a trajectory completes.
//! - [`Trajectory`]: a start and actions; [`case`]: a task with its six trajectories; [`case_file`]: a set of cases as a text file.
//! - [`History`]: a demonstration of a case; [`Demonstrated`]: it in its world; [`mixed`]: histories of other tasks.
//! - [`Elsewhere`]: another warehouse, in which the tasks of cases are demonstrated.
//! - [`WorldState`]: a warehouse after changes; [`stream`]: blocks of cases with events between them.
//! - [`appearance()`], [`ExchangedItems`]: what a mismatch between demonstrations and test is.
//! - [`EndedEpisode`]: the facts of an episode, with the kind of its failure.
//! - [`plan`]: expert trajectories and the fewest steps; [`sight`]: which items are in view, computed on the floor plan.
//! - [`case_book`]: what a run knows about the cases, as data; [`act`]: episodes and demonstrations, acted out for others.
//! - [`GeneratedWorld`]: a warehouse from a seed; [`CaseSet::generate`]: cases from a seed; [`validate`](mod@validate): every constraint checked by replay; [`map`]:
//!   maps as SVG.
//!
//! All arithmetic is in integers on a grid, so every machine computes the same.

pub mod act;
pub mod asset;
pub mod case;
pub mod case_book;
pub mod case_file;
pub mod catalogue;
mod constraints;
mod declaration;
mod demonstrated;
mod demonstrations;
mod draw;
pub mod dynamics;
mod elsewhere;
mod elsewhere_source;
mod ended;
mod event_recorder;
mod failure;
mod generate;
mod generate_world;
pub mod layout;
pub mod map;
mod mismatch;
pub mod mixed;
mod order;
mod paraphrase;
mod path;
pub mod plan;
pub mod progress;
mod racks;
mod route;
pub mod sight;
mod state;
pub mod stream;
mod swapped;
pub mod task;
mod task_type;
#[cfg(test)]
mod testing;
mod trajectory;
pub mod validate;
mod world;
mod worlds;

pub use asset::AssetError;
pub use case::{Case, CaseSet, History, TrajectoryKind};
pub use case_file::file_texts;
pub use catalogue::{Catalogue, Category, ItemType, Shape};
pub use constraints::MAX_DETOUR_PERCENT;
pub use declaration::declaration;
pub use demonstrated::Demonstrated;
pub use dynamics::{Variant, step};
pub use elsewhere::{ELSEWHERE_VARIANT, Elsewhere};
pub use elsewhere_source::ElsewhereError;
pub use ended::EndedEpisode;
pub use event_recorder::EventRecorder;
pub use generate::{GenerateError, MAX_CASES, SHIPPED_COUNT, SHIPPED_SEED};
pub use generate_world::{GeneratedWorld, MIN_SIDE, corridors};
pub use layout::{Aisle, Axis, Layout, MAX_SIDE, Square};
pub use mismatch::{ExchangedItems, appearance};
pub use mixed::Overlap;
pub use progress::Progress;
pub use racks::FaceKind;
pub use state::{StockChange, WorldChange, WorldChangeError, WorldState};
pub use stream::{StreamError, StreamSet};
pub use swapped::{GREY_VARIANT, SwappedPoses, every_pose};
pub use task::{Phase, Task};
pub use task_type::{TaskGroup, TaskType, UnknownTaskType};
pub use trajectory::{Replay, Trajectory};
pub use validate::validate;
pub use world::{CATALOGUE_FILE, Item, LAYOUT_FILE, Warehouse};
pub use worlds::{RunWorlds, RunWorldsError};
