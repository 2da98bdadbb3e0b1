//! Recalls name the selected demonstrations and nothing else, with the expected number of images.

use std::collections::BTreeSet;

use domain::Representation::{Adaptive, Episodic, FullContext, Hybrid, Semantic, Summary, Working};
use domain::{Demonstrations, Pose, Representation, SegmentContent};
use shm_types::message::NO_ACTION;
use warehouse::TrajectoryKind;

use super::SETS;
use super::rig::{Answer, ReplayedDemonstration, Rig, replay_set};

/// Checks an answer of an episode whose memory is built from `demonstrations`.
fn check(
    answer: &Answer,
    representation: Representation,
    set: Demonstrations,
    demonstrations: &[ReplayedDemonstration],
) {
    let Answer { segment, source, texts, trajectories, .. } = answer;
    let expected: &[String] = &match representation {
        Working | FullContext | Episodic | Adaptive => vec![],
        Summary => vec![format!("summary of {set}")],
        Semantic => vec![format!("semantic of {set}")],
        Hybrid => vec![format!("summary of {set}"), format!("semantic of {set}")],
    };
    assert_eq!(texts, expected);
    // A segment is part of the demonstration that the trace names.
    assert_eq!(segment.is_empty(), !representation.matches_views());
    if let Some(((last_view, last_action), before)) = segment.split_last() {
        let (case, number, step) = source.expect("a match");
        let is_source = |demonstration: &&ReplayedDemonstration| {
            (demonstration.of.case as u32, demonstration.of.kind as u16) == (case, number)
        };
        let demonstration =
            demonstrations.iter().find(is_source).expect("a demonstration of the set");
        let (from, to) = (usize::from(step), usize::from(step) + before.len());
        let shown: Vec<(Pose, u8)> = demonstration.poses[from..to]
            .iter()
            .copied()
            .zip(demonstration.actions[from..to].to_vec())
            .collect();
        assert_eq!(before, shown);
        assert_eq!((*last_view, *last_action), (demonstration.poses[to], NO_ACTION));
        assert_eq!(before.len(), (demonstration.poses.len() - 1 - from).min(6));
    } else {
        assert_eq!(*source, None);
    }
    // Trajectories are those of the set, with every action; keyframes show the pose of their step.
    if representation == FullContext {
        let steps = demonstrations.iter().zip(0..).flat_map(|(demonstration, number)| {
            let states = demonstration.poses.iter().zip(&demonstration.actions);
            states.map(move |(&pose, &action)| (pose, action, number))
        });
        let steps: Vec<_> = steps.collect();
        assert_eq!(trajectories.len(), steps.len());
        for (&(shown, action, number), &(pose, acted, demonstration)) in
            trajectories.iter().zip(&steps)
        {
            assert_eq!((action, number), (acted, demonstration));
            assert!(shown.is_none_or(|shown| shown == pose));
        }
    } else {
        assert!(trajectories.is_empty());
    }
}

/// Specification, section 4: test references are never memory. Episodes follow both references of every case, with every
/// representation and every kind of set. Everything that a recall names, and every view that a memory requests, comes from
/// the set's demonstrations.
#[test]
fn nothing_is_supplied_but_the_selected_demonstrations() {
    let mut rig = Rig::new(1, 2000);
    let cases = rig.cases.cases.len();
    for case in 0..cases {
        for set in SETS {
            let demonstrations = replay_set(&rig, case, set);
            let remembered: BTreeSet<Pose> = demonstrations
                .iter()
                .flat_map(|demonstration| demonstration.poses.iter().copied())
                .collect();
            for (id, representation) in (1..).zip(Representation::ALL) {
                let start =
                    if case % 2 == 0 { TrajectoryKind::Test } else { TrajectoryKind::Blocked };
                let script = rig.script(0, id, case as u32, start, representation);
                let script = script.remembering(set);
                rig.asked.clear();
                rig.play(&[script], std::iter::empty());
                assert!(rig.asked.is_subset(&remembered));
                for answer in std::mem::take(&mut rig.answers).into_values() {
                    check(&answer, representation, set, &demonstrations);
                }
            }
            rig.documents.clear();
        }
    }
}

/// Specification, section 5: 7, 47, 7, 7, 7 and 14 images with the standard settings, as soon as the window is full.
#[test]
fn images_of_a_request_are_those_of_the_paper() {
    let mut rig = Rig::new(1, 2000);
    let steps =
        |rig: &Rig, case: usize| replay_set(rig, case, Demonstrations::ORIGINAL)[0].poses.len();
    let case = (0..100).find(|&case| steps(&rig, case) > 50).expect("a long demonstration");
    for set in [Demonstrations::ORIGINAL, Demonstrations::ALL] {
        let most = Representation::ALL.iter().map(|&representation| {
            let script = rig.script(0, 1, case as u32, TrajectoryKind::Test, representation);
            rig.play(&[script.remembering(set)], std::iter::empty());
            let answers = std::mem::take(&mut rig.answers);
            let full = answers.iter().filter(|((_, step), _)| *step >= 6);
            let images: Vec<usize> = full.map(|(_, answer)| answer.images()).collect();
            // A continuation is shorter where the demonstration ends.
            assert!(
                representation.matches_views() || images.iter().all(|count| *count == images[0])
            );
            images.into_iter().max().expect("more than six steps")
        });
        assert_eq!(most.collect::<Vec<_>>(), [7, 47, 7, 7, 7, 14, 14], "{set}");
    }
}

/// Specification, section 6, design choices.
#[test]
fn a_segment_of_images_alone_names_the_same_views_without_actions() {
    let mut rig = Rig::new(1, 2000);
    let mut answers = Vec::new();
    for segment in [SegmentContent::Actions, SegmentContent::Images] {
        let mut script = rig.script(0, 1, 12, TrajectoryKind::Original, Episodic);
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
