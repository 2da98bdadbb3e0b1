use domain::Feedback;

use super::super::history::PastPose;
use super::*;

/// Floor in the columns and rows 20 to 24, all of it known, nothing beyond it passable.
fn hall(pose: Pose) -> Surroundings {
    let mut ground = Surroundings::new(pose, Doubt::default());
    for x in 19..=25 {
        for y in 19..=25 {
            let edge = [x, y].into_iter().any(|at| at == 19 || at == 25);
            let cell = Cell::new(x, y);
            if edge { ground.mark_solid(cell) } else { ground.mark_free(cell) }
        }
    }
    ground
}

fn walked(here: Pose, past: &[(Pose, Action)]) -> History {
    let past = past.iter().map(|&(pose, action)| PastPose {
        pose,
        action: Some(action),
        feedback: Feedback::Moved,
    });
    History { past: past.collect(), here, origin: None }
}

/// Where the course leads in so many steps from `here`, joined where need be.
fn follow(course: &Course, mut here: Pose, steps: usize) -> Vec<Cell> {
    let mut cells = vec![here.cell];
    let mut past = Vec::new();
    for _ in 0..steps {
        let history = walked(here, &past);
        let ground = hall(here);
        let action = course.action_here(&history).map(|(_, action)| action);
        let join = || course.join(&history, &ground, &mut ground.ways()).map(|(_, action)| action);
        let action = action.or_else(join).unwrap();
        past.push((here, action));
        here = after(here, action).unwrap();
        cells.push(here.cell);
    }
    cells
}

const STOPS: [Cell; 3] = [Cell::new(20, 20), Cell::new(24, 24), Cell::new(20, 24)];

#[test]
fn a_round_passes_every_stop_from_wherever_it_is_joined() {
    let course = Course::through(&STOPS, hall).unwrap();
    for start in [(22, 22), (20, 20), (24, 21), (20, 23)] {
        for heading in Heading::ALL {
            let walk = follow(&course, Pose::new(start.0, start.1, heading), 40);
            for stop in STOPS {
                assert!(walk.contains(&stop), "{stop} from {start:?} facing {heading}: {walk:?}");
            }
        }
    }
}

#[test]
fn stops_that_cannot_be_reached_make_no_round() {
    assert_eq!(Course::through(&STOPS[..1], hall), None);
    let beyond = [Cell::new(20, 20), Cell::new(40, 40)];
    let walled = |pose| {
        let mut ground = hall(pose);
        [(39, 40), (41, 40), (40, 39), (40, 41)]
            .into_iter()
            .for_each(|(x, y)| ground.mark_solid(Cell::new(x, y)));
        ground
    };
    assert_eq!(Course::through(&beyond, walled), None);
}

fn north(steps: u8) -> Vec<PathStep> {
    let walk = (0..=steps).map(|t| PathStep {
        pose: Pose::new(20, 20 + t, Heading::N),
        action: (t < steps).then_some(Action::Forward),
    });
    walk.collect()
}

#[test]
fn a_walk_is_followed_to_its_end_and_a_closed_one_back_to_its_start() {
    let open = Course::of_walk(&north(3), &[]);
    let end = Pose::new(20, 23, Heading::N);
    assert_eq!(open.action_here(&walked(end, &[])), None);
    let closed = open.closed(hall);
    let walk = follow(&closed, Pose::new(20, 20, Heading::N), 9);
    assert_eq!(walk[3], end.cell);
    assert_eq!(walk[7], Cell::new(20, 20), "after turning around: {walk:?}");
}

#[test]
fn of_one_pose_twice_on_a_walk_the_last_steps_tell_which() {
    let spot = Pose::new(20, 20, Heading::N);
    let turned = |heading| Pose { heading, ..spot };
    let steps = [
        (spot, Some(Action::TurnRight)),
        (turned(Heading::E), Some(Action::TurnLeft)),
        (spot, Some(Action::TurnAround)),
        (turned(Heading::S), None),
    ];
    let steps: Vec<_> = steps.into_iter().map(|(pose, action)| PathStep { pose, action }).collect();
    let course = Course::of_walk(&steps, &[]);
    assert_eq!(course.action_here(&walked(spot, &[])), Some((0, Action::TurnRight)));
    let past = [(spot, Action::TurnRight), (turned(Heading::E), Action::TurnLeft)];
    assert_eq!(course.action_here(&walked(spot, &past)), Some((2, Action::TurnAround)));
}

#[test]
fn a_walk_is_joined_before_what_is_wanted_unless_that_is_far() {
    let course = Course::of_walk(&north(4), &[Cell::new(20, 21), Cell::new(20, 24)]).closed(hall);
    let join = |x, y| {
        let here = Pose::new(x, y, Heading::N);
        let ground = hall(here);
        course.join(&walked(here, &[]), &ground, &mut ground.ways()).unwrap().1
    };
    assert_eq!(join(21, 21), Action::Left);
    assert_eq!(join(20, 20), Action::Forward, "on it");
}

#[test]
fn what_is_closed_is_joined_beyond() {
    let course = Course::of_walk(&north(4), &[]);
    let here = Pose::new(20, 21, Heading::N);
    let mut ground = hall(here);
    ground.mark_solid(Cell::new(20, 22));
    let (_, action) = course.join(&walked(here, &[]), &ground, &mut ground.ways()).unwrap();
    assert_eq!(action, Action::Right, "around");
    assert!(!leads_on(Action::Forward, &walked(here, &[]), &ground));
}

#[test]
fn the_choice_of_one_of_each_makes_the_round_short() {
    let near = [Cell::new(20, 24), Cell::new(24, 20)];
    let groups = [near.to_vec(), vec![Cell::new(24, 21), Cell::new(20, 20)]];
    let chosen = best_choice(&groups, &hall).unwrap();
    assert_eq!(chosen, [Cell::new(24, 20), Cell::new(24, 21)]);
    assert_eq!(best_choice(&[vec![], near.to_vec()], &hall), None);
    let corners = [(20, 20), (24, 24), (20, 24), (24, 20)].map(|(x, y)| Cell::new(x, y));
    let round = round_trip(corners.to_vec(), &hall);
    let length: u32 = (0..4).map(|i| round[i].distance(round[(i + 1) % 4])).sum();
    assert_eq!((round[0], length), (corners[0], 16));
}
