//! Draws streams from a seed (specification, section 9).
//!
//! A stream is drawn block by block. Its first block is the unchanged world. Before each later one, events of one kind are
//! drawn until enough cases are *affected*, and the block's cases are drawn from those. Each stream draws from numbers of
//! its own, so the first streams of a larger set are those of a smaller one.

use std::collections::BTreeMap;

use domain::{Cell, EventKind, Pose, StreamRules};

use super::{Block, Event, Stream, StreamError, StreamSet};
use crate::asset::Problem;
use crate::case::{Case, CaseSet};
use crate::constraints::{DISTANT_CELLS, enters, target_on};
use crate::draw::Draw;
use crate::generate::{LEAST_STEPS, MOST_BLOCKED_STEPS};
use crate::plan::{Planner, Prices};
use crate::state::{StockChange, WorldChange, WorldState};
use crate::task::{Phase, Task};
use crate::trajectory::{Replay, Trajectory};
use crate::world::{Item, Warehouse, faced_bay};

/// Draws of one stream until one satisfies all rules.
const TRIES: u64 = 200;

/// Types tried for the second of two that swap, and bays tried for an item.
const CHOICES: usize = 8;

impl StreamSet {
    /// Draws streams from the cases of `set` with the indices `among`. The rules:
    ///
    /// - The first block has the unchanged world and any cases.
    /// - A case is *intact* in a world if its original demonstration and its test reference, replayed there, both complete
    ///   the task, and *broken* if neither does.
    /// - Before a later block, events of the block's kind happen until at least as many cases as the block needs were
    ///   intact and are broken. Each event is drawn for one such case. The block's cases are drawn from all of them. Where a
    ///   passage opens again it is the other way round: they were broken and are intact.
    /// - A passage closes that the case's demonstration and test reference both use. It holds no target of the case and no
    ///   start.
    /// - An item moves that both of them visit, to an empty bay at least 6 cells away in another aisle.
    /// - Two types swap places, of which one is that of an item that both of them visit.
    /// - An item is added of a type that a task asks to visit completely, in an empty bay.
    /// - Every case of the stream can be solved in every world of the stream, from its test start and from its original
    ///   start, by an expert's trajectory of 6 to 120 steps.
    ///
    /// # Errors
    /// When rules contradict each other, or no stream that follows them is found.
    pub fn draw(
        warehouse: &Warehouse,
        set: &CaseSet,
        among: &[usize],
        seed: u64,
        rules: &StreamRules,
    ) -> Result<Self, StreamError> {
        check(rules).map_err(StreamError)?;
        let drawing = Drawing { warehouse, set, among, rules };
        let mut worlds = vec![WorldChange::default()];
        let mut streams = Vec::new();
        for number in 0..rules.streams {
            let mut problem = Problem::new();
            let drawn = (0..TRIES).find_map(|attempt| {
                let draw = Draw::new(seed, STREAM | u64::from(number) << 16 | attempt);
                drawing.stream(draw).map_err(|reason| problem = reason).ok()
            });
            let drawn = drawn.ok_or_else(|| {
                StreamError(format!(
                    "no stream {number} found for seed {seed} among {} cases in {TRIES} draws; the last: {problem}; \
                     select more cases (--cases, --limit), or give fewer blocks or cases per block",
                    among.len()
                ))
            })?;
            let blocks = drawn.into_iter().map(|(change, cases, events)| {
                let known = worlds.iter().position(|world| *world == change);
                let world = known.unwrap_or_else(|| {
                    worlds.push(change);
                    worlds.len() - 1
                });
                Block { world: world as u32, cases, events }
            });
            streams.push(Stream { blocks: blocks.collect() });
        }
        Ok(Self { seed, worlds, streams })
    }
}

/// Marks the draws of streams.
const STREAM: u64 = 2 << 56;

/// Checks rules without drawing anything.
fn check(rules: &StreamRules) -> Result<(), Problem> {
    let StreamRules { blocks, cases_per_block, events, .. } = rules;
    if *blocks == 0 || *cases_per_block == 0 {
        return Err("a stream has at least one block, and a block at least one case".into());
    }
    if *blocks > 1 && events.is_empty() {
        return Err(format!("{blocks} blocks need events between them (events)"));
    }
    let kinds = events.iter().cycle().take(*blocks as usize - 1);
    let mut closed = 0_u32;
    for (kind, block) in kinds.zip(2..) {
        match kind {
            EventKind::Close => closed += 1,
            EventKind::Open if closed == 0 => {
                return Err(format!(
                    "a passage opens before block {block}, and none is closed then: `close` comes first in events"
                ));
            }
            EventKind::Open => closed -= 1,
            EventKind::Move | EventKind::Swap | EventKind::Add => {}
        }
    }
    Ok(())
}

struct Drawing<'a> {
    warehouse: &'a Warehouse,
    set: &'a CaseSet,
    among: &'a [usize],
    rules: &'a StreamRules,
}

/// A block before worlds are numbered.
type DrawnBlock = (WorldChange, Vec<u32>, Vec<Event>);

/// The world while a stream is drawn.
#[derive(Clone)]
struct DrawnWorld {
    /// Closed passages.
    closed: Vec<Vec<Cell>>,
    /// Types by standpoint.
    stock: BTreeMap<Cell, usize>,
    state: WorldState,
}

impl Drawing<'_> {
    fn stream(&self, mut draw: Draw) -> Result<Vec<DrawnBlock>, Problem> {
        let count = self.rules.cases_per_block as usize;
        if self.among.len() < count {
            return Err(format!("a block has {count} cases"));
        }
        let mut world = self.unchanged()?;
        let first = some(self.among.to_vec(), count, &mut draw);
        let mut blocks = vec![(world.change(self.warehouse), first, Vec::new())];
        let mut states = vec![world.state.clone()];
        for (&kind, block) in self.rules.events.iter().cycle().zip(2..=self.rules.blocks) {
            let stream_cases: Vec<u32> =
                blocks.iter().flat_map(|(_, cases, _)| cases).copied().collect();
            let (events, mut affected) =
                self.events(kind, &mut world, &stream_cases, &mut draw).ok_or_else(|| {
                    format!("no events `{}` affect {count} cases of block {block}", kind.word())
                })?;
            affected.retain(|&case| {
                states.iter().all(|state| may_be_solved(&self.set.cases[case], state))
            });
            if affected.len() < count {
                return Err(format!("block {block} has {} cases", affected.len()));
            }
            states.push(world.state.clone());
            let cases = some(affected, count, &mut draw);
            blocks.push((world.change(self.warehouse), cases, events));
        }
        self.check_solvable(&blocks)?;
        Ok(blocks)
    }

    fn unchanged(&self) -> Result<DrawnWorld, Problem> {
        let stock = self.warehouse.items.iter().map(|item| (item.standpoint, item.item_type));
        let state = WorldState::new(self.warehouse, &WorldChange::default());
        let state = state.map_err(|error| error.to_string())?;
        Ok(DrawnWorld { closed: Vec::new(), stock: stock.collect(), state })
    }

    /// Draws events of one kind, changes the world, and returns them with the cases that they affect. The
    /// cases `stream_cases`, those of the blocks so far, may still be solved then.
    fn events(
        &self,
        kind: EventKind,
        world: &mut DrawnWorld,
        stream_cases: &[u32],
        draw: &mut Draw,
    ) -> Option<(Vec<Event>, Vec<usize>)> {
        let count = self.rules.cases_per_block as usize;
        let change = ValidityChange::of(kind);
        let before = self.validities(&world.state);
        let mut events = Vec::new();
        loop {
            let after = self.validities(&world.state);
            let cases_from_to = |from: Validity, to: Validity| -> Vec<usize> {
                let validities = before.iter().zip(&after);
                let cases = self.among.iter().zip(validities);
                cases.filter(|&(_, change)| change == (&from, &to)).map(|(case, _)| *case).collect()
            };
            let mut affected = cases_from_to(change.from, change.to);
            affected.retain(|&case| may_be_solved(&self.set.cases[case], &world.state));
            if affected.len() >= count {
                return Some((events, affected));
            }
            if events.len() == count {
                return None;
            }
            let unaffected = draw.shuffled(cases_from_to(change.from, change.from));
            let (event, next) = unaffected
                .into_iter()
                .find_map(|case| self.affecting_event(kind, case, world, stream_cases, draw))?;
            events.push(event);
            *world = next;
        }
    }

    /// An event that affects `case` as its kind says, and the world after it, in which that case and those of the stream may still
    /// be solved.
    fn affecting_event(
        &self,
        kind: EventKind,
        case: usize,
        world: &DrawnWorld,
        stream_cases: &[u32],
        draw: &mut Draw,
    ) -> Option<(Event, DrawnWorld)> {
        let case = &self.set.cases[case];
        let event = self.event(kind, case, world, draw)?;
        let next = world.after(&event, self.warehouse)?;
        let others = stream_cases.iter().map(|&index| &self.set.cases[index as usize]);
        let is_affected = validity(case, &next.state) == ValidityChange::of(kind).to;
        let is_solvable = others.chain([case]).all(|case| may_be_solved(case, &next.state));
        (is_affected && is_solvable).then_some((event, next))
    }

    fn validities(&self, state: &WorldState) -> Vec<Validity> {
        self.among.iter().map(|&case| validity(&self.set.cases[case], state)).collect()
    }

    /// An event of this kind that should affect `case`.
    fn event(
        &self,
        kind: EventKind,
        case: &Case,
        world: &DrawnWorld,
        draw: &mut Draw,
    ) -> Option<Event> {
        let layout = &self.warehouse.layout;
        let replay = |trajectory: &Trajectory| {
            trajectory.replay(&world.state.warehouse, &case.task, &world.state.variant)
        };
        match kind {
            EventKind::Close => {
                let targets = case.task.targets(&world.state.warehouse);
                let paths = [replay(&case.original).poses, replay(&case.test).poses];
                let starts = [case.original.start.cell, case.test.start.cell];
                let fits = |cells: &Vec<Cell>| {
                    paths.iter().all(|path| enters(path, cells))
                        && target_on(cells, &targets).is_none()
                        && !starts.iter().any(|start| cells.contains(start))
                        && !world.closed.contains(cells)
                };
                let passages: Vec<Vec<Cell>> = layout.passages().into_iter().filter(fits).collect();
                draw.shuffled(passages).pop().map(|cells| Event::Close { cells })
            }
            EventKind::Open => {
                let cells = draw.shuffled(world.closed.clone()).pop()?;
                Some(Event::Open { cells })
            }
            EventKind::Move => {
                let item = self.visited(case, world, &replay, draw)?;
                let is_far = |cell: &Cell| {
                    layout.aisle_index(*cell) != layout.aisle_index(item.standpoint)
                        && cell.distance(item.standpoint) >= DISTANT_CELLS
                };
                let to = self.empty_bays(world).filter(is_far).collect();
                let to = draw.shuffled(to).pop()?;
                Some(Event::Move { item_type: item.item_type, from: item.standpoint, to })
            }
            EventKind::Swap => {
                let a = self.visited(case, world, &replay, draw)?.item_type;
                let others =
                    (0..self.warehouse.catalogue.types.len()).filter(|&b| b != a).collect();
                let swap = |b| Event::Swap { a, b };
                let breaks = |event: &Event| {
                    let next = world.after(event, self.warehouse);
                    next.is_some_and(|next| validity(case, &next.state) == Validity::Broken)
                };
                draw.shuffled(others).into_iter().take(CHOICES).map(swap).find(breaks)
            }
            EventKind::Add => {
                let types = match case.task {
                    Task::EveryOfType { a } | Task::EveryAndReturn { a } => vec![a],
                    Task::EveryOfCategory { c } => self.warehouse.catalogue.types_in(c).collect(),
                    _ => return None,
                };
                let item_type = draw.pick(&types);
                let at = draw.shuffled(self.empty_bays(world).collect()).pop()?;
                Some(Event::Add { item_type, at })
            }
        }
    }

    /// An item that counts for the case and that both of its trajectories visit.
    fn visited(
        &self,
        case: &Case,
        world: &DrawnWorld,
        replay: &dyn Fn(&Trajectory) -> Replay,
        draw: &mut Draw,
    ) -> Option<Item> {
        let warehouse = &world.state.warehouse;
        let visits = |trajectory: &Trajectory| -> Vec<Cell> {
            let Replay { poses, goal_steps, .. } = replay(trajectory);
            goal_steps.iter().map(|&step| poses[step as usize].cell).collect()
        };
        let (demonstrated, referenced) = (visits(&case.original), visits(&case.test));
        let both = case.task.targets(warehouse).into_iter().filter(|item| {
            demonstrated.contains(&item.standpoint) && referenced.contains(&item.standpoint)
        });
        draw.shuffled(both.copied().collect()).pop()
    }

    /// The standpoints of empty bays, row by row. None is closed.
    fn empty_bays<'n>(&'n self, world: &'n DrawnWorld) -> impl Iterator<Item = Cell> + 'n {
        let layout = &self.warehouse.layout;
        let is_empty = move |cell: &Cell| {
            !world.stock.contains_key(cell)
                && faced_bay(layout, *cell).is_ok()
                && !world.state.variant.is_closed(*cell)
        };
        layout.free_cells().filter(is_empty)
    }

    /// Checks that the expert solves every case of the stream in each of its worlds.
    fn check_solvable(&self, blocks: &[DrawnBlock]) -> Result<(), Problem> {
        let mut cases: Vec<u32> = blocks.iter().flat_map(|(_, cases, _)| cases).copied().collect();
        cases.sort_unstable();
        cases.dedup();
        let changed = (1..).zip(blocks).filter(|(_, (change, ..))| !change.is_empty());
        for (block, (change, ..)) in changed {
            let state =
                WorldState::new(self.warehouse, change).map_err(|error| error.to_string())?;
            let expert = state.expert();
            for case in cases.iter().map(|&case| &self.set.cases[case as usize]) {
                for start in [case.test.start, case.original.start] {
                    let length =
                        state.reference(&expert, &case.task, start).map(|(_, length)| length);
                    if !length
                        .is_some_and(|length| (LEAST_STEPS..=MOST_BLOCKED_STEPS).contains(&length))
                    {
                        return Err(format!(
                            "in the world of block {block} case {} cannot be solved in 6 to 120 steps from {start}",
                            case.id
                        ));
                    }
                }
            }
        }
        Ok(())
    }
}

impl WorldState {
    /// A planner of expert trajectories in this state.
    pub fn expert(&self) -> Planner<'_> {
        Planner::new(&self.warehouse, self.variant.clone(), Prices::EXPERT)
    }

    /// The expert's trajectory from `start` in this state, planned by [`expert`](Self::expert), and the steps that complete
    /// the task: the reference of an episode. `None` if the task cannot be completed.
    pub fn reference(
        &self,
        expert: &Planner<'_>,
        task: &Task,
        start: Pose,
    ) -> Option<(Trajectory, u32)> {
        if self.variant.is_closed(start.cell) {
            return None;
        }
        let trajectory = expert.plan(start, task)?;
        let length = trajectory.replay(&self.warehouse, task, &self.variant).length?;
        Some((trajectory, length))
    }

    /// Whether `trajectory`, replayed in this state, completes `task`.
    pub fn completes(&self, trajectory: &Trajectory, task: &Task) -> bool {
        trajectory.replay(&self.warehouse, task, &self.variant).length.is_some()
    }
}

/// Whether a case's original demonstration and test reference complete its task in a world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Validity {
    /// Both do.
    Intact,
    /// One does.
    Half,
    /// Neither does.
    Broken,
}

/// The validity that an event of some kind takes from cases, and the one that it gives them.
#[derive(Debug, Clone, Copy)]
struct ValidityChange {
    from: Validity,
    to: Validity,
}

impl ValidityChange {
    /// A passage that opens mends cases; every other event breaks them.
    const fn of(kind: EventKind) -> Self {
        match kind {
            EventKind::Open => Self { from: Validity::Broken, to: Validity::Intact },
            EventKind::Close | EventKind::Move | EventKind::Swap | EventKind::Add => {
                Self { from: Validity::Intact, to: Validity::Broken }
            }
        }
    }
}

/// Whether no start of the case is closed and every sub-goal has an item that can be reached. Whether the task can be completed
/// in time is for the planner to say.
fn may_be_solved(case: &Case, state: &WorldState) -> bool {
    let is_open = |cell| !state.variant.is_closed(cell);
    let is_reachable =
        |set: &Vec<u16>| set.iter().any(|&id| is_open(state.warehouse.item(id).standpoint));
    let phases = case.task.phases(&state.warehouse);
    let can_be_met = |phase: &Phase| match phase {
        Phase::OneOfEach(sets) => sets.iter().all(is_reachable),
        Phase::Origin | Phase::FirstAgain => true,
    };
    is_open(case.test.start.cell)
        && is_open(case.original.start.cell)
        && phases.iter().all(can_be_met)
}

/// `count` of `cases`, sorted.
fn some(cases: Vec<usize>, count: usize, draw: &mut Draw) -> Vec<u32> {
    let chosen = draw.shuffled(cases).into_iter().take(count);
    let mut chosen: Vec<u32> = chosen.map(|case| case as u32).collect();
    chosen.sort_unstable();
    chosen
}

fn validity(case: &Case, state: &WorldState) -> Validity {
    let completes = |trajectory| state.completes(trajectory, &case.task);
    match (completes(&case.original), completes(&case.test)) {
        (true, true) => Validity::Intact,
        (false, false) => Validity::Broken,
        _ => Validity::Half,
    }
}

impl DrawnWorld {
    /// The world after `event`; `None` if it does not fit.
    fn after(&self, event: &Event, warehouse: &Warehouse) -> Option<Self> {
        let mut next = self.clone();
        match *event {
            Event::Close { ref cells } => next.closed.push(cells.clone()),
            Event::Open { ref cells } => next.closed.retain(|closed| closed != cells),
            Event::Move { item_type, from, to } => {
                next.stock.remove(&from);
                next.stock.insert(to, item_type);
            }
            Event::Swap { a, b } => {
                for item_type in next.stock.values_mut() {
                    if *item_type == a {
                        *item_type = b;
                    } else if *item_type == b {
                        *item_type = a;
                    }
                }
            }
            Event::Add { item_type, at } => drop(next.stock.insert(at, item_type)),
        }
        next.state = WorldState::new(warehouse, &next.change(warehouse)).ok()?;
        Some(next)
    }

    /// The difference from `warehouse`.
    fn change(&self, warehouse: &Warehouse) -> WorldChange {
        let mut closed: Vec<Cell> = self.closed.iter().flatten().copied().collect();
        closed.sort_unstable();
        let base: BTreeMap<Cell, usize> =
            warehouse.items.iter().map(|item| (item.standpoint, item.item_type)).collect();
        let emptied =
            base.keys().filter(|cell| !self.stock.contains_key(cell)).map(|&cell| (cell, None));
        let filled = self.stock.iter().filter(|&(cell, item)| base.get(cell) != Some(item));
        let filled = filled.map(|(&cell, &item)| (cell, Some(item)));
        let changed: BTreeMap<Cell, Option<usize>> = emptied.chain(filled).collect();
        let stock = changed
            .into_iter()
            .map(|(standpoint, item_type)| StockChange { standpoint, item_type });
        WorldChange { closed, stock: stock.collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(streams: u32, blocks: u32, events: &[EventKind]) -> StreamRules {
        StreamRules { streams, blocks, cases_per_block: 3, events: events.to_vec() }
    }

    fn draw(seed: u64, rules: &StreamRules) -> Result<StreamSet, StreamError> {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let all: Vec<usize> = (0..cases.cases.len()).collect();
        StreamSet::draw(&warehouse, &cases, &all, seed, rules)
    }

    use EventKind::{Add, Close, Move, Open, Swap};

    #[test]
    fn streams_never_change() {
        let set = draw(1, &rules(1, 6, &[Close, Move, Swap, Open, Add])).unwrap();
        insta::assert_snapshot!(set.to_text());
    }

    #[test]
    fn the_first_streams_of_a_larger_set_are_those_of_a_smaller_one() {
        let events = [Close, Swap];
        let [few, more] = [2, 4].map(|count| draw(5, &rules(count, 3, &events)).unwrap());
        assert_eq!(few.streams, more.streams[..2]);
        assert_eq!(few.worlds, more.worlds[..few.worlds.len()]);
        assert_ne!(few.streams, draw(6, &rules(2, 3, &events)).unwrap().streams);
    }

    #[test]
    fn every_kind_of_event_affects_its_block_s_cases_and_nothing_is_impossible() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        for (kinds, blocks) in [
            (&[Close][..], 3),
            (&[Move], 3),
            (&[Swap], 3),
            (&[Add], 3),
            (&[Close, Open], 5),
            (&[Close, Move, Swap, Open, Add], 6),
        ] {
            let set = draw(7, &rules(4, blocks, kinds)).unwrap();
            set.check(&warehouse, &cases).unwrap();
            let states = set.states(&warehouse).unwrap();
            for stream in &set.streams {
                assert_eq!((stream.blocks.len(), stream.blocks[0].world), (blocks as usize, 0));
                let blocks = stream.blocks.windows(2).zip(kinds.iter().cycle());
                for ([before, block], kind) in
                    blocks.map(|(pair, kind)| ([&pair[0], &pair[1]], kind))
                {
                    assert!(!block.events.is_empty() && block.events.len() <= 3);
                    let mut told = block.events.iter().map(|event| event.describe(&warehouse));
                    assert!(told.all(|event| event.starts_with(kind.word())));
                    let [before, now] = [before, block].map(|block| &states[block.world as usize]);
                    for &case in &block.cases {
                        let case = &cases.cases[case as usize];
                        let found = (validity(case, before), validity(case, now));
                        let (intact, broken) = (Validity::Intact, Validity::Broken);
                        let expected =
                            if *kind == Open { (broken, intact) } else { (intact, broken) };
                        assert_eq!(found, expected, "{}, {kind:?}", case.id);
                    }
                }
                let solved =
                    stream.blocks.iter().all(|block| {
                        let state = &states[block.world as usize];
                        let expert = state.expert();
                        stream.cases().iter().map(|&case| &cases.cases[case as usize]).all(|case| {
                            state.reference(&expert, &case.task, case.test.start).is_some()
                        })
                    });
                assert!(solved, "{kinds:?}");
            }
        }
    }

    #[test]
    fn rules_that_cannot_be_followed_are_refused() {
        let many = |cases_per_block| StreamRules { cases_per_block, ..rules(1, 2, &[Close]) };
        for (rules, expected) in [
            (rules(1, 3, &[Move, Open]), "a passage opens before block 3, and none is closed then"),
            (rules(1, 3, &[]), "3 blocks need events between them"),
            (rules(1, 0, &[]), "a stream has at least one block"),
            (many(60), "200 draws; the last: no events `close` affect 60 cases of block 2"),
            (many(101), "no stream 0 found for seed 1 among 100 cases"),
        ] {
            let error = draw(1, &rules).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
