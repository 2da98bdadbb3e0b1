//! Moves and turns: which leads where.

use domain::{Action, Heading, Pose};

use super::chart::PathStep;

/// The move that goes towards `direction` without turning.
pub(super) fn move_towards(heading: Heading, direction: Heading) -> Action {
    match heading.quarters_to(direction) {
        0 => Action::Forward,
        1 => Action::Right,
        2 => Action::Backward,
        _ => Action::Left,
    }
}

/// The turn that makes the agent face `direction`; `None` when it does.
pub(super) fn turn_towards(heading: Heading, direction: Heading) -> Option<Action> {
    match heading.quarters_to(direction) {
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

/// Adds to `steps` the poses and actions of a walk from `start` through `directions`, facing the way that is
/// walked, and returns where it ends.
pub(super) fn along(
    start: Pose,
    directions: impl IntoIterator<Item = Heading>,
    steps: &mut Vec<PathStep>,
) -> Pose {
    let mut pose = start;
    for direction in directions {
        if let Some(turn) = turn_towards(pose.heading, direction) {
            steps.push(PathStep { pose, action: Some(turn) });
            pose.heading = direction;
        }
        let Some(cell) = pose.cell.step(direction) else { break };
        steps.push(PathStep { pose, action: Some(Action::Forward) });
        pose.cell = cell;
    }
    pose
}

#[cfg(test)]
mod tests {
    use super::*;

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
