//! Top-down maps as SVG: the warehouse, or a case with its six routes, targets and barricade.
//!
//! For people only; nothing reads a map back. North is up.

mod canvas;
mod glyph;
mod legend;
mod routes;

use domain::{Cell, Heading};

use crate::case::Case;
use crate::layout::{Axis, Layout, Square};
use crate::world::{Item, Warehouse};
use canvas::Canvas;

/// Side of a cell, in units of the drawing.
const CELL: f64 = 40.0;
/// Space around the floor, for the coordinates.
const MARGIN: f64 = 44.0;
/// Width of the column with the legend.
const LEGEND: f64 = 372.0;

/// How far a drawn item's middle is from the rack's face, and a target's badge.
const ITEM_DEPTH: f64 = 10.5;
const BADGE_DEPTH: f64 = 28.0;

/// How far an item keeps from the corner of a rack that has items on two faces.
const CORNER: f64 = 9.0;

const INK: &str = "#1f2933";
const MUTED: &str = "#7b8794";
const PAPER: &str = "#ffffff";
const FLOOR: &str = "#f7f5f0";
const GRID: &str = "#e9e5dc";
const AISLE_NAME: &str = "#b9b2a3";
const RACK: &str = "#d9dee5";
const BAY_EDGE: &str = "#c5cdd7";
const RACK_EDGE: &str = "#9aa5b1";
const WALL: &str = "#52606d";
const STANDPOINT: &str = "#fdecc0";

/// The map of `warehouse` with `case`'s routes drawn on it.
pub fn svg(warehouse: &Warehouse, case: &Case) -> String {
    let mut map = Map::new(&warehouse.layout);
    map.floor(warehouse, Some(case));
    map.aisle_names();
    map.items(warehouse, Some(case));
    map.routes(warehouse, case);
    map.case_legend(warehouse, case);
    map.finish()
}

/// The map of `warehouse` alone.
pub fn floor_svg(warehouse: &Warehouse) -> String {
    let mut map = Map::new(&warehouse.layout);
    map.floor(warehouse, None);
    map.aisle_names();
    map.items(warehouse, None);
    map.floor_legend(warehouse);
    map.finish()
}

/// A point of the drawing: right and down.
type Point = (f64, f64);

/// A drawing in progress.
struct Map<'l> {
    layout: &'l Layout,
    canvas: Canvas,
}

impl<'l> Map<'l> {
    fn new(layout: &'l Layout) -> Self {
        let width = 2.0 * MARGIN + f64::from(layout.width()) * CELL + LEGEND;
        let height = 2.0 * MARGIN + f64::from(layout.height()) * CELL;
        Self { layout, canvas: Canvas::new(width, height, PAPER) }
    }

    fn finish(self) -> String {
        self.canvas.finish()
    }

    /// The north-west corner of `cell`.
    fn corner(&self, cell: Cell) -> Point {
        let from_north = i32::from(self.layout.height()) - 1 - i32::from(cell.y);
        (MARGIN + f64::from(cell.x) * CELL, MARGIN + f64::from(from_north) * CELL)
    }

    fn centre(&self, cell: Cell) -> Point {
        let (x, y) = self.corner(cell);
        (x + CELL / 2.0, y + CELL / 2.0)
    }

    /// A point in the rack of `item`, `depth` behind its face and clear of an item round the corner.
    fn in_bay(&self, warehouse: &Warehouse, item: &Item, depth: f64) -> Point {
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

    /// Where the legend begins.
    fn legend_x(&self) -> f64 {
        2.0 * MARGIN + f64::from(self.layout.width()) * CELL
    }

    fn floor(&mut self, warehouse: &Warehouse, case: Option<&Case>) {
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

    /// A line wherever solid meets floor, and round the whole plan.
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
    fn aisle_names(&mut self) {
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

    /// Every item at its face; with a case, its targets stand out and wear a letter.
    fn items(&mut self, warehouse: &Warehouse, case: Option<&Case>) {
        for item in &warehouse.items {
            let letter = case.and_then(|case| legend::letter(warehouse, &case.task, item));
            let faded = case.is_some() && letter.is_none();
            let item_type = &warehouse.catalogue.types[item.item_type];
            let middle = self.in_bay(warehouse, item, ITEM_DEPTH);
            self.canvas.open(&format!("opacity='{}'", if faded { 0.45 } else { 1.0 }));
            glyph::draw(&mut self.canvas, middle, item_type.shape, item_type.colour);
            self.canvas.close();
            if let Some(letter) = letter {
                let middle = self.in_bay(warehouse, item, BADGE_DEPTH);
                legend::badge(&mut self.canvas, middle, letter);
            }
        }
    }
}

/// The unit step of `heading` on the drawing, where y grows downwards.
fn direction(heading: Heading) -> Point {
    let (x, y) = heading.vector();
    (f64::from(x), -f64::from(y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::{CaseSet, Start};

    /// Every element is closed, in order.
    fn check_nesting(svg: &str) {
        let mut open = Vec::new();
        for tag in svg.split('<').skip(1) {
            let name: String =
                tag.trim_start_matches('/').chars().take_while(|c| c.is_alphanumeric()).collect();
            if tag.starts_with('/') {
                assert_eq!(open.pop(), Some(name));
            } else if !tag.split('>').next().unwrap().ends_with('/') {
                open.push(name);
            }
        }
        assert_eq!(open, [""; 0]);
    }

    #[test]
    fn a_map_shows_every_aisle_item_and_route() {
        let warehouse = Warehouse::shipped();
        let cases = CaseSet::shipped();
        let floor = floor_svg(&warehouse);
        check_nesting(&floor);
        for aisle in warehouse.layout.aisles() {
            assert!(floor.contains(&aisle.name.to_uppercase()));
        }
        assert!(floor.contains("160 items of 36 types"));
        for case in cases.cases.iter().step_by(9) {
            let map = svg(&warehouse, case);
            check_nesting(&map);
            assert!(map.contains(&format!("Case {}", case.id)));
            for start in Start::ALL {
                let length = case.replay(&warehouse, start).length.unwrap();
                assert!(map.contains(&format!(">{length} steps<")), "{} {}", case.id, start.name());
            }
            // Every target wears its letter, and the legend explains each letter once.
            let targets = case.task.targets(&warehouse).len();
            let badges = ["A", "B", "C"].map(|l| map.matches(&format!(">{l}</text>")).count());
            let letters = badges.iter().filter(|&&count| count > 0).count();
            assert_eq!(badges.iter().sum::<usize>(), targets + letters, "{}", case.id);
        }
    }
}
