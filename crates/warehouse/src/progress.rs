//! Decides which sub-goals of a task a trajectory has completed. Planner, memory, orchestrator and scorer all use it.
//!
//! Only cells matter. An agent on an item's standpoint has reached the item, whatever its heading, and the first cell of an
//! episode counts like any other.

use domain::Cell;

use crate::task::{Phase, Task};
use crate::world::Warehouse;

/// The progress of one trajectory with one task.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Progress {
    phases: Vec<Goals>,
    phase: usize,
    stage: u32,
    total: u32,
    origin: Cell,
    first: Option<Cell>,
}

/// A [`Phase`] in terms of cells.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Goals {
    /// For each sub-goal that is still open, the standpoints that complete it.
    OneOfEach(Vec<Vec<Cell>>),
    Origin,
    FirstAgain,
}

impl Progress {
    /// The progress of an agent that has just begun `task` on `origin`; that cell is already visited.
    pub fn new(warehouse: &Warehouse, task: &Task, origin: Cell) -> Self {
        let standpoint = |&id: &u16| warehouse.item(id).standpoint;
        let mut total = 0;
        let phases = task.phases(warehouse).into_iter().map(|phase| match phase {
            Phase::OneOfEach(sets) => {
                total += sets.len() as u32;
                Goals::OneOfEach(
                    sets.iter().map(|set| set.iter().map(standpoint).collect()).collect(),
                )
            }
            Phase::Origin => {
                total += 1;
                Goals::Origin
            }
            Phase::FirstAgain => {
                total += 1;
                Goals::FirstAgain
            }
        });
        let phases = phases.collect();
        let mut progress = Self { phases, phase: 0, stage: 0, total, origin, first: None };
        progress.visit(origin);
        progress
    }

    /// Records that the agent is on `cell` and returns how many sub-goals this completes.
    ///
    /// Visiting the same cell twice in a row is the same as visiting it once, so turns and blocked moves may be reported or
    /// left out.
    pub fn visit(&mut self, cell: Cell) -> u32 {
        let before = self.stage;
        while let Some(goals) = self.phases.get_mut(self.phase) {
            match goals {
                Goals::OneOfEach(open) => {
                    let Some(met) = open.iter().position(|cells| cells.contains(&cell)) else {
                        break;
                    };
                    open.remove(met);
                    self.first.get_or_insert(cell);
                    self.stage += 1;
                    if open.is_empty() {
                        self.phase += 1;
                    }
                }
                Goals::Origin if cell == self.origin => {
                    self.stage += 1;
                    self.phase += 1;
                }
                Goals::FirstAgain if Some(cell) == self.first => {
                    self.stage += 1;
                    self.phase += 1;
                }
                Goals::Origin | Goals::FirstAgain => break,
            }
        }
        self.stage - before
    }

    /// Completed sub-goals: one for each required item, one for the return.
    pub fn stage(&self) -> u32 {
        self.stage
    }

    /// Sub-goals of the whole task.
    pub fn total(&self) -> u32 {
        self.total
    }

    /// Whether the task is complete.
    pub fn is_complete(&self) -> bool {
        self.stage == self.total
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{
        BLUE_BARREL, CONES, GREEN_CONE, ORANGE_CONE, RED_BARREL, all_tasks, cells, tiny,
    };

    // Standpoints of the tiny warehouse.
    const BLUE: [(u8, u8); 3] = [(0, 1), (0, 3), (6, 3)];
    const RED: [(u8, u8); 2] = [(6, 1), (3, 3)];
    const ORANGE: [(u8, u8); 2] = [(0, 2), (6, 2)];
    const GREEN: (u8, u8) = (3, 1);
    const NOWHERE: (u8, u8) = (2, 1);

    /// The stage after each cell, beginning on the first.
    fn stages(task: Task, visited: &[(u8, u8)]) -> Vec<u32> {
        let visited = cells(visited);
        let mut progress = Progress::new(&tiny(), &task, visited[0]);
        let mut stages = vec![progress.stage()];
        for &cell in &visited[1..] {
            progress.visit(cell);
            stages.push(progress.stage());
        }
        assert_eq!(progress.is_complete(), progress.stage() == progress.total());
        stages
    }

    #[test]
    fn every_task_type_is_scored_by_its_rule() {
        let (a, b) = (BLUE_BARREL, RED_BARREL);
        type Row<'r> = (Task, &'r [(u8, u8)], &'r [u32]);
        let table: [Row<'_>; 22] = [
            // Any instance counts, other items do not.
            (Task::FindType { a }, &[NOWHERE, RED[0], BLUE[2], BLUE[0]], &[0, 0, 1, 1]),
            (Task::FindCategory { c: CONES }, &[NOWHERE, BLUE[0], GREEN], &[0, 0, 1]),
            // Every instance, each once, in any order.
            (
                Task::EveryOfType { a },
                &[NOWHERE, BLUE[1], BLUE[1], BLUE[0], BLUE[2]],
                &[0, 1, 1, 2, 3],
            ),
            (
                Task::EveryOfCategory { c: CONES },
                &[NOWHERE, ORANGE[1], GREEN, ORANGE[0]],
                &[0, 1, 2, 3],
            ),
            // Any order, one of each.
            (Task::BothTypes { a, b }, &[NOWHERE, RED[0], RED[1], BLUE[0]], &[0, 1, 1, 2]),
            (Task::BothTypes { a, b }, &[NOWHERE, BLUE[0], RED[1]], &[0, 1, 2]),
            // A before B; an early B does not count.
            (Task::InOrder { a, b }, &[NOWHERE, RED[0], BLUE[0], RED[0]], &[0, 0, 1, 2]),
            (Task::InOrder { a, b }, &[NOWHERE, BLUE[0], BLUE[1], RED[1]], &[0, 1, 1, 2]),
            // The return counts only after the target, and only to the origin of this episode.
            (
                Task::FindAndReturn { a },
                &[NOWHERE, NOWHERE, BLUE[0], GREEN, NOWHERE],
                &[0, 0, 1, 1, 2],
            ),
            (
                Task::EveryAndReturn { a: b },
                &[NOWHERE, RED[0], NOWHERE, RED[1], NOWHERE],
                &[0, 1, 1, 2, 3],
            ),
            // The A that was reached first; another A on the way changes nothing.
            (
                Task::Revisit { a, b },
                &[NOWHERE, BLUE[0], RED[0], BLUE[1], BLUE[0]],
                &[0, 1, 2, 2, 3],
            ),
            (
                Task::Revisit { a, b },
                &[NOWHERE, BLUE[1], BLUE[0], RED[0], BLUE[0], BLUE[1]],
                &[0, 1, 1, 2, 2, 3],
            ),
            (
                Task::Revisit { a, b },
                &[NOWHERE, RED[0], BLUE[1], BLUE[1], RED[1], BLUE[1]],
                &[0, 0, 1, 1, 2, 3],
            ),
            (
                Task::InOrderAndReturn { a, b },
                &[NOWHERE, BLUE[0], NOWHERE, RED[0], NOWHERE],
                &[0, 1, 1, 2, 3],
            ),
            (
                Task::InOrderAndReturn { a, b },
                &[NOWHERE, RED[0], NOWHERE, BLUE[0], NOWHERE],
                &[0, 0, 0, 1, 1],
            ),
            // The first cell of an episode counts as visited.
            (Task::FindType { a }, &[BLUE[0]], &[1]),
            (Task::EveryOfType { a }, &[BLUE[0], BLUE[1], BLUE[2]], &[1, 2, 3]),
            (Task::InOrder { a, b }, &[BLUE[0], RED[0]], &[1, 2]),
            (Task::InOrder { a: b, b: a }, &[BLUE[0], RED[0], BLUE[0]], &[0, 1, 2]),
            (Task::FindAndReturn { a }, &[BLUE[0]], &[2]),
            (Task::EveryAndReturn { a: b }, &[RED[0], RED[1], RED[0]], &[1, 2, 3]),
            (Task::Revisit { a, b }, &[BLUE[0], RED[0], BLUE[0]], &[1, 2, 3]),
        ];
        for (task, visited, expected) in table {
            assert_eq!(stages(task, visited), expected, "{task:?} on {visited:?}");
        }
    }

    #[test]
    fn a_task_has_as_many_sub_goals_as_it_names() {
        let (a, b) = (ORANGE_CONE, GREEN_CONE);
        for (task, total) in [
            (Task::FindType { a }, 1),
            (Task::FindCategory { c: CONES }, 1),
            (Task::EveryOfType { a }, 2),
            (Task::EveryOfCategory { c: CONES }, 3),
            (Task::BothTypes { a, b }, 2),
            (Task::InOrder { a, b }, 2),
            (Task::FindAndReturn { a }, 2),
            (Task::EveryAndReturn { a }, 3),
            (Task::Revisit { a, b }, 3),
            (Task::InOrderAndReturn { a, b }, 3),
        ] {
            assert_eq!(Progress::new(&tiny(), &task, Cell::new(2, 1)).total(), total, "{task:?}");
        }
    }

    proptest::proptest! {
        #[test]
        fn standing_still_changes_nothing_and_progress_never_falls(
            task in 0..64_usize,
            visited in proptest::collection::vec(0..17_usize, 1..40),
        ) {
            let warehouse = tiny();
            let tasks = all_tasks(&warehouse);
            let task = tasks[task % tasks.len()];
            let free: Vec<Cell> = warehouse.layout.free_cells().collect();
            let mut once = Progress::new(&warehouse, &task, free[visited[0]]);
            let mut twice = once.clone();
            for &step in &visited {
                let before = once.stage();
                let met = once.visit(free[step]);
                twice.visit(free[step]);
                proptest::prop_assert_eq!(twice.visit(free[step]), 0);
                proptest::prop_assert_eq!(&once, &twice);
                proptest::prop_assert_eq!(once.stage(), before + met);
                proptest::prop_assert!(once.stage() <= once.total());
            }
        }
    }
}
