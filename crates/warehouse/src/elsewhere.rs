//! Another warehouse, in which the tasks of a set of cases are demonstrated, so that what memory knows in general can be told
//! from what it knows about one place.

use crate::task::Task;
use crate::trajectory::Trajectory;
use crate::world::Warehouse;

pub use case_book::ELSEWHERE_VARIANT;

/// Another warehouse with one demonstration of each case's task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Elsewhere {
    pub(crate) layout: String,
    pub(crate) catalogue: String,
    pub(crate) warehouse: Warehouse,
    /// By case: its task with the indices of the other catalogue, and the demonstration.
    pub(crate) shown: Vec<(Task, Trajectory)>,
}

impl Elsewhere {
    /// The texts of its `layout.toml` and `catalogue.toml`.
    pub fn files(&self) -> [&str; 2] {
        [&self.layout, &self.catalogue]
    }

    /// The other warehouse.
    pub fn warehouse(&self) -> &Warehouse {
        &self.warehouse
    }

    /// The task of a case, with the indices of this warehouse's catalogue, and its demonstration here.
    pub fn demonstration(&self, case: usize) -> Option<(&Task, &Trajectory)> {
        self.shown.get(case).map(|(task, trajectory)| (task, trajectory))
    }
}
