//! The dynamics: one function from pose, action and variant to pose and feedback.

use domain::{Action, Cell, Feedback, Pose};

use crate::layout::Layout;

/// A variant of the world: the cells closed by a barricade.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub struct Variant {
    closed: Vec<Cell>,
}

impl Variant {
    /// The world without a barricade.
    pub const UNCHANGED: Self = Self { closed: Vec::new() };

    /// The world with a barricade on `cells`.
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

/// The pose and feedback after `action` at `pose`.
///
/// Turns always succeed. A move into a rack, a wall, a barricade or off the floor leaves the agent where it is, with
/// [`Feedback::Blocked`].
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

#[cfg(test)]
mod tests {
    use domain::Heading::{E, N, S, W};

    use super::*;
    use crate::testing::{cells, tiny};

    #[test]
    fn every_action_does_what_its_name_says() {
        let warehouse = tiny();
        let barricade = Variant::closing(cells(&[(2, 1)]));
        use Feedback::{Blocked, Moved, Turned};
        for (from, action, to, feedback) in [
            (Pose::new(4, 1, W), Action::Forward, Pose::new(3, 1, W), Moved),
            (Pose::new(4, 1, W), Action::Backward, Pose::new(5, 1, W), Moved),
            (Pose::new(3, 2, W), Action::Left, Pose::new(3, 1, W), Moved),
            (Pose::new(3, 2, W), Action::Right, Pose::new(3, 3, W), Moved),
            (Pose::new(4, 1, W), Action::TurnLeft, Pose::new(4, 1, S), Turned),
            (Pose::new(4, 1, W), Action::TurnRight, Pose::new(4, 1, N), Turned),
            (Pose::new(4, 1, W), Action::TurnAround, Pose::new(4, 1, E), Turned),
            // A rack, the edge of the plan, a barricade.
            (Pose::new(4, 1, N), Action::Forward, Pose::new(4, 1, N), Blocked),
            (Pose::new(0, 1, W), Action::Forward, Pose::new(0, 1, W), Blocked),
            (Pose::new(6, 1, N), Action::Right, Pose::new(6, 1, N), Blocked),
            (Pose::new(3, 1, W), Action::Forward, Pose::new(3, 1, W), Blocked),
        ] {
            let found = step(&warehouse.layout, &barricade, from, action);
            assert_eq!(found, (to, feedback), "{action:?} at {from}");
        }
        let open =
            step(&warehouse.layout, &Variant::UNCHANGED, Pose::new(3, 1, W), Action::Forward);
        assert_eq!(open, (Pose::new(2, 1, W), Moved));
    }

    #[test]
    fn a_variant_sorts_its_cells() {
        let variant = Variant::closing(cells(&[(3, 1), (2, 1), (3, 1)]));
        assert_eq!(variant.closed(), cells(&[(2, 1), (3, 1)]));
        assert!(variant.is_closed(Cell::new(2, 1)) && !variant.is_closed(Cell::new(1, 1)));
        assert!(Variant::UNCHANGED.closed().is_empty());
    }
}
