//! One step of the world: pose + action + variant -> pose + feedback. The only place that decides it.

use shm_types::{Action, Cell, Feedback, Pose};

use crate::layout::Layout;

/// Most steps of an episode, T_max of the paper.
pub const MAX_STEPS: u32 = 200;

/// What differs from the warehouse as drawn: cells closed by a barricade.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub struct Variant {
    closed: Vec<Cell>,
}

impl Variant {
    /// The warehouse as drawn.
    pub const UNCHANGED: Self = Self { closed: Vec::new() };

    /// The warehouse with a barricade on `cells`.
    pub fn closing(cells: impl IntoIterator<Item = Cell>) -> Self {
        let mut closed: Vec<Cell> = cells.into_iter().collect();
        closed.sort_unstable();
        closed.dedup();
        Self { closed }
    }

    /// Whether a barricade stands on `cell`.
    pub fn is_closed(&self, cell: Cell) -> bool {
        self.closed.binary_search(&cell).is_ok()
    }

    /// The closed cells, sorted.
    pub fn closed(&self) -> &[Cell] {
        &self.closed
    }
}

/// What `action` does at `pose`: where the agent is afterwards, and what it is told.
///
/// Turns always succeed. A move into a rack, a wall, a barricade or off the floor leaves the agent where
/// it is and is answered with [`Feedback::Blocked`].
pub fn step(layout: &Layout, variant: &Variant, pose: Pose, action: Action) -> (Pose, Feedback) {
    if let Some(quarters) = action.turn_quarters() {
        return (Pose { heading: pose.heading.turned(quarters), ..pose }, Feedback::Turned);
    }
    let direction = pose.heading.turned(action.move_direction().unwrap_or(0));
    match layout.free_neighbour(pose.cell, direction) {
        Some(cell) if !variant.is_closed(cell) => (Pose { cell, ..pose }, Feedback::Moved),
        _ => (pose, Feedback::Blocked),
    }
}
