//! Places floor, walls, roof, lamps and signs.

use domain::{Cell, Heading};
use nalgebra::{Isometry3, Translation3};
use warehouse::{Axis, Layout, Square};

use super::assembly::{Assembly, Label};
use super::frames::{side_of, world_from_face};
use crate::renderer::mesh::builder::MeshPart;
use crate::renderer::mesh::rack::RACK_HEIGHT_M;
use crate::renderer::mesh::{hall, wall};

/// Adds the hall of `layout`, without its racks.
pub(super) fn build(assembly: &mut Assembly, layout: &Layout) {
    for cell in layout.free_cells() {
        let mesh = hall::floor(layout, cell);
        assembly.object(|a| a.solid(&mesh, &Isometry3::identity(), MeshPart::Floor));
    }
    for run in wall_runs(layout) {
        run.build(assembly);
    }
    outer_walls(assembly, layout);
    roof(assembly, layout);
    for index in 0..layout.aisles().len() {
        aisle(assembly, layout, index);
    }
}

/// The approximate distance between gates and doors on a long wall, in metres.
const FEATURE_SPACING_M: f32 = 6.0;

/// A straight piece of wall that borders floor.
struct WallRun {
    /// The floor cells along it, from left to right as a viewer who faces the wall sees them.
    cells: Vec<Cell>,
    /// The direction in which a viewer faces it.
    facing: Heading,
    /// Whether the wall stands inside the hall and so has to reach the roof.
    inside: bool,
}

/// The straight pieces of all walls that border floor.
fn wall_runs(layout: &Layout) -> Vec<WallRun> {
    let is_wall = |cell: Cell, facing: Heading| {
        cell.step(facing).is_none_or(|next| layout.square(next) == Square::Wall)
    };
    let faces = |cell: Cell, facing: Heading| layout.is_free(cell) && is_wall(cell, facing);
    let mut runs = Vec::new();
    for facing in Heading::ALL {
        for start in layout.free_cells() {
            let before = start.step(facing.left());
            if !faces(start, facing) || before.is_some_and(|cell| faces(cell, facing)) {
                continue;
            }
            let next = |cell: &Cell| cell.step(facing.right()).filter(|&cell| faces(cell, facing));
            let cells = std::iter::successors(Some(start), next).collect();
            let beyond = start.step(facing);
            let inside = beyond.is_some_and(|b| b.x < layout.width() && b.y < layout.height());
            runs.push(WallRun { cells, facing, inside });
        }
    }
    runs
}

impl WallRun {
    fn build(&self, assembly: &mut Assembly) {
        let top = if self.inside { hall::ROOF_M } else { RACK_HEIGHT_M };
        for &cell in &self.cells {
            let frame = world_from_face(side_of(cell, self.facing), self.facing);
            let mesh = wall::cladding(self.facing, top);
            assembly.object(|a| a.solid(&mesh, &frame, MeshPart::Wall));
        }
        // What hangs on a wall depends on its direction; columns stand in between.
        let length = self.cells.len() as f32;
        let along = |metres: f32| {
            let first = world_from_face(side_of(self.cells[0], self.facing), self.facing);
            first * Translation3::new(metres - 0.5, 0.0, 0.0)
        };
        let pieces = (length / FEATURE_SPACING_M).round().max(1.0) as u32;
        for k in 1..pieces {
            let at = length * k as f32 / pieces as f32;
            assembly.object(|a| a.solid(&wall::column(), &along(at), MeshPart::Fixture));
        }
        for k in 0..pieces {
            let middle = along(length * (k as f32 + 0.5) / pieces as f32);
            if length >= FEATURE_SPACING_M {
                self.feature(assembly, &middle, k);
            } else if length >= 2.0 {
                self.notice(assembly, &middle);
            }
        }
    }

    /// Adds what marks a long wall: gates to the west and south, emergency exits elsewhere.
    fn feature(&self, assembly: &mut Assembly, frame: &Isometry3<f32>, number: u32) {
        let gate = matches!(self.facing, Heading::W | Heading::S);
        let (mesh, text, rect, paper) = if gate {
            (wall::gate(), format!("GATE {}", number + 1), [-0.5, 2.52, 0.5, 2.8], [24, 92, 150])
        } else {
            (wall::exit(), "EXIT".to_owned(), [-0.36, 2.2, 0.36, 2.44], [20, 130, 70])
        };
        assembly.object(|a| {
            a.solid(&mesh, frame, MeshPart::Fixture);
            let label = Label { text: &text, ink: [250, 250, 250], paper, texels_per_m: 240.0 };
            a.text(frame, rect, wall::BOARD_OFFSET_M, &label);
        });
    }

    /// Adds a notice on a short piece of wall.
    fn notice(&self, assembly: &mut Assembly, frame: &Isometry3<f32>) {
        let text = match self.facing {
            Heading::N => "NORTH WALL",
            Heading::E => "EAST WALL",
            Heading::S => "SOUTH WALL",
            Heading::W => "WEST WALL",
        };
        assembly.object(|a| {
            a.solid(&wall::notice_board(), frame, MeshPart::Fixture);
            let label =
                Label { text, ink: [36, 44, 58], paper: [236, 238, 238], texels_per_m: 200.0 };
            a.text(frame, wall::NOTICE_M, wall::BOARD_OFFSET_M, &label);
        });
    }
}

/// Adds the outer wall above the racks, in pieces.
fn outer_walls(assembly: &mut Assembly, layout: &Layout) {
    let (w, h) = (f32::from(layout.width()), f32::from(layout.height()));
    // Slightly behind and below the lower walls' upper edge: surfaces that only touch leave gaps.
    let (out, bottom) = (0.02, RACK_HEIGHT_M - 0.1);
    let corners = [[-out, h + out], [w + out, h + out], [w + out, -out], [-out, -out]];
    for (i, &from) in corners.iter().enumerate() {
        let to = corners[(i + 1) % 4];
        let length = (to[0] - from[0]).abs() + (to[1] - from[1]).abs();
        let pieces = (length / 4.0).ceil() as u32;
        let at = |k: u32| {
            let share = k as f32 / pieces as f32;
            [from[0] + (to[0] - from[0]) * share, from[1] + (to[1] - from[1]) * share]
        };
        for k in 0..pieces {
            let mesh = hall::upper_wall(at(k), at(k + 1), bottom);
            assembly.object(|a| a.solid(&mesh, &Isometry3::identity(), MeshPart::Wall));
        }
    }
}

/// Adds the roof, in pieces.
fn roof(assembly: &mut Assembly, layout: &Layout) {
    let (w, h) = (f32::from(layout.width()), f32::from(layout.height()));
    let pieces = (h / 5.0).ceil() as u32;
    for k in 0..pieces {
        // Over the edge of the walls.
        let out = 0.1;
        let at = |k: u32| -out + (h + 2.0 * out) * k as f32 / pieces as f32;
        let mesh = hall::roof(-out, w + out, at(k), at(k + 1));
        assembly.object(|a| a.solid(&mesh, &Isometry3::identity(), MeshPart::Wall));
    }
}

/// Adds lamps and signs of an aisle.
fn aisle(assembly: &mut Assembly, layout: &Layout, index: usize) {
    let aisle = &layout.aisles()[index];
    let cells: Vec<Cell> =
        layout.free_cells().filter(|&cell| layout.aisle_index(cell) == Some(index)).collect();
    let Some(area) = Area::around(&cells) else { return };
    let north_south = aisle.runs == Axis::NorthSouth;
    let (middle, length) = (area.middle(north_south), area.length(north_south));
    let lamps = (length / 3.2).round().max(1.0) as u32;
    for k in 0..lamps {
        let along = area.start(north_south) + length * (k as f32 + 0.5) / lamps as f32;
        let (x, y) = if north_south { (middle, along) } else { (along, middle) };
        let mesh = hall::lamp(x, y, north_south);
        assembly.object(|a| a.solid(&mesh, &Isometry3::identity(), MeshPart::Fixture));
    }
    for along in area.sign_places(north_south) {
        let at = if north_south { [middle, along] } else { [along, middle] };
        sign(assembly, at, aisle.runs.forward(), &aisle.name.to_uppercase());
    }
}

/// Adds an overhead sign that is readable from both sides.
fn sign(assembly: &mut Assembly, at: [f32; 2], heading: Heading, text: &str) {
    let [left, bottom, right, top] = hall::SIGN_M;
    let inset = 0.03;
    let rect = [left + inset, bottom + inset, right - inset, top - inset];
    assembly.object(|a| {
        a.solid(&hall::sign_board(), &world_from_face(at, heading), MeshPart::Fixture);
        for viewer in [heading, heading.opposite()] {
            let label =
                Label { text, ink: [250, 250, 250], paper: [24, 92, 150], texels_per_m: 200.0 };
            a.text(&world_from_face(at, viewer), rect, 0.03, &label);
        }
    });
}

/// The bounding rectangle of an aisle's cells, in metres.
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

    /// The coordinate of the middle line, across the aisle.
    fn middle(&self, north_south: bool) -> f32 {
        let across = usize::from(!north_south);
        (self.min[across] + self.max[across]) / 2.0
    }

    /// Where signs hang along the aisle: at both ends of an aisle between racks, and inside an aisle that crosses them.
    fn sign_places(&self, north_south: bool) -> [f32; 2] {
        let (start, length) = (self.start(north_south), self.length(north_south));
        let inset = if north_south { 0.3 } else { length * 0.3125 };
        [start + inset, start + length - inset]
    }
}
