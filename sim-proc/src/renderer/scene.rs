//! The warehouse as geometry: every mesh placed and lit, cut into objects with bounds.
//!
//! A scene is made once and is a pure value; nothing here knows the device.

use std::ops::Range;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use shm_types::plate::{self, Plate};
use shm_types::{Cell, Heading};
use warehouse::{Axis, Layout, Square, Variant, Warehouse};

use super::light::{Light, baked};
use super::mesh::builder::Mesh;
use super::mesh::hall;
use super::mesh::items::item;
use super::mesh::rack::{
    BAY_DEPTH_M, BAY_NUMBER_M, Bay, Edge, LABEL_M, PANEL_OFFSET_M, RACK_HEIGHT_M,
    SHALLOW_BAY_DEPTH_M, SHELF_TOP_M, closed_face,
};
use super::text::{Atlas, AtlasPlan, Lettering};
use super::vertex::{Placement, PlateVertex, SolidVertex, TextVertex};

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
    pub(super) solid: Range<usize>,
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
        let layout = &warehouse.layout;
        for cell in layout.free_cells() {
            assembly.object(|a| {
                a.solid(&hall::floor(layout, cell), &Isometry3::identity(), Light::Hall)
            });
        }
        assembly.racks(warehouse);
        assembly.walls(layout);
        assembly.overhead(layout);
        assembly.finish()
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
                let (x, y) = cell.centre();
                let (fx, fy) = vector(heading);
                let (cos, sin) = vector(heading.opposite().right());
                sides.push(Placement { at: [x + fx * 0.5, y + fy * 0.5], turn: [cos, sin] });
            }
        }
    }
    sides
}

fn vector(heading: Heading) -> (f32, f32) {
    let (x, y) = heading.vector();
    (f32::from(x), f32::from(y))
}

/// The frame of a rack's face: x right of somebody who looks at it, y into the rack, z up.
fn world_from_face(rack: Cell, face: Heading) -> Isometry3<f32> {
    let ((cx, cy), (fx, fy)) = (rack.centre(), vector(face));
    let (rx, ry) = vector(face.opposite().right());
    Isometry3::from_parts(
        Translation3::new(cx + fx * 0.5, cy + fy * 0.5, 0.0),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), ry.atan2(rx)),
    )
}

/// A panel of text before the atlas is drawn.
struct PanelCorner {
    vertex: TextVertex,
    texel: [u32; 2],
}

/// A scene under construction.
#[derive(Default)]
struct Assembly {
    solid: Layer<SolidVertex>,
    plate: Layer<PlateVertex>,
    text: Layer<PanelCorner>,
    objects: Vec<Object>,
    screens: Vec<Screen>,
    barricade: Range<usize>,
    atlas: AtlasPlan,
}

impl Assembly {
    /// Everything that `draw` adds is one object.
    fn object(&mut self, draw: impl FnOnce(&mut Self)) {
        let counts =
            |a: &Self| [a.solid.vertices.len(), a.plate.vertices.len(), a.text.vertices.len()];
        let ends = |a: &Self| [a.solid.indices.len(), a.plate.indices.len(), a.text.indices.len()];
        let (first, start) = (counts(self), ends(self));
        draw(self);
        let end = ends(self);
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        let solid = self.solid.vertices[first[0]..].iter().map(|v| v.position);
        let plate = self.plate.vertices[first[1]..].iter().map(|v| v.position);
        let text = self.text.vertices[first[2]..].iter().map(|v| v.vertex.position);
        for position in solid.chain(plate).chain(text) {
            for axis in 0..3 {
                min[axis] = min[axis].min(position[axis]);
                max[axis] = max[axis].max(position[axis]);
            }
        }
        self.objects.push(Object {
            min,
            max,
            solid: start[0]..end[0],
            plate: start[1]..end[1],
            text: start[2]..end[2],
        });
    }

    fn solid(&mut self, mesh: &Mesh, world_from_mesh: &Isometry3<f32>, light: Light) {
        let first = self.solid.vertices.len() as u32;
        self.solid.vertices.extend(mesh.vertices.iter().map(|vertex| SolidVertex {
            position: (world_from_mesh * vertex.position).into(),
            colour: baked(vertex, light),
        }));
        self.solid.indices.extend(mesh.indices.iter().map(|index| first + index));
    }

    /// A rectangle in a face's frame, `out` metres in front of it: its corners from the bottom left,
    /// counter-clockwise.
    fn panel(world_from_face: &Isometry3<f32>, [l, b, r, t]: [f32; 4], out: f32) -> [[f32; 3]; 4] {
        [[l, b], [r, b], [r, t], [l, t]]
            .map(|[x, z]| (world_from_face * Point3::new(x, -out, z)).into())
    }

    fn plate(&mut self, world_from_face: &Isometry3<f32>, plate: Plate) {
        let (half, centre) = (plate::SIZE_M / 2.0, plate::CENTRE_HEIGHT_M);
        let rect = [-half, centre - half, half, centre + half];
        let code = plate_code(plate);
        let first = self.plate.vertices.len() as u32;
        let across = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
        for (position, across) in
            Self::panel(world_from_face, rect, plate::FACE_OFFSET_M).into_iter().zip(across)
        {
            self.plate.vertices.push(PlateVertex { position, across, code });
        }
        self.plate.indices.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
    }

    fn text(
        &mut self,
        world_from_face: &Isometry3<f32>,
        rect: [f32; 4],
        out: f32,
        writing: &Writing<'_>,
    ) {
        let texels = |metres: f32| (metres * writing.texels_per_m).round() as u32;
        let size = [texels(rect[2] - rect[0]), texels(rect[3] - rect[1])];
        let [l, t, r, b] = self.atlas.rect(Lettering { text: writing.text.to_owned(), size });
        let opaque = |[r, g, b]: [u8; 3]| [r, g, b, 255];
        let first = self.text.vertices.len() as u32;
        for (position, texel) in Self::panel(world_from_face, rect, out).into_iter().zip([
            [l, b],
            [r, b],
            [r, t],
            [l, t],
        ]) {
            let vertex = TextVertex {
                position,
                atlas: [0.0; 2],
                ink: opaque(writing.ink),
                paper: opaque(writing.paper),
            };
            self.text.vertices.push(PanelCorner { vertex, texel });
        }
        self.text.indices.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
    }

    /// Every rack face that borders floor: a bay where an item stands, and along the rest a bay or,
    /// at the end of a run, a sheet of steel.
    fn racks(&mut self, warehouse: &Warehouse) {
        let faces = RackFaces::new(warehouse);
        for rack in faces.racks() {
            for face in Heading::ALL {
                match faces.kind(rack, face) {
                    FaceKind::Inner => {}
                    FaceKind::Closed => self.closed_face(rack, face),
                    FaceKind::Bay => self.bay(warehouse, &faces, rack, face),
                }
            }
        }
    }

    fn closed_face(&mut self, rack: Cell, face: Heading) {
        let frame = world_from_face(rack, face);
        self.object(|a| a.solid(&closed_face(), &frame, Light::Bay));
        self.screen(&frame, [-0.47, 0.034], [0.47, 0.034]);
    }

    fn bay(&mut self, warehouse: &Warehouse, faces: &RackFaces<'_>, rack: Cell, face: Heading) {
        let frame = world_from_face(rack, face);
        let stock = warehouse.items.iter().find(|item| item.rack == rack && item.face == face);
        let viewer = face.opposite();
        let depth = faces.depth(rack);
        let bay = Bay {
            left: faces.edge(rack, face, viewer.left()),
            right: faces.edge(rack, face, viewer.right()),
            depth,
            stocked: stock.is_some(),
            seed: u32::from(rack.x) * 131 + u32::from(rack.y) * 4 + face as u32 + 1,
        };
        self.object(|a| {
            a.solid(&bay.mesh(), &frame, Light::Bay);
            let Some(stock) = stock else { return };
            let kind = &warehouse.catalogue.types[stock.item_type];
            a.solid(&on_shelf(item(kind.shape, kind.colour), depth), &frame, Light::Shelf);
            let category = &warehouse.catalogue.categories[kind.category];
            a.plate(&frame, Plate::new(&category.name, &kind.name));
            a.text(
                &frame,
                LABEL_M,
                PANEL_OFFSET_M,
                &Writing {
                    text: &kind.name,
                    ink: [16, 16, 18],
                    paper: [248, 248, 244],
                    texels_per_m: 560.0,
                },
            );
            let number = bay_number(&warehouse.layout, stock.standpoint);
            a.text(
                &frame,
                BAY_NUMBER_M,
                PANEL_OFFSET_M,
                &Writing {
                    text: &number,
                    ink: [250, 250, 250],
                    paper: [36, 44, 58],
                    texels_per_m: 300.0,
                },
            );
        });
        for [from, to] in bay.screens() {
            self.screen(&frame, from, to);
        }
    }

    fn screen(&mut self, frame: &Isometry3<f32>, from: [f32; 2], to: [f32; 2]) {
        let at = |[x, y]: [f32; 2]| {
            let point = frame * Point3::new(x, y, 0.0);
            [point.x, point.y]
        };
        self.screens.push(Screen { from: at(from), to: at(to) });
    }

    /// The walls around the hall, and pillars that stand on the floor.
    fn walls(&mut self, layout: &Layout) {
        let identity = Isometry3::identity();
        for cell in layout.free_cells() {
            for heading in Heading::ALL {
                let beyond = cell.step(heading);
                if beyond.is_none_or(|next| layout.square(next) == Square::Wall) {
                    let mesh = hall::lower_wall(cell, heading, RACK_HEIGHT_M);
                    self.object(|a| a.solid(&mesh, &identity, Light::Hall));
                    let inside =
                        beyond.is_some_and(|b| b.x < layout.width() && b.y < layout.height());
                    if inside {
                        let frame = world_from_face(cell, heading);
                        let [from, to] = [-0.5, 0.5].map(|x| frame * Point3::new(x, 0.0, 0.0));
                        let mesh = hall::upper_wall([to.x, to.y], [from.x, from.y], RACK_HEIGHT_M);
                        self.object(|a| a.solid(&mesh, &identity, Light::Hall));
                    }
                }
            }
        }
        // Above the racks the outer wall runs all around, in pieces.
        let (w, h) = (f32::from(layout.width()), f32::from(layout.height()));
        let corners = [[0.0, h], [w, h], [w, 0.0], [0.0, 0.0]];
        for (i, &from) in corners.iter().enumerate() {
            let to = corners[(i + 1) % 4];
            let length = (to[0] - from[0]).abs() + (to[1] - from[1]).abs();
            let pieces = (length / 4.0).ceil() as u32;
            let at = |k: u32| {
                let share = k as f32 / pieces as f32;
                [from[0] + (to[0] - from[0]) * share, from[1] + (to[1] - from[1]) * share]
            };
            for k in 0..pieces {
                let mesh = hall::upper_wall(at(k), at(k + 1), RACK_HEIGHT_M);
                self.object(|a| a.solid(&mesh, &identity, Light::Hall));
            }
        }
    }

    /// Roof, lamps and signs.
    fn overhead(&mut self, layout: &Layout) {
        let identity = Isometry3::identity();
        let (w, h) = (f32::from(layout.width()), f32::from(layout.height()));
        let pieces = (h / 5.0).ceil() as u32;
        for k in 0..pieces {
            let at = |k: u32| h * k as f32 / pieces as f32;
            let mesh = hall::roof(0.0, w, at(k), at(k + 1));
            self.object(|a| a.solid(&mesh, &identity, Light::Hall));
        }
        for (index, aisle) in layout.aisles().iter().enumerate() {
            let cells: Vec<Cell> = layout
                .free_cells()
                .filter(|&cell| layout.aisle_index(cell) == Some(index))
                .collect();
            let Some(area) = Area::around(&cells) else { continue };
            let north_south = aisle.runs == Axis::NorthSouth;
            let (middle, length) = (area.middle(north_south), area.length(north_south));
            let lamps = (length / 3.2).round().max(1.0) as u32;
            for k in 0..lamps {
                let along = area.start(north_south) + length * (k as f32 + 0.5) / lamps as f32;
                let (x, y) = if north_south { (middle, along) } else { (along, middle) };
                let mesh = hall::lamp(x, y, north_south);
                self.object(|a| a.solid(&mesh, &identity, Light::Hall));
            }
            for along in area.sign_places(north_south) {
                let at = if north_south { [middle, along] } else { [along, middle] };
                self.sign(at, aisle.runs.forward(), &aisle.name.to_uppercase());
            }
        }
    }

    /// An overhead sign, read from both sides.
    fn sign(&mut self, at: [f32; 2], heading: Heading, text: &str) {
        let (half_width, bottom, top) = (0.8, 2.52, 2.9);
        let board = hall::sign_board(at, heading, half_width, bottom, top);
        self.object(|a| {
            a.solid(&board, &Isometry3::identity(), Light::Hall);
            for viewer in [heading, heading.opposite()] {
                let (rx, ry) = vector(viewer.right());
                let frame = Isometry3::from_parts(
                    Translation3::new(at[0], at[1], 0.0),
                    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), ry.atan2(rx)),
                );
                let inset = 0.03;
                let rect = [inset - half_width, bottom + inset, half_width - inset, top - inset];
                a.text(
                    &frame,
                    rect,
                    0.03,
                    &Writing {
                        text,
                        ink: [250, 250, 250],
                        paper: [24, 92, 150],
                        texels_per_m: 200.0,
                    },
                );
            }
        });
    }

    fn finish(mut self) -> Scene {
        let first = self.solid.indices.len();
        self.solid(&hall::barricade(), &Isometry3::identity(), Light::Bay);
        self.barricade = first..self.solid.indices.len();
        let atlas = self.atlas.draw();
        let text = self.text.vertices.into_iter().map(|corner| {
            let [u, v, ..] = atlas.share([corner.texel[0], corner.texel[1], 0, 0]);
            TextVertex { atlas: [u, v], ..corner.vertex }
        });
        Scene {
            solid: self.solid,
            plate: self.plate,
            text: Layer { vertices: text.collect(), indices: self.text.indices },
            objects: self.objects,
            screens: self.screens,
            barricade: self.barricade,
            atlas,
        }
    }
}

/// What stands on a panel, and in which colours.
struct Writing<'a> {
    text: &'a str,
    ink: [u8; 3],
    paper: [u8; 3],
    texels_per_m: f32,
}

/// Moves an item's mesh onto the shelf of a bay this deep; in a shallow one it stands smaller.
fn on_shelf(mut mesh: Mesh, depth: f32) -> Mesh {
    let (scale, y) = if depth < BAY_DEPTH_M { (0.72, 0.165) } else { (1.0, 0.29) };
    for vertex in &mut mesh.vertices {
        let p = vertex.position.coords * scale;
        vertex.position = Point3::new(p.x, p.y + y, p.z + SHELF_TOP_M);
    }
    mesh
}

/// Three bits a band (red, green, blue), the top band lowest, then the frame's.
fn plate_code(plate: Plate) -> u32 {
    let bits = |rgb: [u8; 3]| {
        let [r, g, b] = rgb.map(|channel| u32::from(channel == 255));
        r | g << 1 | b << 2
    };
    let bands = plate.0.map(|band| plate::BAND_RGB[usize::from(band)]);
    let all = bands.into_iter().chain([plate::FRAME_RGB]);
    all.enumerate().map(|(place, rgb)| bits(rgb) << (3 * place)).sum()
}

/// What is written over a bay: the aisle's last word shortened, and a number along the aisle.
fn bay_number(layout: &Layout, standpoint: Cell) -> String {
    let Some(aisle) = layout.aisle(standpoint) else { return String::new() };
    let word = aisle.name.split([' ', '-']).find(|w| !w.eq_ignore_ascii_case("aisle"));
    let letter = word.and_then(|w| w.chars().next()).unwrap_or('?').to_ascii_uppercase();
    let along = match aisle.runs {
        Axis::NorthSouth => standpoint.y,
        Axis::EastWest => standpoint.x,
    };
    format!("{letter}-{along:02}")
}

/// The rectangle around an aisle's cells, in metres.
struct Area {
    min: [f32; 2],
    max: [f32; 2],
}

impl Area {
    fn around(cells: &[Cell]) -> Option<Self> {
        let min = |of: fn(&Cell) -> u8| cells.iter().map(of).min().map(f32::from);
        let max = |of: fn(&Cell) -> u8| cells.iter().map(of).max().map(|v| f32::from(v) + 1.0);
        Some(Self { min: [min(|c| c.x)?, min(|c| c.y)?], max: [max(|c| c.x)?, max(|c| c.y)?] })
    }

    fn start(&self, north_south: bool) -> f32 {
        self.min[usize::from(north_south)]
    }

    fn length(&self, north_south: bool) -> f32 {
        self.max[usize::from(north_south)] - self.min[usize::from(north_south)]
    }

    /// The coordinate across the aisle of its middle line.
    fn middle(&self, north_south: bool) -> f32 {
        let across = usize::from(!north_south);
        (self.min[across] + self.max[across]) / 2.0
    }

    /// Where signs hang along the aisle: at both ends of one that runs between racks, and within one
    /// that crosses them.
    fn sign_places(&self, north_south: bool) -> [f32; 2] {
        let (start, length) = (self.start(north_south), self.length(north_south));
        let inset = if north_south { 0.3 } else { length * 0.3125 };
        [start + inset, start + length - inset]
    }
}

/// What is on a side of a rack square.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FaceKind {
    /// No floor in front.
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

impl<'a> RackFaces<'a> {
    fn new(warehouse: &'a Warehouse) -> Self {
        Self { warehouse }
    }

    fn racks(&self) -> impl Iterator<Item = Cell> + '_ {
        let layout = &self.warehouse.layout;
        (0..layout.height())
            .flat_map(|y| (0..layout.width()).map(move |x| Cell::new(x, y)))
            .filter(|&cell| layout.square(cell) == Square::Rack)
    }

    fn is_open(&self, rack: Cell, face: Heading) -> bool {
        self.warehouse.layout.free_neighbour(rack, face).is_some()
    }

    fn holds_item(&self, rack: Cell, face: Heading) -> bool {
        self.warehouse.items.iter().any(|item| item.rack == rack && item.face == face)
    }

    fn kind(&self, rack: Cell, face: Heading) -> FaceKind {
        if !self.is_open(rack, face) {
            return FaceKind::Inner;
        }
        if self.holds_item(rack, face) {
            return FaceKind::Bay;
        }
        // Without an item, a face is a bay only if the square has no other bay to share its room with.
        let first_open = Heading::ALL.into_iter().find(|&other| self.is_open(rack, other));
        let any_item = Heading::ALL.into_iter().any(|other| self.holds_item(rack, other));
        if !any_item && first_open == Some(face) { FaceKind::Bay } else { FaceKind::Closed }
    }

    /// Bays that share a square are shallow, so that they do not run into each other.
    fn depth(&self, rack: Cell) -> f32 {
        let bays = Heading::ALL.into_iter().filter(|&face| self.kind(rack, face) == FaceKind::Bay);
        if bays.count() > 1 { SHALLOW_BAY_DEPTH_M } else { BAY_DEPTH_M }
    }

    /// How the bay at `face` ends towards `side`.
    fn edge(&self, rack: Cell, face: Heading, side: Heading) -> Edge {
        match self.kind(rack, side) {
            FaceKind::Closed => Edge::Closed,
            // Of two bays around a corner, the one that looks east or west has it.
            FaceKind::Bay if matches!(face, Heading::E | Heading::W) => {
                Edge::Corner(self.depth(rack))
            }
            FaceKind::Bay => Edge::CutBy(self.depth(rack)),
            FaceKind::Inner => {
                let next = rack.step(side);
                let next = next.filter(|&next| self.warehouse.layout.square(next) != Square::Wall);
                match next {
                    None => Edge::Joined,
                    Some(next) if self.kind(next, face) != FaceKind::Bay => Edge::Closed,
                    Some(next) if self.depth(next) < self.depth(rack) => {
                        Edge::Step(self.depth(next))
                    }
                    Some(_) => Edge::Joined,
                }
            }
        }
    }
}
