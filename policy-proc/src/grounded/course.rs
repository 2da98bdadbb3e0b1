//! A fixed way past everything that is wanted, on which where one is says how far one has come.
//!
//! With a window of a few steps nobody can keep a list of what has been visited. But whoever always goes round
//! on the same closed way has visited everything after one round, wherever on it the round began. So the way
//! depends on nothing but what is lastingly known, and it is walked in one direction, facing ahead.

use std::sync::Arc;

use domain::{Action, Cell, Heading, Pose};
use rustc_hash::FxHashMap;

use super::chart::PathStep;
use super::geometry::{after, along, move_towards, turn_towards};
use super::history::History;
use super::surroundings::{Doubt, Surroundings, Way, Ways};

/// Courses that are kept.
const MOST_KEPT: usize = 1024;

/// Steps of a course that must be passable where it is joined.
const CLEAR: usize = 8;

/// Cells that have to lie straight ahead for a turn towards them to be worth its step.
const LONG: u32 = 3;

/// Steps in order. A closed one leads from its last step back to its first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Course {
    steps: Vec<PathStep>,
    is_closed: bool,
    /// The steps at which the first and the last thing wanted are reached.
    first_stop: usize,
    last_stop: usize,
}

impl Course {
    /// The remembered `steps`. Things wanted stand at `stops`.
    pub(super) fn of_walk(steps: &[PathStep], stops: &[Cell]) -> Self {
        let last = steps.len().saturating_sub(1);
        let is_stop = |step: &PathStep| stops.contains(&step.pose.cell);
        let first_stop = steps.iter().position(is_stop).unwrap_or(0);
        Self { steps: steps.to_vec(), is_closed: false, first_stop, last_stop: last }
    }

    /// Made a round by the way back from its end to its start, if there is one.
    pub(super) fn closed(self, ground: impl Fn(Pose) -> Surroundings) -> Self {
        let (Some(&first), Some(&end)) = (self.steps.first(), self.steps.last()) else {
            return self;
        };
        let (last, ground, mut course) = (self.last_stop, ground(end.pose), self);
        let mut ways = ground.ways();
        if end.action.is_some() || ways.cost(first.pose.cell).is_none() {
            return course;
        }
        course.steps.pop();
        let back = ways.moves_to(first.pose.cell);
        let pose = along(end.pose, back, &mut course.steps);
        match turn_towards(pose.heading, first.pose.heading) {
            Some(turn) => course.steps.push(PathStep { pose, action: Some(turn) }),
            // A walk that ends where it begins: its end is its start.
            None if course.steps.len() == last => course.last_stop = last.saturating_sub(1),
            None => {}
        }
        course.is_closed = true;
        course
    }

    /// The round through `stops` in their order. `ground` tells what is known around a cell. `None` when there
    /// are fewer than two stops, or no way from one to the next.
    pub(super) fn through(stops: &[Cell], ground: impl Fn(Pose) -> Surroundings) -> Option<Self> {
        if stops.len() < 2 {
            return None;
        }
        let mut directions = Vec::new();
        let mut legs = Vec::new();
        for (at, &stop) in stops.iter().enumerate() {
            let goal = stops[(at + 1) % stops.len()];
            let heading = directions.last().copied().unwrap_or(Heading::N);
            let ground = ground(Pose { cell: stop, heading });
            let mut ways = ground.ways();
            ways.cost(goal)?;
            directions.extend(ways.moves_to(goal));
            legs.push(directions.len());
        }
        let start = Pose { cell: stops[0], heading: *directions.last()? };
        let mut steps = Vec::new();
        along(start, directions.iter().copied(), &mut steps);
        // The last stop is where the leg before the last one ends.
        let moves = legs[legs.len() - 2];
        let is_move = |step: &PathStep| step.action == Some(Action::Forward);
        let nth = steps.iter().enumerate().filter(|(_, step)| is_move(step)).nth(moves);
        let last_stop = nth.map_or(0, |(at, _)| at);
        Some(Self { steps, is_closed: true, first_stop: 0, last_stop })
    }

    /// What is done on the course where the agent is, if it is on it in the very pose. Of several such
    /// steps the one that the last steps led to most, else the first.
    pub(super) fn action_here(&self, history: &History) -> Option<(usize, Action)> {
        let here = self.steps.iter().enumerate().filter(|(_, step)| step.pose == history.here);
        let candidates = here.filter_map(|(at, step)| Some((at, step.action?)));
        let led_to = |(at, action)| (self.led_to(at, history), std::cmp::Reverse(at), action);
        let best = candidates.map(led_to).max_by_key(|&(led, at, _)| (led, at));
        best.map(|(led, _, action)| (led, action))
    }

    /// How many of the last steps were those of the course before step `at`.
    fn led_to(&self, at: usize, history: &History) -> usize {
        let length = self.steps.len();
        let before = (1..=length).map_while(|back| match at.checked_sub(back) {
            None if !self.is_closed => None,
            before => Some(self.steps[before.unwrap_or((at + length - back % length) % length)]),
        });
        let past = history.past.iter().rev();
        let same = |(past, step): &(&super::history::PastPose, PathStep)| {
            past.pose == step.pose && past.action == step.action
        };
        past.zip(before).take_while(same).count()
    }

    /// The step that brings the agent onto the course where that makes the rest shortest, if everything
    /// wanted is still to be visited, around what is known to be in the way; and how many steps it makes in all.
    pub(super) fn join(
        &self,
        history: &History,
        ground: &Surroundings,
        ways: &mut Ways,
    ) -> Option<(u32, Action)> {
        let here = history.here;
        let clear = |at: usize| (0..CLEAR).all(|ahead| !self.is_solid(at + ahead, ground));
        // What comes after the way to a step.
        let then = |(at, step): (usize, &PathStep)| {
            let turn = turn_towards(here.heading, step.pose.heading).is_some();
            step.action.map(|_| (u32::from(turn) + self.left(at), at, step.pose.cell))
        };
        let joints = || self.steps.iter().enumerate().filter_map(then);
        let least = |&(then, at, cell): &(u32, usize, Cell)| (then + here.cell.distance(cell), at);
        // What looks best is looked at first: that spares looking far for others.
        let promising = joints().filter(|&(_, at, _)| clear(at)).min_by_key(least);
        let mut best: Option<(u32, usize)> = None;
        for joint in promising.into_iter().chain(joints()) {
            let (then, at, cell) = joint;
            if best.is_some_and(|best| best <= least(&joint)) || !clear(at) {
                continue;
            }
            let dearest = best.map_or(u32::MAX, |(cost, _)| cost - then);
            if let Some(cost) = ways.cost_within(cell, dearest) {
                best = best.into_iter().chain([(cost + then, at)]).min();
            }
        }
        let (cost, at) = best?;
        let step = self.steps[at];
        let action = if step.pose.cell == here.cell {
            turn_towards(here.heading, step.pose.heading).or(step.action)?
        } else {
            stride(here.heading, ways.to(step.pose.cell)?)
        };
        Some((cost, action))
    }

    fn is_solid(&self, at: usize, ground: &Surroundings) -> bool {
        let at = if self.is_closed { at % self.steps.len() } else { at };
        self.steps.get(at).is_some_and(|step| ground.is_solid(step.pose.cell))
    }

    /// Steps from step `at` until everything wanted has been visited.
    fn left(&self, at: usize) -> u32 {
        let whole = if at <= self.first_stop || !self.is_closed { 0 } else { self.steps.len() };
        (whole + self.last_stop).saturating_sub(at) as u32
    }
}

/// A step on `way`: a turn first when it leads on straight for long, so that what lies ahead is seen.
pub(super) fn stride(heading: Heading, way: Way) -> Action {
    let turn = turn_towards(heading, way.direction).filter(|_| way.straight >= LONG);
    turn.unwrap_or_else(|| move_towards(heading, way.direction))
}

/// Whether `action` did not fail here lately, and does not lead where the agent has been twice lately.
pub(super) fn leads_on(action: Action, history: &History, ground: &Surroundings) -> bool {
    after(history.here, action).is_some_and(|pose| {
        let stays = pose.cell == history.here.cell;
        history.times_in(pose) < 2 && (stays || !ground.is_solid(pose.cell))
    })
}

/// The shortest round through one cell of each of `groups`, in their order: the cells.
pub(super) fn best_choice(
    groups: &[Vec<Cell>],
    ground: &dyn Fn(Pose) -> Surroundings,
) -> Option<Vec<Cell>> {
    let (first, rest) = groups.split_first()?;
    let mut distances = Distances { known: FxHashMap::default(), ground };
    let mut best: Option<(u32, Vec<Cell>)> = None;
    for &start in first {
        let mut ends: Vec<(u32, Vec<Cell>)> = vec![(0, vec![start])];
        for group in rest {
            let extend = |&cell: &Cell| {
                let from = |(cost, cells): &(u32, Vec<Cell>)| {
                    let cost = cost + distances.of(*cells.last()?, cell)?;
                    Some((cost, [cells.as_slice(), &[cell]].concat()))
                };
                ends.iter().filter_map(from).min()
            };
            ends = group.iter().filter_map(extend).collect();
        }
        for (cost, cells) in ends {
            let Some(back) = cells.last().and_then(|&last| distances.of(last, start)) else {
                continue;
            };
            if best.as_ref().is_none_or(|(least, _)| cost + back < *least) {
                best = Some((cost + back, cells));
            }
        }
    }
    best.map(|(_, cells)| cells)
}

/// `cells` in the order of a short round that begins with the first: nearest next, then as long as reversing
/// a stretch makes it shorter, that.
pub(super) fn round_trip(mut cells: Vec<Cell>, ground: &dyn Fn(Pose) -> Surroundings) -> Vec<Cell> {
    let mut distances = Distances { known: FxHashMap::default(), ground };
    let mut cost = |a, b| distances.of(a, b).unwrap_or(10_000);
    for at in 1..cells.len() {
        let from = cells[at - 1];
        let nearest = (at..cells.len()).min_by_key(|&next| (cost(from, cells[next]), cells[next]));
        cells.swap(at, nearest.unwrap_or(at));
    }
    let mut improved = true;
    while improved {
        improved = false;
        for i in 1..cells.len() {
            for j in i + 1..cells.len() {
                let next = cells[(j + 1) % cells.len()];
                let now = cost(cells[i - 1], cells[i]) + cost(cells[j], next);
                if cost(cells[i - 1], cells[j]) + cost(cells[i], next) < now {
                    cells[i..=j].reverse();
                    improved = true;
                }
            }
        }
    }
    cells
}

/// What it costs to get from cell to cell.
struct Distances<'a> {
    known: FxHashMap<Cell, Ways>,
    ground: &'a dyn Fn(Pose) -> Surroundings,
}

impl Distances<'_> {
    fn of(&mut self, from: Cell, to: Cell) -> Option<u32> {
        let pose = Pose { cell: from, heading: Heading::N };
        self.known.entry(from).or_insert_with(|| (self.ground)(pose).ways()).cost(to)
    }
}

/// What kind of course.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Plan {
    /// Along a whole walk, by its position among those known.
    Walk(u16),
    /// Through the standpoints of what is wanted.
    Stops,
    /// Through the regions in which what is wanted has been seen.
    Regions,
}

/// Everything that a course is made from.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct Source {
    pub(super) plan: Plan,
    /// Names what is lastingly known for the instruction.
    pub(super) lasting: u64,
    /// Positions of the whole walks that are kept.
    pub(super) kept: Vec<u16>,
    pub(super) origin: Option<Cell>,
    pub(super) doubt: Doubt,
}

/// Courses by what they are made from.
#[derive(Debug, Default)]
pub(super) struct Courses {
    kept: FxHashMap<Source, Option<Arc<Course>>>,
}

impl Courses {
    /// The course that is made from `source` by `make`, which may use nothing else.
    pub(super) fn of(
        &mut self,
        source: Source,
        make: impl FnOnce() -> Option<Course>,
    ) -> Option<Arc<Course>> {
        if self.kept.len() >= MOST_KEPT {
            self.kept.clear();
        }
        self.kept.entry(source).or_insert_with(|| make().map(Arc::new)).clone()
    }
}

#[cfg(test)]
mod tests;
