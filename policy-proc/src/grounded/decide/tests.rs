use domain::{DocumentKind, Feedback, Heading};
use proptest::prelude::*;

use super::*;
use plates::painter::{Aisle, Picture};

use crate::grounded::geometry::after;
use crate::grounded::testing::view;
use crate::{DocumentView, FrameView, PastView, Segment, SegmentView, Trajectory, TrajectoryView};

/// A request in the making: pictures of the aisle from the poses that are told.
struct Ask {
    instruction: String,
    step: u32,
    seed: u64,
    pose: Pose,
    /// What was done before, and the pose it was done from.
    past: Vec<(Pose, Action, Feedback)>,
    /// What is remembered: where from, and what the expert did there.
    remembered: Vec<(Pose, Option<Action>)>,
    /// A whole demonstration, all its views keyframes.
    demonstration: Vec<(Pose, Option<Action>)>,
    document: String,
    hint: bool,
    blank: bool,
}

impl Ask {
    fn at(pose: Pose) -> Self {
        Self {
            instruction: "Find a fork lift.".to_owned(),
            step: 20,
            seed: 1,
            pose,
            past: Vec::new(),
            remembered: Vec::new(),
            demonstration: Vec::new(),
            document: String::new(),
            hint: false,
            blank: false,
        }
    }

    fn for_the(self, instruction: &str) -> Self {
        Self { instruction: instruction.to_owned(), ..self }
    }

    fn after(self, past: &[(Pose, Action, Feedback)]) -> Self {
        Self { past: past.to_vec(), ..self }
    }

    fn remembering(self, remembered: &[(Pose, Option<Action>)]) -> Self {
        Self { remembered: remembered.to_vec(), ..self }
    }

    fn told(self, document: &str) -> Self {
        Self { document: document.to_owned(), ..self }
    }

    fn shown(self, demonstration: &[(Pose, Option<Action>)]) -> Self {
        Self { demonstration: demonstration.to_vec(), ..self }
    }

    /// The decision; the same whatever the frames' ids.
    fn action(&self) -> Action {
        let first = self.action_with_ids(1);
        assert_eq!(first, self.action_with_ids(1000));
        first
    }

    fn action_with_ids(&self, first_id: u64) -> Action {
        let aisle = Aisle::new();
        let poses = self.past.iter().map(|past| past.0);
        let poses = poses.chain(self.remembered.iter().map(|view| view.0));
        let poses = poses.chain(self.demonstration.iter().map(|view| view.0)).chain([self.pose]);
        let pictures: Vec<_> = poses.map(|pose| aisle.picture(pose)).collect();
        let views: Vec<_> =
            (first_id..).zip(&pictures).map(|(id, picture)| view(picture, id)).collect();
        let (past, views) = views.split_at(self.past.len());
        let (remembered, views) = views.split_at(self.remembered.len());
        let (demonstration, current) = views.split_at(self.demonstration.len());
        let window: Vec<_> = past
            .iter()
            .zip(&self.past)
            .map(|(&frame, &(_, action, feedback))| PastView {
                frame,
                action: Some(action),
                feedback,
            })
            .collect();
        let steps: Vec<_> = remembered
            .iter()
            .zip(&self.remembered)
            .map(|(&frame, &(_, action))| SegmentView { frame, action })
            .collect();
        let whole: Vec<_> = demonstration
            .iter()
            .zip(&self.demonstration)
            .map(|(&frame, &(_, action))| TrajectoryView { frame: Some(frame), action })
            .collect();
        let trajectory = [Trajectory { steps: &whole }];
        let document =
            [DocumentView { id: first_id, kind: DocumentKind::Summary, text: &self.document }];
        let grey = [128; 64 * 64 * 4];
        let blank = FrameView {
            id: first_id + 500,
            width: 64,
            height: 64,
            pixels: &grey,
            ..FrameView::NONE
        };
        let request = Request {
            lane: 0,
            step: self.step,
            episode: 1,
            repeat: 1,
            episode_seed: self.seed,
            instruction: &self.instruction,
            pose: self.pose,
            feedback: window.last().map_or(Feedback::Start, |past| past.feedback),
            frame: if self.blank { blank } else { current[0] },
            window: &window,
            segment: (!steps.is_empty()).then_some(Segment { distance: 0.0, steps: &steps }),
            documents: if self.document.is_empty() { &[] } else { &document },
            trajectories: if whole.is_empty() { &[] } else { &trajectory },
            starts_as_demonstrated: self.hint,
        };
        action(&request, &mut Mind::default())
    }
}

const HERE: Pose = Pose::new(10, 12, Heading::N);

#[test]
fn memory_that_fits_is_followed() {
    for expert in Action::ALL {
        let there = after(HERE, expert).unwrap();
        let ask = Ask::at(HERE).remembering(&[(HERE, Some(expert)), (there, None)]);
        assert_eq!(ask.action(), expert);
    }
}

#[test]
fn turns_between_images_alone_are_told_by_the_plates_they_show() {
    for turn in [Action::TurnLeft, Action::TurnRight, Action::TurnAround] {
        let came =
            [10, 11].map(|y| (Pose::new(10, y, Heading::N), Action::Forward, Feedback::Moved));
        let there = after(HERE, turn).unwrap();
        let ask = Ask::at(HERE).after(&came).remembering(&[(HERE, None), (there, None)]);
        assert_eq!(ask.action(), turn);
    }
}

#[test]
fn memory_of_another_place_is_not_followed() {
    let elsewhere = Pose::new(10, 18, Heading::N);
    let explored = Ask::at(HERE).action();
    for expert in Action::ALL {
        let ask = Ask::at(HERE).remembering(&[(elsewhere, Some(expert)), (elsewhere, None)]);
        assert_eq!(ask.action(), explored);
    }
}

#[test]
fn nothing_is_followed_and_nowhere_walked_when_nothing_is_seen() {
    let ask = Ask::at(HERE).remembering(&[(HERE, Some(Action::Forward)), (HERE, None)]);
    assert_eq!(Ask { blank: true, ..ask }.action(), Action::TurnRight);
}

#[test]
fn a_remembered_path_is_joined_where_it_is_near() {
    let path = |heading| {
        let ahead = Pose { heading, ..Pose::new(11, 13, Heading::N) };
        [(ahead, Some(Action::Forward)), (after(ahead, Action::Forward).unwrap(), None)]
    };
    assert_eq!(Ask::at(HERE).remembering(&path(Heading::N)).action(), Action::Forward);
    let beside = Pose::new(11, 12, Heading::N);
    let path = [(beside, Some(Action::Forward)), (Pose::new(11, 13, Heading::N), None)];
    let ask = Ask::at(HERE).remembering(&path);
    assert_eq!(ask.action(), Action::Right);
}

#[test]
fn what_failed_is_not_tried_again_and_again() {
    let path = [(HERE, Some(Action::Forward)), (Pose::new(10, 13, Heading::N), None)];
    let hit = (HERE, Action::Forward, Feedback::Blocked);
    for times in 1..=6 {
        let ask = Ask::at(HERE).after(&vec![hit; times]).remembering(&path);
        assert_ne!(ask.action(), Action::Forward);
    }
}

#[test]
fn what_is_asked_for_and_in_sight_is_walked_to() {
    // The cones stand on the east side: the nearest way to "cones 14" is two rows up, one column over.
    let to_the_cone = Ask::at(HERE).for_the("Find a cones 14.");
    assert_eq!(to_the_cone.action(), Action::Forward);
    let beside = Ask::at(Pose::new(10, 14, Heading::S))
        .after(&[(Pose::new(10, 14, Heading::N), Action::TurnAround, Feedback::Turned)])
        .for_the("Find a barrels 16.");
    assert_eq!(beside.action(), Action::Backward, "seen before turning, remembered by the window");
    let nearest = Ask::at(HERE).for_the("Find any item of the category cones.");
    assert_eq!(nearest.action(), Action::Forward);
}

#[test]
fn orders_are_kept_as_far_as_the_window_tells() {
    let to_the_barrel = [
        (Pose::new(11, 11, Heading::N), Action::Forward, Feedback::Moved),
        (Pose::new(11, 12, Heading::N), Action::Forward, Feedback::Moved),
        (Pose::new(11, 13, Heading::N), Action::Left, Feedback::Moved),
    ];
    let here = Pose::new(10, 13, Heading::N);
    let on_barrel_13 = |instruction| Ask::at(here).after(&to_the_barrel).for_the(instruction);
    let then = "Visit a barrels 13, then a cones 15.";
    assert_eq!(on_barrel_13(then).action(), Action::Forward);
    let back = "Find a barrels 13, then return to the cell where you started.";
    assert_eq!(Ask { step: 3, ..on_barrel_13(back) }.action(), Action::Right);
    let any = "Visit a cones 14 and a barrels 13, in any order.";
    assert_eq!(on_barrel_13(any).action(), Action::Forward);
    let revisit = "Find a cones 13, then visit a barrels 13, then go back to the same cones 13.";
    assert_eq!(on_barrel_13(revisit).action(), Action::Right);
    let every = "Visit every item of the category barrels in the warehouse.";
    assert_eq!(on_barrel_13(every).action(), Action::Forward, "not the one stood on");
}

/// North along the aisle from (10, 11), then a look to the west.
fn demonstration() -> Vec<(Pose, Option<Action>)> {
    let ahead = (11..15).map(|y| (Pose::new(10, y, Heading::N), Some(Action::Forward)));
    let end = Pose::new(10, 15, Heading::N);
    let looks = [(end, Some(Action::TurnLeft)), (Pose { heading: Heading::W, ..end }, None)];
    ahead.chain(looks).collect()
}

#[test]
fn a_whole_demonstration_is_followed_where_it_is_recognised() {
    for (pose, action) in demonstration() {
        if let Some(action) = action {
            assert_eq!(Ask::at(pose).shown(&demonstration()).action(), action, "at {pose}");
        }
    }
    let elsewhere: Vec<_> = demonstration()
        .into_iter()
        .map(|(pose, action)| (Pose::new(11, 12, pose.heading.opposite()), action))
        .collect();
    assert_eq!(Ask::at(HERE).shown(&elsewhere).action(), Ask::at(HERE).action());
}

#[test]
fn a_demonstration_recognised_nearby_is_joined() {
    let ask = Ask::at(Pose::new(11, 12, Heading::N)).for_the("Visit a cones 11, then a cones 15.");
    let joined = ask.shown(&demonstration()).action();
    assert_eq!(joined, Action::Left);
}

#[test]
fn the_hint_is_believed_unless_what_is_seen_speaks_against_it() {
    // Only the last views are keyframes in effect: the first shows another place.
    let start = Pose::new(10, 11, Heading::S);
    let walk = [(start, Some(Action::TurnAround)), (Pose::new(10, 11, Heading::N), None)];
    let at_start = |hint| Ask { hint, step: 0, ..Ask::at(start).shown(&walk) };
    assert_eq!(at_start(true).action(), Action::TurnAround);
    let elsewhere =
        Ask { hint: true, step: 0, ..Ask::at(Pose::new(10, 16, Heading::N)).shown(&walk) };
    let unaided =
        Ask { hint: false, step: 0, ..Ask::at(Pose::new(10, 16, Heading::N)).shown(&walk) };
    assert_eq!(elsewhere.action(), unaided.action());
}

#[test]
fn what_a_document_tells_is_walked_to_over_what_it_calls_floor() {
    let text =
        "## Items\n- fork lift: stand at (10, 22) facing N\n## Passages\n- column 10: rows 10-30\n";
    assert_eq!(Ask::at(HERE).told(text).action(), Action::Forward);
    let south = text.replace("(10, 22)", "(10, 10)");
    assert_eq!(Ask::at(HERE).told(&south).action(), Action::Backward, "too near for a turn");
    let far = text.replace("(10, 22)", "(10, 4)");
    assert_eq!(Ask::at(HERE).told(&far).action(), Action::TurnAround);
    let around = "- fork lift: stand at (13, 12)\n- column 10: rows 10-15\nrow 15: columns 10-13\n\
                  column 13: rows 12-15 are passages";
    let around = format!("## Passages\n{around}");
    assert_eq!(Ask::at(HERE).told(&around).action(), Action::Forward, "nothing but racks between");
}

#[test]
fn a_way_told_is_left_where_it_is_blocked() {
    let text =
        "- fork lift: stand at (10, 22) facing N\n## Passages\n- columns 10-11: rows 10-30\n";
    let hit = (HERE, Action::Forward, Feedback::Blocked);
    assert_eq!(Ask::at(HERE).after(&[hit]).told(text).action(), Action::Right);
}

#[test]
fn where_a_kind_stands_is_gone_to_and_looked_at() {
    let text = "## Layout\n- corridor: columns 10-11, rows 4-30\n## Where\n- fork lifts: columns 9-12, rows 24-27; seen there: fork lift\n";
    assert_eq!(Ask::at(HERE).told(text).action(), Action::Forward);
    let turned = Ask::at(Pose { heading: Heading::S, ..HERE }).told(text);
    assert_eq!(turned.action(), Action::TurnAround);
}

#[test]
fn a_route_for_the_same_task_is_followed() {
    let text = "- \"Visit a fork lift, then a truck.\" from (10, 11) facing N: north 3 to (10, 14), east 1 to (11, 14); reached fork lift at (11, 14).";
    let on_it = |x, y, heading| {
        Ask::at(Pose::new(x, y, heading))
            .for_the("Visit a fork lift, then a truck.")
            .told(text)
            .action()
    };
    assert_eq!(on_it(10, 12, Heading::N), Action::Forward);
    assert_eq!(on_it(10, 14, Heading::N), Action::TurnRight);
    assert_eq!(on_it(10, 14, Heading::E), Action::Forward);
}

fn pose() -> impl Strategy<Value = Pose> {
    (9..13_u8, 9..21_u8, 0..4_usize).prop_map(|(x, y, h)| Pose::new(x, y, Heading::ALL[h]))
}

fn any_action() -> impl Strategy<Value = Action> {
    prop::sample::select(&Action::ALL[..])
}

fn feedback() -> impl Strategy<Value = Feedback> {
    prop::sample::select(&Feedback::ALL[..])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_request_has_an_answer_and_only_one(
        here in pose(),
        past in prop::collection::vec((pose(), any_action(), feedback()), 0..7),
        remembered in prop::collection::vec((pose(), prop::option::of(any_action())), 0..8),
        step in 0..200_u32,
        seed: u64,
        instruction in prop::sample::select(vec![
            "", "Find any item of the category cones.", "Visit a barrels 13, then a cones 15.",
        ]),
    ) {
        let ask = Ask::at(here).for_the(instruction).after(&past).remembering(&remembered);
        let ask = Ask { step, seed, ..ask };
        ask.action();
    }

    #[test]
    fn rubbish_in_frames_and_edges_of_the_grid_have_an_answer(
        pixels in prop::collection::vec(any::<u8>(), 32 * 32 * 4),
        x: u8, y: u8, heading in 0..4_usize,
        past in prop::collection::vec((any_action(), feedback()), 0..7),
        actions in prop::collection::vec(prop::option::of(any_action()), 1..8),
    ) {
        let texture = Picture::background(64, 3);
        let noise = FrameView { id: 2, width: 32, height: 32, pixels: &pixels, ..FrameView::NONE };
        for frame in [view(&texture, 1), noise] {
            let window: Vec<_> = past
                .iter()
                .map(|&(action, feedback)| PastView { frame, action: Some(action), feedback })
                .collect();
            let steps: Vec<_> =
                actions.iter().map(|&action| SegmentView { frame, action }).collect();
            let request = Request {
                lane: 0,
                step: window.len() as u32,
                episode: 1,
                repeat: 1,
                episode_seed: 7,
                instruction: "Find a blue barrel, then return to the cell where you started.",
                pose: Pose::new(x, y, Heading::ALL[heading]),
                feedback: Feedback::Moved,
                frame,
                window: &window,
                segment: Some(Segment { distance: f32::NAN, steps: &steps }),
                documents: &[],
                trajectories: &[],
                starts_as_demonstrated: false,
            };
            action(&request, &mut Mind::default());
        }
    }
}

#[test]
fn a_walk_that_is_not_kept_still_counts_in_what_courses_are_made_from() {
    // Both walks are recognised; the first one alone passes what is wanted. What the second one shows is
    // known all the same, so a course made with it is another than one made without.
    let aisle = Aisle::new();
    let here = Pose::new(11, 12, Heading::N);
    let walk = |x| [Pose::new(x, 12, Heading::N), Pose::new(x, 13, Heading::N)];
    let pictures = [walk(11), walk(10)].map(|walk| walk.map(|pose| aisle.picture(pose)));
    let steps = [1, 3].map(|id| id..).into_iter().zip(&pictures).map(|(ids, pictures)| {
        let frames = ids.zip(pictures).map(|(id, picture)| Some(view(picture, id)));
        let actions = [Some(Action::Forward), None];
        let step = |(frame, action)| TrajectoryView { frame, action };
        frames.zip(actions).map(step).collect::<Vec<_>>()
    });
    let steps: Vec<_> = steps.collect();
    let trajectories: Vec<_> = steps.iter().map(|steps| Trajectory { steps }).collect();
    let request = Request {
        lane: 0,
        step: 20,
        episode: 1,
        repeat: 1,
        episode_seed: 1,
        instruction: "Find a cones 13.",
        pose: here,
        feedback: Feedback::Moved,
        frame: view(&pictures[0][0], 9),
        window: &[],
        segment: None,
        documents: &[],
        trajectories: &trajectories,
        starts_as_demonstrated: false,
    };
    let mut mind = Mind::default();
    let mut source = |request: Request<'_>| {
        let (history, goal) = (History::of(&request), Goal::parse(request.instruction));
        let scene = Scene::of(&request, &history, goal.as_ref(), &mut mind);
        assert_eq!(scene.kept, [0]);
        let situation = Situation::new(&request, &history, &scene, goal.as_ref());
        (scene.lasting.walks.len(), situation.source(Plan::Walk(0)))
    };
    let (both, with) = source(request);
    let (one, without) = source(Request { trajectories: &trajectories[..1], ..request });
    assert_eq!((both, one), (2, 1));
    assert_ne!(with, without);
}
