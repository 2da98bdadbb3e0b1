//! The floor plan with aisles and items.

use domain::{Cell, Heading};

use super::canvas::{CELL, DrawingPoint, MARGIN, MUTED, PAPER, SvgCanvas};
use super::glyph;
use super::marks::{badge, direction};
use crate::case::Case;
use crate::layout::{Axis, Layout, Square};
use crate::world::{Item, Warehouse};

/// Distances of an item's glyph and of a target's badge from the rack's face.
const ITEM_DEPTH: f64 = 10.5;
const BADGE_DEPTH: f64 = 28.0;

/// Distance of an item from the corner of a rack that has items on two faces.
const CORNER: f64 = 9.0;
const FLOOR: &str = "#f7f5f0";
const GRID: &str = "#e9e5dc";
const AISLE_NAME: &str = "#b9b2a3";
const RACK: &str = "#d9dee5";
const BAY_EDGE: &str = "#c5cdd7";
const RACK_EDGE: &str = "#9aa5b1";
const WALL: &str = "#52606d";
const STANDPOINT: &str = "#fdecc0";

/// A map in progress.
pub(super) struct Map<'l> {
    pub(super) layout: &'l Layout,
    pub(super) canvas: SvgCanvas,
}

impl<'l> Map<'l> {
    /// An empty map with `legend` units of room to its right.
    pub(super) fn new(layout: &'l Layout, legend: f64) -> Self {
        let width = 2.0 * MARGIN + f64::from(layout.width()) * CELL + legend;
        let height = 2.0 * MARGIN + f64::from(layout.height()) * CELL;
        Self { layout, canvas: SvgCanvas::new(width, height, PAPER) }
    }

    /// The north-west corner of `cell`.
    pub(super) fn corner(&self, cell: Cell) -> DrawingPoint {
        let from_north = i32::from(self.layout.height()) - 1 - i32::from(cell.y);
        (MARGIN + f64::from(cell.x) * CELL, MARGIN + f64::from(from_north) * CELL)
    }

    pub(super) fn centre(&self, cell: Cell) -> DrawingPoint {
        let (x, y) = self.corner(cell);
        (x + CELL / 2.0, y + CELL / 2.0)
    }

    /// A point in the rack of `item`, `depth` behind its face and clear of an item round the corner.
    fn in_bay(&self, warehouse: &Warehouse, item: &Item, depth: f64) -> DrawingPoint {
        let (mut x, mut y) = self.centre(item.rack);
        let (dx, dy) = direction(item.face);
        x += dx * (CELL / 2.0 - depth);
        y += dy * (CELL / 2.0 - depth);
        let others = warehouse.items.iter().filter(|o| o.rack == item.rack && o.id != item.id);
        for (dx, dy) in others.map(|other| direction(other.face)) {
            x -= dx * CORNER;
            y -= dy * CORNER;
        }
        (x, y)
    }

    /// The left edge of the legend.
    pub(super) fn legend_x(&self) -> f64 {
        2.0 * MARGIN + f64::from(self.layout.width()) * CELL
    }

    pub(super) fn floor(&mut self, warehouse: &Warehouse, case: Option<&Case>) {
        let layout = self.layout;
        for cell in layout.cells() {
            let (x, y) = self.corner(cell);
            let (fill, edge) = match layout.square(cell) {
                Square::Floor => (FLOOR, GRID),
                Square::Rack => (RACK, BAY_EDGE),
                Square::Wall => (WALL, WALL),
            };
            self.canvas.rect((x, y), (CELL, CELL), &format!("fill='{fill}' stroke='{edge}'"));
        }
        for item in case.iter().flat_map(|case| case.task.targets(warehouse)) {
            let (x, y) = self.corner(item.standpoint);
            self.canvas.rect(
                (x + 0.5, y + 0.5),
                (CELL - 1.0, CELL - 1.0),
                &format!("fill='{STANDPOINT}'"),
            );
        }
        self.rack_outlines();
        self.coordinates();
    }

    /// Lines where racks and walls meet floor, and around the plan.
    fn rack_outlines(&mut self) {
        let layout = self.layout;
        let mut lines = String::new();
        for cell in layout.cells().filter(|&cell| !layout.is_free(cell)) {
            for heading in Heading::ALL {
                if cell.step(heading).is_some_and(|next| layout.is_free(next)) {
                    let (x, y) = self.centre(cell);
                    let ((fx, fy), (sx, sy)) = (direction(heading), direction(heading.right()));
                    let half = CELL / 2.0;
                    let (x, y) = (x + fx * half, y + fy * half);
                    lines += &format!(
                        "M{:.1} {:.1}L{:.1} {:.1}",
                        x - sx * half,
                        y - sy * half,
                        x + sx * half,
                        y + sy * half
                    );
                }
            }
        }
        self.canvas
            .path(&lines, &format!("stroke='{RACK_EDGE}' stroke-width='2' stroke-linecap='round'"));
        let size = (f64::from(layout.width()) * CELL, f64::from(layout.height()) * CELL);
        self.canvas.rect(
            (MARGIN, MARGIN),
            size,
            &format!("fill='none' stroke='{WALL}' stroke-width='3' rx='2'"),
        );
    }

    fn coordinates(&mut self) {
        let style = format!("font-size='11' fill='{MUTED}' text-anchor='middle'");
        let bottom = MARGIN + f64::from(self.layout.height()) * CELL;
        for x in 0..self.layout.width() {
            let (cx, _) = self.centre(Cell::new(x, 0));
            for y in [MARGIN - 9.0, bottom + 18.0] {
                self.canvas.text((cx, y), &x.to_string(), &style);
            }
        }
        for y in 0..self.layout.height() {
            let (_, cy) = self.centre(Cell::new(0, y));
            self.canvas.text((MARGIN - 15.0, cy + 4.0), &y.to_string(), &style);
        }
    }

    /// Each aisle's name along its middle.
    pub(super) fn aisle_names(&mut self) {
        for (index, aisle) in self.layout.aisles().iter().enumerate() {
            let cells = self.layout.free_cells();
            let cells: Vec<Cell> =
                cells.filter(|&cell| self.layout.aisle_index(cell) == Some(index)).collect();
            let (Some(first), Some(last)) = (cells.first(), cells.last()) else { continue };
            let ((ax, ay), (bx, by)) = (self.centre(*first), self.centre(*last));
            let (x, y) = ((ax + bx) / 2.0, (ay + by) / 2.0);
            let turn = match aisle.runs {
                Axis::EastWest => 0,
                Axis::NorthSouth => -90,
            };
            self.canvas.text(
                (x, y),
                &aisle.name.to_uppercase(),
                &format!(
                    "font-size='17' font-weight='700' letter-spacing='5' fill='{AISLE_NAME}' \
                     text-anchor='middle' dominant-baseline='central' \
                     transform='rotate({turn} {x:.1} {y:.1})'"
                ),
            );
        }
    }

    /// Every item at its face. With a case, its targets are highlighted and have a letter.
    pub(super) fn items(&mut self, warehouse: &Warehouse, case: Option<&Case>) {
        for item in &warehouse.items {
            let mark = case.and_then(|case| case.task.letter(warehouse, item));
            let faded = case.is_some() && mark.is_none();
            let item_type = &warehouse.catalogue.types[item.item_type];
            let middle = self.in_bay(warehouse, item, ITEM_DEPTH);
            self.canvas.open(&format!("opacity='{}'", if faded { 0.45 } else { 1.0 }));
            glyph::draw(&mut self.canvas, middle, item_type.shape, item_type.colour);
            self.canvas.close();
            if let Some(letter) = mark {
                let middle = self.in_bay(warehouse, item, BADGE_DEPTH);
                badge(&mut self.canvas, middle, letter);
            }
        }
    }
}
