//! Decides which rack faces are bays, how bays meet, and what stands in them.

use std::collections::HashMap;

use domain::{Cell, Heading};
use nalgebra::{Isometry3, Point3};
use plates::Plate;
use warehouse::{Axis, Catalogue, FaceKind, Item, Layout, Square, Warehouse};

use super::assembly::{Assembly, Label, PANEL_INDICES};
use super::frames::{side_of, world_from_face};
use super::object::{Occluder, StockObjects};
use crate::renderer::mesh::builder::MeshPart;
use crate::renderer::mesh::builder::{Detail, Mesh};
use crate::renderer::mesh::items::item;
use crate::renderer::mesh::rack::{
    BAY_DEPTH_M, BAY_NUMBER_M, BayEdge, CLOSED_FACE_OCCLUDER_M, LABEL_M, PANEL_OFFSET_M, RackBay,
    SHALLOW_BAY_DEPTH_M, SHELF_TOP_M, closed_face,
};

/// Adds every rack face that borders floor: a bay where an item stands; elsewhere a bay or, at the end of a row, a sheet
/// of steel. A face that is the same with several stocks is added once. Returns what each stock consists of, together with
/// all that `assembly` holds already.
pub(super) fn build(assembly: &mut Assembly, stocks: &[Warehouse]) -> Vec<StockObjects> {
    let hall = assembly.stock();
    let mut built: HashMap<(Cell, Heading), Vec<BuiltFace>> = HashMap::new();
    let mut build = |assembly: &mut Assembly, warehouse: &Warehouse| {
        let faces = RackFaces::new(warehouse, assembly.appearance().plates);
        let mut stock = hall.clone();
        for (rack, side) in sides(&warehouse.layout) {
            let Some(face) = faces.face(rack, side) else { continue };
            let built = built.entry((rack, side)).or_default();
            let at = built.iter().position(|built| built.face == face).unwrap_or_else(|| {
                let frame = world_from_face(side_of(rack, side), side.opposite());
                built.push(face.build(assembly, &frame, &warehouse.catalogue));
                built.len() - 1
            });
            stock.objects.push(built[at].object);
            if faces.holds_item(rack, side) {
                stock.items.insert((rack, side), built[at].object);
            }
            stock.occluders.extend(&built[at].occluders);
        }
        stock
    };
    let Some((first, others)) = stocks.split_first() else { return Vec::new() };
    let mut stocks = vec![build(assembly, first)];
    if !others.is_empty() {
        reserve_numbers(assembly, &first.layout);
    }
    stocks.extend(others.iter().map(|warehouse| build(assembly, warehouse)));
    stocks
}

/// All sides of all rack squares.
fn sides(layout: &Layout) -> impl Iterator<Item = (Cell, Heading)> + '_ {
    let racks = layout.cells().filter(|&cell| layout.square(cell) == Square::Rack);
    racks.flat_map(|rack| Heading::ALL.map(|side| (rack, side)))
}

/// Gives the number of every bay its place in the atlas, so that the pixels of a stock do not depend on the others. The
/// names of all types are there with the first stock, in which every type has an item.
fn reserve_numbers(assembly: &mut Assembly, layout: &Layout) {
    if !assembly.appearance().labels {
        return;
    }
    assembly.separate_texts();
    for (rack, side) in sides(layout) {
        if let Some(standpoint) = layout.free_neighbour(rack, side) {
            assembly.reserve_text(BAY_NUMBER_M, &number_label(&bay_number(layout, standpoint)));
        }
    }
}

/// What a side of a rack looks like.
#[derive(Debug, Clone, PartialEq)]
enum Face {
    /// A sheet of steel.
    Closed,
    /// Shelves without an item.
    RackBay(RackBay),
    /// Shelves with an item of this type, under this number.
    Stocked(RackBay, usize, String),
}

/// A face that has been added.
struct BuiltFace {
    face: Face,
    object: u32,
    occluders: Vec<Occluder>,
}

impl Face {
    /// Adds the face as one object.
    fn build(
        self,
        assembly: &mut Assembly,
        frame: &Isometry3<f32>,
        catalogue: &Catalogue,
    ) -> BuiltFace {
        let object = match &self {
            Self::Closed => assembly.object(|a| a.solid(&closed_face(), frame, MeshPart::Rack)),
            Self::RackBay(bay) => assembly.object_with_far(
                |a| a.solid(&bay.mesh(Detail::Near), frame, MeshPart::Rack),
                |a| a.solid(&bay.mesh(Detail::Far), frame, MeshPart::Rack),
            ),
            Self::Stocked(bay, item_type, number) => {
                stocked_bay(assembly, frame, bay, catalogue, *item_type, number)
            }
        };
        let panels = match &self {
            Self::Closed => vec![CLOSED_FACE_OCCLUDER_M],
            Self::RackBay(bay) | Self::Stocked(bay, ..) => bay.occluders(),
        };
        let at = |[x, y]: [f32; 2]| {
            let point = frame * Point3::new(x, y, 0.0);
            [point.x, point.y]
        };
        let occluder = |[from, to]: [[f32; 2]; 2]| Occluder { from: at(from), to: at(to) };
        BuiltFace { object, occluders: panels.into_iter().map(occluder).collect(), face: self }
    }
}

/// Adds one object: a bay with its item, the plate above it, the label below it and the bay's number.
fn stocked_bay(
    assembly: &mut Assembly,
    world_from_face: &Isometry3<f32>,
    bay: &RackBay,
    catalogue: &Catalogue,
    item_type: usize,
    number: &str,
) -> u32 {
    let kind = &catalogue.types[item_type];
    let category = &catalogue.categories[kind.category];
    let [near_item, far_item] = [Detail::Near, Detail::Far]
        .map(|detail| on_shelf(item(kind.shape, kind.colour, detail), bay.depth));
    let solid = |a: &mut Assembly, item: &Mesh, detail| {
        a.solid(item, world_from_face, MeshPart::Item);
        a.solid(&bay.mesh(detail), world_from_face, MeshPart::Rack);
    };
    let near = |a: &mut Assembly| {
        solid(a, &near_item, Detail::Near);
        a.plate(world_from_face, Plate::new(&category.name, &kind.name));
        let label = Label {
            text: &kind.name,
            ink: [16, 16, 18],
            paper: [248, 248, 244],
            texels_per_m: 560.0,
        };
        a.text(world_from_face, LABEL_M, PANEL_OFFSET_M, &label);
        a.text(world_from_face, BAY_NUMBER_M, PANEL_OFFSET_M, &number_label(number));
    };
    let object = assembly.object_with_far(near, |a| solid(a, &far_item, Detail::Far));
    let label = if assembly.appearance().labels { PANEL_INDICES } else { 0 };
    assembly.note_item(object, [near_item.indices.len(), far_item.indices.len(), label]);
    object
}

fn number_label(number: &str) -> Label<'_> {
    Label { text: number, ink: [250, 250, 250], paper: [36, 44, 58], texels_per_m: 300.0 }
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

/// Decides for every rack square which of its faces are bays.
struct RackFaces<'a> {
    layout: &'a Layout,
    /// By rack square and side.
    items: HashMap<(Cell, Heading), &'a Item>,
    /// Whether a plate hangs above every item.
    plates: bool,
}

impl<'a> RackFaces<'a> {
    fn new(warehouse: &'a Warehouse, plates: bool) -> Self {
        let items = warehouse.items.iter().map(|item| ((item.rack, item.face), item)).collect();
        Self { layout: &warehouse.layout, items, plates }
    }

    /// What the side looks like; `None` if it borders no floor.
    fn face(&self, rack: Cell, face: Heading) -> Option<Face> {
        match (self.kind(rack, face), self.items.get(&(rack, face))) {
            (FaceKind::Inner, _) => None,
            (FaceKind::Closed, _) => Some(Face::Closed),
            (FaceKind::Bay, None) => Some(Face::RackBay(self.bay(rack, face))),
            (FaceKind::Bay, Some(item)) => {
                let number = bay_number(self.layout, item.standpoint);
                Some(Face::Stocked(self.bay(rack, face), item.item_type, number))
            }
        }
    }

    fn holds_item(&self, rack: Cell, face: Heading) -> bool {
        self.items.contains_key(&(rack, face))
    }

    fn kind(&self, rack: Cell, face: Heading) -> FaceKind {
        FaceKind::of(self.layout, |rack, face| self.holds_item(rack, face), rack, face)
    }

    fn bay(&self, rack: Cell, face: Heading) -> RackBay {
        let viewer = face.opposite();
        RackBay {
            left: self.edge(rack, face, viewer.left()),
            right: self.edge(rack, face, viewer.right()),
            depth: self.depth(rack),
            stocked: self.holds_item(rack, face),
            plate: self.plates && self.holds_item(rack, face),
            seed: u32::from(rack.x) * 131 + u32::from(rack.y) * 4 + face as u32 + 1,
        }
    }

    /// The depth of bays in this square: shallow where several share it, so that they do not overlap.
    fn depth(&self, rack: Cell) -> f32 {
        let bays = Heading::ALL.into_iter().filter(|&face| self.kind(rack, face) == FaceKind::Bay);
        if bays.count() > 1 { SHALLOW_BAY_DEPTH_M } else { BAY_DEPTH_M }
    }

    /// How the bay at `face` ends towards `side`.
    fn edge(&self, rack: Cell, face: Heading, side: Heading) -> BayEdge {
        match self.kind(rack, side) {
            FaceKind::Closed => BayEdge::Closed,
            // Of two bays around a corner, the one that faces east or west keeps its width. A sheet separates
            // them, so that an item is visible through its own face only.
            FaceKind::Bay if matches!(face, Heading::E | Heading::W) => BayEdge::Closed,
            FaceKind::Bay => BayEdge::Narrowed(self.depth(rack)),
            FaceKind::Inner => match rack.step(side) {
                Some(next) if self.kind(next, face) == FaceKind::Bay => {
                    let depth = self.depth(next);
                    if depth < self.depth(rack) { BayEdge::Step(depth) } else { BayEdge::Joined }
                }
                _ => BayEdge::Ended,
            },
        }
    }
}
