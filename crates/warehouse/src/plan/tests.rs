//! The planner against brute force, and the expert's habits.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use domain::{Action, Heading};
use proptest::prelude::*;

use super::*;
use crate::progress::Progress;
use crate::testing::{all_tasks, cells, tiny};
use crate::{CaseSet, TrajectoryKind};

/// Dijkstra over (pose, progress): no orders, no fields, only the world's own dynamics and the checker.
fn brute_force(
    warehouse: &Warehouse,
    variant: &Variant,
    prices: Prices,
    start: Pose,
    task: &Task,
) -> Option<u32> {
    let targets = task.targets(warehouse);
    let target_on = |cell| targets.iter().find(|item| item.standpoint == cell);
    let mut states = vec![(start, Progress::new(warehouse, task, start.cell))];
    let mut known = HashMap::from([(states[0].clone(), 0)]);
    let mut queue = BinaryHeap::from([Reverse((0, 0))]);
    while let Some(Reverse((cost, at))) = queue.pop() {
        let (pose, progress) = states[at].clone();
        if progress.is_complete() {
            return Some(cost);
        }
        if known[&states[at]] < cost {
            continue;
        }
        // The first instance entered is the one to revisit, whether it was faced or not.
        let stays = progress.stage() == 0
            && target_on(pose.cell).is_some_and(|item| first_of(task) == Some(item.item_type));
        for action in Action::ALL {
            let (next, _) = step(&warehouse.layout, variant, pose, action);
            if stays && next.cell != pose.cell {
                continue;
            }
            let mut after = progress.clone();
            let looks =
                target_on(next.cell).is_none_or(|item| item.viewing_heading() == next.heading);
            if looks || prices == Prices::STEPS {
                after.visit(next.cell);
            }
            let total = cost + prices.of(action, warehouse.item_at(next.cell).is_some());
            let state = (next, after);
            if next != pose && known.get(&state).is_none_or(|&found| total < found) {
                known.insert(state.clone(), total);
                states.push(state);
                queue.push(Reverse((total, states.len() - 1)));
            }
        }
    }
    None
}

/// A of a revisit.
fn first_of(task: &Task) -> Option<usize> {
    if let Task::Revisit { a, .. } = *task { Some(a) } else { None }
}

/// Checks that a plan costs what brute force finds, and that replaying it completes the task.
fn check(warehouse: &Warehouse, variant: &Variant, start: Pose, task: &Task) {
    let fewest = Planner::new(warehouse, variant.clone(), Prices::STEPS).cost(start, task);
    assert_eq!(
        fewest,
        brute_force(warehouse, variant, Prices::STEPS, start, task),
        "fewest steps of {task:?} from {start} with {variant:?}"
    );
    let on_target = task.targets(warehouse).iter().any(|item| item.standpoint == start.cell);
    if on_target {
        // Brute force counts items at the first cell as faced, whatever the heading.
        return;
    }
    let expert = Planner::new(warehouse, variant.clone(), Prices::EXPERT);
    let cost = expert.cost(start, task);
    assert_eq!(
        cost,
        brute_force(warehouse, variant, Prices::EXPERT, start, task),
        "the expert's cost of {task:?} from {start} with {variant:?}"
    );
    let Some((cost, fewest)) = cost.zip(fewest) else { return };

    let trajectory = expert.plan(start, task).unwrap();
    let replay = trajectory.replay(warehouse, task, variant);
    let priced: u32 = std::iter::zip(&trajectory.actions, &replay.poses[1..])
        .map(|(&action, pose)| Prices::EXPERT.of(action, warehouse.item_at(pose.cell).is_some()))
        .sum();
    assert_eq!(priced, cost, "the plan costs what it says");
    let (length, items) = (replay.length.unwrap(), task.targets(warehouse).len() as u32);
    assert!(fewest <= length && length <= 2 * fewest + items, "{length} of {fewest}");
}

#[test]
fn every_plan_in_a_tiny_warehouse_is_the_cheapest() {
    let warehouse = tiny();
    for task in all_tasks(&warehouse) {
        for cell in warehouse.layout.free_cells() {
            check(&warehouse, &Variant::UNCHANGED, Pose { cell, heading: Heading::E }, &task);
        }
    }
}

#[test]
fn every_plan_round_a_barricade_is_the_cheapest_and_none_passes_it() {
    let warehouse = tiny();
    let closed = cells(&[(2, 3), (3, 2), (4, 1)]);
    let variant = Variant::closing(closed.iter().copied());
    let expert = Planner::new(&warehouse, variant.clone(), Prices::EXPERT);
    for task in all_tasks(&warehouse) {
        for start in [Pose::new(1, 1, Heading::N), Pose::new(4, 3, Heading::S)] {
            check(&warehouse, &variant, start, &task);
            let Some(plan) = expert.plan(start, &task) else { continue };
            let replay = plan.replay(&warehouse, &task, &variant);
            assert!(replay.poses.iter().all(|pose| !closed.contains(&pose.cell)));
            assert!(!replay.feedback.contains(&domain::Feedback::Blocked));
        }
    }
    // The two halves are cut off from each other, and no blue barrel but those of its half is reached.
    let all_blue = Task::EveryOfType { a: crate::testing::BLUE_BARREL };
    assert_eq!(expert.plan(Pose::new(1, 1, Heading::N), &all_blue), None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn plans_in_the_shipped_warehouse_are_the_cheapest(
        a in 0..36_usize, other in 1..36_usize, kind in 0..8, cell in 0..1000_usize, heading in 0..4_usize,
    ) {
        let warehouse = Warehouse::shipped();
        let b = (a + other) % 36;
        // Brute force cannot enumerate what has been met of more than a few items.
        let few = warehouse.instances(a).count() <= 5;
        let task = match kind {
            0 => Task::FindType { a },
            1 => Task::FindCategory { c: a / 3 },
            2 if few => Task::EveryOfType { a },
            3 => Task::BothTypes { a, b },
            4 => Task::InOrder { a, b },
            5 => Task::FindAndReturn { a },
            6 if few => Task::EveryAndReturn { a },
            7 => Task::Revisit { a, b },
            _ => Task::InOrderAndReturn { a, b },
        };
        let free: Vec<Cell> = warehouse.layout.free_cells().collect();
        let start = Pose { cell: free[cell % free.len()], heading: Heading::ALL[heading] };
        check(&warehouse, &Variant::UNCHANGED, start, &task);
    }
}

#[test]
fn the_expert_turns_towards_where_it_goes_and_sidesteps_by_one_cell_only() {
    let warehouse = tiny();
    let expert = Planner::new(&warehouse, Variant::UNCHANGED, Prices::EXPERT);
    let letters = |start: Pose, task| {
        let plan = expert.plan(start, &task).unwrap();
        plan.actions.iter().map(|action| action.letter()).collect::<String>()
    };
    let green = Task::FindType { a: crate::testing::GREEN_CONE };
    // Forward and a turn to the rack, never two sidesteps; backwards never where turning round is as cheap.
    assert_eq!(letters(Pose::new(5, 1, Heading::W), green), "ffL");
    assert_eq!(letters(Pose::new(5, 1, Heading::S), green), "RffL");
    assert_eq!(letters(Pose::new(5, 1, Heading::E), green), "UffL");
    // One cell to the side, still facing the rack, is a sidestep.
    assert_eq!(letters(Pose::new(4, 1, Heading::S), green), "r");
    // Already in front of it: only the look is missing.
    assert_eq!(letters(Pose::new(3, 1, Heading::N), green), "U");
}

#[test]
fn most_moves_of_the_shipped_trajectories_are_forward() {
    let cases = CaseSet::shipped();
    let trajectories =
        cases.cases.iter().flat_map(|case| TrajectoryKind::ALL.map(|s| case.trajectory(s)));
    let moves: Vec<Action> = trajectories
        .flat_map(|trajectory| &trajectory.actions)
        .copied()
        .filter(|action| action.move_direction().is_some())
        .collect();
    let forward = moves.iter().filter(|&&action| action == Action::Forward).count();
    assert!(100 * forward > 90 * moves.len(), "{forward} of {}", moves.len());
}
