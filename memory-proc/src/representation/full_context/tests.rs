//! The choice of keyframes: examples by hand, and properties.

use domain::Heading;
use proptest::prelude::*;

use super::super::testing::{TestDocuments, demonstration, spec};
use super::super::{RecallQuery, StoredView};
use super::*;

/// A demonstration that takes `actions`, completing a sub-goal at each of `goals`; pose `t` is unlike any other.
fn acted(actions: &str, goals: &[usize]) -> Demonstration {
    let actions: Vec<Action> = actions.chars().filter_map(Action::from_letter).collect();
    let steps = 0..=actions.len();
    Demonstration {
        case: 0,
        number: 0,
        poses: steps.clone().map(|t| Pose::new(t as u8, 0, Heading::N)).collect(),
        stages: steps.map(|t| goals.iter().filter(|&&goal| goal <= t).count() as u32).collect(),
        actions,
    }
}

#[test]
fn a_share_goes_to_start_end_sub_goals_turns_and_then_evenly() {
    // Steps 0 to 15: sub-goals at 5 and 15, turns at 3, 6 and 12.
    let demonstration = acted("fffRffLfffffUff", &[5, 15]);
    for (share, expected) in [
        (0, vec![]),
        (1, vec![0]),
        (2, vec![0, 15]),
        (3, vec![0, 5, 15]),
        (4, vec![0, 5, 6, 15]),
        (5, vec![0, 3, 5, 12, 15]),
        (6, vec![0, 3, 5, 6, 12, 15]),
        (7, vec![0, 3, 5, 6, 9, 12, 15]),
        (8, vec![0, 3, 4, 5, 6, 11, 12, 15]),
        (16, (0..16).collect()),
        (40, (0..16).collect()),
    ] {
        assert_eq!(keyframes(&demonstration, share), expected, "a share of {share}");
    }
    assert_eq!(
        keyframes(&acted("", &[0]), 40),
        [0],
        "a demonstration of one frame consists of its start"
    );
}

#[test]
fn the_budget_is_shared_fairly() {
    for (lengths, budget, expected) in [
        (vec![], 40, vec![]),
        (vec![90], 40, vec![40]),
        (vec![90, 90, 90, 90], 40, vec![10, 10, 10, 10]),
        (vec![90, 90, 90], 40, vec![14, 13, 13]),
        (vec![5, 90, 90, 90], 40, vec![5, 12, 12, 11]),
        (vec![90, 3, 4, 90], 40, vec![17, 3, 4, 16]),
        (vec![9, 9, 9, 9], 40, vec![9, 9, 9, 9]),
        (vec![90, 90, 90, 90], 3, vec![1, 1, 1, 0]),
        (vec![90, 90], 0, vec![0, 0]),
    ] {
        assert_eq!(shares(&lengths, budget), expected, "{lengths:?} within {budget}");
    }
}

/// The published steps, and the document they are in.
fn steps(demonstrations: &[Demonstration], keyframes: usize) -> (Vec<TrajectoryStep>, usize) {
    let builder = FullContext::new(MemorySpec { keyframes, ..spec(demonstrations.to_vec()) });
    assert!(builder.poses().is_sorted_by(|a, b| a < b));
    let mut views = StoredViews::default();
    for &pose in builder.poses() {
        let frame = frame(pose);
        views.insert(pose, StoredView { frame, content: [0; 16], embedding: None });
    }
    let mut documents = TestDocuments::default();
    let memory = builder.build(&views, &mut documents).unwrap();
    let supply = memory.recall(&RecallQuery { embedding: None, stage: 0, elapsed: 3 });
    assert_eq!((supply.segment, supply.documents.as_slice()), (None, &[1][..]));
    assert_eq!(documents.published.len(), 1);
    let Some((Some((1, 7)), Content::Trajectories(steps))) = documents.published.pop() else {
        panic!("a document of trajectories for the episode")
    };
    (steps, views.len())
}

fn frame(pose: Pose) -> u64 {
    1000 * (1 + u64::from(pose.cell.y)) + u64::from(pose.cell.x)
}

#[test]
fn a_view_seen_twice_is_pinned_once_and_may_be_shown_twice() {
    let (steps, views) = steps(&[demonstration(0, 5, 9), demonstration(3, 7, 4)], 40);
    assert_eq!((steps.len(), views), (15, 10));
    assert!(steps.iter().all(|step| step.frame != NO_FRAME));
}

proptest! {
    #[test]
    fn the_rule_holds_for_any_demonstrations(
        demonstrations in prop::collection::vec(
            ("[fblrLRU]{0,120}", prop::collection::btree_set(0..121_usize, 0..9)), 0..6
        ),
        budget in 0..60_usize,
    ) {
        let demonstrations: Vec<Demonstration> = demonstrations
            .iter()
            .map(|(actions, goals)| acted(actions, &goals.iter().copied().collect::<Vec<_>>()))
            .collect();
        let (steps, _) = steps(&demonstrations, budget);
        let all: usize = demonstrations.iter().map(|demonstration| demonstration.poses.len()).sum();
        let shown = steps.iter().filter(|step| step.frame != NO_FRAME).count();
        prop_assert_eq!(shown, budget.min(all), "the whole budget, and never more");
        let chosen = steps.chunk_by(|a, b| a.trajectory == b.trajectory).collect::<Vec<_>>();
        prop_assert_eq!(chosen.len(), demonstrations.len());
        let shares: Vec<usize> = chosen
            .iter()
            .map(|steps| steps.iter().filter(|step| step.frame != NO_FRAME).count())
            .collect();
        for (number, (steps, demonstration)) in chosen.iter().zip(&demonstrations).enumerate() {
            prop_assert_eq!(usize::from(steps[0].trajectory), number);
            // Every action, in order, and none after the end.
            let actions: Vec<u8> = demonstration.actions.iter().map(|&action| action as u8).collect();
            let (last, before) = steps.split_last().unwrap();
            prop_assert_eq!(before.iter().map(|step| step.action).collect::<Vec<_>>(), actions);
            prop_assert_eq!(last.action, NO_ACTION);
            for (step, &pose) in steps.iter().zip(&demonstration.poses) {
                prop_assert!(step.frame == NO_FRAME || step.frame == frame(pose));
            }
            if budget >= 2 * demonstrations.len() {
                prop_assert!(steps[0].frame != NO_FRAME && last.frame != NO_FRAME);
            }
            // A moment is kept only if all more important moments are.
            let moments = |kept: bool| {
                let these = steps.iter().enumerate();
                these
                    .filter(move |(_, step)| (step.frame != NO_FRAME) == kept)
                    .map(|(at, _)| Moment::of(demonstration, at) as u8)
            };
            if let (Some(least), Some(most)) = (moments(true).max(), moments(false).min()) {
                prop_assert!(least <= most);
            }
            // A smaller share is the whole demonstration. Other shares differ by one at most; earlier ones are larger.
            for (other, theirs) in shares.iter().enumerate() {
                let mine = shares[number];
                let fair = theirs + usize::from(number < other);
                prop_assert!(mine <= fair || *theirs == demonstrations[other].poses.len());
            }
        }
    }
}
