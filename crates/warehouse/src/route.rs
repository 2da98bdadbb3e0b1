//! Cheapest routes from any pose to a goal: a backward Dijkstra search over poses. [`plan`](crate::plan) decides which goals
//! are visited in which order.

use domain::{Action, Cell, Heading, Pose};

use crate::dynamics::{Variant, step};
use crate::world::Warehouse;

/// The prices of actions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Prices {
    /// One cell forward.
    forward: u32,
    /// Any turn, a half turn included.
    turn: u32,
    /// One cell to the left, to the right or backward.
    sidestep: u32,
    /// Added for each move onto a cell in front of an item; too little to be worth a step.
    bay: u32,
    /// Whether a target must be faced. Otherwise standing in front of it is enough, and all moves must cost the same.
    facing: bool,
}

impl Prices {
    /// The expert's prices, in thousandths of a step.
    pub const EXPERT: Self =
        Self { forward: 1000, turn: 1000, sidestep: 2100, bay: 1, facing: true };

    /// One for every step, which makes the cheapest routes the shortest.
    pub const STEPS: Self = Self { forward: 1, turn: 1, sidestep: 1, bay: 0, facing: false };

    /// The price of an action that ends on a cell which is, or is not, in front of an item.
    pub(crate) const fn of(&self, action: Action, onto_bay: bool) -> u32 {
        let bay = if onto_bay { self.bay } else { 0 };
        match action {
            Action::Forward => self.forward + bay,
            Action::TurnLeft | Action::TurnRight | Action::TurnAround => self.turn,
            Action::Left | Action::Right | Action::Backward => self.sidestep + bay,
        }
    }

    /// The price of the cheapest action.
    const fn cheapest(&self) -> u32 {
        if self.forward < self.turn { self.forward } else { self.turn }
    }

    /// The price of the dearest action in that of the cheapest, rounded up.
    const fn spread(&self) -> usize {
        (self.sidestep + self.bay).div_ceil(self.cheapest()) as usize
    }
}

/// Buckets of the queue of a search: the cost of the dearest action in those of the cheapest, rounded up, and the current one.
const BUCKETS: usize = 4;
const _: () = assert!(Prices::EXPERT.spread() < BUCKETS && Prices::STEPS.spread() < BUCKETS);

/// Of equally cheap actions the first of these is taken.
const PREFERENCE: [Action; 7] = [
    Action::Forward,
    Action::TurnLeft,
    Action::TurnRight,
    Action::TurnAround,
    Action::Left,
    Action::Right,
    Action::Backward,
];

/// The cost where no route exists.
pub(crate) const NO_WAY: u32 = u32::MAX;

/// The link of a blocked action.
const NO_POSE: u16 = u16::MAX;

/// All poses of a world variant, the actions that connect them, and their prices.
#[derive(Debug)]
pub(crate) struct Graph {
    prices: Prices,
    width: usize,
    /// By pose: the pose from which each action leads here, and its price.
    back: Vec<[(u16, u32); 7]>,
    /// By pose: where each action leads, and its price, in the order of [`PREFERENCE`].
    ahead: Vec<[(u16, u32); 7]>,
}

/// The cheapest cost from every pose to a goal, by pose.
#[derive(Debug)]
pub(crate) struct CostField(Vec<u32>);

impl Graph {
    pub(crate) fn new(warehouse: &Warehouse, variant: &Variant, prices: Prices) -> Self {
        let layout = &warehouse.layout;
        let width = usize::from(layout.width());
        let poses = width * usize::from(layout.height()) * Heading::ALL.len();
        let nowhere = [(NO_POSE, NO_WAY); 7];
        let mut graph =
            Self { prices, width, back: vec![nowhere; poses], ahead: vec![nowhere; poses] };
        let mut is_bay = vec![false; poses];
        for item in &warehouse.items {
            for pose in facing_anywhere(item.standpoint) {
                is_bay[graph.index(pose)] = true;
            }
        }
        for pose in layout.free_cells().flat_map(facing_anywhere) {
            for (rank, action) in PREFERENCE.into_iter().enumerate() {
                let (next, _) = step(layout, variant, pose, action);
                if next == pose || variant.is_closed(pose.cell) {
                    continue;
                }
                let (from, to) = (graph.index(pose), graph.index(next));
                let price = prices.of(action, is_bay[to]);
                graph.ahead[from][rank] = (to as u16, price);
                graph.back[to][rank] = (from as u16, price);
            }
        }
        graph
    }

    fn index(&self, pose: Pose) -> usize {
        (usize::from(pose.cell.y) * self.width + usize::from(pose.cell.x)) * Heading::ALL.len()
            + pose.heading as usize
    }

    /// The costs of reaching `goal` without entering `avoid`, with any heading where headings do not matter.
    pub(crate) fn towards_target(&self, goal: Pose, avoid: &[Cell]) -> CostField {
        if self.prices.facing {
            self.towards(&[goal], avoid)
        } else {
            self.towards(&facing_anywhere(goal.cell), avoid)
        }
    }

    /// The costs of reaching `cell` with any heading.
    pub(crate) fn towards_cell(&self, cell: Cell) -> CostField {
        self.towards(&facing_anywhere(cell), &[])
    }

    /// Dijkstra backwards from `goals`, with no route from or through `avoid`.
    ///
    /// The queue is a ring of buckets, each as wide as the cheapest action: no pose leads to another of its own bucket, so the
    /// order within a bucket does not matter.
    fn towards(&self, goals: &[Pose], avoid: &[Cell]) -> CostField {
        let mut avoided = vec![false; self.back.len()];
        for pose in avoid.iter().copied().flat_map(facing_anywhere) {
            avoided[self.index(pose)] = true;
        }
        let mut costs = vec![NO_WAY; self.back.len()];
        let width = self.prices.cheapest();
        let mut buckets: [Vec<u16>; BUCKETS] = Default::default();
        for &goal in goals {
            costs[self.index(goal)] = 0;
            buckets[0].push(self.index(goal) as u16);
        }
        let mut number = 0;
        while buckets.iter().any(|bucket| !bucket.is_empty()) {
            let mut bucket = std::mem::take(&mut buckets[number % BUCKETS]);
            for pose in bucket.drain(..) {
                let cost = costs[usize::from(pose)];
                // A cheaper route has been found since, and this pose is done.
                if cost / width != number as u32 {
                    continue;
                }
                for &(before, price) in &self.back[usize::from(pose)] {
                    let Some(known) = costs.get_mut(usize::from(before)) else { continue };
                    let cost = cost + price;
                    if cost < *known && !avoided[usize::from(before)] {
                        *known = cost;
                        buckets[(cost / width) as usize % BUCKETS].push(before);
                    }
                }
            }
            // Keeps the allocation.
            buckets[number % BUCKETS] = bucket;
            number += 1;
        }
        CostField(costs)
    }

    /// The cost of the cheapest route from `pose` to the goal of `field`.
    pub(crate) fn cost(&self, field: &CostField, pose: Pose) -> u32 {
        field.0.get(self.index(pose)).copied().unwrap_or(NO_WAY)
    }

    /// The cheapest route from `pose` to the goal of `field`, if there is one.
    pub(crate) fn route(&self, field: &CostField, pose: Pose) -> Option<Vec<Action>> {
        let mut actions = Vec::new();
        let mut at = self.index(pose);
        while *field.0.get(at)? > 0 {
            let left = field.0[at];
            let mut ways = PREFERENCE.into_iter().zip(&self.ahead[at]);
            let (action, &(next, _)) = ways.find(|&(_, &(next, price))| {
                let after = field.0.get(usize::from(next)).copied().unwrap_or(NO_WAY);
                after.checked_add(price) == Some(left)
            })?;
            actions.push(action);
            at = usize::from(next);
        }
        Some(actions)
    }
}

/// The four poses on `cell`.
fn facing_anywhere(cell: Cell) -> [Pose; 4] {
    Heading::ALL.map(|heading| Pose { cell, heading })
}
