use std::fs;

use domain::{Action, Feedback, Heading, Pose};
use peer::memory::EpisodeEnd;
use search::Embedding;

use super::super::testing::{build_with_views, demonstration, settings};
use super::*;
use crate::bank::KnownView;
use crate::demonstrations;

const TASK: &str = "Find a cone.";

/// Every cell has its own view, an angle that grows with the row; `turned` turns it further.
fn angle(pose: Pose, turned: f32) -> Vec<f32> {
    let angle = f32::from(pose.cell.y) / 4.0 + f32::from(pose.cell.x) + turned;
    Embedding::normalised(&[angle.cos(), angle.sin()]).unwrap().as_slice().to_vec()
}

fn at(x: u8, y: u8) -> Pose {
    Pose::new(x, y, Heading::N)
}

/// A memory of demonstrations north along column 3, each from a row for some steps, of [`TASK`].
fn memory(routes: &[(u8, u8)]) -> Adaptive {
    let demonstrations: Vec<demonstrations::RememberedDemonstration> =
        routes.iter().map(|&(from, steps)| demonstration(0, from, steps)).collect();
    let view = |pose: Pose| KnownView {
        frame: 1,
        content: [pose.cell.y; 16],
        embedding: Embedding::normalised(&angle(pose, 0.0)),
    };
    build_with_views(Adaptive::new, &settings(), &demonstrations, view)
}

/// A step of an episode: pose, action that led there, feedback, and how much the view differs.
type Seen = (Pose, Option<Action>, Feedback, f32);

fn north(from: u8, to: u8) -> Vec<Seen> {
    let moved = |y| (at(3, y), Some(Action::Forward), Feedback::Moved, 0.0);
    let start = (at(3, from), None, Feedback::Start, 0.0);
    std::iter::once(start).chain((from + 1..=to).map(moved)).collect()
}

fn step<'a>(number: usize, seen: &Seen, embedding: Option<&'a [f32]>) -> Step<'a> {
    let &(pose, last_action, feedback, _) = seen;
    Step {
        lane: 0,
        episode: 9,
        step: number as u32,
        state: pose.into(),
        last_action: last_action.map(Action::into),
        feedback: feedback.into(),
        frame: None,
        embedding,
        pinned: None,
    }
}

/// An episode of [`TASK`].
fn episode(learns: bool) -> Episode<'static> {
    Episode {
        lane: 0,
        episode: 9,
        instruction: TASK,
        seed: 1,
        repeat: 1,
        image_budget: 60,
        text_budget: 0,
        learns,
    }
}

/// Lives through an episode. The last step has no view.
fn live(memory: &mut Adaptive, number: u32, seen: &[Seen], success: Option<bool>) {
    memory.begin_episode(&episode(true)).unwrap();
    for (number, step_of) in seen.iter().enumerate() {
        let view = angle(step_of.0, step_of.3);
        let view = (number + 1 < seen.len()).then_some(&*view);
        memory.observe(&step(number, step_of, view)).unwrap();
    }
    let end =
        EpisodeEnd { lane: 0, episode: 9, demonstration: Some(number), success, sub_goals: None };
    memory.end_episode(&end).unwrap();
}

/// Number, first step and number of steps that are supplied at a pose after some steps.
fn supplied(memory: &mut Adaptive, pose: Pose, elapsed: usize, task: &str) -> (u32, u32, u32) {
    let view = angle(pose, 0.0);
    let now = step(elapsed, &(pose, None, Feedback::Start, 0.0), Some(&view));
    let query = Query { now, instruction: task, window: &[], image_budget: 60, text_budget: 0 };
    match &memory.recall(&query).unwrap()[..] {
        [MemoryItem::Steps { source, .. }] => (source.demonstration, source.first, source.count),
        [] => (u32::MAX, 0, 0),
        other => panic!("{other:?}"),
    }
}

fn cuts(memory: &Adaptive) -> Vec<(u32, usize)> {
    let all = memory.trajectories.iter().flat_map(|of| {
        let steps = of.steps.iter().enumerate().filter(|(_, step)| step.is_cut);
        steps.map(|(at, _)| (of.number, at))
    });
    all.collect()
}

#[test]
fn a_task_is_recalled_from_its_own_trajectories_if_it_has_any() {
    let mut memory = memory(&[(5, 9), (7, 9)]);
    memory.trajectories[1].instruction = "Find a barrel.".to_owned();
    assert_eq!(supplied(&mut memory, at(3, 8), 1, "Find a barrel."), (1, 1, 7));
    assert_eq!(supplied(&mut memory, at(3, 8), 1, TASK), (0, 3, 7));
    assert_eq!(supplied(&mut memory, at(3, 16), 0, TASK), (0, 9, 1), "nothing after its end");
    assert_eq!(supplied(&mut memory, at(3, 16), 0, "Find a tyre."), (1, 9, 1), "any other");
}

#[test]
fn what_follows_as_predicted_is_verified_and_what_does_not_is_cut() {
    for (last, expected) in [
        // Blocked where the demonstration went on; another view; another pose.
        ((at(3, 8), Some(Action::Forward), Feedback::Blocked, 0.0), vec![(0, 3)]),
        ((at(3, 9), Some(Action::Forward), Feedback::Moved, 0.5), vec![(0, 3)]),
        ((at(4, 9), Some(Action::Forward), Feedback::Moved, 0.0), vec![(0, 3)]),
        // A view that has changed a little; another action.
        ((at(3, 9), Some(Action::Forward), Feedback::Moved, 0.2), vec![]),
        ((at(3, 8), Some(Action::Left), Feedback::Blocked, 0.0), vec![]),
        ((at(3, 8), None, Feedback::NotUnderstood, 0.0), vec![]),
    ] {
        let mut memory = memory(&[(5, 9)]);
        let mut seen = north(5, 8);
        let turned = (last.0, Some(Action::TurnAround), Feedback::Turned, last.3);
        seen.extend([last, turned]);
        live(&mut memory, 1, &seen, None);
        assert_eq!(cuts(&memory), expected, "{last:?}");
        // The continuation is supplied up to the cut, not from it, and again behind it.
        if !expected.is_empty() {
            assert_eq!(supplied(&mut memory, at(3, 6), 1, TASK), (0, 1, 3));
            assert_ne!(supplied(&mut memory, at(3, 8), 3, TASK).1, 3);
            assert_eq!(supplied(&mut memory, at(3, 9), 4, TASK), (0, 4, 6));
            // Verified again, it is back.
            live(&mut memory, 2, &north(5, 10), None);
            assert_eq!(cuts(&memory), []);
            assert_eq!(supplied(&mut memory, at(3, 8), 3, TASK), (0, 3, 7));
        }
    }
}

#[test]
fn a_success_is_stored_once_and_preferred() {
    let mut memory = memory(&[(5, 9), (5, 9)]);
    assert_eq!(supplied(&mut memory, at(3, 6), 1, TASK), (0, 1, 7));
    // Sideways at row 8, and on in column 4.
    let mut seen = north(5, 8);
    seen.push((at(4, 8), Some(Action::Right), Feedback::Moved, 0.0));
    seen.push((at(4, 9), Some(Action::Forward), Feedback::Moved, 0.0));
    for (success, stored) in [(None, 2), (Some(false), 2), (Some(true), 3)] {
        live(&mut memory, 2, &seen, success);
        assert_eq!(memory.trajectories.len(), stored, "{success:?}");
    }
    let confirmed = |memory: &Adaptive| -> Vec<u32> {
        memory.trajectories.iter().map(|of| of.confirmed).collect()
    };
    assert_eq!(confirmed(&memory), [3, 3, 3], "they were verified on the way");
    assert_eq!(supplied(&mut memory, at(3, 6), 1, TASK), (2, 1, 5), "to its end");
    assert_eq!(supplied(&mut memory, at(3, 11), 6, TASK).0, 0, "where it has not been");
    live(&mut memory, 3, &seen, Some(true));
    assert_eq!(confirmed(&memory), [4, 4, 4], "the same path is stored once");
    assert_eq!(memory.trajectories[2].steps[1].stage, None, "nothing is told of sub-goals");
}

#[test]
fn a_trajectory_with_a_cut_ahead_comes_after_one_without() {
    let mut memory = memory(&[(5, 9), (5, 9)]);
    memory.trajectories[0].steps[7].is_cut = true;
    assert_eq!(supplied(&mut memory, at(3, 6), 1, TASK), (1, 1, 7));
    assert_eq!(supplied(&mut memory, at(3, 13), 8, TASK).0, 0, "behind the cut");
}

#[test]
fn steps_of_its_own_that_change_no_pose_are_not_supplied() {
    for is_told in [true, false] {
        let mut memory = memory(&[(30, 2)]);
        let mut seen = north(5, 8);
        seen.push((at(3, 8), Some(Action::Left), Feedback::Blocked, 0.0));
        seen.push((at(3, 9), Some(Action::Forward), Feedback::Moved, 0.0));
        seen.push((at(3, 10), Some(Action::Forward), Feedback::Moved, 0.0));
        if !is_told {
            seen.iter_mut().for_each(|seen| seen.2 = Feedback::Start);
        }
        live(&mut memory, 1, &seen, Some(true));
        assert_eq!(supplied(&mut memory, at(3, 7), 2, TASK), (1, 2, 2));
        assert_eq!(supplied(&mut memory, at(3, 8), 3, TASK), (1, 4, 3));
    }
}

#[test]
fn the_oldest_unconfirmed_trajectories_are_dropped_first() {
    let mut memory = memory(&[(5, 9), (20, 9), (40, 9)]);
    memory.budget = 25;
    live(&mut memory, 3, &north(5, 10), Some(true));
    let numbers: Vec<u32> = memory.trajectories.iter().map(|of| of.number).collect();
    assert_eq!(numbers, [0, 3], "the first was confirmed by the episode");
    live(&mut memory, 4, &north(60, 75), Some(true));
    let numbers: Vec<u32> = memory.trajectories.iter().map(|of| of.number).collect();
    assert_eq!(numbers, [3, 4]);
    let steps: usize = memory.trajectories.iter().map(|of| of.steps.len()).sum();
    assert!(steps <= 25);
    assert_eq!(supplied(&mut memory, at(3, 61), 1, TASK).0, 4);
}

#[test]
fn a_memory_that_is_loaded_is_the_one_that_was_saved() {
    let routes = [(5, 9), (20, 9), (40, 9)];
    let mut lived = memory(&routes);
    lived.budget = 40;
    live(&mut lived, 3, &north(5, 10), Some(true));
    let mut blocked = north(20, 25);
    blocked.push((at(3, 25), Some(Action::Forward), Feedback::Blocked, 0.0));
    blocked.push((at(3, 25), Some(Action::TurnLeft), Feedback::Turned, 0.0));
    live(&mut lived, 4, &blocked, Some(false));
    assert!(!cuts(&lived).is_empty());
    let folder = tempfile::tempdir().unwrap();
    lived.save(folder.path()).unwrap();
    let mut loaded = memory(&routes);
    loaded.budget = 40;
    loaded.load(folder.path()).unwrap();
    assert_eq!(loaded.trajectories, lived.trajectories);
    assert_eq!((loaded.episodes, loaded.store_bytes()), (lived.episodes, lived.store_bytes()));
    for memory in [&mut lived, &mut loaded] {
        live(memory, 5, &north(20, 27), Some(true));
    }
    assert_eq!(loaded.trajectories, lived.trajectories);
    for row in 0..60 {
        let of = |memory: &mut Adaptive| supplied(memory, at(3, row), 2, TASK);
        assert_eq!(of(&mut loaded), of(&mut lived));
    }
    fs::write(folder.path().join(VIEWS_FILE), [0; 3]).unwrap();
    assert!(memory(&routes).load(folder.path()).is_err());
}

#[test]
fn an_episode_that_is_not_learned_from_changes_nothing() {
    let mut memory = memory(&[(5, 9)]);
    let before = memory.trajectories.clone();
    memory.begin_episode(&episode(false)).unwrap();
    supplied(&mut memory, at(3, 6), 1, TASK);
    memory.observe(&step(0, &north(5, 6)[0], Some(&angle(at(3, 5), 0.0)))).unwrap();
    memory.end_episode(&EpisodeEnd::unlearned(0, 9)).unwrap();
    assert!(memory.trajectories == before && memory.episodes == 0 && memory.running.is_empty());
}
