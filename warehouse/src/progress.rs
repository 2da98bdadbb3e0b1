//! The one checker: how far a walk has got with a task. Planner, memory, orchestrator and scorer use it.
//!
//! It sees cells only. Standing on an item's standpoint reaches the item, whatever the heading, and the
//! cell an episode begins on counts like any other.

use shm_types::Cell;

use crate::task::{Phase, Task};
use crate::world::Warehouse;

/// How far one walk has got with one task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Progress {
    phases: Vec<Goals>,
    phase: usize,
    stage: u32,
    total: u32,
    origin: Cell,
    first: Option<Cell>,
}

/// A [`Phase`] in terms of cells.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Goals {
    /// The standpoints that satisfy each sub-goal still open.
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

    /// The agent stands on `cell`. Says how many sub-goals that completed.
    ///
    /// Visiting the same cell twice in a row is the same as visiting it once, so turns and blocked moves
    /// may be reported or left out.
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

    /// Sub-goals completed: one for each required item, one for the return.
    pub fn stage(&self) -> u32 {
        self.stage
    }

    /// Sub-goals of the whole task.
    pub fn total(&self) -> u32 {
        self.total
    }

    /// Whether the task is done.
    pub fn is_complete(&self) -> bool {
        self.stage == self.total
    }
}
