//! What is known of the cells around the agent, from the last few steps alone, and ways through them.

use shm_types::{Cell, Heading, Pose};

/// Cells to each side of the agent that are looked at.
const REACH: i16 = 15;

/// Cells across: one word has a bit for each.
const SIDE: usize = 2 * REACH as usize + 1;

/// A square of cells around the agent, of which some are known to be solid. Whatever is not known to
/// be solid may be walked on: that is found out by trying.
#[derive(Debug, Clone)]
pub(super) struct Surroundings {
    here: Pose,
    solid: [u32; SIDE],
    free: [u32; SIDE],
}

impl Surroundings {
    pub(super) fn new(here: Pose) -> Self {
        Self { here, solid: [0; SIDE], free: [0; SIDE] }
    }

    /// Nobody can be on `cell`.
    pub(super) fn mark_solid(&mut self, cell: Cell) {
        if let Some((x, y)) = self.field(cell) {
            self.solid[y] |= 1 << x;
        }
    }

    /// Somebody can be on `cell`.
    pub(super) fn mark_free(&mut self, cell: Cell) {
        if let Some((x, y)) = self.field(cell) {
            self.free[y] |= 1 << x;
        }
    }

    /// Whether nobody can be on `cell`, as far as is known.
    pub(super) fn is_solid(&self, cell: Cell) -> bool {
        self.field(cell).is_some_and(|(x, y)| self.solid[y] >> x & 1 == 1)
    }

    /// Whether somebody can be on `cell`, as far as is known.
    pub(super) fn is_free(&self, cell: Cell) -> bool {
        self.field(cell).is_some_and(|(x, y)| self.free[y] >> x & 1 == 1)
    }

    /// The first move of a shortest way to `goal` and the way's length: `None` when there is no way, or
    /// the agent is there. Of equal ways the one that starts forward is taken, then right, left, back.
    pub(super) fn way_to(&self, goal: Cell) -> Option<(Heading, u32)> {
        self.field(goal)?;
        // Backwards from the goal, so that the agent's neighbours know their distances.
        let mut distance = [[u32::MAX; SIDE]; SIDE];
        let mut queue = std::collections::VecDeque::from([goal]);
        let (x, y) = self.field(goal)?;
        distance[y][x] = 0;
        while let Some(cell) = queue.pop_front() {
            let (x, y) = self.field(cell)?;
            if cell == self.here.cell {
                break;
            }
            let next = distance[y][x] + 1;
            for neighbour in Heading::ALL.into_iter().filter_map(|heading| cell.step(heading)) {
                if let Some((x, y)) = self.field(neighbour)
                    && !self.is_solid(neighbour)
                    && distance[y][x] == u32::MAX
                {
                    distance[y][x] = next;
                    queue.push_back(neighbour);
                }
            }
        }
        let of = |cell: Cell| self.field(cell).map_or(u32::MAX, |(x, y)| distance[y][x]);
        let length = of(self.here.cell);
        let first = [0, 1, 3, 2].map(|quarters| self.here.heading.turned(quarters));
        let leads = |heading: &Heading| {
            self.here.cell.step(*heading).is_some_and(|cell| of(cell).saturating_add(1) == length)
        };
        (length != u32::MAX && length != 0).then_some(())?;
        first.into_iter().find(leads).map(|heading| (heading, length))
    }

    /// Column and row in the square.
    fn field(&self, cell: Cell) -> Option<(usize, usize)> {
        let along = |to: u8, from: u8| {
            let field = i16::from(to) - i16::from(from) + REACH;
            usize::try_from(field).ok().filter(|&field| field < SIDE)
        };
        Some((along(cell.x, self.here.cell.x)?, along(cell.y, self.here.cell.y)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: Pose = Pose::new(20, 20, Heading::N);

    fn with_solid(cells: &[(u8, u8)]) -> Surroundings {
        let mut surroundings = Surroundings::new(HERE);
        cells.iter().for_each(|&(x, y)| surroundings.mark_solid(Cell::new(x, y)));
        surroundings
    }

    #[test]
    fn the_way_is_straight_where_nothing_is_known() {
        let empty = with_solid(&[]);
        assert_eq!(empty.way_to(Cell::new(20, 24)), Some((Heading::N, 4)));
        assert_eq!(empty.way_to(Cell::new(18, 19)), Some((Heading::W, 3)));
        assert_eq!(empty.way_to(Cell::new(22, 21)), Some((Heading::N, 3)), "forward first");
        assert_eq!(empty.way_to(HERE.cell), None);
        assert_eq!(empty.way_to(Cell::new(20, 36)), None, "out of reach");
    }

    #[test]
    fn solid_cells_are_walked_around() {
        let wall = with_solid(&[(19, 21), (20, 21), (21, 21), (21, 20)]);
        assert_eq!(wall.way_to(Cell::new(20, 22)), Some((Heading::W, 6)));
        let cell = with_solid(&[(20, 21), (21, 20), (20, 19), (19, 20)]);
        assert_eq!(cell.way_to(Cell::new(20, 22)), None);
    }

    #[test]
    fn the_grid_has_an_edge() {
        let mut corner = Surroundings::new(Pose::new(0, 0, Heading::S));
        corner.mark_solid(Cell::new(0, 1));
        assert_eq!(corner.way_to(Cell::new(0, 2)), Some((Heading::E, 4)));
        corner.mark_solid(Cell::new(200, 200));
        assert!(!corner.is_solid(Cell::new(200, 200)), "too far away to be kept");
    }
}
