//! Moves and turns on the grid.

use domain::{Action, Cell, Heading, Pose};

/// A pose on a path and the action taken there; `None` where the path ends or the action is unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct PathStep {
    pub(super) pose: Pose,
    pub(super) action: Option<Action>,
}

/// The pose that `action` leads to if nothing is in the way; `None` off the grid.
pub(super) fn after(pose: Pose, action: Action) -> Option<Pose> {
    let heading = pose.heading.turned(action.turn_quarters().unwrap_or(0));
    let cell = match action.move_direction() {
        Some(direction) => pose.cell.step(pose.heading.turned(direction))?,
        None => pose.cell,
    };
    Some(Pose { cell, heading })
}

/// The move towards `direction` that keeps the heading.
pub(super) fn move_towards(heading: Heading, direction: Heading) -> Action {
    match heading.quarters_to(direction) {
        0 => Action::Forward,
        1 => Action::Right,
        2 => Action::Backward,
        _ => Action::Left,
    }
}

/// The turn after which the agent faces `direction`; `None` if it does already.
pub(super) fn turn_towards(heading: Heading, direction: Heading) -> Option<Action> {
    match heading.quarters_to(direction) {
        0 => None,
        1 => Some(Action::TurnRight),
        2 => Some(Action::TurnAround),
        _ => Some(Action::TurnLeft),
    }
}

/// Maps `pose` by the shift and rotation that map `from` to `to`; `None` off the grid.
pub(super) fn relocated(pose: Pose, from: Pose, to: Pose) -> Option<Pose> {
    let (ahead, right) = from.offset_of(pose.cell);
    let cell = to.cell_at(ahead.try_into().ok()?, right.try_into().ok()?)?;
    Some(Pose { cell, heading: to.heading.turned(from.heading.quarters_to(pose.heading)) })
}

/// The cells in order, each once.
pub(super) fn sorted(cells: impl Iterator<Item = Cell>) -> Vec<Cell> {
    let mut cells: Vec<Cell> = cells.collect();
    cells.sort_unstable();
    cells.dedup();
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_and_turns_lead_in_the_requested_direction() {
        for heading in Heading::ALL {
            for direction in Heading::ALL {
                let start = Pose::new(9, 9, heading);
                let moved = after(start, move_towards(heading, direction)).unwrap();
                assert_eq!(
                    (Some(moved.cell), moved.heading),
                    (start.cell.step(direction), heading)
                );
                let turned = turn_towards(heading, direction).map(|turn| after(start, turn));
                let faces = turned.map_or(start, Option::unwrap);
                assert_eq!(faces, Pose { heading: direction, ..start });
            }
        }
    }

    #[test]
    fn relocation_shifts_and_rotates() {
        let (from, to) = (Pose::new(128, 128, Heading::N), Pose::new(20, 20, Heading::E));
        let two_north = Pose::new(128, 130, Heading::W);
        assert_eq!(relocated(two_north, from, to), Some(Pose::new(22, 20, Heading::N)));
        assert_eq!(relocated(two_north, from, Pose::new(255, 20, Heading::E)), None);
    }
}
