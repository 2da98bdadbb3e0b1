//! What the orchestrator notices of a walk and tells nobody: which of the task's items the agent stood before,
//! and when it first had one in view. For the log, so that failures can be sorted by kind from it alone.
//!
//! Whether a visit counted, and in which order visits have to come, is [`Progress`](warehouse::Progress)'s
//! business.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use domain::{Cell, Pose};
use serde::{Deserialize, Serialize};
use warehouse::layout::Layout;
use warehouse::sight::sees;
use warehouse::{Item, Task, Warehouse};

use crate::names::named;

named! {
    /// What an item is in a task (SPEC section 3).
    Requirement, "requirement" {
        /// An instance of the first type.
        A = "A",
        /// An instance of the second type.
        B = "B",
        /// An item of the category.
        C = "C",
    }
}

/// The agent came to stand before an item of the task. Written `12A@3,7`: after 12 steps, before an A,
/// on the cell in column 3 and row 7.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Visit {
    /// Steps taken when it was there; 0 for the cell that the episode began on.
    pub step: u32,
    /// What the item is in the task.
    pub requirement: Requirement,
    /// The item's standpoint.
    pub cell: Cell,
}

impl fmt::Display for Visit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}@{},{}", self.step, self.requirement, self.cell.x, self.cell.y)
    }
}

/// A text that is no visit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no visit (for example 12A@3,7: step, requirement, column, row)")]
pub struct BadVisit(String);

impl FromStr for Visit {
    type Err = BadVisit;

    fn from_str(text: &str) -> Result<Self, BadVisit> {
        let read = || {
            let (when, cell) = text.split_once('@')?;
            let (step, requirement) = when.split_at_checked(when.len().checked_sub(1)?)?;
            let (x, y) = cell.split_once(',')?;
            Some(Self {
                step: step.parse().ok()?,
                requirement: requirement.parse().ok()?,
                cell: Cell::new(x.parse().ok()?, y.parse().ok()?),
            })
        };
        read().ok_or_else(|| BadVisit(text.to_owned()))
    }
}

impl TryFrom<String> for Visit {
    type Error = BadVisit;

    fn try_from(text: String) -> Result<Self, BadVisit> {
        text.parse()
    }
}

impl From<Visit> for String {
    fn from(visit: Visit) -> Self {
        visit.to_string()
    }
}

/// Watches one walk.
#[derive(Debug)]
pub struct Witness {
    items: Vec<(Requirement, Item)>,
    at: Option<Cell>,
    /// Every time that the agent came to stand before an item of the task, whether or not that counted.
    pub visits: Vec<Visit>,
    /// The first step whose view showed an item of a requirement.
    pub first_seen: BTreeMap<Requirement, u32>,
}

impl Witness {
    /// Of a walk for `task` that is about to begin.
    pub fn new(warehouse: &Warehouse, task: &Task) -> Self {
        let items = task.targets(warehouse).into_iter();
        let items = items.map(|item| (requirement(task, item), *item));
        Self { items: items.collect(), at: None, visits: Vec::new(), first_seen: BTreeMap::new() }
    }

    /// After `step` steps the agent is at `pose`.
    pub fn stands(&mut self, step: u32, pose: Pose) {
        let Pose { cell, .. } = pose;
        if self.at.replace(cell) == Some(cell) {
            return;
        }
        let before = self.items.iter().filter(|(_, item)| item.standpoint == cell);
        self.visits.extend(before.map(|&(requirement, _)| Visit { step, requirement, cell }));
    }

    /// After `step` steps the agent is shown the view from `pose`.
    pub fn looks(&mut self, layout: &Layout, step: u32, pose: Pose) {
        for (requirement, item) in &self.items {
            if !self.first_seen.contains_key(requirement) && sees(layout, pose, item) {
                self.first_seen.insert(*requirement, step);
            }
        }
    }
}

/// What `item`, one of the task's targets, is in it.
fn requirement(task: &Task, item: &Item) -> Requirement {
    match *task {
        Task::FindCategory { .. } | Task::EveryOfCategory { .. } => Requirement::C,
        Task::FindType { .. }
        | Task::EveryOfType { .. }
        | Task::FindAndReturn { .. }
        | Task::EveryAndReturn { .. } => Requirement::A,
        Task::BothTypes { a, .. }
        | Task::InOrder { a, .. }
        | Task::Revisit { a, .. }
        | Task::InOrderAndReturn { a, .. } => {
            if item.item_type == a {
                Requirement::A
            } else {
                Requirement::B
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use warehouse::{CaseSet, Start};

    /// What the witness of a case's original demonstration says.
    fn witness(id: &str) -> (String, String) {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let case = cases.case(id).unwrap();
        let mut witness = Witness::new(&warehouse, &case.task);
        for (step, pose) in (0..).zip(case.replay(&warehouse, Start::Original).poses) {
            witness.stands(step, pose);
            witness.looks(&warehouse.layout, step, pose);
        }
        let visits: Vec<String> = witness.visits.iter().map(ToString::to_string).collect();
        (visits.join(" "), serde_json::to_string(&witness.first_seen).unwrap())
    }

    #[test]
    fn visits_and_first_sights_are_noticed() {
        let cases = CaseSet::shipped();
        let warehouse = Warehouse::shipped();
        let told = ["t01-01", "t02-01", "t06-01", "t09-01", "t10-01"].map(|id| {
            let case = cases.case(id).unwrap();
            let goals = case.replay(&warehouse, Start::Original).goal_steps;
            let (visits, seen) = witness(id);
            format!("{id} {goals:?}: visits {visits}; seen {seen}")
        });
        insta::assert_snapshot!(told.join("\n"), @r#"
        t01-01 [16]: visits 16A@9,9; seen {"A":11}
        t02-01 [23]: visits 23C@8,13; seen {"C":21}
        t06-01 [22, 57]: visits 22A@6,28 57B@6,1; seen {"A":8,"B":52}
        t09-01 [5, 21, 38]: visits 5A@14,11 21B@9,9 38A@14,11; seen {"A":1,"B":16}
        t10-01 [8, 23, 35]: visits 8A@1,26 23B@12,26; seen {"A":6,"B":22}
        "#);
    }

    #[test]
    fn standing_still_is_one_visit_and_coming_back_another() {
        let warehouse = Warehouse::shipped();
        let item = warehouse.items[0];
        let mut witness = Witness::new(&warehouse, &Task::FindType { a: item.item_type });
        let there = Pose { cell: item.standpoint, heading: item.face };
        let away = Pose { cell: Cell::new(0, 15), ..there };
        for (step, pose) in [(0, there), (1, there), (2, away), (3, there)] {
            witness.stands(step, pose);
        }
        assert_eq!(witness.visits.iter().map(|visit| visit.step).collect::<Vec<_>>(), [0, 3]);
        // Its back to the item, it does not see it.
        witness.looks(&warehouse.layout, 3, there);
        let turned = Pose { heading: item.viewing_heading(), ..there };
        witness.looks(&warehouse.layout, 4, turned);
        witness.looks(&warehouse.layout, 5, turned);
        assert_eq!(witness.first_seen, BTreeMap::from([(Requirement::A, 4)]));
    }

    #[test]
    fn visits_are_read_as_they_are_written() {
        for text in ["0A@0,0", "12B@3,7", "200C@15,29"] {
            assert_eq!(text.parse::<Visit>().unwrap().to_string(), text);
        }
        for text in ["", "@", "12@3,7", "A@3,7", "12D@3,7", "12A@3", "12A@3,256", "12é@3,7"] {
            assert_eq!(text.parse::<Visit>(), Err(BadVisit(text.to_owned())));
        }
    }
}
