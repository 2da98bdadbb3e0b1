//! Floor that demonstrations cover, as stretches of columns and rows.

use std::collections::{BTreeMap, BTreeSet};

use domain::Cell;

/// How many demonstrations each cell is part of.
#[derive(Debug, Clone, Default)]
pub(super) struct Floor(BTreeMap<Cell, u32>);

/// Cells in a straight line without a gap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Stretch {
    /// In column `x`, from row `from` to row `to`.
    Column {
        /// The column.
        x: u8,
        /// The southernmost row.
        from: u8,
        /// The northernmost row.
        to: u8,
    },
    /// In row `y`, from column `from` to column `to`.
    Row {
        /// The row.
        y: u8,
        /// The westernmost column.
        from: u8,
        /// The easternmost column.
        to: u8,
    },
}

impl Stretch {
    /// Number of cells.
    pub(super) fn cells(self) -> u8 {
        let (Self::Column { from, to, .. } | Self::Row { from, to, .. }) = self;
        to - from + 1
    }

    fn has(self, cell: Cell) -> bool {
        match self {
            Self::Column { x, from, to } => cell.x == x && (from..=to).contains(&cell.y),
            Self::Row { y, from, to } => cell.y == y && (from..=to).contains(&cell.x),
        }
    }
}

impl Floor {
    /// Adds the cells of a demonstration, each once.
    pub(super) fn add(&mut self, cells: impl IntoIterator<Item = Cell>) {
        for cell in cells.into_iter().collect::<BTreeSet<_>>() {
            *self.0.entry(cell).or_default() += 1;
        }
    }

    /// The maximal stretches of cells that at least `least` demonstrations share, columns before rows.
    pub(super) fn stretches(&self, least: u32) -> Vec<Stretch> {
        let cells = || self.0.iter().filter(|&(_, &count)| count >= least).map(|(&cell, _)| cell);
        let columns = runs(cells().map(|cell| (cell.x, cell.y)));
        let rows = runs(cells().map(|cell| (cell.y, cell.x)));
        let columns = columns.map(|(x, from, to)| Stretch::Column { x, from, to });
        columns.chain(rows.map(|(y, from, to)| Stretch::Row { y, from, to })).collect()
    }

    /// Stretches that cover all cells: for each cell the longest stretch that contains it, a column rather than an
    /// equally long row.
    pub(super) fn covering(&self) -> Vec<Stretch> {
        let all = self.stretches(1);
        let mut needed = BTreeSet::new();
        for &cell in self.0.keys() {
            // `max_by_key` keeps the last of equals, and columns come first.
            needed.extend(all.iter().rev().filter(|s| s.has(cell)).max_by_key(|s| s.cells()));
        }
        needed.into_iter().collect()
    }
}

/// The runs without a gap in each line, from pairs of line and position.
fn runs(places: impl Iterator<Item = (u8, u8)>) -> impl Iterator<Item = (u8, u8, u8)> {
    let mut places: Vec<(u8, u8)> = places.collect();
    places.sort_unstable();
    let follows = |a: &(u8, u8), b: &(u8, u8)| a.0 == b.0 && Some(b.1) == a.1.checked_add(1);
    let runs: Vec<_> =
        places.chunk_by(follows).map(|run| (run[0].0, run[0].1, run[run.len() - 1].1)).collect();
    runs.into_iter()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn floor(cells: &[(u8, u8)]) -> Floor {
        let mut floor = Floor::default();
        floor.add(cells.iter().map(|&(x, y)| Cell::new(x, y)));
        floor
    }

    #[test]
    fn a_bent_route_is_a_column_and_a_row() {
        let cells = [(3, 1), (3, 2), (3, 3), (4, 3), (5, 3)];
        let expected =
            [Stretch::Column { x: 3, from: 1, to: 3 }, Stretch::Row { y: 3, from: 3, to: 5 }];
        assert_eq!(floor(&cells).covering(), expected);
    }

    #[test]
    fn a_wide_corridor_is_covered_lengthwise() {
        let corridor: Vec<_> = (2..4).flat_map(|x| (1..9).map(move |y| (x, y))).collect();
        let expected = [2, 3].map(|x| Stretch::Column { x, from: 1, to: 8 });
        assert_eq!(floor(&corridor).covering(), expected);
    }

    #[test]
    fn a_demonstration_counts_once_and_rare_floor_can_be_left_out() {
        let mut twice = floor(&[(1, 1), (1, 2), (1, 1), (1, 2), (1, 3)]);
        twice.add([Cell::new(1, 1), Cell::new(1, 2)]);
        let column = |to| Stretch::Column { x: 1, from: 1, to };
        assert!(twice.stretches(1).contains(&column(3)));
        assert!(twice.stretches(2).contains(&column(2)) && twice.stretches(3).is_empty());
    }

    proptest! {
        #[test]
        fn stretches_cover_the_floor_and_nothing_else(
            cells in prop::collection::vec((0..9_u8, 0..9_u8), 0..60)
        ) {
            let covering = floor(&cells).covering();
            for cell in (0..9).flat_map(|x| (0..9).map(move |y| (x, y))) {
                let covered = covering.iter().any(|s| s.has(Cell::new(cell.0, cell.1)));
                prop_assert_eq!(covered, cells.contains(&cell));
            }
        }
    }
}
