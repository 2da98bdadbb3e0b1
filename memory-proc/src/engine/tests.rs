//! The engine against a scripted simulator, orchestrator and encoder, in every order of events.

use domain::Representation::{Episodic, FullContext, Working};
use domain::{Demonstrations, Feedback, Heading, Pose, Representation};
use proptest::prelude::*;
use shm_types::message::{EXTERNAL, MAX_STATE, NO_ACTION, NO_FRAME};
use warehouse::TrajectoryKind;

use self::rig::{Answer, Rig, Script, content, pose_of, replay_set};
use super::*;

mod external;
mod rig;
mod streams;
mod supplied;

#[test]
fn on_a_demonstrated_route_the_segment_is_the_experts_continuation() {
    let mut rig = Rig::new(1, 1000);
    let script = rig.script(0, 7, 3, TrajectoryKind::Original, Episodic);
    rig.play(std::slice::from_ref(&script), std::iter::empty());
    let steps = script.poses.len() - 1;
    assert_eq!(rig.answers.len(), steps);
    for (&(_, step), Answer { segment, distance, source, .. }) in &rig.answers {
        let step = step as usize;
        assert_eq!(f32::from_bits(*distance), 0.0);
        let (case, number, first) = source.unwrap();
        assert_eq!(case, 3);
        assert_eq!(segment[0].0, script.poses[step]);
        if number == 0 && usize::from(first) == step {
            let until = (step + 6).min(steps);
            let followed: Vec<Pose> = segment.iter().map(|step| step.0).collect();
            assert_eq!(followed, script.poses[step..=until]);
            for (entry, seen) in segment.iter().zip(&script.observations[step + 1..=until]) {
                assert_eq!(entry.1, seen.action);
            }
            assert_eq!(segment.last().unwrap().1, NO_ACTION);
        }
    }
    let first = rig.answers[&(7, 0)].source;
    assert_eq!(first, Some((3, 0, 0)), "the first view is the original's own");
}

#[test]
fn every_view_is_pinned_once_embedded_once_and_released() {
    let mut rig = Rig::new(3, 1000);
    let scripts: Vec<Script> = (0..3)
        .map(|lane| rig.script(lane, lane.into(), 5, TrajectoryKind::Nearby, Episodic))
        .collect();
    let demonstrations = demonstrations(&rig, 5);
    rig.play(&scripts, [0; 6].into_iter());
    assert_eq!((rig.pins, rig.releases), (demonstrations, demonstrations));
    assert_eq!(rig.embedded, demonstrations, "the test route shows only demonstrated views");
    assert!(rig.engine.pending.is_empty() && rig.engine.admission.is_empty());

    // Another episode of the same case pins its views again and embeds nothing.
    let again = rig.script(1, 9, 5, TrajectoryKind::Opposite, Episodic);
    rig.play(&[again], std::iter::empty());
    assert_eq!((rig.pins, rig.embedded), (2 * demonstrations, demonstrations));
}

/// Distinct views of a case's four demonstrations.
fn demonstrations(rig: &Rig, case: usize) -> usize {
    let poses = replay_set(rig, case, Demonstrations::ALL)
        .into_iter()
        .flat_map(|demonstration| demonstration.poses);
    poses.collect::<HashSet<_>>().len()
}

#[test]
fn views_pinned_for_their_pixels_are_embedded_when_a_memory_matches_views() {
    let mut rig = Rig::new(2, 1000);
    let whole = rig.script(0, 1, 5, TrajectoryKind::Original, FullContext);
    rig.engine.config(&whole.config).unwrap();
    rig.observe(whole.observations[0]).unwrap();
    assert!(rig.collect().is_empty(), "its views are requested when it has named them");
    while rig.work(0) {}
    assert_eq!(rig.collect(), [0]);
    let keyframes = rig.pins;
    assert!((1..=40).contains(&keyframes) && rig.embedded == 0);
    let compared = rig.script(1, 2, 5, TrajectoryKind::Original, Episodic);
    rig.play(&[compared], std::iter::empty());
    assert_eq!((rig.pins, rig.embedded), (demonstrations(&rig, 5), rig.pins));
    assert_eq!(rig.releases, rig.pins - keyframes, "the first lane still shows its keyframes");
    rig.observe(Observation { last: 1, ..whole.observations[1] }).unwrap();
    while rig.work(0) {}
    assert_eq!(rig.releases, rig.pins);
}

#[test]
fn a_waiting_lane_does_not_delay_others() {
    let mut rig = Rig::new(2, 1000);
    let slow = rig.script(0, 1, 0, TrajectoryKind::Original, Episodic);
    let quick = rig.script(1, 2, 1, TrajectoryKind::Original, Working);
    rig.engine.config(&slow.config).unwrap();
    rig.engine.config(&quick.config).unwrap();
    rig.observe(slow.observations[0]).unwrap();
    for (step, seen) in quick.observations.iter().enumerate() {
        rig.observe(*seen).unwrap();
        let answered = rig.collect();
        assert_eq!(answered, if seen.last == 1 { vec![] } else { vec![1] }, "step {step}");
    }
    assert!(rig.answers.values().all(|answer| answer.segment.is_empty()));
    assert!(rig.answers.values().all(|answer| answer.source.is_none()));
    while rig.work(0) {
        rig.collect();
    }
    assert!(rig.answers.contains_key(&(1, 0)));
}

#[test]
fn lanes_whose_views_do_not_fit_together_take_turns() {
    let mut rig = Rig::new(2, 0);
    let room = demonstrations(&rig, 0).max(demonstrations(&rig, 60));
    rig = Rig::new(2, room);
    let first = rig.script(0, 1, 0, TrajectoryKind::Original, Episodic);
    let second = rig.script(1, 2, 60, TrajectoryKind::Original, Episodic);
    rig.play(&[first.clone(), second.clone()], std::iter::empty());
    assert_eq!(rig.answers.len(), first.poses.len() + second.poses.len() - 2);

    let mut rig = Rig::new(2, room - 1);
    let configs = [first.config, second.config];
    let error =
        configs.iter().find_map(|config| rig.engine.config(config).err()).unwrap().to_string();
    assert!(error.contains("raise --frame-budget"), "{error}");
}

#[test]
fn an_episode_that_never_began_is_dropped() {
    let mut rig = Rig::new(1, 1000);
    for id in 1..4 {
        let script = rig.script(0, id, id as u32, TrajectoryKind::Original, Episodic);
        rig.engine.config(&script.config).unwrap();
        rig.work(0);
    }
    let last = rig.script(0, 4, 2, TrajectoryKind::Original, Episodic);
    rig.play(&[last], std::iter::empty());
    while rig.work(0) {}
    assert_eq!(rig.pins, rig.releases);
}

#[test]
fn unusable_messages_are_refused_with_a_reason() {
    let mut rig = Rig::new(2, 1000);
    let script = rig.script(0, 1, 0, TrajectoryKind::Original, Episodic);
    let config = script.config;
    for (bad, expected) in [
        (MemoryEpisodeConfig { lane: 2, ..config }, "lane 2 of 2"),
        (
            MemoryEpisodeConfig { case: 100, ..config },
            "case 100 with demonstrations 0b1111, but there are 100 cases",
        ),
        (MemoryEpisodeConfig { demonstrations: 16, ..config }, "demonstrations 0b10000"),
        (
            MemoryEpisodeConfig { demonstrations: 0, ..config },
            "episodic memory of no demonstrations",
        ),
        (
            MemoryEpisodeConfig { demonstrations: 0, representation: 2, ..config },
            "summary memory of no demonstrations",
        ),
        (MemoryEpisodeConfig { segment: 2, ..config }, "2 is not a segment content"),
        (MemoryEpisodeConfig { representation: 9, ..config }, "9 is not a representation"),
        (
            MemoryEpisodeConfig { representation: EXTERNAL, external: 3, ..config },
            "external memory 3, which does not take part in the run",
        ),
        (MemoryEpisodeConfig { hits: 0, ..config }, "0 segments for a step, but must be 1 to 8"),
        (MemoryEpisodeConfig { horizon: 32, ..config }, "a horizon of 32"),
    ] {
        let error = rig.engine.config(&bad).unwrap_err().to_string();
        assert!(error.starts_with("config of episode 1: ") && error.contains(expected), "{error}");
    }
    rig.engine.config(&config).unwrap();
    let first = script.observations[0];
    let refuse = |rig: &mut Rig, bad: Observation, expected: &str| {
        let reported = rig.report(&bad).and_then(|()| rig.engine.observe(&bad, 1).map(drop));
        let error = reported.unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    let first = Observation { frame: 1, ..first };
    refuse(&mut rig, Observation { episode: 8, ..first }, "unknown episode 8 in lane 0");
    refuse(&mut rig, Observation { lane: 7, ..first }, "episode 1 in lane 7");
    refuse(&mut rig, Observation { step: 1, ..first }, "step 1: expected step 0");
    refuse(&mut rig, Observation { action: 7, ..first }, "7 is not an action");
    refuse(&mut rig, Observation { feedback: 5, ..first }, "5 is not a feedback");
    refuse(&mut rig, Observation { frame: NO_FRAME, ..first }, "it names no frame");
    let mut foreign = first;
    foreign.state[2] = 4.0;
    refuse(&mut rig, foreign, "no state of the world warehouse: heading is 4, not one of 0 to 3");
    let pose = Pose::new(0, 0, Heading::N);
    let view_id = ViewId { sequence: 9, number: 0, step: 3 };
    let unexpected = rig.engine.view(view_id, 9, [0; 16], pose);
    assert!(unexpected.unwrap_err().to_string().contains("which was not requested"));
    assert_eq!(Feedback::Start as u8, first.feedback);
    rig.play(&[], std::iter::repeat_n(1, 4000));
    rig.observe(script.observations[0]).unwrap();
    refuse(&mut rig, Observation { frame: 1, ..script.observations[2] }, "expected step 1");
    assert_eq!(rig.collect(), [0]);
}

/// Sets of demonstrations.
const SETS: [Demonstrations; 5] = [
    Demonstrations::ORIGINAL,
    Demonstrations::ALL,
    Demonstrations::IRRELEVANT,
    Demonstrations::CONFUSABLE,
    Demonstrations::bank(16),
];

#[test]
fn episodes_with_one_bank_share_its_memory_and_pin_few_of_its_views() {
    let mut rig = Rig::new(2, 100);
    let scripts = [0, 1].map(|lane| {
        let script =
            rig.script(lane, lane.into(), 7 * lane, TrajectoryKind::Test, Representation::Episodic);
        script.remembering(Demonstrations::bank(400))
    });
    rig.play(&scripts, 0..);
    let steps: usize = scripts.iter().map(|script| script.poses.len() - 1).sum();
    assert_eq!(rig.answers.len(), steps);
    // Every view once, and at each step those of a segment.
    let views = rig.asked.len();
    assert!(views > 500 && rig.pins <= views + 7 * steps, "{} pins of {views} views", rig.pins);
    assert_eq!(rig.pins, rig.releases);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// An answer depends on its episode only, not on lanes or timing.
    #[test]
    fn no_order_of_events_changes_an_answer(
        episodes in prop::collection::vec(
            (0..100_u32, 0..6_usize, 0..7_usize, 0..SETS.len(), 0..2_u8, 0..60_u8), 1..7
        ),
        lanes in 1..4_u32,
        choices in prop::collection::vec(any::<usize>(), 0..600),
        room in 300..2000_usize,
    ) {
        let scripts = |rig: &Rig, lanes: u32| -> Vec<Script> {
            (0..).zip(&episodes).map(|(id, &(case, start, memory, set, segment, keyframes))| {
                let (lane, memory) = (id as u32 % lanes, Representation::ALL[memory]);
                let mut script = rig.script(lane, id, case, TrajectoryKind::ALL[start], memory);
                script.config.demonstrations = SETS[set].bits();
                (script.config.segment, script.config.keyframes) = (segment, keyframes);
                script
            }).collect()
        };
        let mut alone = Rig::new(1, 2000);
        let in_turn = scripts(&alone, 1);
        alone.play(&in_turn, std::iter::empty());
        let mut together = Rig::new(lanes, room);
        let at_once = scripts(&together, lanes);
        together.play(&at_once, choices.into_iter());
        prop_assert_eq!(&together.answers, &alone.answers);
        prop_assert_eq!(together.pins, together.releases);
        let steps: usize = at_once.iter().map(|script| script.poses.len() - 1).sum();
        prop_assert_eq!(together.answers.len(), steps);
    }

    /// Any message is accepted or refused, and every pinned view is released.
    #[test]
    fn no_message_panics(
        messages in prop::collection::vec(
            (any::<bool>(), 0..4_u64, 0..3_u32, 0..4_u32, any::<[u8; 7]>(), 0..40_u32), 0..80
        ),
    ) {
        let mut rig = Rig::new(2, 400);
        for (is_config, episode, lane, small, bytes, demonstrations) in messages {
            let [a, b, c, d, e, f, g] = bytes.map(|byte| if byte < 128 { byte % 8 } else { byte });
            if is_config {
                let _ = rig.engine.config(&MemoryEpisodeConfig {
                    episode,
                    lane,
                    case: small * 40,
                    demonstrations,
                    representation: a,
                    horizon: c,
                    keyframes: d,
                    segment: e,
                    text_budget: b.into(),
                    image_budget: f.into(),
                    hits: g,
                    external: b,
                    ..bytemuck::Zeroable::zeroed()
                });
            } else {
                let mut state = [0.0; MAX_STATE];
                state[..4].copy_from_slice(&[a, b, c % 5, d % 2].map(f32::from));
                let seen = Observation {
                    episode,
                    lane,
                    step: small,
                    frame: 1,
                    state,
                    feedback: e,
                    action: f,
                    last: g % 2,
                    ..bytemuck::Zeroable::zeroed()
                };
                let _ = rig.report(&seen);
                if let Ok(Some(_)) = rig.engine.observe(&seen, 1) {
                    let pose = pose_of(&state);
                    rig.engine.current_view(lane, content(pose), pose);
                }
            }
            rig.work(usize::from(a));
            let _ = rig.engine.answers(|| 5, &mut rig.documents);
        }
        for (lane, id) in [(0, 90), (1, 91)] {
            let script = rig.script(lane, id, 3, TrajectoryKind::Original, Working);
            rig.engine.config(&script.config).unwrap();
            rig.observe(script.observations[0]).unwrap();
        }
        while rig.work(0) {}
        prop_assert_eq!(rig.pins, rig.releases);
    }
}
