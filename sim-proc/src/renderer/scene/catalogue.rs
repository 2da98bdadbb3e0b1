//! The catalogue as a scene: every type in a bay of its own, far apart on an empty floor.

use domain::{Appearance, Heading};
use nalgebra::Isometry3;
use warehouse::Catalogue;

use super::assembly::Assembly;
use super::frames::world_from_face;
use super::object::Scene;
use super::racks;
use crate::renderer::light::MeshPart;
use crate::renderer::mesh::hall;
use crate::renderer::mesh::rack::{BAY_DEPTH_M, BayEdge, RackBay};

/// Distance between two bays, in metres.
const SPACING_M: f32 = 8.0;

/// Where a type stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::renderer) struct ItemStand {
    /// The middle of its bay's face on the floor plan.
    pub(in crate::renderer) at: [f32; 2],
    /// The direction in which a viewer faces it.
    pub(in crate::renderer) viewer: Heading,
}

/// The scene, and the stand of every type in the order of the catalogue.
pub(in crate::renderer) fn catalogue_scene(
    catalogue: &Catalogue,
    appearance: Appearance,
) -> (Scene, Vec<ItemStand>) {
    let mut assembly = Assembly::new(appearance);
    let mut stands = Vec::new();
    for index in 0..catalogue.types.len() {
        let stand = ItemStand { at: [SPACING_M * index as f32, 0.0], viewer: Heading::N };
        let bay = RackBay {
            left: BayEdge::Closed,
            right: BayEdge::Closed,
            depth: BAY_DEPTH_M,
            stocked: true,
            plate: appearance.plates,
            seed: index as u32 + 1,
        };
        let frame = world_from_face(stand.at, stand.viewer);
        let number = format!("{:02}", index + 1);
        racks::stocked_bay(&mut assembly, &frame, &bay, catalogue, index, &number);
        let floor = hall::open_floor(stand.at, SPACING_M / 2.0);
        assembly.object(|a| a.solid(&floor, &Isometry3::identity(), MeshPart::Floor));
        stands.push(stand);
    }
    let stock = assembly.stock();
    (assembly.finish(vec![stock]), stands)
}
