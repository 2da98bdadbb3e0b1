//! Cells as seen from a pose.

use shm_types::{Action, Cell, Heading, Pose};

/// The cell that lies so many cells ahead and to the right of `pose`; `None` off the grid.
pub(super) fn cell_at(pose: Pose, ahead: i8, right: i8) -> Option<Cell> {
    let (along, across) = (pose.heading.vector(), pose.heading.right().vector());
    let moved = |from: u8, along: i8, across: i8| {
        let offset = i16::from(along) * i16::from(ahead) + i16::from(across) * i16::from(right);
        u8::try_from(i16::from(from) + offset).ok()
    };
    Some(Cell::new(moved(pose.cell.x, along.0, across.0)?, moved(pose.cell.y, along.1, across.1)?))
}

/// How far ahead and to the right of `pose` a cell lies.
pub(super) fn offset_of(pose: Pose, cell: Cell) -> (i16, i16) {
    let (along, across) = (pose.heading.vector(), pose.heading.right().vector());
    let (dx, dy) =
        (i16::from(cell.x) - i16::from(pose.cell.x), i16::from(cell.y) - i16::from(pose.cell.y));
    let in_direction = |(x, y): (i8, i8)| dx * i16::from(x) + dy * i16::from(y);
    (in_direction(along), in_direction(across))
}

/// Right turns from one heading to another: 0 to 3.
pub(super) fn quarters(from: Heading, to: Heading) -> i8 {
    (to as i8 - from as i8).rem_euclid(4)
}

/// The move that goes towards `direction` without turning.
pub(super) fn move_towards(heading: Heading, direction: Heading) -> Action {
    match quarters(heading, direction) {
        0 => Action::Forward,
        1 => Action::Right,
        2 => Action::Backward,
        _ => Action::Left,
    }
}

/// The turn that makes the agent face `direction`; `None` when it does.
pub(super) fn turn_towards(heading: Heading, direction: Heading) -> Option<Action> {
    match quarters(heading, direction) {
        0 => None,
        1 => Some(Action::TurnRight),
        2 => Some(Action::TurnAround),
        _ => Some(Action::TurnLeft),
    }
}

/// The pose that `action` leads to from `pose` if nothing is in the way; `None` off the grid.
pub(super) fn after(pose: Pose, action: Action) -> Option<Pose> {
    let heading = pose.heading.turned(action.turn_quarters().unwrap_or(0));
    let cell = match action.move_direction() {
        Some(direction) => pose.cell.step(pose.heading.turned(direction))?,
        None => pose.cell,
    };
    Some(Pose { cell, heading })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_and_offsets_are_each_other_s_inverse() {
        for heading in Heading::ALL {
            let pose = Pose::new(20, 30, heading);
            for (ahead, right) in [(0, 0), (3, 1), (-2, 4), (5, -6)] {
                let cell = cell_at(pose, ahead, right).unwrap();
                assert_eq!(offset_of(pose, cell), (i16::from(ahead), i16::from(right)));
            }
        }
        assert_eq!(cell_at(Pose::new(5, 5, Heading::W), 3, 1), Some(Cell::new(2, 6)));
        assert_eq!(cell_at(Pose::new(5, 5, Heading::W), 6, 0), None);
    }

    #[test]
    fn moves_and_turns_go_where_they_should() {
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
}
