//! The warehouse as geometry: every mesh placed and lit, and grouped into objects with bounds.
//!
//! A scene is a pure value, built once; nothing here knows a backend. `assembly` collects meshes, `racks` and `hall`
//! place them.

mod assembly;
mod frames;
mod hall;
mod object;
mod racks;

use domain::Appearance;
use warehouse::Warehouse;

use assembly::Assembly;

pub(super) use frames::barricade_sides;
pub(super) use object::{Occluder, Scene, SceneObject, StockObjects};

impl Scene {
    /// The scene of a hall with each of `stocks`, which differ in their items only.
    pub(super) fn new(stocks: &[Warehouse], appearance: Appearance) -> Self {
        let mut assembly = Assembly::new(appearance);
        if let Some(first) = stocks.first() {
            hall::build(&mut assembly, &first.layout);
        }
        let stocks = racks::build(&mut assembly, stocks);
        assembly.finish(stocks)
    }
}
