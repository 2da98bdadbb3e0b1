//! Documents: where items stand, which cells are floor, and routes that were demonstrated.
//!
//! Parses the grammar of `docs/documents.md` line by line and skips what does not follow it. A line of a
//! model's free text that names an item and gives a cell counts as a place to stand.

use domain::{Cell, Heading, Pose};
use plates::ItemName;

use super::geometry::{PathStep, path_along};

/// The largest rectangle that counts as floor, in cells.
const LARGEST_PASSAGE: usize = 1024;

/// The longest route that is used, in cells.
const LONGEST_ROUTE: u32 = 400;

/// The columns and rows of a rectangle of cells, both ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rect {
    columns: (u8, u8),
    rows: (u8, u8),
}

impl Rect {
    pub(super) fn cells(self) -> impl Iterator<Item = Cell> {
        let Self { columns, rows } = self;
        (columns.0..=columns.1).flat_map(move |x| (rows.0..=rows.1).map(move |y| Cell::new(x, y)))
    }
}

/// A parsed document.
#[derive(Debug, Default)]
pub(super) struct ParsedDocument {
    places: Vec<DocumentedPlace>,
    /// Cells that can be walked on, sorted.
    pub(super) floor: Vec<Cell>,
    routes: Vec<DocumentedRoute>,
}

/// A line that says where items of some kind are.
#[derive(Debug)]
struct DocumentedPlace {
    /// In lower case.
    text: String,
    standpoints: Vec<Cell>,
    regions: Vec<Rect>,
}

/// A demonstrated route.
#[derive(Debug)]
struct DocumentedRoute {
    /// In lower case.
    instruction: String,
    facing: Option<Heading>,
    /// Its start, the cells where it bends, and its end.
    corners: Vec<Cell>,
}

impl ParsedDocument {
    pub(super) fn parse(text: &str) -> Self {
        let mut document = Self::default();
        let mut is_about_floor = false;
        for line in text.lines().map(str::to_lowercase) {
            if line.starts_with('#') {
                is_about_floor = mentions_floor(&line);
            } else if !document.parse_route(&line) {
                let (standpoints, regions) = (cells(&line), rects(&line));
                if standpoints.is_empty() && (is_about_floor || mentions_floor(&line)) {
                    document.floor.extend(regions.into_iter().flat_map(Rect::cells));
                } else if !(standpoints.is_empty() && regions.is_empty()) {
                    document.places.push(DocumentedPlace { text: line, standpoints, regions });
                }
            }
        }
        let walked = document.routes.iter().filter_map(DocumentedRoute::path).flatten();
        document.floor.extend(walked.map(|step| step.pose.cell));
        document.floor.sort_unstable();
        document.floor.dedup();
        document
    }

    /// `"Find a blue barrel." from (14, 11) facing S: south 3 to (14, 8); reached blue barrel at (14, 8).`
    fn parse_route(&mut self, line: &str) -> bool {
        let quoted = line.split_once('"').and_then(|(_, rest)| rest.split_once('"'));
        let Some((instruction, route)) = quoted else { return false };
        let Some(route) = route.trim_start().strip_prefix("from ") else { return false };
        for text in route.split("reached ").skip(1) {
            let standpoints = cells(text).into_iter().take(1).collect();
            let text = text.split('(').next().unwrap_or_default().to_owned();
            self.places.push(DocumentedPlace { text, standpoints, regions: Vec::new() });
        }
        let facing = route.split_once("facing ").and_then(|(_, rest)| {
            let letter = rest.chars().next()?.to_ascii_uppercase();
            Heading::ALL.into_iter().find(|heading| heading.letter() == letter)
        });
        let mut corners = cells(route);
        corners.dedup();
        self.routes.push(DocumentedRoute { instruction: instruction.to_owned(), facing, corners });
        true
    }

    /// Cells from which items of the target kind can be reached.
    pub(super) fn standpoints(&self, target: ItemName<'_>) -> impl Iterator<Item = Cell> {
        self.about(target).flat_map(|place| place.standpoints.iter().copied())
    }

    /// Where items of the target kind were seen.
    pub(super) fn regions(&self, target: ItemName<'_>) -> impl Iterator<Item = Rect> {
        self.about(target).flat_map(|place| place.regions.iter().copied())
    }

    /// Lines that give a plate or the name of the target kind.
    fn about(&self, target: ItemName<'_>) -> impl Iterator<Item = &DocumentedPlace> {
        let digits = |name| plates::code(name).map(|digit| digit.to_string()).concat();
        let (name, plate) = match target {
            ItemName::Type(name) => (name, format!("-{}]", digits(name))),
            ItemName::Category(name) => (name, format!("[plate {}", digits(name))),
        };
        let name = name.to_lowercase();
        let places = self.places.iter();
        places.filter(move |place| place.text.contains(&plate) || place.text.contains(&name))
    }

    /// Routes that were demonstrated for exactly this instruction.
    pub(super) fn routes(&self, instruction: &str) -> impl Iterator<Item = Vec<PathStep>> {
        let instruction = instruction.to_lowercase();
        self.routes
            .iter()
            .filter(move |route| route.instruction == instruction)
            .filter_map(DocumentedRoute::path)
    }
}

impl DocumentedRoute {
    /// The poses and actions of the route, facing ahead; `None` if it is empty or bends elsewhere than at its
    /// corners.
    fn path(&self) -> Option<Vec<PathStep>> {
        let mut directions = Vec::new();
        for leg in self.corners.windows(2) {
            let (from, to) = (leg[0], leg[1]);
            let heading = match (to.x.cmp(&from.x) as i8, to.y.cmp(&from.y) as i8) {
                (0, 1) => Heading::N,
                (1, 0) => Heading::E,
                (0, -1) => Heading::S,
                (-1, 0) => Heading::W,
                _ => return None,
            };
            let length = from.distance(to).min(LONGEST_ROUTE);
            directions.extend((0..length).map(|_| heading));
        }
        let heading = self.facing.or(directions.first().copied()).unwrap_or(Heading::N);
        Some(path_along(Pose { cell: *self.corners.first()?, heading }, directions))
    }
}

fn mentions_floor(text: &str) -> bool {
    ["passage", "corridor", "aisle", "layout", "walkable"].iter().any(|word| text.contains(word))
}

/// Cells written as `(column, row)`.
fn cells(line: &str) -> Vec<Cell> {
    let cell = |text: &str| {
        let (x, y) = text.split_once(')')?.0.split_once(',')?;
        Some(Cell::new(x.trim().parse().ok()?, y.trim().parse().ok()?))
    };
    line.split('(').skip(1).filter_map(cell).collect()
}

/// Rectangles written as columns with rows, in either order: `column 3: rows 1-14`, `row 15 (columns 0-15)`,
/// `columns 2-5, rows 6-9`.
fn rects(line: &str) -> Vec<Rect> {
    let words = || {
        let words = line.split(|c: char| !c.is_ascii_alphanumeric() && c != '-');
        words.filter(|word| !word.is_empty())
    };
    let (mut columns, mut rows, mut rects) = (None, None, Vec::new());
    for (word, next) in words().zip(words().skip(1)) {
        match word {
            "column" | "columns" => columns = stretch(next),
            "row" | "rows" => rows = stretch(next),
            _ => continue,
        }
        if let (Some(of_columns), Some(of_rows)) = (columns, rows) {
            rects.push(Rect { columns: of_columns, rows: of_rows });
            (columns, rows) = (None, None);
        }
    }
    rects.retain(|rect| rect.cells().count() <= LARGEST_PASSAGE);
    rects
}

/// `7` or `3-14`.
fn stretch(word: &str) -> Option<(u8, u8)> {
    let (from, to) = word.split_once('-').unwrap_or((word, word));
    let (from, to) = (from.parse().ok()?, to.parse().ok()?);
    Some((u8::min(from, to), u8::max(from, to)))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::grounded::instruction::NavigationGoal;

    const SUMMARY: &str = r#"# Summary of the demonstrations
Positions are (column, row): columns grow east, rows grow north.

## Items
- blue barrel [plate 061-611]: stand at (3, 7) facing E; stand at (3, 9) facing E
- barrels item [plate 554-113]: stand at (12, 4) facing W
- item [plate 222-113]: stand at (12, 5) facing W

## Passages
- column 3: rows 1-14
- row 15: columns 0-15

## LocalRoutes
- "Find a blue barrel." from (14, 11) facing S: south 3 to (14, 8), west 5 to (9, 8); reached blue barrel at (9, 8).
"#;

    const SEMANTIC: &str = "# Knowledge of the warehouse
## Layout
- North-south corridors: column 3 (rows 1-14), column 6 (rows 1-14)
- East-west aisles: row 0 (columns 0-15), row 15 (columns 0-15)
## Where kinds of items stand
- barrels [plate 554]: columns 2-5, rows 6-9; seen there: blue barrel, red barrel
## Navigation
- To change corridors use an east-west aisle: rows 0, 15, 29.
";

    fn standpoints(text: &str, instruction: &str) -> Vec<(u8, u8)> {
        let goal = NavigationGoal::read(instruction).unwrap();
        let cells: Vec<Cell> = ParsedDocument::parse(text).standpoints(goal.targets[0]).collect();
        cells.into_iter().map(|cell| (cell.x, cell.y)).collect()
    }

    #[test]
    fn items_are_found_by_plate_and_by_what_routes_reached() {
        // Plates spell "blue barrel" as 611 and "barrels" as 554.
        assert_eq!(standpoints(SUMMARY, "Find a blue barrel."), [(3, 7), (3, 9), (9, 8)]);
        let category = "Find any item of the category barrels.";
        assert_eq!(standpoints(SUMMARY, category), [(12, 4)]);
        assert_eq!(standpoints(SUMMARY, "Find a red barrel."), []);
    }

    #[test]
    fn passages_and_routes_are_floor() {
        let document = ParsedDocument::parse(SUMMARY);
        let route = document.routes("Find a blue barrel.").next().unwrap();
        assert_eq!(route[0].pose, Pose::new(14, 11, Heading::S));
        assert_eq!(route.last().unwrap().pose.cell, Cell::new(9, 8));
        assert_eq!(route.len(), 3 + 1 + 5 + 1, "moves, a turn, the end");
        assert_eq!(document.routes("Find a red barrel.").count(), 0);
        assert_eq!(document.floor.len(), 14 + 16 + 1 + 3 + 5);
    }

    #[test]
    fn regions_say_where_kinds_of_items_were_seen() {
        let document = ParsedDocument::parse(SEMANTIC);
        assert_eq!(document.floor.len(), 14 + 14 + 16 + 16);
        let regions = |instruction: &str| {
            let goal = NavigationGoal::read(instruction).unwrap();
            document.regions(goal.targets[0]).collect::<Vec<_>>()
        };
        let region = Rect { columns: (2, 5), rows: (6, 9) };
        assert_eq!(regions("Find any item of the category barrels."), [region]);
        assert_eq!(regions("Find a red barrel."), [region]);
        assert_eq!(regions("Find a green cone."), []);
    }

    #[test]
    fn in_free_text_a_line_with_a_name_and_a_cell_is_a_place() {
        let text = "I saw two Blue Barrels, at (3, 7) and (3, 9).\n\
                    A blue cone: (1, 1). Cones stand at (9, 9).";
        assert_eq!(standpoints(text, "Find a blue barrel."), [(3, 7), (3, 9)]);
    }

    #[test]
    fn rectangles_may_give_columns_or_rows_first() {
        let rect = |a, b, c, d| Rect { columns: (a, b), rows: (c, d) };
        for (line, expected) in [
            ("- column 3: rows 1-14", vec![rect(3, 3, 1, 14)]),
            ("- row 15: columns 0-15", vec![rect(0, 15, 15, 15)]),
            (
                "- corridors: column 3 (rows 1-14), column 6 (rows 2-13)",
                vec![rect(3, 3, 1, 14), rect(6, 6, 2, 13)],
            ),
            ("barrels [plate 061]: columns 2-5, rows 6-9; seen", vec![rect(2, 5, 6, 9)]),
            ("change corridors in an aisle: rows 0, 15, 29.", vec![]),
            ("columns 2-5 hold 12 things; rows 999", vec![]),
        ] {
            assert_eq!(rects(line), expected, "{line}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_parsed(text: String, template in 0..6_usize) {
            let templates = [
                "{}",
                "- blue barrel: stand at ({}, {})",
                "- \"{}\" from ({}, 3) facing {}: reached {} at (3, {})",
                "## Layout {}\ncolumn {}: rows {}-{}",
                "plate {}-{}",
                "(1, 2) {} (255, 256) columns 0-255 rows 0-255 {}",
            ];
            let text = templates[template].replace("{}", &text);
            let document = ParsedDocument::parse(&text);
            let instruction = "Visit a blue barrel and an orange cone, in any order.";
            for target in NavigationGoal::read(instruction).unwrap().targets {
                let _ = (document.standpoints(target).count(), document.regions(target).count());
            }
            let _ = document.routes(&text).count();
        }
    }
}
