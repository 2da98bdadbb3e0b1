//! Decides which rack faces are bays, how bays meet, and what stands in them.

use domain::{Cell, Heading};
use nalgebra::{Isometry3, Point3};
use plates::Plate;
use warehouse::{Axis, Catalogue, Layout, Square, Warehouse};

use super::assembly::{Assembly, Label};
use super::frames::{side_of, world_from_face};
use crate::renderer::light::Light;
use crate::renderer::mesh::builder::{Detail, Mesh};
use crate::renderer::mesh::items::item;
use crate::renderer::mesh::rack::{
    BAY_DEPTH_M, BAY_NUMBER_M, Bay, CLOSED_FACE_OCCLUDER_M, Edge, LABEL_M, PANEL_OFFSET_M,
    SHALLOW_BAY_DEPTH_M, SHELF_TOP_M, closed_face,
};

/// Adds every rack face that borders floor: a bay where an item stands; elsewhere a bay or, at the end of a row, a sheet
/// of steel.
pub(super) fn build(assembly: &mut Assembly, warehouse: &Warehouse) {
    let faces = RackFaces { warehouse };
    let layout = &warehouse.layout;
    for rack in layout.cells().filter(|&cell| layout.square(cell) == Square::Rack) {
        for face in Heading::ALL {
            let frame = world_from_face(side_of(rack, face), face.opposite());
            match faces.kind(rack, face) {
                FaceKind::Inner => {}
                FaceKind::Closed => {
                    assembly.object(|a| a.solid(&closed_face(), &frame, Light::Bay));
                    let [from, to] = CLOSED_FACE_OCCLUDER_M;
                    assembly.occluder(&frame, from, to);
                }
                FaceKind::Bay => {
                    let bay = faces.bay(rack, face);
                    let stock = warehouse.items.iter().find(|i| i.rack == rack && i.face == face);
                    if let Some(stock) = stock {
                        let number = bay_number(layout, stock.standpoint);
                        let catalogue = &warehouse.catalogue;
                        stocked_bay(assembly, &frame, &bay, catalogue, stock.item_type, &number);
                    } else {
                        assembly.object_with_far(
                            |a| a.solid(&bay.mesh(Detail::Near), &frame, Light::Bay),
                            |a| a.solid(&bay.mesh(Detail::Far), &frame, Light::Bay),
                        );
                    }
                    for [from, to] in bay.occluders() {
                        assembly.occluder(&frame, from, to);
                    }
                }
            }
        }
    }
}

/// Adds one object: a bay with its item, the plate above it, the label below it and the bay's number.
pub(super) fn stocked_bay(
    assembly: &mut Assembly,
    world_from_face: &Isometry3<f32>,
    bay: &Bay,
    catalogue: &Catalogue,
    item_type: usize,
    number: &str,
) {
    let kind = &catalogue.types[item_type];
    let category = &catalogue.categories[kind.category];
    let solid = |a: &mut Assembly, detail| {
        let item = on_shelf(item(kind.shape, kind.colour, detail), bay.depth);
        a.solid(&item, world_from_face, Light::Shelf);
        a.solid(&bay.mesh(detail), world_from_face, Light::Bay);
    };
    let near = |a: &mut Assembly| {
        solid(a, Detail::Near);
        a.plate(world_from_face, Plate::new(&category.name, &kind.name));
        let label = Label {
            text: &kind.name,
            ink: [16, 16, 18],
            paper: [248, 248, 244],
            texels_per_m: 560.0,
        };
        a.text(world_from_face, LABEL_M, PANEL_OFFSET_M, &label);
        let number =
            Label { text: number, ink: [250, 250, 250], paper: [36, 44, 58], texels_per_m: 300.0 };
        a.text(world_from_face, BAY_NUMBER_M, PANEL_OFFSET_M, &number);
    };
    assembly.object_with_far(near, |a| solid(a, Detail::Far));
}

/// Moves an item's mesh onto the shelf of a bay this deep. In a shallow bay it is scaled down.
fn on_shelf(mut mesh: Mesh, depth: f32) -> Mesh {
    let half_depth = mesh.vertices.iter().map(|v| v.position.y.abs()).fold(0.0, f32::max);
    let (scale, y) = if depth < BAY_DEPTH_M {
        // Smaller than the depth alone demands: a bay around the corner takes some of this one's width.
        (f32::min(0.72, (depth / 2.0 - 0.01) / half_depth), depth / 2.0)
    } else {
        (1.0, 0.29)
    };
    for vertex in &mut mesh.vertices {
        let p = vertex.position.coords * scale;
        vertex.position = Point3::new(p.x, p.y + y, p.z + SHELF_TOP_M);
    }
    mesh
}

/// The number of a bay: the first letter of the aisle's name without the word "aisle", the number in the name if there is one,
/// and the position along the aisle.
fn bay_number(layout: &Layout, standpoint: Cell) -> String {
    let Some(aisle) = layout.aisle(standpoint) else { return String::new() };
    let word = aisle.name.split([' ', '-']).find(|w| !w.eq_ignore_ascii_case("aisle"));
    let letter = word.and_then(|w| w.chars().next()).unwrap_or('?').to_ascii_uppercase();
    let number: String = aisle.name.chars().filter(char::is_ascii_digit).collect();
    let along = match aisle.runs {
        Axis::NorthSouth => standpoint.y,
        Axis::EastWest => standpoint.x,
    };
    format!("{letter}{number}-{along:02}")
}

/// What a side of a rack square is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FaceKind {
    /// Not a rack, or no floor in front of it.
    Inner,
    /// A sheet of steel.
    Closed,
    /// Shelves.
    Bay,
}

/// Decides for every rack square which of its faces are bays.
struct RackFaces<'a> {
    warehouse: &'a Warehouse,
}

impl RackFaces<'_> {
    fn is_open(&self, rack: Cell, face: Heading) -> bool {
        self.warehouse.layout.free_neighbour(rack, face).is_some()
    }

    fn holds_item(&self, rack: Cell, face: Heading) -> bool {
        self.warehouse.items.iter().any(|item| item.rack == rack && item.face == face)
    }

    fn kind(&self, rack: Cell, face: Heading) -> FaceKind {
        let is_rack = self.warehouse.layout.square(rack) == Square::Rack;
        if !is_rack || !self.is_open(rack, face) {
            return FaceKind::Inner;
        }
        if self.holds_item(rack, face) {
            return FaceKind::Bay;
        }
        // Without an item, a face is a bay only if the square holds no other bay.
        let first_open = Heading::ALL.into_iter().find(|&other| self.is_open(rack, other));
        let any_item = Heading::ALL.into_iter().any(|other| self.holds_item(rack, other));
        if !any_item && first_open == Some(face) { FaceKind::Bay } else { FaceKind::Closed }
    }

    fn bay(&self, rack: Cell, face: Heading) -> Bay {
        let viewer = face.opposite();
        Bay {
            left: self.edge(rack, face, viewer.left()),
            right: self.edge(rack, face, viewer.right()),
            depth: self.depth(rack),
            stocked: self.holds_item(rack, face),
            seed: u32::from(rack.x) * 131 + u32::from(rack.y) * 4 + face as u32 + 1,
        }
    }

    /// The depth of bays in this square: shallow where several share it, so that they do not overlap.
    fn depth(&self, rack: Cell) -> f32 {
        let bays = Heading::ALL.into_iter().filter(|&face| self.kind(rack, face) == FaceKind::Bay);
        if bays.count() > 1 { SHALLOW_BAY_DEPTH_M } else { BAY_DEPTH_M }
    }

    /// How the bay at `face` ends towards `side`.
    fn edge(&self, rack: Cell, face: Heading, side: Heading) -> Edge {
        match self.kind(rack, side) {
            FaceKind::Closed => Edge::Closed,
            // Of two bays around a corner, the one that faces east or west keeps its width. A sheet separates
            // them, so that an item is visible through its own face only.
            FaceKind::Bay if matches!(face, Heading::E | Heading::W) => Edge::Closed,
            FaceKind::Bay => Edge::Narrowed(self.depth(rack)),
            FaceKind::Inner => match rack.step(side) {
                Some(next) if self.kind(next, face) == FaceKind::Bay => {
                    let depth = self.depth(next);
                    if depth < self.depth(rack) { Edge::Step(depth) } else { Edge::Joined }
                }
                _ => Edge::Ended,
            },
        }
    }
}
