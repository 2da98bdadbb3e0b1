//! Records the events of an episode by which the log sorts failures: when the agent stood before one of the task's
//! items, and when an item first came into view.
//!
//! Whether a visit counts, and in which order visits must come, is decided by
//! [`Progress`](crate::Progress).

use std::collections::BTreeMap;

use domain::camera::CameraSetup;
use domain::events::{Requirement, Visit};
use domain::{Cell, Pose};

use crate::sight::sees;
use crate::task::Task;
use crate::world::{Item, Warehouse};

/// Records the events of one episode.
#[derive(Debug, Clone)]
pub struct EventRecorder {
    items: Vec<(Requirement, Item)>,
    camera: CameraSetup,
    at: Option<Cell>,
    /// Every arrival before an item of the task, whether or not it counted.
    pub visits: Vec<Visit>,
    /// For each requirement, the first step whose view showed one of its items.
    pub first_seen: BTreeMap<Requirement, u32>,
}

impl EventRecorder {
    /// Starts recording an episode of `task` whose agent sees through `camera`.
    pub fn new(warehouse: &Warehouse, task: &Task, camera: CameraSetup) -> Self {
        let items = task.targets(warehouse).into_iter();
        let items = items.map(|item| (requirement(task, item), *item));
        Self {
            items: items.collect(),
            camera,
            at: None,
            visits: Vec::new(),
            first_seen: BTreeMap::new(),
        }
    }

    /// Records that the agent is at `pose` after `step` steps.
    pub fn stands(&mut self, step: u32, pose: Pose) {
        let Pose { cell, .. } = pose;
        if self.at.replace(cell) == Some(cell) {
            return;
        }
        let before = self.items.iter().filter(|(_, item)| item.standpoint == cell);
        self.visits.extend(before.map(|&(requirement, _)| Visit { step, requirement, cell }));
    }

    /// Records that the agent is shown the view from `pose` of this warehouse after `step` steps.
    pub fn looks(&mut self, warehouse: &Warehouse, step: u32, pose: Pose) {
        for (requirement, item) in &self.items {
            let is_first = !self.first_seen.contains_key(requirement);
            if is_first && sees(warehouse, self.camera, pose, item) {
                self.first_seen.insert(*requirement, step);
            }
        }
    }
}

/// The requirement that `item`, one of the task's targets, fulfils.
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
    use crate::{CaseSet, TrajectoryKind};

    /// What is recorded of a case's original demonstration.
    fn recorded(id: &str) -> (String, String) {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let case = cases.case(id).unwrap();
        let mut recorder = EventRecorder::new(&warehouse, &case.task, CameraSetup::STANDARD);
        for (step, pose) in (0..).zip(case.replay(&warehouse, TrajectoryKind::Original).poses) {
            recorder.stands(step, pose);
            recorder.looks(&warehouse, step, pose);
        }
        let visits: Vec<String> = recorder.visits.iter().map(ToString::to_string).collect();
        (visits.join(" "), serde_json::to_string(&recorder.first_seen).unwrap())
    }

    #[test]
    fn visits_and_first_sights_are_recorded() {
        let cases = CaseSet::shipped();
        let warehouse = Warehouse::shipped();
        let told = ["t01-01", "t02-01", "t06-01", "t09-01", "t10-01"].map(|id| {
            let case = cases.case(id).unwrap();
            let goals = case.replay(&warehouse, TrajectoryKind::Original).goal_steps;
            let (visits, seen) = recorded(id);
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
        let task = Task::FindType { a: item.item_type };
        let mut recorder = EventRecorder::new(&warehouse, &task, CameraSetup::STANDARD);
        let there = Pose { cell: item.standpoint, heading: item.face };
        let away = Pose { cell: Cell::new(0, 15), ..there };
        for (step, pose) in [(0, there), (1, there), (2, away), (3, there)] {
            recorder.stands(step, pose);
        }
        assert_eq!(recorder.visits.iter().map(|visit| visit.step).collect::<Vec<_>>(), [0, 3]);
        // Its back to the item, it does not see it.
        recorder.looks(&warehouse, 3, there);
        let turned = Pose { heading: item.viewing_heading(), ..there };
        recorder.looks(&warehouse, 4, turned);
        recorder.looks(&warehouse, 5, turned);
        assert_eq!(recorder.first_seen, BTreeMap::from([(Requirement::A, 4)]));
    }
}
