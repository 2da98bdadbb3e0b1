//! The choice of keyframes: examples by hand, and properties.

use case_book::Moment;
use domain::{Action, Feedback, Heading, Pose};
use proptest::prelude::*;

use super::super::testing::{build, demonstration, recall, turns};
use super::*;
use crate::bank::{BankSteps, MemoryBank};
use crate::demonstrations::{RememberedDemonstration, ViewId};

/// A demonstration that takes `actions`, completing a sub-goal at each of `goals`; pose `t` is unlike any other.
fn acted(actions: &str, goals: &[usize]) -> RememberedDemonstration {
    let actions: Vec<Action> = actions.chars().filter_map(Action::from_letter).collect();
    let steps = 0..=actions.len();
    RememberedDemonstration {
        case: 0,
        number: 0,
        views: (0..=actions.len() as u32)
            .map(|step| ViewId { sequence: 0, number: 0, step })
            .collect(),
        instruction: String::new(),
        feedback: steps.clone().map(|_| Feedback::Moved.into()).collect(),
        states: steps.clone().map(|t| Pose::new(t as u8, 0, Heading::N).into()).collect(),
        stages: steps.map(|t| goals.iter().filter(|&&goal| goal <= t).count() as u32).collect(),
        actions: actions.into_iter().map(|action| Some(action.into())).collect(),
    }
}

/// The steps of `share` keyframes.
fn chosen(demonstration: &RememberedDemonstration, share: usize) -> Vec<usize> {
    let bank = MemoryBank::new(vec![demonstration.clone()]);
    keyframes(&BankSteps::without_views(&bank).demonstrations()[0], share, &turns())
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
        assert_eq!(chosen(&demonstration, share), expected, "a share of {share}");
    }
    assert_eq!(
        chosen(&acted("", &[0]), 40),
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

/// The keyframes of each demonstration.
fn supplied(demonstrations: &[RememberedDemonstration], keyframes: usize) -> Vec<Vec<u32>> {
    let mut memory = FullContext::new(keyframes, turns());
    build(&mut memory, demonstrations).unwrap();
    let items = recall(&mut memory, None, 3).unwrap();
    let shown = items.into_iter().zip(0..).map(|(item, number)| match item {
        MemoryItem::Steps {
            source,
            views: Views::Keyframes(shown),
            actions: true,
            distance: None,
        } => {
            let count = demonstrations[number as usize].states.len() as u32;
            assert_eq!(source, Source { demonstration: number, first: 0, count });
            shown
        }
        other => panic!("{other:?}"),
    });
    shown.collect()
}

#[test]
fn a_view_seen_twice_may_be_shown_twice() {
    let shown = supplied(&[demonstration(0, 5, 9), demonstration(3, 7, 4)], 40);
    assert_eq!(shown, [(0..10).collect::<Vec<_>>(), (0..5).collect()]);
}

proptest! {
    #[test]
    fn the_rule_holds_for_any_demonstrations(
        demonstrations in prop::collection::vec(
            ("[fblrLRU]{0,120}", prop::collection::btree_set(0..121_usize, 0..9)), 0..6
        ),
        budget in 0..60_usize,
    ) {
        let demonstrations: Vec<RememberedDemonstration> = demonstrations
            .iter()
            .map(|(actions, goals)| acted(actions, &goals.iter().copied().collect::<Vec<_>>()))
            .collect();
        let shown = supplied(&demonstrations, budget);
        let all: usize = demonstrations.iter().map(|demonstration| demonstration.states.len()).sum();
        let shares: Vec<usize> = shown.iter().map(Vec::len).collect();
        prop_assert_eq!(shares.iter().sum::<usize>(), budget.min(all), "the whole budget, and never more");
        let bank = MemoryBank::new(demonstrations.clone());
        let steps = BankSteps::without_views(&bank);
        for (number, demonstration) in steps.demonstrations().iter().enumerate() {
            let length = demonstration.steps.len();
            let is_kept = |step: usize| shown[number].contains(&(step as u32));
            prop_assert!(shown[number].is_sorted_by(|a, b| a < b));
            if budget >= 2 * demonstrations.len() {
                prop_assert!(is_kept(0) && is_kept(length - 1));
            }
            // A moment is kept only if all more important moments are.
            let moments = |kept: bool| {
                let these = (0..length).filter(move |&step| is_kept(step) == kept);
                let is_turn = |step: usize| {
                    demonstration.steps[step].action.is_some_and(|action| turns().contains(&action))
                };
                these.map(move |step| Moment::of(demonstration.stages, step, is_turn))
            };
            if let (Some(least), Some(most)) = (moments(true).max(), moments(false).min()) {
                prop_assert!(least <= most);
            }
            // A smaller share is the whole demonstration. Other shares differ by one at most; earlier ones are larger.
            for (other, theirs) in shares.iter().enumerate() {
                let mine = shares[number];
                let fair = theirs + usize::from(number < other);
                prop_assert!(mine <= fair || *theirs == demonstrations[other].states.len());
            }
        }
    }
}
