//! Coordinate frames of faces and walls in the world.

use domain::{Cell, Heading};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use raster::Placement;
use warehouse::{Layout, Variant};

/// The unit vector towards `heading` on the floor plan.
pub(in crate::renderer) fn vector(heading: Heading) -> (f32, f32) {
    let (x, y) = heading.vector();
    (f32::from(x), f32::from(y))
}

/// The frame of an upright face whose middle stands at `at` and which a viewer faces in the direction `viewer`: x points
/// to the right, y ahead, z up.
pub(super) fn world_from_face(at: [f32; 2], viewer: Heading) -> Isometry3<f32> {
    let (rx, ry) = vector(viewer.right());
    Isometry3::from_parts(
        Translation3::new(at[0], at[1], 0.0),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), ry.atan2(rx)),
    )
}

/// The middle of a cell's side towards `heading`.
pub(super) fn side_of(cell: Cell, heading: Heading) -> [f32; 2] {
    let ((x, y), (fx, fy)) = (cell.centre(), vector(heading));
    [x + fx * 0.5, y + fy * 0.5]
}

/// Where the sides of the barricades of `variant` stand: on every side of a closed cell that borders open floor.
pub(in crate::renderer) fn barricade_sides(layout: &Layout, variant: &Variant) -> Vec<Placement> {
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
