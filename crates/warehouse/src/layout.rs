//! The floor plan: free floor, racks and walls, and the names of aisles. Items are in the
//! [`catalogue`](crate::catalogue).

use domain::{Cell, Heading};
use serde::Deserialize;

use crate::asset::{Problem, toml};

/// Largest side of a floor plan, in cells.
pub const MAX_SIDE: usize = 64;

/// What fills one square of the floor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Square {
    /// Free floor, part of a named aisle.
    Floor,
    /// A rack. Items stand on its faces towards the floor.
    Rack,
    /// A wall or pillar, and everything outside the plan.
    Wall,
}

/// The direction of an aisle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// Along `x`.
    EastWest,
    /// Along `y`.
    NorthSouth,
}

impl Axis {
    /// The heading in which the coordinate along this axis grows.
    pub const fn forward(self) -> Heading {
        match self {
            Self::EastWest => Heading::E,
            Self::NorthSouth => Heading::N,
        }
    }
}

/// A named part of the free floor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Aisle {
    /// Its name, for example `Cross-aisle`.
    pub name: String,
    /// The direction in which it runs.
    pub runs: Axis,
}

/// The floor plan. Cells are [`Cell`]s: column from the west, row from the south.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    width: u8,
    height: u8,
    /// Row by row from the south; for floor with the index of its aisle.
    squares: Vec<(Square, u8)>,
    aisles: Vec<Aisle>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LayoutFile {
    plan: String,
    aisle: Vec<AisleEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AisleEntry {
    mark: char,
    name: String,
    runs: Axis,
}

impl Layout {
    /// Reads the text of a `layout.toml`.
    ///
    /// # Errors
    /// Rows of different length, an unknown mark, an aisle without floor, floor that cannot be reached. The message names
    /// line, column or aisle.
    pub(crate) fn parse(text: &str) -> Result<Self, Problem> {
        let file: LayoutFile = toml(text)?;
        check_aisles(&file.aisle)?;
        let rows: Vec<Vec<char>> = file.plan.lines().map(|line| line.chars().collect()).collect();
        let width = rows.first().map_or(0, Vec::len);
        if !(3..=MAX_SIDE).contains(&width) || !(3..=MAX_SIDE).contains(&rows.len()) {
            return Err(format!(
                "plan is {width} x {} cells; each side must be 3 to {MAX_SIDE}",
                rows.len()
            ));
        }
        let mut squares = Vec::with_capacity(width * rows.len());
        for (line, row) in rows.iter().enumerate().rev() {
            if row.len() != width {
                return Err(format!(
                    "plan line {} is {} cells wide and the first is {width}; make them equal",
                    line + 1,
                    row.len()
                ));
            }
            for (x, &mark) in row.iter().enumerate() {
                squares.push(match mark {
                    '#' => (Square::Rack, 0),
                    '%' => (Square::Wall, 0),
                    _ => match file.aisle.iter().position(|aisle| aisle.mark == mark) {
                        Some(aisle) => (Square::Floor, aisle as u8),
                        None => {
                            return Err(format!(
                                "plan line {}, column {}: {mark:?} is neither # (rack), % (wall) nor \
                                 the mark of an [[aisle]]",
                                line + 1,
                                x + 1
                            ));
                        }
                    },
                });
            }
        }
        let aisles = file.aisle.into_iter().map(|a| Aisle { name: a.name, runs: a.runs }).collect();
        let layout = Self { width: width as u8, height: rows.len() as u8, squares, aisles };
        layout.check_floor()?;
        Ok(layout)
    }

    /// Checks that every aisle has floor and that all floor is connected.
    fn check_floor(&self) -> Result<(), Problem> {
        for (index, aisle) in self.aisles.iter().enumerate() {
            if !self.free_cells().any(|cell| self.aisle_index(cell) == Some(index)) {
                return Err(format!(
                    "aisle {:?} has no cell in the plan; draw it or remove it",
                    aisle.name
                ));
            }
        }
        let Some(first) = self.free_cells().next() else {
            return Err("plan has no floor; draw at least one aisle".into());
        };
        let reached = self.reachable(first, &[]);
        match self.free_cells().find(|cell| reached.binary_search(cell).is_err()) {
            Some(cell) => Err(format!("floor cell {cell} cannot be reached from {first}")),
            None => Ok(()),
        }
    }

    /// Number of columns.
    pub fn width(&self) -> u8 {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> u8 {
        self.height
    }

    fn index(&self, cell: Cell) -> Option<usize> {
        (cell.x < self.width && cell.y < self.height)
            .then(|| usize::from(cell.y) * usize::from(self.width) + usize::from(cell.x))
    }

    /// What fills `cell`; a wall for cells outside the plan.
    pub fn square(&self, cell: Cell) -> Square {
        self.index(cell).map_or(Square::Wall, |index| self.squares[index].0)
    }

    /// Whether an agent can stand on `cell`.
    pub fn is_free(&self, cell: Cell) -> bool {
        self.square(cell) == Square::Floor
    }

    /// Every cell of the plan, row by row from the south-west corner.
    pub fn cells(&self) -> impl Iterator<Item = Cell> + use<> {
        let width = self.width;
        (0..self.height).flat_map(move |y| (0..width).map(move |x| Cell::new(x, y)))
    }

    /// Every free cell, row by row from the south-west corner.
    pub fn free_cells(&self) -> impl Iterator<Item = Cell> + '_ {
        self.cells().filter(|&cell| self.is_free(cell))
    }

    /// The free neighbour of `cell` towards `heading`.
    pub fn free_neighbour(&self, cell: Cell, heading: Heading) -> Option<Cell> {
        cell.step(heading).filter(|&next| self.is_free(next))
    }

    /// The aisles, in the order of the file.
    pub fn aisles(&self) -> &[Aisle] {
        &self.aisles
    }

    /// The index in [`aisles`](Self::aisles) of the aisle of a free cell.
    pub fn aisle_index(&self, cell: Cell) -> Option<usize> {
        let (square, aisle) = self.squares[self.index(cell)?];
        (square == Square::Floor).then_some(usize::from(aisle))
    }

    /// The aisle of a free cell.
    pub fn aisle(&self, cell: Cell) -> Option<&Aisle> {
        self.aisle_index(cell).map(|index| &self.aisles[index])
    }

    /// The name of the aisle of a free cell.
    pub fn aisle_name(&self, cell: Cell) -> Option<&str> {
        self.aisle(cell).map(|aisle| aisle.name.as_str())
    }

    /// All passages. A passage is the cells across one aisle, from wall or rack to wall or rack; closing it closes the aisle
    /// there across its full width. Sorted by first cell; the cells of each are sorted, too.
    pub fn passages(&self) -> Vec<Vec<Cell>> {
        let mut passages = Vec::new();
        for first in self.free_cells() {
            let Some(index) = self.aisle_index(first) else { continue };
            let across = match self.aisles[index].runs {
                Axis::EastWest => Heading::N,
                Axis::NorthSouth => Heading::E,
            };
            if self.free_neighbour(first, across.opposite()).is_some() {
                continue;
            }
            let run = std::iter::successors(Some(first), |&cell| self.free_neighbour(cell, across));
            let run: Vec<Cell> = run.collect();
            // Cells that leave the aisle are at a junction, which has no full width to close.
            if run.iter().all(|&cell| self.aisle_index(cell) == Some(index)) {
                passages.push(run);
            }
        }
        passages
    }

    /// The free cells that can be reached from `from` without entering `closed`, sorted.
    pub fn reachable(&self, from: Cell, closed: &[Cell]) -> Vec<Cell> {
        let mut reached = vec![from];
        let mut seen = vec![false; self.squares.len()];
        if let Some(index) = self.index(from) {
            seen[index] = true;
        }
        let mut next = 0;
        while let Some(&cell) = reached.get(next) {
            next += 1;
            for heading in Heading::ALL {
                let Some(neighbour) = self.free_neighbour(cell, heading) else { continue };
                let Some(index) = self.index(neighbour) else { continue };
                if !seen[index] && !closed.contains(&neighbour) {
                    seen[index] = true;
                    reached.push(neighbour);
                }
            }
        }
        reached.sort_unstable();
        reached
    }
}

fn check_aisles(aisles: &[AisleEntry]) -> Result<(), Problem> {
    for (index, aisle) in aisles.iter().enumerate() {
        if "#% .".contains(aisle.mark) {
            return Err(format!(
                "aisle {:?}: mark {:?} has a meaning of its own; use a letter",
                aisle.name, aisle.mark
            ));
        }
        if aisle.name.trim().is_empty() {
            return Err(format!("the aisle marked {:?} has no name", aisle.mark));
        }
        if let Some(other) =
            aisles[..index].iter().find(|o| o.mark == aisle.mark || o.name == aisle.name)
        {
            return Err(format!(
                "aisles {:?} and {:?} share a mark or a name; give each its own",
                other.name, aisle.name
            ));
        }
    }
    if aisles.len() > usize::from(u8::MAX) {
        return Err(format!("{} aisles; at most {}", aisles.len(), u8::MAX));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const AISLE: &str = "[[aisle]]\nmark = \"a\"\nname = \"Aisle A\"\nruns = \"north-south\"\n";

    fn parse(plan: &str) -> Result<Layout, Problem> {
        Layout::parse(&format!("plan = \"\"\"\n{plan}\"\"\"\n{AISLE}"))
    }

    #[test]
    fn north_is_up_and_west_is_left() {
        let layout = parse("%a#\naa#\n#aa\n").unwrap();
        assert_eq!((layout.width(), layout.height()), (3, 3));
        assert_eq!(layout.square(Cell::new(0, 2)), Square::Wall);
        assert_eq!(layout.square(Cell::new(0, 0)), Square::Rack);
        assert_eq!(layout.square(Cell::new(2, 0)), Square::Floor);
        assert_eq!(layout.square(Cell::new(3, 0)), Square::Wall, "off the plan");
        assert_eq!(layout.aisle_name(Cell::new(2, 0)), Some("Aisle A"));
        assert_eq!(layout.aisle_name(Cell::new(0, 0)), None);
        assert_eq!(layout.free_cells().count(), 5);
        assert_eq!(layout.reachable(Cell::new(0, 1), &[Cell::new(1, 1)]), [Cell::new(0, 1)]);
    }

    #[test]
    fn a_passage_spans_its_aisle_from_rack_to_rack() {
        let layout = crate::testing::tiny().layout;
        // The aisles east-west are one cell wide and open to the north or south at each junction.
        let across = |y| [1, 2, 4, 5].map(|x| vec![Cell::new(x, y)]);
        let between = [0, 3, 6].map(|x| vec![Cell::new(x, 2)]);
        let mut expected: Vec<Vec<Cell>> = across(1).into_iter().chain(across(3)).collect();
        expected.extend(between);
        expected.sort_by_key(|cells| (cells[0].y, cells[0].x));
        assert_eq!(layout.passages(), expected);
    }

    #[test]
    fn a_broken_plan_says_where() {
        for (plan, expected) in [
            ("aaa\naa\naaa\n", "plan line 2 is 2 cells wide and the first is 3"),
            ("aaa\na?a\naaa\n", "plan line 2, column 2: '?'"),
            ("aa\naa\n", "plan is 2 x 2 cells"),
            ("", "plan is 0 x 0 cells"),
            ("###\n###\n###\n", "\"Aisle A\" has no cell"),
            ("a#a\na#a\na#a\n", "floor cell (2, 0) cannot be reached from (0, 0)"),
        ] {
            let problem = parse(plan).unwrap_err();
            assert!(problem.contains(expected), "{plan:?}: {problem}");
        }
        let twice = format!("plan = \"aaa\\naaa\\naaa\"\n{AISLE}{AISLE}");
        assert!(Layout::parse(&twice).unwrap_err().contains("share a mark or a name"));
        let unknown = format!("plan = \"aaa\"\nplam = 1\n{AISLE}");
        assert!(Layout::parse(&unknown).unwrap_err().contains("plam"));
    }
}
