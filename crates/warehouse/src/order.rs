//! The cheapest order of visits: exact dynamic programming over (completed sub-goals, last item), after Held and Karp. The
//! tables also cover the choice of instances and several phases.
//!
//! Costs are counted from an item to the end of the plan, so one table serves every start.

use crate::route::NO_WAY;

/// One set of items for each sub-goal. One item of each set must be visited, in any order of sets.
pub(crate) type PhaseSets = Vec<Vec<u16>>;

/// The cost of going from one item to another.
pub(crate) type Leg<'l> = &'l dyn Fn(u16, u16) -> u32;

/// A plan: its cost and the items in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Visits {
    pub(crate) cost: u32,
    pub(crate) items: Vec<u16>,
}

/// The tables for the phases of a task.
#[derive(Debug)]
pub(crate) struct PhaseOrder {
    phases: Vec<PhaseTable>,
}

/// One phase. `to_go[met * items + last]` is the cost from `last` to the end of the plan when the sub-goals in the bit set
/// `met`, that of `last` included, are completed.
#[derive(Debug)]
struct PhaseTable {
    /// Item id and the sub-goal it serves, sorted.
    items: Vec<(u16, u32)>,
    /// All sub-goals, as a bit set.
    all: u32,
    to_go: Vec<u32>,
}

impl PhaseOrder {
    /// Computes the tables from the last phase to the first. `tail` is the cost after the last item.
    pub(crate) fn new(phases: &[PhaseSets], leg: Leg<'_>, tail: &dyn Fn(u16) -> u32) -> Self {
        let mut tables: Vec<PhaseTable> = Vec::new();
        for sets in phases.iter().rev() {
            let after = |id| match tables.last() {
                None => tail(id),
                Some(next) => next.entry(&|to| leg(id, to)).map_or(NO_WAY, |(_, cost)| cost),
            };
            let table = PhaseTable::new(sets, leg, &after);
            tables.push(table);
        }
        tables.reverse();
        Self { phases: tables }
    }

    /// The cheapest visits if `entry` is the cost of reaching an item from the start; `None` if there are none. Of equally
    /// cheap visits, those with lower ids come first.
    pub(crate) fn visits(&self, leg: Leg<'_>, entry: &dyn Fn(u16) -> u32) -> Option<Visits> {
        let mut visits: Option<Visits> = None;
        for table in &self.phases {
            let (first, cost) = match &visits {
                None => table.entry(entry)?,
                Some(Visits { items, .. }) => {
                    let from = *items.last()?;
                    table.entry(&|to| leg(from, to))?
                }
            };
            let items = table.follow(first, leg)?;
            visits.get_or_insert(Visits { cost, items: Vec::new() }).items.extend(items);
        }
        visits
    }
}

impl PhaseTable {
    fn new(sets: &[Vec<u16>], leg: Leg<'_>, after: &dyn Fn(u16) -> u32) -> Self {
        let members = (0..).zip(sets).flat_map(|(goal, set)| set.iter().map(move |&id| (id, goal)));
        let mut items: Vec<(u16, u32)> = members.collect();
        items.sort_unstable();
        let count = items.len();
        let pairs =
            items.iter().flat_map(|&(from, _)| items.iter().map(move |&(to, _)| (from, to)));
        let legs: Vec<u32> = pairs.map(|(from, to)| leg(from, to)).collect();
        let all = (1_u32 << sets.len()) - 1;
        let mut table = Self { to_go: vec![NO_WAY; (all as usize + 1) * count], items, all };
        // The items that may come next, and the cost that remains from each.
        let mut open: Vec<(usize, u32)> = Vec::with_capacity(count);
        for met in (1..=all).rev() {
            open.clear();
            for (next, &(_, goal)) in table.items.iter().enumerate() {
                if met & (1 << goal) == 0 {
                    open.push((next, table.to_go(met | 1 << goal, next)));
                }
            }
            for last in 0..count {
                let (id, goal) = table.items[last];
                if met & (1 << goal) == 0 {
                    continue;
                }
                let legs = &legs[last * count..][..count];
                let costs = open.iter().map(|&(next, left)| legs[next].saturating_add(left));
                let cheapest = if met == all { after(id) } else { costs.min().unwrap_or(NO_WAY) };
                table.to_go[met as usize * count + last] = cheapest;
            }
        }
        table
    }

    fn to_go(&self, met: u32, last: usize) -> u32 {
        self.to_go[met as usize * self.items.len() + last]
    }

    /// The cheapest item to begin with if `entry` is the cost of reaching it: its position, and the cost to the end of the
    /// plan.
    fn entry(&self, entry: &dyn Fn(u16) -> u32) -> Option<(usize, u32)> {
        let entries = self
            .items
            .iter()
            .enumerate()
            .map(|(i, &(id, goal))| (i, entry(id).saturating_add(self.to_go(1 << goal, i))));
        // `min_by_key` keeps the first of equals.
        entries.min_by_key(|&(_, cost)| cost).filter(|&(_, cost)| cost < NO_WAY)
    }

    /// The items in their cheapest order, beginning with the one at position `last`.
    fn follow(&self, mut last: usize, leg: Leg<'_>) -> Option<Vec<u16>> {
        let (id, goal) = self.items[last];
        let (mut met, mut ids) = (1 << goal, vec![id]);
        while met != self.all {
            let (from, left) = (self.items[last].0, self.to_go(met, last));
            last = self.items.iter().enumerate().position(|(next, &(id, goal))| {
                met & (1 << goal) == 0
                    && leg(from, id).saturating_add(self.to_go(met | 1 << goal, next)) == left
            })?;
            met |= 1 << self.items[last].1;
            ids.push(self.items[last].0);
        }
        Some(ids)
    }
}
