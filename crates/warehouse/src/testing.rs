//! A warehouse small enough to search by brute force, for tests.

use domain::Cell;

use crate::task::Task;
use crate::world::Warehouse;

/// Two aisles round two racks, joined on the left, in the middle and on the right. See [`STOCK`].
const LAYOUT: &str = r##"
plan = """
#######
nnnnnnn
a##b##c
sssssss
#######
"""
[[aisle]]
mark = "s"
name = "South aisle"
runs = "east-west"
[[aisle]]
mark = "n"
name = "North aisle"
runs = "east-west"
[[aisle]]
mark = "a"
name = "Aisle A"
runs = "north-south"
[[aisle]]
mark = "b"
name = "Aisle B"
runs = "north-south"
[[aisle]]
mark = "c"
name = "Aisle C"
runs = "north-south"
"##;

const STOCK: &str = r##"
stock = """
## ## ## ## ## ## ##
b1 .. .. b2 .. .. b1
c1 ## ## .. ## ## c1
b1 .. .. c2 .. .. b2
## ## ## ## ## ## ##
"""
[[category]]
mark = "b"
name = "barrels"
shape = "barrel"
types = [{ name = "blue barrel", colour = "#2a5bd0" }, { name = "red barrel", colour = "#d22c2c" }]
[[category]]
mark = "c"
name = "cones"
shape = "cone"
types = [{ name = "orange cone", colour = "#f07f1a" }, { name = "green cone", colour = "#2f9e44" }]
"##;

/// Indices of the types of [`tiny`].
pub(crate) const BLUE_BARREL: usize = 0;
pub(crate) const RED_BARREL: usize = 1;
pub(crate) const ORANGE_CONE: usize = 2;
pub(crate) const GREEN_CONE: usize = 3;
pub(crate) const CONES: usize = 1;

/// The small warehouse: blue barrels in three corners, red ones at (3, 3) and (6, 1), orange cones at the
/// sides, a green one at (3, 1).
pub(crate) fn tiny() -> Warehouse {
    Warehouse::parse("tiny layout".into(), LAYOUT, "tiny catalogue".into(), STOCK).unwrap()
}

/// Every task that can be asked in `warehouse`.
pub(crate) fn all_tasks(warehouse: &Warehouse) -> Vec<Task> {
    let types = warehouse.catalogue.types.len();
    let mut tasks = Vec::new();
    for a in 0..types {
        tasks.extend([
            Task::FindType { a },
            Task::EveryOfType { a },
            Task::FindAndReturn { a },
            Task::EveryAndReturn { a },
        ]);
        for b in (0..types).filter(|&b| b != a) {
            tasks.extend([
                Task::BothTypes { a, b },
                Task::InOrder { a, b },
                Task::Revisit { a, b },
                Task::InOrderAndReturn { a, b },
            ]);
        }
    }
    for c in 0..warehouse.catalogue.categories.len() {
        tasks.extend([Task::FindCategory { c }, Task::EveryOfCategory { c }]);
    }
    tasks
}

/// Cells from `(x, y)` pairs.
pub(crate) fn cells(pairs: &[(u8, u8)]) -> Vec<Cell> {
    pairs.iter().map(|&(x, y)| Cell::new(x, y)).collect()
}
