//! The engine against a scripted simulator, orchestrator and encoder, in every order of events.

use std::collections::BTreeMap;

use proptest::prelude::*;
use shm_types::Representation;
use shm_types::message::{NO_ACTION, NO_FRAME, ViewRequestKind};
use shm_types::{Feedback, Heading};
use warehouse::{CaseSet, Start};

use super::*;

const EPISODIC: u8 = Representation::Episodic as u8;
const WORKING: u8 = Representation::Working as u8;
const ALL_FOUR: u32 = 0b1111;

/// Stands for a renderer and an encoder: every pose has its own content and direction.
fn content(pose: Pose) -> ContentHash {
    *blake3::hash(pose.to_string().as_bytes()).as_bytes().first_chunk().unwrap()
}

fn embedding(content: ContentHash) -> Embedding {
    let raw: Vec<f32> = content.iter().map(|&byte| f32::from(byte) - 127.5).collect();
    Embedding::normalised(&raw).unwrap()
}

/// An episode that walks one of its case's trajectories in the unchanged world.
#[derive(Debug, Clone)]
struct Script {
    brief: MemoryBrief,
    poses: Vec<Pose>,
    observations: Vec<Observation>,
}

/// What was answered, with poses in place of frames: (window, segment, distance, source).
type Answer = (Vec<(Pose, u8)>, Vec<(Pose, u8)>, u32, (u32, u16, u16));

struct Rig {
    engine: Engine<Pose>,
    /// Pose of frame `i + 1`.
    frames: Vec<Pose>,
    arriving: VecDeque<Pose>,
    embedding: Vec<ContentHash>,
    holds: usize,
    releases: usize,
    embedded: usize,
    answers: BTreeMap<(u64, u32), Answer>,
}

impl Rig {
    fn new(lanes: u32, room: usize) -> Self {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let engine = Engine::new(warehouse, cases, lanes, room, EmbeddingCache::in_memory());
        Self {
            engine,
            frames: Vec::new(),
            arriving: VecDeque::new(),
            embedding: Vec::new(),
            holds: 0,
            releases: 0,
            embedded: 0,
            answers: BTreeMap::new(),
        }
    }

    fn script(&self, lane: u32, ticket: u64, case: u32, start: Start, kind: u8) -> Script {
        let (case_index, case) = (case, &self.engine.cases.cases[case as usize]);
        let replay = case.trajectory(start).replay(
            &self.engine.warehouse,
            &case.task,
            &warehouse::Variant::UNCHANGED,
        );
        let actions = &case.trajectory(start).actions;
        let last = replay.poses.len() - 1;
        let observation = |step: usize| Observation {
            episode: ticket,
            frame: NO_FRAME,
            step: step as u32,
            lane,
            pose: replay.poses[step].into(),
            feedback: replay.feedback[step] as u8,
            action: if step == 0 { NO_ACTION } else { actions[step - 1] as u8 },
            last: u8::from(step == last),
            ..bytemuck::Zeroable::zeroed()
        };
        Script {
            brief: MemoryBrief {
                episode: ticket,
                lane,
                case: case_index,
                demonstrations: ALL_FOUR,
                representation: kind,
                window: 6,
                horizon: 6,
                keyframes: 40,
                segment: 0,
                reserved: [0; 7],
            },
            observations: (0..=last).map(observation).collect(),
            poses: replay.poses,
        }
    }

    fn frame(&mut self, pose: Pose) -> FrameId {
        self.frames.push(pose);
        self.frames.len() as FrameId
    }

    fn observe(&mut self, mut seen: Observation) -> Result<(), Unusable> {
        let pose = Pose::try_from(seen.pose).unwrap();
        seen.frame = if seen.last == 1 { NO_FRAME } else { self.frame(pose) };
        if let Some(frame) = self.engine.observe(&seen, 1)? {
            assert_eq!(frame, seen.frame);
            self.engine.show(seen.lane, content(pose), pose);
        }
        Ok(())
    }

    /// One event of those that are due, by `choice`. Says whether there was any.
    fn work(&mut self, choice: usize) -> bool {
        for request in self.engine.take_view_requests() {
            if request.kind == ViewRequestKind::Hold as u8 {
                self.holds += 1;
                self.arriving.push_back(Pose::try_from(request.pose).unwrap());
            } else {
                assert_eq!(
                    self.frames[request.frame as usize - 1],
                    request.pose.try_into().unwrap()
                );
                self.releases += 1;
            }
        }
        while self.embedding.len() < 3 {
            let Some((next, pose)) = self.engine.next_picture() else { break };
            assert_eq!(next, content(pose));
            self.embedding.push(next);
        }
        let due = usize::from(!self.arriving.is_empty()) + self.embedding.len();
        if due == 0 {
            return false;
        }
        let choice = choice % due;
        if choice < self.embedding.len() {
            let content = self.embedding.remove(choice);
            self.embedded += 1;
            self.engine.embedded(content, embedding(content)).unwrap();
        } else if let Some(pose) = self.arriving.pop_front() {
            let frame = self.frame(pose);
            self.engine.view(pose, frame, content(pose), pose).unwrap();
        }
        true
    }

    /// Collects what can be answered now; says whose lanes were answered.
    fn collect(&mut self) -> Vec<u32> {
        let pose = |frame: FrameId| self.frames[frame as usize - 1];
        let mut lanes = Vec::new();
        for (recall, trace) in self.engine.answers(|| 5) {
            let window = &recall.window[..recall.window_len as usize];
            let segment = &recall.segment[..recall.segment_len as usize];
            let answer = (
                window.iter().map(|step| (pose(step.frame), step.action)).collect(),
                segment.iter().map(|step| (pose(step.frame), step.action)).collect(),
                recall.distance.to_bits(),
                (trace.case, trace.demonstration, trace.index),
            );
            assert_eq!((recall.episode, recall.step), (trace.episode, trace.step));
            assert!(self.answers.insert((recall.episode, recall.step), answer).is_none());
            lanes.push(recall.lane);
        }
        lanes
    }

    /// Runs episodes lane by lane to their ends, each lane's steps in order and everything else in the
    /// order that `choices` say.
    fn play(&mut self, episodes: &[Script], choices: impl Iterator<Item = usize>) {
        let mut lanes: BTreeMap<u32, VecDeque<&Script>> = BTreeMap::new();
        episodes.iter().for_each(|e| lanes.entry(e.brief.lane).or_default().push_back(e));
        // Lane -> observations still to come; absent while an answer is due.
        let mut turns: BTreeMap<u32, VecDeque<Observation>> =
            lanes.keys().map(|&lane| (lane, VecDeque::new())).collect();
        let mut waiting: BTreeMap<u32, VecDeque<Observation>> = BTreeMap::new();
        for choice in choices.chain(std::iter::repeat(0)) {
            let worked = choice % 3 != 0 && self.work(choice / 3);
            if !worked && !turns.is_empty() {
                let lane = *turns.keys().nth(choice / 3 % turns.len()).unwrap();
                let mut coming = turns.remove(&lane).unwrap();
                if coming.is_empty() {
                    let Some(script) = lanes.get_mut(&lane).and_then(VecDeque::pop_front) else {
                        continue;
                    };
                    self.engine.brief(&script.brief).unwrap();
                    coming = script.observations.iter().copied().collect();
                }
                let seen = coming.pop_front().unwrap();
                self.observe(seen).unwrap();
                if seen.last == 1 { &mut turns } else { &mut waiting }.insert(lane, coming);
            } else if !worked && !self.work(choice) && waiting.is_empty() {
                return;
            }
            for lane in self.collect() {
                let coming = waiting.remove(&lane).unwrap();
                turns.insert(lane, coming);
            }
        }
    }
}

#[test]
fn on_a_demonstrated_route_the_segment_is_the_experts_continuation() {
    let mut rig = Rig::new(1, 1000);
    let script = rig.script(0, 7, 3, Start::Original, EPISODIC);
    rig.play(std::slice::from_ref(&script), std::iter::empty());
    let steps = script.poses.len() - 1;
    assert_eq!(rig.answers.len(), steps);
    for (&(_, step), (window, segment, distance, source)) in &rig.answers {
        let step = step as usize;
        assert_eq!(f32::from_bits(*distance), 0.0);
        assert_eq!(source.0, 3);
        assert_eq!(segment[0].0, script.poses[step]);
        let past: Vec<Pose> = window.iter().map(|past| past.0).collect();
        assert_eq!(past, script.poses[step.saturating_sub(6)..step]);
        for (past, seen) in window.iter().zip(&script.observations[step.saturating_sub(6) + 1..]) {
            assert_eq!(past.1, seen.action);
        }
        if source.1 == 0 && usize::from(source.2) == step {
            let until = (step + 6).min(steps);
            let followed: Vec<Pose> = segment.iter().map(|step| step.0).collect();
            assert_eq!(followed, script.poses[step..=until]);
            for (entry, seen) in segment.iter().zip(&script.observations[step + 1..=until]) {
                assert_eq!(entry.1, seen.action);
            }
            assert_eq!(segment.last().unwrap().1, NO_ACTION);
        }
    }
    let (case, demonstration, index) = rig.answers[&(7, 0)].3;
    assert_eq!((case, demonstration, index), (3, 0, 0), "the first view is the original's own");
}

#[test]
fn every_view_is_held_once_embedded_once_and_let_go() {
    let mut rig = Rig::new(3, 1000);
    let scripts: Vec<Script> =
        (0..3).map(|lane| rig.script(lane, lane.into(), 5, Start::Nearby, EPISODIC)).collect();
    let demonstrations = demonstrations(&rig, 5);
    rig.play(&scripts, [0; 6].into_iter());
    assert_eq!((rig.holds, rig.releases), (demonstrations, demonstrations));
    assert_eq!(rig.embedded, demonstrations, "the walk shows nothing that was not demonstrated");
    assert!(rig.engine.open.is_empty() && rig.engine.admission.is_empty());

    // Another episode of the same case holds its views anew and embeds nothing.
    let again = rig.script(1, 9, 5, Start::Opposite, EPISODIC);
    rig.play(&[again], std::iter::empty());
    assert_eq!((rig.holds, rig.embedded), (2 * demonstrations, demonstrations));
}

/// Distinct views of a case's four demonstrations.
fn demonstrations(rig: &Rig, case: usize) -> usize {
    let replay = |start| rig.engine.cases.cases[case].replay(&rig.engine.warehouse, start).poses;
    let poses = Start::DEMONSTRATIONS.into_iter().flat_map(replay);
    poses.collect::<std::collections::HashSet<_>>().len()
}

#[test]
fn a_lane_that_waits_holds_up_nobody() {
    let mut rig = Rig::new(2, 1000);
    let slow = rig.script(0, 1, 0, Start::Original, EPISODIC);
    let quick = rig.script(1, 2, 1, Start::Original, WORKING);
    rig.engine.brief(&slow.brief).unwrap();
    rig.engine.brief(&quick.brief).unwrap();
    rig.observe(slow.observations[0]).unwrap();
    for (step, seen) in quick.observations.iter().enumerate() {
        rig.observe(*seen).unwrap();
        let answered = rig.collect();
        assert_eq!(answered, if seen.last == 1 { vec![] } else { vec![1] }, "step {step}");
    }
    assert!(rig.answers.values().all(|answer| answer.1.is_empty() && answer.3.0 == u32::MAX));
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
    let first = rig.script(0, 1, 0, Start::Original, EPISODIC);
    let second = rig.script(1, 2, 60, Start::Original, EPISODIC);
    rig.play(&[first.clone(), second.clone()], std::iter::empty());
    assert_eq!(rig.answers.len(), first.poses.len() + second.poses.len() - 2);

    let mut rig = Rig::new(2, room - 1);
    let briefs = [first.brief, second.brief];
    let error = briefs.iter().find_map(|brief| rig.engine.brief(brief).err()).unwrap().to_string();
    assert!(error.contains("raise --frame-budget"), "{error}");
}

#[test]
fn an_episode_that_never_ran_is_forgotten() {
    let mut rig = Rig::new(1, 1000);
    for ticket in 1..4 {
        let script = rig.script(0, ticket, ticket as u32, Start::Original, EPISODIC);
        rig.engine.brief(&script.brief).unwrap();
        rig.work(0);
    }
    let last = rig.script(0, 4, 2, Start::Original, EPISODIC);
    rig.play(&[last], std::iter::empty());
    while rig.work(0) {}
    assert_eq!(rig.holds, rig.releases);
}

#[test]
fn what_cannot_be_used_is_refused_and_named() {
    let mut rig = Rig::new(2, 1000);
    let script = rig.script(0, 1, 0, Start::Original, EPISODIC);
    let brief = script.brief;
    for (bad, expected) in [
        (MemoryBrief { lane: 2, ..brief }, "lane 2 of 2"),
        (
            MemoryBrief { case: 100, ..brief },
            "case 100 with demonstrations 0b1111, but there are 100 cases",
        ),
        (MemoryBrief { demonstrations: 16, ..brief }, "demonstrations 0b10000"),
        (MemoryBrief { demonstrations: 0, ..brief }, "a memory of no demonstrations"),
        (MemoryBrief { representation: 9, ..brief }, "9 is not a representation"),
        (MemoryBrief { window: 33, ..brief }, "a window of 33"),
        (MemoryBrief { horizon: 32, ..brief }, "a horizon of 32"),
    ] {
        let error = rig.engine.brief(&bad).unwrap_err().to_string();
        assert!(error.starts_with("brief of episode 1: ") && error.contains(expected), "{error}");
    }
    rig.engine.brief(&brief).unwrap();
    let first = script.observations[0];
    let refuse = |rig: &mut Rig, bad: Observation, expected: &str| {
        let error = rig.engine.observe(&bad, 1).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    let first = Observation { frame: 1, ..first };
    refuse(&mut rig, Observation { episode: 8, ..first }, "unknown episode 8 in lane 0");
    refuse(&mut rig, Observation { lane: 7, ..first }, "unknown episode 1 in lane 7");
    refuse(&mut rig, Observation { step: 1, ..first }, "step 1: step 0 was to come");
    refuse(&mut rig, Observation { action: 7, ..first }, "7 is not an action");
    refuse(&mut rig, Observation { feedback: 5, ..first }, "5 is not a feedback");
    refuse(&mut rig, Observation { frame: NO_FRAME, ..first }, "it names no frame");
    refuse(
        &mut rig,
        Observation { pose: shm_types::message::WirePose([1, 1, 4, 0]), ..first },
        "4 is not a heading",
    );
    let unexpected =
        rig.engine.view(Pose::new(0, 0, Heading::N), 9, [0; 16], Pose::new(0, 0, Heading::N));
    assert!(unexpected.unwrap_err().to_string().contains("which nobody waits for"));
    assert_eq!(Feedback::Start as u8, first.feedback);
    rig.play(&[], std::iter::repeat_n(1, 4000));
    rig.observe(script.observations[0]).unwrap();
    refuse(&mut rig, Observation { frame: 1, ..script.observations[2] }, "step 1 was to come");
    assert_eq!(rig.collect(), [0]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Rule 1 of the design: what is answered depends on the episode alone, not on lanes or timing.
    #[test]
    fn no_order_of_events_changes_an_answer(
        cases in prop::collection::vec((0..100_u32, 0..6_usize, any::<bool>()), 1..7),
        lanes in 1..4_u32,
        choices in prop::collection::vec(any::<usize>(), 0..600),
        room in 260..2000_usize,
    ) {
        let scripts = |rig: &Rig, lanes: u32| -> Vec<Script> {
            (0..).zip(&cases).map(|(ticket, &(case, start, episodic))| {
                let kind = if episodic { EPISODIC } else { WORKING };
                rig.script(ticket as u32 % lanes, ticket, case, Start::ALL[start], kind)
            }).collect()
        };
        let mut alone = Rig::new(1, 2000);
        let in_turn = scripts(&alone, 1);
        alone.play(&in_turn, std::iter::empty());
        let mut together = Rig::new(lanes, room);
        let at_once = scripts(&together, lanes);
        together.play(&at_once, choices.into_iter());
        prop_assert_eq!(&together.answers, &alone.answers);
        prop_assert_eq!(together.holds, together.releases);
        let steps: usize = at_once.iter().map(|script| script.poses.len() - 1).sum();
        prop_assert_eq!(together.answers.len(), steps);
    }

    /// Whatever arrives is taken up or refused, and what was held is let go again.
    #[test]
    fn no_message_panics(
        messages in prop::collection::vec(
            (any::<bool>(), 0..4_u64, 0..3_u32, 0..4_u32, any::<[u8; 7]>(), 0..18_u32), 0..80
        ),
    ) {
        let mut rig = Rig::new(2, 400);
        for (is_brief, episode, lane, small, bytes, demonstrations) in messages {
            let [a, b, c, d, e, f, g] = bytes.map(|byte| if byte < 128 { byte % 8 } else { byte });
            if is_brief {
                let _ = rig.engine.brief(&MemoryBrief {
                    episode,
                    lane,
                    case: small * 40,
                    demonstrations,
                    representation: a,
                    window: b,
                    horizon: c,
                    keyframes: d,
                    segment: e,
                    reserved: [f; 7],
                });
            } else {
                let pose = shm_types::message::WirePose([a, b, c, d]);
                let seen = Observation {
                    episode,
                    lane,
                    step: small,
                    frame: 1,
                    pose,
                    feedback: e,
                    action: f,
                    last: g % 2,
                    ..bytemuck::Zeroable::zeroed()
                };
                if let Ok(Some(_)) = rig.engine.observe(&seen, 1) {
                    let pose = Pose::try_from(pose).unwrap();
                    rig.engine.show(lane, content(pose), pose);
                }
            }
            rig.work(usize::from(a));
            let _ = rig.engine.answers(|| 5);
        }
        for (lane, ticket) in [(0, 90), (1, 91)] {
            let script = rig.script(lane, ticket, 3, Start::Original, WORKING);
            rig.engine.brief(&script.brief).unwrap();
            rig.observe(script.observations[0]).unwrap();
        }
        while rig.work(0) {}
        prop_assert_eq!(rig.holds, rig.releases);
    }
}
