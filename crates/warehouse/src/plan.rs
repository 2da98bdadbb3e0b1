//! The planner: the cheapest trajectory that completes a task, exact over poses, choices of instances and visit orders.
//!
//! A plan has two exact parts. *Legs* are the cheapest routes from any pose to any goal (`route`). The *order* is the
//! cheapest choice of instances and order of visits, given the costs of legs (`order`).
//!
//! There are two sets of prices. [`Prices::EXPERT`] plans the reference trajectories: a sidestep or a step backwards costs
//! slightly more than two plain steps, so the expert turns to face its direction except for a single sidestep; of equally
//! cheap routes it takes the one that avoids bays it does not visit; and a target counts when it is faced from its
//! standpoint, so the expert faces the rack on arrival. [`Prices::STEPS`] counts steps only and gives the true optimum.
//!
//! # Distance from the optimum
//! Let `opt` be the fewest steps that complete a task and `k` the number of items visited. A route of `opt` moves becomes
//! one that always faces its direction by adding at most one turn per move and one per target, so the expert never needs
//! more than `2 * opt + k` steps. In practice it needs far fewer: every trajectory of a generated set stays within
//! [`MAX_DETOUR_PERCENT`](crate::MAX_DETOUR_PERCENT).

use std::cell::{OnceCell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;

use domain::{Cell, Pose};

use crate::dynamics::{Variant, step};
use crate::order::{PhaseOrder, PhaseSets, Visits};
pub use crate::route::Prices;
use crate::route::{CostField, Graph};
use crate::task::{Phase, Task};
use crate::trajectory::Trajectory;
use crate::world::Warehouse;

/// Plans in one variant of a warehouse with one set of prices, and caches what it has computed.
#[derive(Debug)]
pub struct Planner<'w> {
    warehouse: &'w Warehouse,
    variant: Variant,
    graph: Graph,
    /// By item id: the field towards it.
    fields: Vec<OnceCell<CostField>>,
    /// Results for tasks whose plans do not depend on the start.
    choices: RefCell<BTreeMap<Task, Rc<Vec<Choice>>>>,
}

/// One way to complete a task. The cheapest is the plan.
#[derive(Debug)]
struct Choice {
    order: PhaseOrder,
    /// The field towards the first item, if it is not the ordinary one.
    approach: Option<CostField>,
}

/// The cheapest visits of a task from one start.
struct BestVisits {
    visits: Visits,
    choices: Rc<Vec<Choice>>,
    chosen: usize,
    /// The field towards the origin, if the task ends there.
    home: Option<CostField>,
}

impl<'w> Planner<'w> {
    /// A planner with empty caches.
    pub fn new(warehouse: &'w Warehouse, variant: Variant, prices: Prices) -> Self {
        let graph = Graph::new(warehouse, &variant, prices);
        let fields = warehouse.items.iter().map(|_| OnceCell::new()).collect();
        Self { warehouse, variant, graph, fields, choices: RefCell::default() }
    }

    /// The cheapest trajectory from `start` that completes `task`, if there is one.
    ///
    /// With [`Prices::EXPERT`] it ends facing the last target's rack. Of equally cheap plans, lower item ids come first,
    /// then forward moves before turns before sidesteps.
    pub fn plan(&self, start: Pose, task: &Task) -> Option<Trajectory> {
        let BestVisits { visits, choices, chosen, home } = self.find(start, task)?;
        let mut fields: Vec<&CostField> = visits.items.iter().map(|&id| self.field(id)).collect();
        if let (Some(first), Some(approach)) = (fields.first_mut(), &choices[chosen].approach) {
            *first = approach;
        }
        fields.extend(&home);
        let mut actions = Vec::new();
        let mut pose = start;
        for field in fields {
            for action in self.graph.route(field, pose)? {
                (pose, _) = step(&self.warehouse.layout, &self.variant, pose, action);
                actions.push(action);
            }
        }
        Some(Trajectory { start, actions })
    }

    /// The cost of the cheapest trajectory, if there is one.
    pub fn cost(&self, start: Pose, task: &Task) -> Option<u32> {
        self.find(start, task).map(|found| found.visits.cost)
    }

    fn find(&self, start: Pose, task: &Task) -> Option<BestVisits> {
        let phases = task.phases(self.warehouse);
        let home = phases.contains(&Phase::Origin).then(|| self.graph.towards_cell(start.cell));
        let choices = match &home {
            Some(home) => {
                let order = self.order(&sets(&phases), &|id| self.graph.cost(home, self.goal(id)));
                Rc::new(vec![Choice { order, approach: None }])
            }
            None => self.choices_for_any_start(task, &phases),
        };
        let visits = choices.iter().enumerate().filter_map(|(chosen, choice)| {
            let entry = |id| {
                self.graph.cost(choice.approach.as_ref().unwrap_or_else(|| self.field(id)), start)
            };
            Some((choice.order.visits(&|from, to| self.leg(from, to), &entry)?, chosen))
        });
        // `min_by_key` keeps the first of equals.
        let (visits, chosen) = visits.min_by_key(|(visits, _)| visits.cost)?;
        Some(BestVisits { visits, choices, chosen, home })
    }

    /// The choices of a task without a return to the origin: one; for a revisit, one for each instance that may come first.
    /// It must be approached without passing another instance, which would come first then.
    fn choices_for_any_start(&self, task: &Task, phases: &[Phase]) -> Rc<Vec<Choice>> {
        if let Some(known) = self.choices.borrow().get(task) {
            return Rc::clone(known);
        }
        let choices = match (phases, sets(phases).as_slice()) {
            ([.., Phase::FirstAgain], [firsts, middle @ ..]) => {
                let firsts: Vec<u16> = firsts.iter().flatten().copied().collect();
                let revisit = |&first: &u16| {
                    let others = firsts.iter().filter(|&&other| other != first);
                    let avoid: Vec<Cell> = others.map(|&id| self.goal(id).cell).collect();
                    let once = [vec![vec![first]]];
                    Choice {
                        order: self.order(&[&once, middle, &once].concat(), &|_| 0),
                        approach: Some(self.graph.towards_target(self.goal(first), &avoid)),
                    }
                };
                firsts.iter().map(revisit).collect()
            }
            (_, sets) => vec![Choice { order: self.order(sets, &|_| 0), approach: None }],
        };
        let choices = Rc::new(choices);
        self.choices.borrow_mut().insert(*task, Rc::clone(&choices));
        choices
    }

    fn order(&self, sets: &[PhaseSets], tail: &dyn Fn(u16) -> u32) -> PhaseOrder {
        PhaseOrder::new(sets, &|from, to| self.leg(from, to), tail)
    }

    /// The pose in which item `id` is visited. Where headings do not matter, it stands for all four.
    fn goal(&self, id: u16) -> Pose {
        let item = self.warehouse.item(id);
        Pose { cell: item.standpoint, heading: item.viewing_heading() }
    }

    fn field(&self, id: u16) -> &CostField {
        let field = || self.graph.towards_target(self.goal(id), &[]);
        self.fields[usize::from(id)].get_or_init(field)
    }

    fn leg(&self, from: u16, to: u16) -> u32 {
        self.graph.cost(self.field(to), self.goal(from))
    }
}

/// The sets of items to visit, phase by phase, without returns to the origin or the first item.
fn sets(phases: &[Phase]) -> Vec<PhaseSets> {
    let sets = phases.iter().filter_map(|phase| match phase {
        Phase::OneOfEach(sets) => Some(sets.clone()),
        Phase::Origin | Phase::FirstAgain => None,
    });
    sets.collect()
}

#[cfg(test)]
mod tests;
