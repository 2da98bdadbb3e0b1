//! What is known of the floor around the agent, and ways over it.

use domain::{Cell, Heading, Pose};

/// Cells to each side of the agent that are looked at.
const REACH: i16 = 31;

/// Cells across: one word has a bit for each, and one bit that is none's.
const SIDE: usize = 2 * REACH as usize + 1;

/// What a step onto a cell costs of which nothing is known: as much as so many on known floor.
const UNKNOWN: u32 = 8;

/// More than any step costs.
const DEAREST: u32 = u64::BITS;

/// What a step onto a doubtful cell costs more.
const DOUBTFUL: u32 = 24;

/// What a step onto a cell in a part of the floor that is kept off costs more.
const KEPT_OFF: u32 = 8;

const _: () = assert!(UNKNOWN + DOUBTFUL + KEPT_OFF < DEAREST);

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

/// Marks all over the grid, to be laid on surroundings at once.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Marks {
    /// The first row with a mark, and from it on a bit for each cell, from the west edge on.
    first: usize,
    rows: Vec<[u64; 4]>,
}

impl Marks {
    /// A mark on each of `cells`.
    pub(super) fn on(cells: impl Iterator<Item = Cell> + Clone) -> Self {
        let ends = cells.clone().map(|cell| usize::from(cell.y));
        let (Some(first), Some(last)) = (ends.clone().min(), ends.max()) else {
            return Self::default();
        };
        let mut rows = vec![[0; 4]; last - first + 1];
        for cell in cells {
            rows[usize::from(cell.y) - first][usize::from(cell.x / 64)] |= 1 << (cell.x % 64);
        }
        Self { first, rows }
    }

    /// Lays them on the square around `here`.
    fn lay(&self, here: Cell, square: &mut [u64; SIDE]) {
        let south = i16::from(here.y) - REACH;
        let west = i16::from(here.x) - REACH;
        let (word, shift) = (west.div_euclid(64), west.rem_euclid(64) as u32);
        for (y, row) in (self.first as i16 - south..).zip(&self.rows) {
            let Some(field) = usize::try_from(y).ok().and_then(|y| square.get_mut(y)) else {
                continue;
            };
            let part = |word: i16| usize::try_from(word).ok().and_then(|word| row.get(word));
            let low = part(word).map_or(0, |&bits| bits >> shift);
            let high = part(word + 1).map_or(0, |&bits| bits.checked_shl(64 - shift).unwrap_or(0));
            *field |= (low | high) & INSIDE;
        }
    }
}

/// The bits of a row that have a cell.
const INSIDE: u64 = u64::MAX >> (u64::BITS as usize - SIDE);

/// The period of doubt from which on the doubtful parts of the floor are drawn.
const DRAWN: u32 = 3;

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
        let period = step / patience.max(1);
        // Before there is anything to draw, all episodes doubt alike.
        Self { seed: if period < DRAWN { 0 } else { episode_seed }, period }
    }

    /// What is added to the cost of a step onto `cell`: the same for 4 x 4 cells.
    fn of(self, cell: Cell) -> u32 {
        if self.period < DRAWN {
            return 0;
        }
        let block = u64::from(cell.x / 4) << 32 | u64::from(cell.y / 4) << 16;
        let mut hash =
            self.seed ^ (block | u64::from(self.period)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        hash = (hash ^ (hash >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        if (hash >> 40).is_multiple_of(3) { KEPT_OFF } else { 0 }
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

/// A row of the square in [`Ways`], which has a column and two rows about it that are closed: whoever looks at
/// a cell's neighbours need not look whether there are any.
const ROW: usize = SIDE + 1;

/// Rows of it.
const ROWS: usize = SIDE + 2;

/// Where the agent is in it.
const START: usize = ROW * (REACH as usize + 1) + REACH as usize;

/// The cheapest ways to everywhere from where the agent is, found as far as they were asked for.
///
/// Dijkstra's search with a queue for every cost, in each of which it is first come, first served. It goes no
/// farther than it must for an answer, and on from there for the next. Of a cell that was reached at no more
/// than the cost that is being served, neither the cost nor the way changes any more.
#[derive(Debug)]
pub(super) struct Ways {
    ground: Surroundings,
    /// A bit for each cell that can be stepped on, in rows of the square.
    open: [u64; ROWS],
    /// By cell: its cost so far times four, and the direction of the last move on the way to it.
    reached: Vec<u32>,
    /// Cells in queues, each with what comes after it in its own.
    waiting: Vec<(u16, u16)>,
    /// First and last of each queue in `waiting`; meaningless where the queue is empty.
    ends: [(u16, u16); DEAREST as usize],
    /// A bit for each queue that is not empty.
    busy: u64,
    /// The cost that is being served.
    at: u32,
}

/// What no cell's cost and last direction come to.
const NOT_REACHED: u32 = u32::MAX;

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

    /// Nobody can be on the cells that are marked.
    pub(super) fn lay_solid(&mut self, marks: &Marks) {
        marks.lay(self.here.cell, &mut self.solid);
    }

    /// Somebody can be on the cells that are marked.
    pub(super) fn lay_free(&mut self, marks: &Marks) {
        marks.lay(self.here.cell, &mut self.free);
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

    /// Ways to everywhere.
    pub(super) fn ways(&self) -> Ways {
        Ways::over(self.clone())
    }

    /// The cheapest way to `goal`: `None` when there is none, or the agent is there.
    #[cfg(test)]
    pub(super) fn way_to(&self, goal: Cell) -> Option<Way> {
        self.ways().to(goal)
    }

    /// What a step onto the cell in column `x` and row `y` of the square costs.
    fn cost_of(&self, x: usize, y: usize) -> u32 {
        let step = if self.free[y] >> x & 1 == 1 { 1 } else { UNKNOWN };
        let doubtful = if self.doubtful[y] >> x & 1 == 1 { DOUBTFUL } else { 0 };
        let in_grid = |from: u8, field: usize| (i16::from(from) + field as i16 - REACH) as u8;
        let cell = Cell::new(in_grid(self.here.cell.x, x), in_grid(self.here.cell.y, y));
        step + doubtful + self.doubt.of(cell)
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

impl Ways {
    fn over(ground: Surroundings) -> Self {
        // Beyond the grid's edges there is nothing to step on.
        let here = ground.here.cell;
        let inside = |from: u8| {
            let first = (REACH - i16::from(from)).max(0) as usize;
            let last = (i16::from(u8::MAX) - i16::from(from) + REACH).min(SIDE as i16 - 1) as usize;
            first..=last
        };
        let columns = inside(here.x).fold(0, |columns, x| columns | 1 << x);
        let mut open = [0; ROWS];
        for y in inside(here.y) {
            open[y + 1] = columns & !ground.solid[y];
        }
        let (waiting, ends) = (Vec::new(), [(0, 0); DEAREST as usize]);
        Self { ground, open, reached: Vec::new(), waiting, ends, busy: 0, at: 0 }
    }

    /// The cell's place in the square; `None` outside it, and where nobody can ever be.
    fn place(&self, cell: Cell) -> Option<usize> {
        let (x, y) = self.ground.field(cell)?;
        let at = ROW * (y + 1) + x;
        (at == START || self.open[y + 1] >> x & 1 == 1).then_some(at)
    }

    /// Searches until the way to the cell in `place` is found, or nothing can be found any more at `dearest`
    /// or less. What the way there costs.
    fn find(&mut self, place: usize, dearest: u32) -> Option<u32> {
        if self.reached.is_empty() {
            self.reached = vec![NOT_REACHED; ROW * ROWS];
            self.waiting.reserve(256);
            self.reached[START] = 0;
            self.wait(START, 0);
        }
        // Clockwise from ahead: of equal ways the one is found that starts forward, else right, left, back.
        let first = [0, 1, 3, 2].map(|quarters| self.ground.here.heading.turned(quarters));
        let moves = first.map(|heading| {
            let (east, north) = heading.vector();
            (heading, isize::from(north) * ROW as isize + isize::from(east))
        });
        while self.reached[place] >> 2 > self.at {
            if self.busy == 0 {
                break;
            }
            let idle = self.busy.rotate_right(self.at % DEAREST).trailing_zeros();
            if self.at + idle > dearest {
                return None;
            }
            self.at += idle;
            self.serve(moves);
        }
        let cost = self.reached[place] >> 2;
        (cost <= self.at).then_some(cost)
    }

    /// Goes on from the first cell that waits at the cost that is being served.
    fn serve(&mut self, moves: [(Heading, isize); 4]) {
        let queue = self.at % DEAREST;
        let (head, tail) = self.ends[queue as usize];
        let (cell, next) = self.waiting[usize::from(head)];
        self.ends[queue as usize].0 = next;
        if head == tail {
            self.busy &= !(1 << queue);
        }
        let cell = usize::from(cell);
        if self.reached[cell] >> 2 != self.at {
            return;
        }
        for (heading, offset) in moves {
            let next = cell.wrapping_add_signed(offset);
            let (y, x) = (next / ROW, next % ROW);
            if self.open[y] >> x & 1 == 0 {
                continue;
            }
            let cost = self.at + self.ground.cost_of(x, y - 1);
            if cost < self.reached[next] >> 2 {
                self.reached[next] = cost << 2 | heading as u32;
                self.wait(next, cost);
            }
        }
    }

    fn wait(&mut self, cell: usize, cost: u32) {
        let queue = cost % DEAREST;
        let at = self.waiting.len() as u16;
        self.waiting.push((cell as u16, 0));
        let (head, tail) = &mut self.ends[queue as usize];
        if self.busy >> queue & 1 == 1 {
            self.waiting[usize::from(*tail)].1 = at;
        } else {
            *head = at;
        }
        *tail = at;
        self.busy |= 1 << queue;
    }

    /// What it costs to get to `cell`.
    pub(super) fn cost(&mut self, cell: Cell) -> Option<u32> {
        self.cost_within(cell, u32::MAX)
    }

    /// What it costs to get to `cell`, if that is no more than `dearest`.
    pub(super) fn cost_within(&mut self, cell: Cell, dearest: u32) -> Option<u32> {
        let place = self.place(cell)?;
        self.find(place, dearest).filter(|&cost| cost <= dearest)
    }

    /// The moves to `goal`, the last one first; none when there is no way or the agent is there.
    fn back_from(&mut self, goal: Cell) -> impl Iterator<Item = Heading> {
        let place = self.place(goal).filter(|&place| self.find(place, u32::MAX).is_some());
        let mut place = place.unwrap_or(START);
        std::iter::from_fn(move || {
            let heading = Heading::ALL[(self.reached.get(place)? & 3) as usize];
            let (east, north) = heading.vector();
            let offset = isize::from(north) * ROW as isize + isize::from(east);
            let is_move = place != START;
            place = place.wrapping_add_signed(-offset);
            is_move.then_some(heading)
        })
    }

    /// The moves of the way to `goal`; none when there is no way or the agent is there.
    pub(super) fn moves_to(&mut self, goal: Cell) -> Vec<Heading> {
        let mut moves: Vec<Heading> = self.back_from(goal).collect();
        moves.reverse();
        moves
    }

    /// The way to `goal`: `None` when there is none, or the agent is there. Of equal ways one is taken that
    /// starts forward, else right, left, back.
    pub(super) fn to(&mut self, goal: Cell) -> Option<Way> {
        let cost = self.cost(goal)?;
        let (mut length, mut straight, mut direction) = (0, 0, None);
        for heading in self.back_from(goal) {
            length += 1;
            straight = if direction == Some(heading) { straight + 1 } else { 1 };
            direction = Some(heading);
        }
        Some(Way { direction: direction?, straight, length, cost })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

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
        assert_eq!(Doubt::at(49, 50, 5), Doubt::at(0, 50, 6), "nothing is drawn yet");
        assert_eq!(Doubt::at(150, 50, 5), Doubt { seed: 5, period: 3 });
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
            ground.ways().moves_to(goal).last().copied()
        };
        assert_eq!([0, 1, 2].map(first), [Some(Heading::S), Some(Heading::E), Some(Heading::S)]);
    }

    proptest! {
        #[test]
        fn marks_are_laid_where_they_are(
            here in any::<(u8, u8)>(),
            cells in prop::collection::vec(any::<(u8, u8)>(), 0..40),
        ) {
            let cells = cells.iter().map(|&(x, y)| Cell::new(x, y));
            let mut one_by_one = Surroundings::new(Pose::new(here.0, here.1, Heading::N), Doubt::default());
            let mut at_once = one_by_one.clone();
            cells.clone().for_each(|cell| one_by_one.mark_free(cell));
            at_once.lay_free(&Marks::on(cells));
            prop_assert_eq!(at_once.free, one_by_one.free);
        }
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
