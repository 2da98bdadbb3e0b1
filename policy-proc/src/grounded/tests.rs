//! The policy's decisions in painted aisles.

use std::sync::Arc;

use conformance::messages::scripted_world;
use domain::{Action, Feedback, Heading, Pose};
use peer::{
    CaptionedView, Decision, DocumentKind, FrameView, Item, PastView, Policy, Request, StepView,
    StepsView, TextView,
};
use plates::painter::{PlateAisle, PlateImage};
use proptest::prelude::*;

use super::Grounded;
use super::geometry::after;
use super::testing::{blank_frame, content_hash, frame, paint_barricade, square_frame};

/// A request under construction, whose frames are painted views of the aisle.
#[derive(Default)]
struct Ask {
    instruction: String,
    step: u32,
    seed: u64,
    pose: Option<Pose>,
    /// Past steps with the poses in which they were taken.
    window: Vec<(Pose, Action, Feedback)>,
    /// The retrieved segments: poses and the expert's actions.
    segments: Vec<Vec<(Pose, Option<Action>)>>,
    /// A whole demonstration in which every view is a keyframe.
    demonstration: Vec<(Pose, Option<Action>)>,
    texts: Vec<(DocumentKind, String)>,
    /// Where a captioned view was taken.
    captioned: Option<Pose>,
    is_blank: bool,
    is_elsewhere: bool,
    /// Where a barricade is in the current view, as (cells ahead, cells to the right).
    barricade: Option<(i8, i8)>,
}

impl Ask {
    fn at(pose: Pose) -> Self {
        let instruction = "Find a fork lift.".to_owned();
        Self { instruction, step: 20, seed: 1, pose: Some(pose), ..Self::default() }
    }

    fn to(self, instruction: &str) -> Self {
        Self { instruction: instruction.to_owned(), ..self }
    }

    fn after(self, window: &[(Pose, Action, Feedback)]) -> Self {
        Self { window: window.to_vec(), ..self }
    }

    fn with_segment(mut self, segment: &[(Pose, Option<Action>)]) -> Self {
        self.segments.push(segment.to_vec());
        self
    }

    fn with_document(self, document: &str) -> Self {
        self.with_text(DocumentKind::Summary, document)
    }

    fn with_text(mut self, kind: DocumentKind, text: &str) -> Self {
        self.texts.push((kind, text.to_owned()));
        self
    }

    fn with_demonstration(self, demonstration: &[(Pose, Option<Action>)]) -> Self {
        Self { demonstration: demonstration.to_vec(), ..self }
    }

    /// The decision, which must not depend on the ids of the frames.
    fn action(&self) -> Action {
        let first = self.action_with_ids(1);
        assert_eq!(first, self.action_with_ids(1000));
        first
    }

    fn action_with_ids(&self, first_id: u64) -> Action {
        let aisle = PlateAisle::new();
        let pose = self.pose.unwrap();
        let remembered = self.segments.iter().flatten().chain(&self.demonstration);
        let poses = self.window.iter().map(|past| past.0);
        let poses = poses.chain(remembered.map(|step| step.0)).chain(self.captioned);
        let pictures: Vec<_> = poses.map(|pose| aisle.picture(pose)).collect();
        let mut frames = (first_id..).zip(&pictures).map(|(id, picture)| frame(picture, id));
        let mut next = || frames.next().unwrap();
        let mut current = aisle.picture(pose).pixels().to_vec();
        if let Some(cell) = self.barricade {
            paint_barricade(&mut current, cell);
        }

        let window = self.window.iter().map(|&(_, action, feedback)| PastView {
            frame: next(),
            action: Some(action.into()),
            feedback: feedback.into(),
        });
        let window: Vec<_> = window.collect();
        let mut supplied = |steps: &Vec<(Pose, Option<Action>)>| -> Vec<_> {
            let step = |&(_, action): &(Pose, Option<Action>)| StepView {
                frame: Some(next()),
                action: action.map(Action::into),
            };
            steps.iter().map(step).collect()
        };
        let segments: Vec<_> = self.segments.iter().map(&mut supplied).collect();
        let demonstration = supplied(&self.demonstration);
        let mut items = Vec::new();
        for steps in &segments {
            items.push(Item::Steps(StepsView { distance: Some(0.0), is_whole: false, steps }));
        }
        if !demonstration.is_empty() {
            let steps = &demonstration;
            items.push(Item::Steps(StepsView { distance: None, is_whole: true, steps }));
        }
        if self.captioned.is_some() {
            items.push(Item::Frame(CaptionedView { frame: next(), caption: "" }));
        }
        for (id, (kind, text)) in (first_id..).zip(&self.texts) {
            items.push(Item::Text(TextView { id: id.into(), kind: *kind, text }));
        }
        act(&Request {
            lane: 0,
            step: self.step,
            episode: 1,
            repeat: 1,
            episode_seed: self.seed,
            instruction: &self.instruction,
            state: pose.into(),
            feedback: window.last().map_or(Feedback::Start.into(), |past| past.feedback),
            frame: if self.is_blank {
                blank_frame(first_id + 500)
            } else {
                square_frame(&current, first_id + 400)
            },
            window: &window,
            items: &items,
            starts_as_demonstrated: false,
            demonstrated_elsewhere: self.is_elsewhere,
            world: &Arc::new(scripted_world()),
        })
    }
}

/// The decision of a new policy.
fn act(request: &Request<'_>) -> Action {
    let decisions = Grounded::default().act(std::slice::from_ref(request));
    let [Decision { answer, .. }] = decisions[..] else { panic!("{decisions:?}") };
    answer.action().unwrap().try_into().unwrap()
}

const HERE: Pose = Pose::new(10, 12, Heading::N);

#[test]
fn a_segment_that_fits_is_followed() {
    for expert in Action::ALL {
        let there = after(HERE, expert).unwrap();
        let ask = Ask::at(HERE).with_segment(&[(HERE, Some(expert)), (there, None)]);
        assert_eq!(ask.action(), expert);
    }
}

#[test]
fn actions_between_images_alone_are_inferred() {
    let there = Pose::new(11, 12, Heading::N);
    let ask = Ask::at(HERE).with_segment(&[(HERE, None), (there, None)]);
    assert_eq!(ask.action(), Action::Right);
}

#[test]
fn a_segment_from_elsewhere_is_not_followed() {
    let elsewhere = Pose::new(10, 18, Heading::N);
    let explored = Ask::at(HERE).action();
    for expert in Action::ALL {
        let ask = Ask::at(HERE).with_segment(&[(elsewhere, Some(expert)), (elsewhere, None)]);
        assert_eq!(ask.action(), explored);
    }
}

#[test]
fn a_memory_of_another_warehouse_is_left_out() {
    let explored = Ask::at(HERE).to("Find a blue barrel.").action();
    let document = "- blue barrel: stand at (10, 5), facing west";
    for expert in Action::ALL {
        let steps = [(HERE, Some(expert)), (after(HERE, expert).unwrap(), None)];
        let ask = Ask::at(HERE).to("Find a blue barrel.").with_document(document);
        let ask = ask.with_segment(&steps).with_demonstration(&steps);
        assert_eq!(ask.action(), expert);
        assert_eq!(Ask { is_elsewhere: true, ..ask }.action(), explored);
    }
}

#[test]
fn the_agent_turns_on_the_spot_when_it_sees_nothing() {
    let ask = Ask::at(HERE).with_segment(&[(HERE, Some(Action::Forward)), (HERE, None)]);
    assert_eq!(Ask { is_blank: true, ..ask }.action(), Action::TurnRight);
}

#[test]
fn a_segment_is_joined_where_it_is_near() {
    let ahead = Pose::new(11, 13, Heading::N);
    let segment = [(ahead, Some(Action::Forward)), (Pose::new(11, 14, Heading::N), None)];
    assert_eq!(Ask::at(HERE).with_segment(&segment).action(), Action::Forward);
    let beside = Pose::new(11, 12, Heading::N);
    let segment = [(beside, Some(Action::Forward)), (Pose::new(11, 13, Heading::N), None)];
    assert_eq!(Ask::at(HERE).with_segment(&segment).action(), Action::Right);
}

#[test]
fn of_several_segments_the_first_that_fits_is_followed() {
    let elsewhere = [(Pose::new(10, 18, Heading::N), Some(Action::Backward))];
    let here = |action| [(HERE, Some(action)), (after(HERE, action).unwrap(), None)];
    let ask = Ask::at(HERE).with_segment(&elsewhere).with_segment(&here(Action::TurnLeft));
    assert_eq!(ask.with_segment(&here(Action::Right)).action(), Action::TurnLeft);
}

#[test]
fn a_blocked_move_is_not_repeated() {
    let segment = [(HERE, Some(Action::Forward)), (Pose::new(10, 13, Heading::N), None)];
    let blocked = (HERE, Action::Forward, Feedback::Blocked);
    for times in 1..=6 {
        let ask = Ask::at(HERE).after(&vec![blocked; times]).with_segment(&segment);
        assert_ne!(ask.action(), Action::Forward);
    }
}

#[test]
fn a_target_in_sight_is_approached() {
    // Cones stand on the east side: "cones 14" is two rows up, one column to the right.
    assert_eq!(Ask::at(HERE).to("Find a cones 14.").action(), Action::Forward);
    let before_turning = (Pose::new(10, 14, Heading::N), Action::TurnAround, Feedback::Turned);
    let behind =
        Ask::at(Pose::new(10, 14, Heading::S)).after(&[before_turning]).to("Find a barrels 16.");
    assert_eq!(behind.action(), Action::Backward, "seen in the window only");
    let category = Ask::at(HERE).to("Find any item of the category cones.");
    assert_eq!(category.action(), Action::Forward);
}

#[test]
fn targets_are_visited_in_order_as_far_as_the_window_tells() {
    let to_the_barrel = [
        (Pose::new(11, 11, Heading::N), Action::Forward, Feedback::Moved),
        (Pose::new(11, 12, Heading::N), Action::Forward, Feedback::Moved),
        (Pose::new(11, 13, Heading::N), Action::Left, Feedback::Moved),
    ];
    let here = Pose::new(10, 13, Heading::N);
    let on_barrel_13 = |instruction| Ask::at(here).after(&to_the_barrel).to(instruction);
    let then = "Visit a barrels 13, then a cones 15.";
    assert_eq!(on_barrel_13(then).action(), Action::Forward);
    let back = "Find a barrels 13, then return to the cell where you started.";
    assert_eq!(Ask { step: 3, ..on_barrel_13(back) }.action(), Action::Right);
    let any = "Visit a cones 14 and a barrels 13, in any order.";
    assert_eq!(on_barrel_13(any).action(), Action::Forward);
    let revisit = "Find a cones 13, then visit a barrels 13, then go back to the same cones 13.";
    assert_eq!(on_barrel_13(revisit).action(), Action::Right);
    let every = "Visit every item of the category barrels in the warehouse.";
    assert_eq!(on_barrel_13(every).action(), Action::Forward, "to another one");
}

/// North along the aisle from (10, 11), then a turn to the west.
fn demonstration() -> Vec<(Pose, Option<Action>)> {
    let ahead = (11..15).map(|y| (Pose::new(10, y, Heading::N), Some(Action::Forward)));
    let end = Pose::new(10, 15, Heading::N);
    let turn = [(end, Some(Action::TurnLeft)), (Pose { heading: Heading::W, ..end }, None)];
    ahead.chain(turn).collect()
}

#[test]
fn a_demonstration_is_followed_where_it_is_recognised() {
    for (pose, action) in demonstration() {
        if let Some(action) = action {
            let ask = Ask::at(pose).with_demonstration(&demonstration());
            assert_eq!(ask.action(), action, "at {pose}");
        }
    }
    let elsewhere: Vec<_> = demonstration()
        .into_iter()
        .map(|(pose, action)| (Pose::new(11, 12, pose.heading.opposite()), action))
        .collect();
    let ask = Ask::at(HERE).with_demonstration(&elsewhere);
    assert_eq!(ask.action(), Ask::at(HERE).action());
}

#[test]
fn a_demonstration_nearby_is_joined() {
    let ask = Ask::at(Pose::new(11, 12, Heading::N)).to("Visit a cones 11, then a cones 15.");
    assert_eq!(ask.with_demonstration(&demonstration()).action(), Action::Left);
}

#[test]
fn a_place_that_a_document_names_is_approached_over_known_floor() {
    let text =
        "## Items\n- fork lift: stand at (10, 22) facing N\n## Passages\n- column 10: rows 1-30\n";
    assert_eq!(Ask::at(HERE).with_document(text).action(), Action::Forward);
    let south = text.replace("(10, 22)", "(10, 10)");
    let ask = Ask::at(HERE).with_document(&south);
    assert_eq!(ask.action(), Action::Backward, "too near for a turn");
    let far = text.replace("(10, 22)", "(10, 4)");
    assert_eq!(Ask::at(HERE).with_document(&far).action(), Action::TurnAround);
    let around = "## Items\n- fork lift: stand at (13, 12)\n## Passages\n- column 10: rows 10-15\n\
                  - row 15: columns 10-13\n- column 13: rows 12-15\n";
    let ask = Ask::at(HERE).with_document(around);
    assert_eq!(ask.action(), Action::Forward, "around the racks in between");
}

#[test]
fn a_note_is_read_like_a_document_and_a_captioned_view_is_perceived() {
    let text =
        "## Items\n- fork lift: stand at (10, 4) facing N\n## Passages\n- column 10: rows 1-30\n";
    let ask = Ask::at(HERE).with_text(DocumentKind::Note, text);
    assert_eq!(ask.action(), Action::TurnAround);
    // The captioned view shows the plates ahead, and a barrel on the right that the agent does not see.
    let ask = || Ask::at(Pose::new(10, 12, Heading::E)).to("Find a barrels 10.");
    let captioned = Ask { captioned: Some(Pose::new(10, 15, Heading::S)), ..ask() };
    assert_eq!(captioned.action(), Action::Right);
    assert_ne!(ask().action(), Action::Right);
}

#[test]
fn a_blocked_route_is_left() {
    let text = "- fork lift: stand at (10, 22) facing N\n## Passages\n- column 10: rows 10-30\n- column 11: rows 10-30\n";
    let blocked = (HERE, Action::Forward, Feedback::Blocked);
    assert_eq!(Ask::at(HERE).after(&[blocked]).with_document(text).action(), Action::Right);
}

#[test]
fn a_barricade_in_sight_is_avoided() {
    let text = "- fork lift: stand at (10, 22) facing N\n## Passages\n- column 10: rows 10-30\n- column 11: rows 10-30\n";
    let ask = || Ask::at(HERE).with_document(text);
    assert_eq!(ask().action(), Action::Forward);
    assert_eq!(Ask { barricade: Some((1, 0)), ..ask() }.action(), Action::Right);
    assert_eq!(Ask { barricade: Some((2, 1)), ..ask() }.action(), Action::Forward);
}

#[test]
fn a_documented_route_for_the_same_task_is_followed() {
    let text = "## \"Visit a fork lift, then a truck.\"\n\
                - start: You are in column 10, row 11, and face north.\n\
                - move forward 3, turn right, move forward\n\
                - sub-goal 1 of 2: You are in column 11, row 14, and face east.\n";
    let on_it = |x, y, heading| {
        let ask = Ask::at(Pose::new(x, y, heading)).to("Visit a fork lift, then a truck.");
        ask.with_document(text).action()
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
    fn every_request_has_one_answer(
        here in pose(),
        past in prop::collection::vec((pose(), any_action(), feedback()), 0..7),
        segment in prop::collection::vec((pose(), prop::option::of(any_action())), 0..8),
        step in 0..200_u32,
        seed: u64,
        instruction in prop::sample::select(vec![
            "", "Find any item of the category cones.", "Visit a barrels 13, then a cones 15.",
        ]),
    ) {
        let ask = Ask::at(here).to(instruction).after(&past).with_segment(&segment);
        Ask { step, seed, ..ask }.action();
    }

    #[test]
    fn noise_and_the_edges_of_the_grid_have_an_answer(
        pixels in prop::collection::vec(any::<u8>(), 32 * 32 * 4),
        x: u8, y: u8, heading in 0..4_usize,
        past in prop::collection::vec((any_action(), feedback()), 0..7),
        actions in prop::collection::vec(prop::option::of(any_action()), 1..8),
    ) {
        let texture = PlateImage::background(64, 3);
        let content_hash = content_hash(&pixels);
        let noise = FrameView { id: 2, content_hash, width: 32, height: 32, pixels: &pixels };
        for frame in [frame(&texture, 1), noise] {
            let past = past.iter();
            let window = past.map(|&(action, feedback)| PastView {
                frame,
                action: Some(action.into()),
                feedback: feedback.into(),
            });
            let window: Vec<_> = window.collect();
            let steps = actions.iter().map(|action| StepView {
                frame: Some(frame),
                action: action.map(Action::into),
            });
            let steps: Vec<_> = steps.collect();
            let segment = StepsView { distance: None, is_whole: false, steps: &steps };
            act(&Request {
                lane: 0,
                step: window.len() as u32,
                episode: 1,
                repeat: 1,
                episode_seed: 7,
                instruction: "Find a blue barrel, then return to the cell where you started.",
                state: Pose::new(x, y, Heading::ALL[heading]).into(),
                feedback: Feedback::Moved.into(),
                frame,
                window: &window,
                items: &[
                    Item::Steps(segment),
                    Item::Frame(CaptionedView { frame, caption: "noise" }),
                ],
                starts_as_demonstrated: false,
                demonstrated_elsewhere: false,
                world: &Arc::new(scripted_world()),
            });
        }
    }
}
