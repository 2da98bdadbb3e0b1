//! The warehouse as geometry: every mesh placed and lit, cut into objects with bounds.
//!
//! A scene is made once and is a pure value; nothing here knows the device. `assembly` puts meshes
//! together, `racks` and `hall` say which stand where.

mod assembly;
mod hall;
mod racks;
mod showcase;

use std::ops::Range;

use domain::{Cell, Heading};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use warehouse::{Layout, Variant, Warehouse};

use super::text::Atlas;
use super::vertex::{Placement, PlateVertex, SolidVertex, TextVertex};
use assembly::Assembly;

pub(super) use showcase::showcase;

/// Triangles of one pipeline: what they are made of, and which corners make them up.
pub(super) struct Layer<V> {
    pub(super) vertices: Vec<V>,
    pub(super) indices: Vec<u32>,
}

impl<V> Default for Layer<V> {
    fn default() -> Self {
        Self { vertices: Vec::new(), indices: Vec::new() }
    }
}

/// A piece of the scene that is drawn or left out as a whole: ranges of each layer's indices.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Object {
    pub(super) min: [f32; 3],
    pub(super) max: [f32; 3],
    /// Lit triangles for a look from nearby, and for one from several metres.
    pub(super) near: Range<usize>,
    pub(super) far: Range<usize>,
    pub(super) plate: Range<usize>,
    pub(super) text: Range<usize>,
}

/// An upright sheet, from the floor to the racks' height, that nobody sees through. In plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Screen {
    pub(super) from: [f32; 2],
    pub(super) to: [f32; 2],
}

/// Everything there is to draw.
pub(super) struct Scene {
    pub(super) solid: Layer<SolidVertex>,
    /// The plane of each triangle of `solid`: its unit normal, and how far along that it lies.
    pub(super) planes: Vec<[f32; 4]>,
    pub(super) plate: Layer<PlateVertex>,
    pub(super) text: Layer<TextVertex>,
    pub(super) objects: Vec<Object>,
    pub(super) screens: Vec<Screen>,
    /// The indices, in the solid layer, of one side of a barricade; placed by [`barricade_sides`].
    pub(super) barricade: Range<usize>,
    pub(super) atlas: Atlas,
}

impl Scene {
    /// Builds the scene of `warehouse`.
    pub(super) fn new(warehouse: &Warehouse) -> Self {
        let mut assembly = Assembly::default();
        hall::build(&mut assembly, &warehouse.layout);
        racks::build(&mut assembly, warehouse);
        assembly.finish()
    }

    /// The bounds of a side of a barricade that stands at `side`.
    pub(super) fn barricade_at(&self, side: Placement) -> Object {
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        let [cos, sin] = side.turn;
        for &corner in &self.solid.indices[self.barricade.clone()] {
            let [x, y, z] = self.solid.vertices[corner as usize].position;
            // As in `solid.wgsl`.
            let position = [side.at[0] + cos * x - sin * y, side.at[1] + sin * x + cos * y, z];
            for axis in 0..3 {
                min[axis] = min[axis].min(position[axis]);
                max[axis] = max[axis].max(position[axis]);
            }
        }
        Object { min, max, ..Object::default() }
    }
}

/// Where the sides of the barricades of `variant` stand: on every side of a closed cell that borders
/// open floor.
pub(super) fn barricade_sides(layout: &Layout, variant: &Variant) -> Vec<Placement> {
    let mut sides = Vec::new();
    for &cell in variant.closed() {
        for heading in Heading::ALL {
            let Some(beyond) = layout.free_neighbour(cell, heading) else { continue };
            if !variant.is_closed(beyond) {
                let (cos, sin) = vector(heading.opposite().right());
                sides.push(Placement { at: side_of(cell, heading), turn: [cos, sin] });
            }
        }
    }
    sides
}

fn vector(heading: Heading) -> (f32, f32) {
    let (x, y) = heading.vector();
    (f32::from(x), f32::from(y))
}

/// The frame of an upright face in the middle of which, on the floor, `at` lies, and which is looked at
/// along `viewer`: x to the right, y ahead, z up.
fn world_from_face(at: [f32; 2], viewer: Heading) -> Isometry3<f32> {
    let (rx, ry) = vector(viewer.right());
    Isometry3::from_parts(
        Translation3::new(at[0], at[1], 0.0),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), ry.atan2(rx)),
    )
}

/// The middle of a cell's side towards `heading`.
fn side_of(cell: Cell, heading: Heading) -> [f32; 2] {
    let ((x, y), (fx, fy)) = (cell.centre(), vector(heading));
    [x + fx * 0.5, y + fy * 0.5]
}
