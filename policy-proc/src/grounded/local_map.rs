//! The floor around the agent, and the cheapest routes over it.

use std::collections::VecDeque;

use domain::{Cell, Heading, Pose};

/// Cells along each side of the map.
const SIDE: usize = 64;

/// The cost of a step onto a cell about which nothing is known; a step onto a known free cell costs 1.
const UNKNOWN_COST: u32 = 8;

/// How many cells a route may leave the area that anything is known about.
const MARGIN: u8 = 4;

/// What is known about a cell. Unknown cells may be tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CellState {
    Unknown,
    Free,
    Occupied,
}

/// The square of cells that a map covers.
#[derive(Debug, Clone, Copy)]
struct MapArea {
    /// Column and row of the south-west corner; negative near the grid's edges.
    corner: (i16, i16),
}

impl MapArea {
    fn index(self, cell: Cell) -> Option<usize> {
        let x = usize::try_from(i16::from(cell.x) - self.corner.0).ok()?;
        let y = usize::try_from(i16::from(cell.y) - self.corner.1).ok()?;
        (x < SIDE && y < SIDE).then_some(y * SIDE + x)
    }
}

/// A map of the cells around the agent.
#[derive(Debug, Clone)]
pub(super) struct LocalMap {
    area: MapArea,
    cells: Vec<CellState>,
    /// The south-west and the north-east corner of what is known.
    known: [Cell; 2],
}

impl LocalMap {
    /// A map around `centre`, of which nothing else is known.
    pub(super) fn around(centre: Cell) -> Self {
        let half = SIDE as i16 / 2;
        let area = MapArea { corner: (i16::from(centre.x) - half, i16::from(centre.y) - half) };
        let cells = vec![CellState::Unknown; SIDE * SIDE];
        let mut map = Self { area, cells, known: [centre; 2] };
        map.mark_free(centre);
        map
    }

    pub(super) fn mark_free(&mut self, cell: Cell) {
        self.mark(cell, CellState::Free);
    }

    /// An occupied cell stays occupied, whatever else is marked.
    pub(super) fn mark_occupied(&mut self, cell: Cell) {
        self.mark(cell, CellState::Occupied);
    }

    fn mark(&mut self, cell: Cell, state: CellState) {
        let Some(index) = self.area.index(cell) else { return };
        if self.cells[index] != CellState::Occupied {
            self.cells[index] = state;
        }
        let [low, high] = self.known;
        self.known = [
            Cell::new(low.x.min(cell.x), low.y.min(cell.y)),
            Cell::new(high.x.max(cell.x), high.y.max(cell.y)),
        ];
    }

    pub(super) fn is_free(&self, cell: Cell) -> bool {
        self.state(cell) == Some(CellState::Free)
    }

    pub(super) fn is_occupied(&self, cell: Cell) -> bool {
        self.state(cell) == Some(CellState::Occupied)
    }

    fn state(&self, cell: Cell) -> Option<CellState> {
        self.area.index(cell).map(|index| self.cells[index])
    }

    /// Whether `cell` is in the area that anything is known about, or at most `MARGIN` cells outside it.
    fn is_near_known(&self, cell: Cell) -> bool {
        let [low, high] = self.known;
        let within = |low: u8, at: u8, high: u8| {
            (low.saturating_sub(MARGIN)..=high.saturating_add(MARGIN)).contains(&at)
        };
        within(low.x, cell.x, high.x) && within(low.y, cell.y, high.y)
    }

    /// Searches routes from `start`: to every reachable cell, or only to the nearest of `goals` if there are
    /// any. Of equal routes it finds the one that starts ahead, else right, left, back.
    ///
    /// Breadth first, with one queue per step cost: each queue is in order of cost by itself, and the cheaper
    /// of the two heads comes next.
    pub(super) fn routes(&self, start: Pose, goals: &[Cell]) -> LocalRoutes {
        let directions = [0, 1, 3, 2].map(|quarters| start.heading.turned(quarters));
        let mut routes = LocalRoutes {
            area: self.area,
            start: start.cell,
            reached: vec![None; SIDE * SIDE],
            nearest: None,
        };
        let mut queues = [VecDeque::new(), VecDeque::new()];
        if let Some(index) = self.area.index(start.cell) {
            routes.reached[index] = Some((0, start.heading));
            queues[0].push_back((0, start.cell));
        }
        while let Some((cost, cell)) = pop_cheapest(&mut queues) {
            if routes.cost(cell) != Some(cost) {
                continue;
            }
            if goals.contains(&cell) {
                routes.nearest = Some(cell);
                break;
            }
            for direction in directions {
                let next = cell.step(direction).filter(|&next| self.is_near_known(next));
                let Some(next) = next else { continue };
                let Some(index) = self.area.index(next) else { continue };
                let is_unknown = match self.cells[index] {
                    CellState::Occupied => continue,
                    state => state == CellState::Unknown,
                };
                let cost = cost + if is_unknown { UNKNOWN_COST } else { 1 };
                let reached = &mut routes.reached[index];
                if reached.is_none_or(|(known, _)| cost < known) {
                    *reached = Some((cost, direction));
                    queues[usize::from(is_unknown)].push_back((cost, next));
                }
            }
        }
        routes
    }
}

fn pop_cheapest(queues: &mut [VecDeque<(u32, Cell)>; 2]) -> Option<(u32, Cell)> {
    let [known, unknown] = queues;
    match (known.front(), unknown.front()) {
        (Some((a, _)), Some((b, _))) if b < a => unknown.pop_front(),
        (Some(_), _) => known.pop_front(),
        (None, _) => unknown.pop_front(),
    }
}

/// The cheapest routes from one cell.
#[derive(Debug)]
pub(super) struct LocalRoutes {
    area: MapArea,
    start: Cell,
    /// For each cell of the map, the cost of its route and the route's last move.
    reached: Vec<Option<(u32, Heading)>>,
    /// The goal found first.
    pub(super) nearest: Option<Cell>,
}

impl LocalRoutes {
    fn reached(&self, cell: Cell) -> Option<(u32, Heading)> {
        self.reached[self.area.index(cell)?]
    }

    /// The cost of the route to `goal`; `None` if there is none.
    pub(super) fn cost(&self, goal: Cell) -> Option<u32> {
        self.reached(goal).map(|(cost, _)| cost)
    }

    /// The moves of the route to `goal`; empty if there is none, or the route ends where it starts.
    pub(super) fn moves_to(&self, goal: Cell) -> Vec<Heading> {
        let (mut cell, mut moves) = (goal, Vec::new());
        while cell != self.start
            && let Some((_, heading)) = self.reached(cell)
            && let Some(before) = cell.step(heading.opposite())
        {
            moves.push(heading);
            cell = before;
        }
        moves.reverse();
        moves
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: Pose = Pose::new(40, 40, Heading::N);

    fn with_occupied(cells: &[(u8, u8)]) -> LocalMap {
        let mut map = LocalMap::around(HERE.cell);
        cells.iter().for_each(|&(x, y)| map.mark_occupied(Cell::new(x, y)));
        map
    }

    /// The first direction and the number of moves of a route.
    fn route(map: &LocalMap, x: u8, y: u8) -> Option<(Heading, usize)> {
        let moves = map.routes(HERE, &[]).moves_to(Cell::new(x, y));
        Some((*moves.first()?, moves.len()))
    }

    #[test]
    fn routes_are_straight_where_nothing_is_known() {
        let empty = with_occupied(&[]);
        assert_eq!(route(&empty, 40, 44), Some((Heading::N, 4)));
        assert_eq!(route(&empty, 38, 39), Some((Heading::W, 3)));
        assert_eq!(route(&empty, 42, 41), Some((Heading::N, 3)), "ahead first");
        assert_eq!(route(&empty, 40, 40), None);
        assert_eq!(route(&empty, 40, 50), None, "far beyond what is known");
        assert_eq!(route(&empty, 200, 200), None, "beyond the map");
    }

    #[test]
    fn routes_avoid_occupied_cells() {
        let wall = with_occupied(&[(39, 41), (40, 41), (41, 41), (41, 40)]);
        assert_eq!(route(&wall, 40, 42), Some((Heading::W, 6)));
        let closed = with_occupied(&[(40, 41), (41, 40), (40, 39), (39, 40)]);
        assert_eq!(route(&closed, 40, 42), None);
    }

    #[test]
    fn known_floor_is_worth_a_detour() {
        let mut map = with_occupied(&[]);
        (40..=43).for_each(|y| map.mark_free(Cell::new(41, y)));
        let goal = Cell::new(40, 43);
        let routes = map.routes(HERE, &[]);
        assert_eq!(routes.cost(goal), Some(4 + UNKNOWN_COST));
        assert_eq!(routes.moves_to(goal)[..2], [Heading::E, Heading::N]);
        let nearest = map.routes(HERE, &[Cell::new(38, 40), goal, Cell::new(41, 43)]);
        assert_eq!(nearest.nearest, Some(Cell::new(41, 43)), "by cost, not by distance");
    }

    #[test]
    fn the_grid_ends_at_its_edges() {
        let mut corner = LocalMap::around(Cell::new(0, 0));
        corner.mark_occupied(Cell::new(0, 1));
        let routes = corner.routes(Pose::new(0, 0, Heading::S), &[]);
        assert_eq!(routes.moves_to(Cell::new(0, 2)).len(), 4);
    }
}
