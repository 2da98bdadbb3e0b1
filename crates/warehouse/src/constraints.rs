//! The constraints on cases (specification, section 4), one predicate each, on replayed trajectories.
//!
//! The generator searches for cases that satisfy them, and the validator reports cases that do not.

use domain::camera::CameraSetup;
use domain::{Cell, Feedback, MAX_STEPS, Pose};

use crate::layout::{Axis, Layout};
use crate::sight::sees;
use crate::task::Task;
use crate::trajectory::Replay;
use crate::world::{Item, Warehouse};

/// Distance of a nearby start along the aisle, in cells.
pub(crate) const NEARBY_CELLS: std::ops::RangeInclusive<u8> = 2..=4;

/// Minimum distance of a distant start, in cells (columns plus rows).
pub(crate) const DISTANT_CELLS: u32 = 6;

/// Length of the test reference, in percent of the original demonstration's.
pub(crate) const TEST_LENGTH_PERCENT: std::ops::RangeInclusive<u32> = 75..=135;

/// Maximum number of steps of any trajectory of a generated set, in percent of the fewest steps that complete its task.
pub const MAX_DETOUR_PERCENT: u32 = 150;

/// An undirected move between two neighbouring cells, the smaller cell first.
pub(crate) type FloorEdge = (Cell, Cell);

/// The edges of a trajectory, each once, sorted. Turns and blocked moves have none.
pub(crate) fn edges(poses: &[Pose]) -> Vec<FloorEdge> {
    let moves = poses.windows(2).map(|pair| (pair[0].cell, pair[1].cell));
    let mut edges: Vec<FloorEdge> =
        moves.filter(|(a, b)| a != b).map(|(a, b)| (a.min(b), a.max(b))).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

/// The number of edges in both lists.
pub(crate) fn shared(one: &[FloorEdge], other: &[FloorEdge]) -> usize {
    one.iter().filter(|edge| other.binary_search(edge).is_ok()).count()
}

/// Same cell, facing the other way.
pub(crate) fn is_opposite(original: Pose, opposite: Pose) -> bool {
    opposite == Pose { heading: original.heading.opposite(), ..original }
}

/// 2 to 4 cells along the same aisle, in the direction it runs, same heading.
pub(crate) fn is_nearby(layout: &Layout, original: Pose, nearby: Pose) -> bool {
    let (from, to) = (original.cell, nearby.cell);
    let Some(aisle) = layout.aisle(from) else { return false };
    let (along, across) = match aisle.runs {
        Axis::EastWest => (from.x.abs_diff(to.x), from.y.abs_diff(to.y)),
        Axis::NorthSouth => (from.y.abs_diff(to.y), from.x.abs_diff(to.x)),
    };
    layout.aisle_index(from) == layout.aisle_index(to)
        && original.heading == nearby.heading
        && NEARBY_CELLS.contains(&along)
        && across == 0
}

/// At least 6 cells away, in another aisle, heading turned by 90 degrees.
pub(crate) fn is_distant(layout: &Layout, original: Pose, distant: Pose) -> bool {
    layout.is_free(distant.cell)
        && layout.aisle_index(original.cell) != layout.aisle_index(distant.cell)
        && original.cell.distance(distant.cell) >= DISTANT_CELLS
        && [original.heading.left(), original.heading.right()].contains(&distant.heading)
}

/// At least half of the original's edges are in the other trajectory.
pub(crate) fn shares_at_least_half(original: &[FloorEdge], other: &[FloorEdge]) -> bool {
    2 * shared(original, other) >= original.len()
}

/// At most half of the original's edges are in the other trajectory.
pub(crate) fn shares_at_most_half(original: &[FloorEdge], other: &[FloorEdge]) -> bool {
    2 * shared(original, other) <= original.len()
}

/// The test reference is neither much shorter nor much longer than the original demonstration.
pub(crate) fn is_of_similar_length(original: u32, test: u32) -> bool {
    let percent = TEST_LENGTH_PERCENT;
    (percent.start() * original..=percent.end() * original).contains(&(100 * test))
}

/// The first of `targets` that is in view from `pose`.
pub(crate) fn target_in_view<'i>(
    warehouse: &Warehouse,
    pose: Pose,
    targets: &[&'i Item],
) -> Option<&'i Item> {
    targets.iter().copied().find(|item| sees(warehouse, CameraSetup::STANDARD, pose, item))
}

/// The first of `targets` whose standpoint is among `cells`.
pub(crate) fn target_on<'i>(cells: &[Cell], targets: &[&'i Item]) -> Option<&'i Item> {
    targets.iter().copied().find(|item| cells.contains(&item.standpoint))
}

/// Whether a trajectory enters `cells` from outside; beginning inside is not enough.
pub(crate) fn enters(poses: &[Pose], cells: &[Cell]) -> bool {
    let is_inside = |pose: &Pose| cells.contains(&pose.cell);
    poses.windows(2).any(|pair| !is_inside(&pair[0]) && is_inside(&pair[1]))
}

/// Checks that the trajectory completes its task within the step limit, is never blocked, and ends there: at most one turn
/// follows the step that completes the task. Returns that step.
pub(crate) fn completes_task(replay: &Replay) -> Result<u32, String> {
    let blocked = replay.feedback.iter().position(|&feedback| feedback == Feedback::Blocked);
    if let Some(at) = blocked {
        return Err(format!("step {at} is blocked at {}", replay.poses[at]));
    }
    let steps = replay.poses.len() as u32 - 1;
    let Some(length) = replay.length else {
        return Err(format!(
            "the task is not complete after {steps} steps: {} sub-goals met",
            replay.goal_steps.len()
        ));
    };
    if length == 0 || length > MAX_STEPS {
        return Err(format!("complete after {length} steps; must be 1 to {MAX_STEPS}"));
    }
    let tail = &replay.feedback[length as usize + 1..];
    if tail.len() > 1 || tail.contains(&Feedback::Moved) {
        return Err(format!("continues for {} steps after completing the task", tail.len()));
    }
    Ok(length)
}

/// Checks that wherever the trajectory reaches an item that counts, it faces the item before it leaves the cell.
pub(crate) fn faces_targets(
    warehouse: &Warehouse,
    task: &Task,
    replay: &Replay,
) -> Result<(), String> {
    let goals = replay.goal_steps.len();
    let returns = usize::from(task.returns_to_origin() && replay.length.is_some());
    for &at in replay.goal_steps.iter().take(goals - returns) {
        let cell = replay.poses[at as usize].cell;
        let Some(item) = warehouse.item_at(cell) else { continue };
        let mut stay = replay.poses[at as usize..].iter().take_while(|pose| pose.cell == cell);
        if !stay.any(|pose| pose.heading == item.viewing_heading()) {
            return Err(format!("reaches item {} at step {at} without facing it", item.id));
        }
    }
    Ok(())
}

/// At most [`MAX_DETOUR_PERCENT`] of the fewest steps.
pub(crate) fn is_near_optimal(length: u32, fewest: u32) -> bool {
    100 * length <= MAX_DETOUR_PERCENT * fewest
}

#[cfg(test)]
mod tests {
    use domain::Heading::{E, N, S, W};

    use super::*;
    use crate::testing::cells;

    fn poses(visited: &[(u8, u8)]) -> Vec<Pose> {
        cells(visited).into_iter().map(|cell| Pose { cell, heading: N }).collect()
    }

    #[test]
    fn edges_have_no_direction_and_count_once() {
        let there_and_back = edges(&poses(&[(0, 0), (0, 0), (0, 1), (1, 1), (0, 1), (0, 0)]));
        assert_eq!(there_and_back.len(), 2);
        assert_eq!(there_and_back, edges(&poses(&[(1, 1), (0, 1), (0, 0)])));
        let longer = edges(&poses(&[(0, 0), (0, 1), (0, 2), (0, 3)]));
        assert_eq!(shared(&there_and_back, &longer), 1);
        // One edge of two is half, one of three is less; half is enough for both rules.
        assert!(shares_at_least_half(&there_and_back, &longer));
        assert!(!shares_at_least_half(&longer, &there_and_back));
        assert!(shares_at_most_half(&there_and_back, &longer));
        assert!(!shares_at_most_half(&longer, &longer));
    }

    #[test]
    fn starts_relate_as_their_names_say() {
        let layout = Warehouse::shipped().layout;
        let start = Pose::new(2, 8, N);
        assert!(is_opposite(start, Pose::new(2, 8, S)) && !is_opposite(start, Pose::new(2, 8, E)));
        for (nearby, expected, why) in [
            (Pose::new(2, 10, N), true, "two cells up the aisle"),
            (Pose::new(2, 4, N), true, "four cells down the aisle"),
            (Pose::new(2, 9, N), false, "one cell only"),
            (Pose::new(2, 13, N), false, "five cells"),
            (Pose::new(3, 10, N), false, "not straight along the aisle"),
            (Pose::new(2, 10, E), false, "another heading"),
        ] {
            assert_eq!(is_nearby(&layout, start, nearby), expected, "{why}");
        }
        assert!(!is_nearby(&layout, Pose::new(2, 12, N), Pose::new(2, 14, N)), "another aisle");
        for (distant, expected, why) in [
            (Pose::new(8, 8, E), true, "the next aisle, turned right"),
            (Pose::new(8, 8, W), true, "the next aisle, turned left"),
            (Pose::new(8, 8, S), false, "turned around"),
            (Pose::new(8, 8, N), false, "not turned"),
            (Pose::new(2, 13, E), false, "the same aisle"),
            (Pose::new(2, 14, E), true, "just out of the aisle, six cells away"),
            (Pose::new(5, 8, E), false, "no free cell"),
        ] {
            assert_eq!(is_distant(&layout, start, distant), expected, "{why}");
        }
    }

    #[test]
    fn limits_include_their_ends() {
        let similar = |test| is_of_similar_length(20, test);
        assert_eq!([14, 15, 27, 28].map(similar), [false, true, true, false]);
        assert!(is_near_optimal(15, 10) && !is_near_optimal(16, 10));
        let passage = cells(&[(1, 1)]);
        assert!(enters(&poses(&[(0, 1), (1, 1)]), &passage));
        assert!(!enters(&poses(&[(1, 1), (0, 1)]), &passage), "it begins inside");
    }
}
