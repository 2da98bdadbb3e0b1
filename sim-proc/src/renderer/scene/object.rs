//! The finished scene: triangles grouped into objects with bounds.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::OnceLock;

use domain::{Cell, Heading};
use raster::{Geometry, PackedGeometry, Placement};

/// A part of the scene that is drawn or left out as a whole: its bounds, and ranges of each layer's indices.
#[derive(Debug, Clone, Default, PartialEq)]
pub(in crate::renderer) struct SceneObject {
    pub(in crate::renderer) min: [f32; 3],
    pub(in crate::renderer) max: [f32; 3],
    /// Lit triangles in full detail.
    pub(in crate::renderer) near: Range<usize>,
    /// Lit triangles to be drawn from several metres away.
    pub(in crate::renderer) far: Range<usize>,
    pub(in crate::renderer) plate: Range<usize>,
    pub(in crate::renderer) text: Range<usize>,
    /// How many indices at the beginning of `near`, `far` and `text` are those of an item and its label.
    pub(in crate::renderer) item: [usize; 3],
}

impl SceneObject {
    /// The object without the item in it, its plate and its label.
    pub(in crate::renderer) fn without_item(&self) -> Self {
        let [near, far, text] = self.item;
        Self {
            near: self.near.start + near..self.near.end,
            far: self.far.start + far..self.far.end,
            plate: self.plate.end..self.plate.end,
            text: self.text.start + text..self.text.end,
            item: [0; 3],
            ..self.clone()
        }
    }
}

/// An opaque upright panel from the floor to the racks' height, by its ends on the floor plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::renderer) struct Occluder {
    pub(in crate::renderer) from: [f32; 2],
    pub(in crate::renderer) to: [f32; 2],
}

/// Everything there is to draw.
pub(in crate::renderer) struct Scene {
    pub(in crate::renderer) geometry: Geometry,
    /// The plane of each lit triangle: its unit normal, and the normal's dot product with any point of the triangle.
    pub(in crate::renderer) planes: Vec<[f32; 4]>,
    pub(in crate::renderer) objects: Vec<SceneObject>,
    /// What each stock consists of.
    pub(in crate::renderer) stocks: Vec<StockObjects>,
    /// What [`Scene::packed`] has made.
    pub(in crate::renderer) packed: OnceLock<PackedGeometry>,
}

/// The objects that there are with one of a scene's stocks, and what hides others. Every stock has the same number of
/// objects, and the objects at the same place of two stocks are the same side of a rack, or one object.
#[derive(Debug, Clone, Default, PartialEq)]
pub(in crate::renderer) struct StockObjects {
    /// Indices of the scene's objects.
    pub(in crate::renderer) objects: Vec<u32>,
    pub(in crate::renderer) occluders: Vec<Occluder>,
    /// The object with the item on this side of this rack square.
    pub(in crate::renderer) items: HashMap<(Cell, Heading), u32>,
}

impl Scene {
    /// The geometry as the CPU draws it, made at the first call: a process that finds all its views in a folder, or draws
    /// on a graphics card, needs none.
    pub(in crate::renderer) fn packed(&self) -> &PackedGeometry {
        self.packed.get_or_init(|| PackedGeometry::new(&self.geometry))
    }

    /// The bounds of a barricade's side that stands at `side`.
    pub(in crate::renderer) fn barricade_at(&self, side: Placement) -> SceneObject {
        let solid = &self.geometry.solid;
        let [cos, sin] = side.turn;
        let corners = solid.indices[self.geometry.barricade.clone()].iter().map(|&corner| {
            let [x, y, z] = solid.vertices[corner as usize].position;
            // As in `solid.wgsl`.
            [side.at[0] + cos * x - sin * y, side.at[1] + sin * x + cos * y, z]
        });
        let [min, max] = bounds(corners);
        SceneObject { min, max, ..SceneObject::default() }
    }
}

/// The least and the greatest coordinates of these points.
pub(super) fn bounds(points: impl Iterator<Item = [f32; 3]>) -> [[f32; 3]; 2] {
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in points {
        for axis in 0..3 {
            min[axis] = min[axis].min(point[axis]);
            max[axis] = max[axis].max(point[axis]);
        }
    }
    [min, max]
}
