//! The world and its tasks as pure values: nothing here renders, talks or waits.
//!
//! - [`layout`]: the floor plan; [`catalogue`]: what stands on the racks; [`Warehouse`]: both, checked.
//! - [`dynamics`]: one function, pose + action + variant -> pose + feedback.
//! - [`task`]: the ten task types; [`progress`]: the one checker that scores any walk.
//! - [`case`]: a task with its six trajectories.
//!
//! Everything is integer arithmetic on a grid, so every machine computes the same.

pub mod asset;
pub mod case;
pub mod catalogue;
pub mod dynamics;
pub mod layout;
pub mod progress;
pub mod task;
mod world;

pub use asset::AssetError;
pub use case::{Case, CaseSet, Replay, Start, Trajectory};
pub use catalogue::{Catalogue, Category, ItemType, Shape};
pub use dynamics::{MAX_STEPS, Variant, step};
pub use layout::{Aisle, Axis, Layout, Square};
pub use progress::Progress;
pub use task::{Group, Phase, Task};
pub use world::{Item, Warehouse};
