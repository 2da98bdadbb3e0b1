//! What is known of the floor around the agent, and ways over it.

use std::collections::VecDeque;

use shm_types::{Cell, Heading, Pose};

/// Cells to each side of the agent that are looked at.
const REACH: i16 = 31;

/// Cells across: one word has a bit for each.
const SIDE: usize = 2 * REACH as usize + 1;

/// What a step onto a cell costs of which nothing is known: as much as so many on known floor.
const UNKNOWN: u32 = 8;

/// More than any step costs.
const DEAREST: usize = 64;

/// What a step onto a doubtful cell costs more.
const DOUBTFUL: u32 = 24;

/// A square of cells around the agent, of which some are known to be solid and some known to be floor.
/// Whatever is not known to be solid may be walked on: that is found out by trying.
#[derive(Debug, Clone)]
pub(super) struct Surroundings {
    here: Pose,
    solid: [u64; SIDE],
    free: [u64; SIDE],
    doubtful: [u64; SIDE],
    doubt: Doubt,
}

/// Distrust of parts of the floor, of a kind that changes now and then. What has not led to the end for a
/// long time may be blocked somewhere, which is forgotten once it has left the window; to prefer other ways
/// for a while is then better than to try the same one again: first to come from another side
/// ([`Surroundings::mark_approach`]), later to keep off parts of the floor drawn at random.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub(super) struct Doubt {
    seed: u64,
    period: u32,
}

impl Doubt {
    /// The doubt of an episode's `step`: none at first, then another after every `patience` steps.
    pub(super) fn at(step: u32, patience: u32, episode_seed: u64) -> Self {
        Self { seed: episode_seed, period: step / patience.max(1) }
    }

    /// What is added to the cost of a step onto `cell`: the same for 4 x 4 cells.
    fn of(self, cell: Cell) -> u32 {
        if self.period < 3 {
            return 0;
        }
        let block = u64::from(cell.x / 4) << 32 | u64::from(cell.y / 4) << 16;
        let mut hash =
            self.seed ^ (block | u64::from(self.period)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        hash = (hash ^ (hash >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        if (hash >> 40).is_multiple_of(3) { 8 } else { 0 }
    }
}

/// A way to somewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Way {
    /// The first move.
    pub(super) direction: Heading,
    /// Cells until the way bends or ends.
    pub(super) straight: u32,
    /// Steps.
    pub(super) length: u32,
    /// Steps, with those onto unknown and doubtful cells counted more than once.
    pub(super) cost: u32,
}

/// The cheapest ways to everywhere from where the agent is.
#[derive(Debug)]
pub(super) struct Ways<'a> {
    ground: &'a Surroundings,
    reached: Box<[[Reached; SIDE]; SIDE]>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Reached {
    cost: Option<u32>,
    /// The direction of the last move on the way here.
    by: Option<Heading>,
}

impl Surroundings {
    pub(super) fn new(here: Pose, doubt: Doubt) -> Self {
        Self { here, solid: [0; SIDE], free: [0; SIDE], doubtful: [0; SIDE], doubt }
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

    /// In doubt, `goal` is not to be come to from two of its four sides, and later not from the other two.
    pub(super) fn mark_approach(&mut self, goal: Cell) {
        let sides: &[Heading] = match self.doubt.period {
            1 => &[Heading::N, Heading::E],
            2 => &[Heading::S, Heading::W],
            _ => return,
        };
        for &heading in sides {
            let goal = Pose { cell: goal, heading };
            for (ahead, right) in
                (1..=2).flat_map(|ahead| (-2..=2).map(move |right| (ahead, right)))
            {
                if let Some((x, y)) = goal.cell_at(ahead, right).and_then(|cell| self.field(cell)) {
                    self.doubtful[y] |= 1 << x;
                }
            }
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

    /// Ways to everywhere, or as far as the nearest of `goals` if there are any.
    pub(super) fn ways(&self, goals: &[Cell]) -> Ways<'_> {
        let mut ways = Ways { ground: self, reached: Box::new([[Reached::default(); SIDE]; SIDE]) };
        let mut queue: [VecDeque<(Cell, u32)>; DEAREST] = std::array::from_fn(|_| VecDeque::new());
        let first = [0, 1, 3, 2].map(|quarters| self.here.heading.turned(quarters));
        queue[0].push_back((self.here.cell, 0));
        let mut waiting = 1;
        ways.reach(self.here.cell, 0, None);
        let mut at = 0;
        while waiting > 0 {
            let Some((cell, cost)) = queue[at as usize % DEAREST].pop_front() else {
                at += 1;
                continue;
            };
            waiting -= 1;
            if ways.cost(cell) != Some(cost) {
                continue;
            }
            if goals.contains(&cell) {
                break;
            }
            for heading in first {
                let Some(next) = cell.step(heading).filter(|&next| !self.is_solid(next)) else {
                    continue;
                };
                let step = if self.is_free(next) { 1 } else { UNKNOWN };
                let cost = cost + step + self.doubt_of(next);
                if ways.reach(next, cost, Some(heading)) {
                    queue[cost as usize % DEAREST].push_back((next, cost));
                    waiting += 1;
                }
            }
        }
        ways
    }

    /// The cheapest way to `goal`: `None` when there is none, or the agent is there.
    #[cfg(test)]
    pub(super) fn way_to(&self, goal: Cell) -> Option<Way> {
        self.ways(&[goal]).to(goal)
    }

    fn doubt_of(&self, cell: Cell) -> u32 {
        let is_doubtful = self.field(cell).is_some_and(|(x, y)| self.doubtful[y] >> x & 1 == 1);
        self.doubt.of(cell) + if is_doubtful { DOUBTFUL } else { 0 }
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

impl Ways<'_> {
    /// Whether that is news.
    fn reach(&mut self, cell: Cell, cost: u32, by: Option<Heading>) -> bool {
        let Some((x, y)) = self.ground.field(cell) else { return false };
        let reached = &mut self.reached[y][x];
        let is_news = reached.cost.is_none_or(|known| cost < known);
        if is_news {
            *reached = Reached { cost: Some(cost), by };
        }
        is_news
    }

    /// What it costs to get to `cell`.
    pub(super) fn cost(&self, cell: Cell) -> Option<u32> {
        self.ground.field(cell).and_then(|(x, y)| self.reached[y][x].cost)
    }

    /// The cells of the way to `goal`, which is the last one; empty when there is none or the agent is there.
    pub(super) fn cells_to(&self, goal: Cell) -> Vec<(Heading, Cell)> {
        let by = |cell| self.ground.field(cell).and_then(|(x, y)| self.reached[y][x].by);
        let mut cells = Vec::new();
        let mut cell = goal;
        while let Some(heading) = by(cell) {
            cells.push((heading, cell));
            let Some(before) = cell.step(heading.opposite()) else { break };
            cell = before;
        }
        cells.reverse();
        cells
    }

    /// The way to `goal`: `None` when there is none, or the agent is there. Of equal ways one is taken that
    /// starts forward, else right, left, back.
    pub(super) fn to(&self, goal: Cell) -> Option<Way> {
        let cost = self.cost(goal)?;
        let cells = self.cells_to(goal);
        let &(direction, _) = cells.first()?;
        let straight = cells.iter().take_while(|(heading, _)| *heading == direction).count();
        Some(Way { direction, straight: straight as u32, length: cells.len() as u32, cost })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: Pose = Pose::new(40, 40, Heading::N);

    fn with_solid(cells: &[(u8, u8)]) -> Surroundings {
        let mut surroundings = Surroundings::new(HERE, Doubt::default());
        cells.iter().for_each(|&(x, y)| surroundings.mark_solid(Cell::new(x, y)));
        surroundings
    }

    fn way(ground: &Surroundings, x: u8, y: u8) -> Option<(Heading, u32)> {
        ground.way_to(Cell::new(x, y)).map(|way| (way.direction, way.length))
    }

    #[test]
    fn the_way_is_straight_where_nothing_is_known() {
        let empty = with_solid(&[]);
        assert_eq!(way(&empty, 40, 44), Some((Heading::N, 4)));
        assert_eq!(way(&empty, 38, 39), Some((Heading::W, 3)));
        assert_eq!(way(&empty, 42, 41), Some((Heading::N, 3)), "forward first");
        assert_eq!(way(&empty, 40, 40), None);
        assert_eq!(way(&empty, 40, 72), None, "out of reach");
    }

    #[test]
    fn solid_cells_are_walked_around() {
        let wall = with_solid(&[(39, 41), (40, 41), (41, 41), (41, 40)]);
        assert_eq!(way(&wall, 40, 42), Some((Heading::W, 6)));
        let cell = with_solid(&[(40, 41), (41, 40), (40, 39), (39, 40)]);
        assert_eq!(way(&cell, 40, 42), None);
    }

    #[test]
    fn known_floor_is_worth_a_detour() {
        let mut ground = with_solid(&[]);
        for (x, y) in [(41, 40), (41, 41), (41, 42), (41, 43)] {
            ground.mark_free(Cell::new(x, y));
        }
        let found = ground.way_to(Cell::new(40, 43)).unwrap();
        assert_eq!((found.direction, found.straight), (Heading::E, 1));
        assert_eq!((found.length, found.cost), (5, 4 + UNKNOWN));
    }

    #[test]
    fn doubt_comes_with_time_and_changes_with_it() {
        let cost = |period| {
            let doubt = Doubt { seed: 5, period };
            Surroundings::new(HERE, doubt).way_to(Cell::new(50, 60)).unwrap().cost
        };
        assert_eq!(cost(0), UNKNOWN * 30);
        assert_eq!(Doubt::at(49, 50, 5), Doubt { seed: 5, period: 0 });
        assert!((3..8).any(|period| cost(period) > cost(0)));
        assert!((3..8).any(|period| cost(period) != cost(period + 1)));
    }

    #[test]
    fn in_doubt_a_goal_is_come_to_from_another_side() {
        let first = |period| {
            let mut ground = Surroundings::new(HERE, Doubt { seed: 5, period });
            let goal = Cell::new(40, 36);
            for x in 38..=42 {
                (34..=40).for_each(|y| ground.mark_free(Cell::new(x, y)));
            }
            ground.mark_approach(goal);
            let ways = ground.ways(&[goal]);
            ways.cells_to(goal).last().map(|&(heading, _)| heading)
        };
        assert_eq!([0, 1, 2].map(first), [Some(Heading::S), Some(Heading::E), Some(Heading::S)]);
    }

    #[test]
    fn the_grid_has_an_edge() {
        let mut corner = Surroundings::new(Pose::new(0, 0, Heading::S), Doubt::default());
        corner.mark_solid(Cell::new(0, 1));
        assert_eq!(way(&corner, 0, 2), Some((Heading::E, 4)));
        corner.mark_solid(Cell::new(200, 200));
        assert!(!corner.is_solid(Cell::new(200, 200)), "too far away to be kept");
    }
}
