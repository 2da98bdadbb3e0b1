//! What recalls name: the selected demonstrations, as they are, and nothing else; and how many images that is.

use std::collections::BTreeSet;

use domain::{
    Pose, Representation,
    Representation::{Episodic, FullContext, Hybrid, Semantic, Summary, Working},
    SegmentContent,
};
use shm_types::message::NO_ACTION;
use warehouse::{Demonstrations, Start};

use super::SETS;
use super::rig::{Answer, Rig, Walk, walks};

/// Checks one answer of an episode whose memory is made of `walks`.
fn check(answer: &Answer, representation: Representation, set: Demonstrations, walks: &[Walk]) {
    let Answer { segment, source, texts, trajectories, .. } = answer;
    let expected: &[String] = &match representation {
        Working | FullContext | Episodic => vec![],
        Summary => vec![format!("summary of {set}")],
        Semantic => vec![format!("knowledge of {set}")],
        Hybrid => vec![format!("summary of {set}"), format!("knowledge of {set}")],
    };
    assert_eq!(texts, expected);
    // A segment is a piece of the demonstration that the trace names.
    assert_eq!(segment.is_empty(), representation != Episodic);
    let &(case, number, step) = source;
    if let Some(((last_view, last_action), before)) = segment.split_last() {
        let is_source =
            |walk: &&Walk| (walk.of.case as u32, walk.of.start as u16) == (case, number);
        let walk = walks.iter().find(is_source).expect("a demonstration of the set");
        let (from, to) = (usize::from(step), usize::from(step) + before.len());
        let shown: Vec<(Pose, u8)> =
            walk.poses[from..to].iter().copied().zip(walk.actions[from..to].to_vec()).collect();
        assert_eq!(before, shown);
        assert_eq!((*last_view, *last_action), (walk.poses[to], NO_ACTION));
        assert_eq!(before.len(), (walk.poses.len() - 1 - from).min(6));
    } else {
        assert_eq!(*source, (u32::MAX, u16::MAX, u16::MAX));
    }
    // Whole trajectories are those of the set, every action, and views where they were seen.
    if representation == FullContext {
        let steps = walks.iter().zip(0..).flat_map(|(walk, number)| {
            let states = walk.poses.iter().zip(&walk.actions);
            states.map(move |(&pose, &action)| (pose, action, number))
        });
        let steps: Vec<_> = steps.collect();
        assert_eq!(trajectories.len(), steps.len());
        for (&(shown, action, number), &(pose, acted, walk)) in trajectories.iter().zip(&steps) {
            assert_eq!((action, number), (acted, walk));
            assert!(shown.is_none_or(|shown| shown == pose));
        }
    } else {
        assert!(trajectories.is_empty());
    }
}

/// SPEC section 4: test references are never memory. Every case is walked along its two references with
/// every representation and every kind of set; whatever a recall names comes from the set's demonstrations,
/// and so does whatever the simulator was asked to show for a memory.
#[test]
fn nothing_is_supplied_but_the_selected_demonstrations() {
    let mut rig = Rig::new(1, 2000);
    let cases = rig.engine.cases.cases.len();
    for case in 0..cases {
        for set in SETS {
            let walks = walks(&rig, case, set);
            let remembered: BTreeSet<Pose> =
                walks.iter().flat_map(|walk| walk.poses.iter().copied()).collect();
            for (ticket, &representation) in (1..).zip(Representation::ALL) {
                let start = if case % 2 == 0 { Start::Test } else { Start::Blocked };
                let script = rig.script(0, ticket, case as u32, start, representation);
                let script = script.remembering(set);
                rig.asked.clear();
                rig.play(&[script], std::iter::empty());
                assert!(rig.asked.is_subset(&remembered));
                for answer in std::mem::take(&mut rig.answers).into_values() {
                    check(&answer, representation, set, &walks);
                }
            }
            rig.shelf.published.clear();
        }
    }
}

/// SPEC section 5: 7, 47, 7, 7, 7 and 14 images with the standard settings, as soon as the window is full.
#[test]
fn images_of_a_request_are_those_of_the_paper() {
    let mut rig = Rig::new(1, 2000);
    let steps = |rig: &Rig, case: usize| walks(rig, case, Demonstrations::ORIGINAL)[0].poses.len();
    let case = (0..100).find(|&case| steps(&rig, case) > 50).expect("a long demonstration");
    for set in [Demonstrations::ORIGINAL, Demonstrations::ALL] {
        let most = Representation::ALL.iter().map(|&representation| {
            let script = rig.script(0, 1, case as u32, Start::Test, representation);
            rig.play(&[script.remembering(set)], std::iter::empty());
            let answers = std::mem::take(&mut rig.answers);
            let full = answers.iter().filter(|((_, step), _)| *step >= 6);
            let images: Vec<usize> = full.map(|(_, answer)| answer.images()).collect();
            // A continuation is shorter where the demonstration ends.
            assert!(representation == Episodic || images.iter().all(|count| *count == images[0]));
            images.into_iter().max().expect("more than six steps")
        });
        assert_eq!(most.collect::<Vec<_>>(), [7, 47, 7, 7, 7, 14], "{set}");
    }
}

/// SPEC section 6, design choices.
#[test]
fn a_segment_of_images_alone_names_the_same_views_without_actions() {
    let mut rig = Rig::new(1, 2000);
    let mut answers = Vec::new();
    for segment in [SegmentContent::Actions, SegmentContent::Images] {
        let mut script = rig.script(0, 1, 12, Start::Original, Episodic);
        script.config.segment = segment as u8;
        rig.play(&[script], std::iter::empty());
        answers.push(std::mem::take(&mut rig.answers));
    }
    for (with, without) in answers[0].values().zip(answers[1].values()) {
        let views = |answer: &Answer| answer.segment.iter().map(|s| s.0).collect::<Vec<_>>();
        assert_eq!((views(with), with.source), (views(without), without.source));
        assert!(without.segment.iter().all(|step| step.1 == NO_ACTION));
        assert_eq!(with.images(), without.images());
    }
}
