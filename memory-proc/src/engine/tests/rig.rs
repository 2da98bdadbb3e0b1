//! A scripted simulator, orchestrator, encoder and documents around one engine.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

use case_book::BookRequest;
use domain::{Demonstrations, Pose, Representation, State};
use shm_types::documents::Content;
use shm_types::message::{
    EpisodeEnd, ItemKind, MAX_STATE, NO_ACTION, NO_FRAME, RecalledItem, RecalledSource,
    SegmentStep, ViewRequestKind,
};
use warehouse::case_book::write_books;
use warehouse::{CaseSet, History, TrajectoryKind, Warehouse};

use super::super::*;
use crate::external::{ExternalLimits, ExternalMemories};
use crate::representation::testing::TestDocuments;

/// Stands in for renderer and encoder: every pose has its own content and embedding.
pub(super) fn content(pose: Pose) -> ContentHash {
    *blake3::hash(pose.to_string().as_bytes()).as_bytes().first_chunk().unwrap()
}

pub(super) fn embedding(content: ContentHash) -> Embedding {
    let raw: Vec<f32> = content.iter().map(|&byte| f32::from(byte) - 127.5).collect();
    Embedding::normalised(&raw).unwrap()
}

/// The pose in a message.
pub(super) fn pose_of(state: &[f32; MAX_STATE]) -> Pose {
    let state = warehouse::declaration().read_state(state).unwrap();
    Pose::try_from(state).unwrap()
}

/// An episode that follows one of its case's trajectories in the unchanged world.
#[derive(Debug, Clone)]
pub(super) struct Script {
    pub(super) config: MemoryEpisodeConfig,
    pub(super) poses: Vec<Pose>,
    pub(super) observations: Vec<Observation>,
}

/// An answer, with poses in place of frames and texts in place of documents.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Answer {
    /// Views and actions.
    pub(super) segment: Vec<(Pose, u8)>,
    /// The distance's bits.
    pub(super) distance: u32,
    /// Case, demonstration and step of the match, if there is one.
    pub(super) source: Option<(u32, u16, u16)>,
    pub(super) texts: Vec<String>,
    /// Keyframe, action and number of the demonstration.
    pub(super) trajectories: Vec<(Option<Pose>, u8, u8)>,
}

impl Answer {
    /// Images of a request with this answer and a full window.
    pub(super) fn images(&self) -> usize {
        let keyframes = self.trajectories.iter().filter(|step| step.0.is_some());
        1 + 6 + self.segment.len() + keyframes.count()
    }
}

pub(super) struct Rig {
    pub(super) warehouse: Warehouse,
    pub(super) cases: CaseSet,
    pub(super) engine: Engine<Pose>,
    /// Pose of frame `i + 1`.
    pub(super) frames: Vec<Pose>,
    pub(super) arriving: VecDeque<ViewId>,
    pub(super) embedding: Vec<ContentHash>,
    pub(super) pins: usize,
    pub(super) releases: usize,
    pub(super) embedded: usize,
    pub(super) answers: BTreeMap<(u64, u32), Answer>,
    pub(super) documents: TestDocuments,
    /// Poses whose views were requested.
    pub(super) asked: BTreeSet<Pose>,
    /// Frames that the simulator may have evicted.
    pub(super) gone: BTreeSet<FrameId>,
    /// Where the views of episodes that were learned from are seen.
    lived: BTreeMap<ViewId, Pose>,
    /// By episode and step: sub-goals completed so far, and whether the task is.
    progress: RefCell<BTreeMap<(u64, u32), (u16, bool)>>,
}

impl Rig {
    pub(super) fn new(lanes: u32, room: usize) -> Self {
        let none = ExternalMemories::new(BTreeMap::new(), ExternalLimits::default());
        Self::with_externals(lanes, room, none)
    }

    pub(super) fn with_externals(lanes: u32, room: usize, externals: ExternalMemories) -> Self {
        let book = write_books(&BookRequest::default()).unwrap().demonstrations;
        let (library, embeddings) = (DemonstrationLibrary::new(book), EmbeddingCache::in_memory());
        Self::with(Engine::new(library, lanes, room, embeddings, externals, None))
    }

    pub(super) fn with(engine: Engine<Pose>) -> Self {
        Self {
            warehouse: Warehouse::shipped(),
            cases: CaseSet::shipped(),
            engine,
            frames: Vec::new(),
            arriving: VecDeque::new(),
            embedding: Vec::new(),
            pins: 0,
            releases: 0,
            embedded: 0,
            answers: BTreeMap::new(),
            documents: TestDocuments::default(),
            asked: BTreeSet::new(),
            gone: BTreeSet::new(),
            lived: BTreeMap::new(),
            progress: RefCell::default(),
        }
    }

    /// Episode `id` with the case's own four demonstrations and the standard settings.
    pub(super) fn script(
        &self,
        lane: u32,
        id: u64,
        case: u32,
        kind: TrajectoryKind,
        representation: Representation,
    ) -> Script {
        let (case_index, case) = (case, &self.cases.cases[case as usize]);
        let unchanged = warehouse::Variant::UNCHANGED;
        let replay = case.trajectory(kind).replay(&self.warehouse, &case.task, &unchanged);
        let actions = &case.trajectory(kind).actions;
        let last = replay.poses.len() - 1;
        let observation = |step: usize| Observation {
            episode: id,
            frame: NO_FRAME,
            step: step as u32,
            lane,
            state: State::from(replay.poses[step]).padded(),
            feedback: replay.feedback[step] as u8,
            action: if step == 0 { NO_ACTION } else { actions[step - 1] as u8 },
            last: u8::from(step == last),
            ..bytemuck::Zeroable::zeroed()
        };
        let progress = (0..).zip(&replay.stages).map(|(step, &stage)| {
            ((id, step), (stage as u16, step as usize == last && replay.length.is_some()))
        });
        self.progress.borrow_mut().extend(progress);
        Script {
            config: MemoryEpisodeConfig {
                episode: id,
                lane,
                case: case_index,
                demonstrations: Demonstrations::ALL.bits(),
                representation: representation as u8,
                horizon: 6,
                keyframes: 40,
                image_budget: 60,
                text_budget: 65536,
                hits: 1,
                repeat: 1,
                ..bytemuck::Zeroable::zeroed()
            },
            observations: (0..=last).map(observation).collect(),
            poses: replay.poses,
        }
    }

    pub(super) fn frame(&mut self, pose: Pose) -> FrameId {
        self.frames.push(pose);
        self.frames.len() as FrameId
    }

    pub(super) fn observe(&mut self, mut seen: Observation) -> Result<(), String> {
        let pose = pose_of(&seen.state);
        seen.frame = if seen.last == 1 { NO_FRAME } else { self.frame(pose) };
        self.report(&seen)?;
        if let Some(frame) = self.engine.observe(&seen, 1)? {
            assert_eq!(frame, seen.frame);
            self.engine.current_view(seen.lane, content(pose), pose);
        }
        Ok(())
    }

    /// Reports the step of an observation.
    pub(super) fn report(&mut self, seen: &Observation) -> Result<(), String> {
        let known = self.progress.borrow().get(&(seen.episode, seen.step)).copied();
        let (sub_goals, is_complete) = known.unwrap_or_default();
        let ended = if is_complete { EpisodeEnd::Complete } else { EpisodeEnd::GoesOn } as u8;
        let Observation { episode, lane, step, .. } = *seen;
        let report =
            StepReport { episode, lane, step, sub_goals, ended, ..bytemuck::Zeroable::zeroed() };
        self.engine.step_report(&report)
    }

    /// Notes where the views of an episode are seen if a memory learns from it, and may ask for them.
    pub(super) fn remember(&mut self, script: &Script) {
        let MemoryEpisodeConfig { sequence, position: number, learns, .. } = script.config;
        if learns == 0 {
            return;
        }
        let view = |step| ViewId { sequence, number, step };
        let poses = (0..).zip(&script.observations);
        self.lived.extend(poses.map(|(step, seen)| (view(step), pose_of(&seen.state))));
    }

    /// The rig after a restart of the process.
    pub(super) fn restarted(&mut self, engine: Engine<Pose>) -> Self {
        let (lived, progress) = (std::mem::take(&mut self.lived), self.progress.take());
        Self { lived, progress: RefCell::new(progress), ..Self::with(engine) }
    }

    /// Where a view is seen.
    fn pose(&self, view: ViewId) -> Pose {
        match view.sequence {
            0 => self.engine.library.pose(view),
            _ => self.lived[&view],
        }
    }

    /// Processes one of the pending events, chosen by `choice`. Returns whether there was one.
    pub(super) fn work(&mut self, choice: usize) -> bool {
        for request in self.engine.take_view_requests() {
            if request.kind == ViewRequestKind::Pin as u8 {
                self.pins += 1;
                let ViewRequest { sequence, demonstration: number, step, .. } = request;
                let view_id = ViewId { sequence, number, step };
                self.asked.insert(self.pose(view_id));
                self.arriving.push_back(view_id);
            } else {
                self.releases += 1;
                self.gone.insert(request.frame);
            }
        }
        while self.embedding.len() < 3 {
            let Some((next, pose)) = self.engine.next_image() else { break };
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
            self.engine.add_embedding(content, embedding(content)).unwrap();
        } else if let Some(view_id) = self.arriving.pop_front() {
            let pose = self.pose(view_id);
            let frame = self.frame(pose);
            self.engine.view(view_id, frame, content(pose), pose).unwrap();
        }
        true
    }

    /// Collects the answers that are possible now; returns their lanes.
    pub(super) fn collect(&mut self) -> Vec<u32> {
        let mut lanes = Vec::new();
        for answer in self.engine.answers(|| 5, &mut self.documents).unwrap() {
            let (recall, trace) = *answer;
            let answer = self.answer(&recall, &trace);
            assert_eq!((recall.episode, recall.step), (trace.episode, trace.step));
            assert!(self.answers.insert((recall.episode, recall.step), answer).is_none());
            lanes.push(recall.lane);
        }
        lanes
    }

    /// An answer in terms of poses and texts.
    fn answer(&self, recall: &Recall, trace: &RecallTrace) -> Answer {
        let held = |frame: FrameId| {
            assert!(!self.gone.contains(&frame), "frame {frame} is named and not pinned");
            self.frames[frame as usize - 1]
        };
        let mut answer = Answer { distance: f32::NAN.to_bits(), ..Answer::default() };
        for item in &recall.items[..recall.items_len as usize] {
            let RecalledItem { document, first_step, steps, first_byte, bytes, .. } = *item;
            let steps = first_step as usize..(first_step + steps) as usize;
            let published = || &self.documents.published[document as usize - 1];
            match ItemKind::try_from(item.kind).unwrap() {
                ItemKind::Text => {
                    let (episode, Content::Summary(text) | Content::Semantic(text)) = published()
                    else {
                        panic!("{:?}", published())
                    };
                    assert_eq!(*episode, None, "a text is for the whole run");
                    assert_eq!((first_byte, bytes as usize), (0, text.len()), "the whole text");
                    answer.texts.push(text.clone());
                }
                ItemKind::Steps => {
                    let steps = recall.steps[steps].iter();
                    let shown = |step: &SegmentStep| (held(step.frame), step.action);
                    answer.segment.extend(steps.map(shown));
                    answer.distance = item.distance.to_bits();
                }
                ItemKind::Trajectory => {
                    let (episode, Content::Trajectories(all)) = published() else {
                        panic!("{:?}", published())
                    };
                    assert_eq!(*episode, Some((recall.lane, recall.episode)), "its own");
                    assert!(item.whole == 1 && item.distance.is_nan() && steps == (0..all.len()));
                    let shown = |frame| (frame != NO_FRAME).then(|| held(frame));
                    let steps = all.iter();
                    answer.trajectories.extend(
                        steps.map(|step| (shown(step.frame), step.action, step.trajectory)),
                    );
                }
                kind @ (ItemKind::Frame | ItemKind::Plan) => {
                    panic!("no built-in memory supplies a {kind:?}")
                }
            }
        }
        let sources = trace.sources[..trace.sources_len as usize].iter();
        let matched = |source: &&RecalledSource| source.kind == ItemKind::Steps as u8;
        let source = sources.clone().find(matched);
        answer.source = source.map(|source| (source.case, source.demonstration, source.first));
        assert_eq!((trace.images, trace.text), (trace.images_asked, trace.text_asked));
        assert_eq!(trace.images as usize, answer.images() - 7);
        answer
    }

    /// Runs episodes to their ends: the steps of a lane in order, everything else in the order of `choices`.
    pub(super) fn play(&mut self, episodes: &[Script], choices: impl Iterator<Item = usize>) {
        let mut lanes: BTreeMap<u32, VecDeque<&Script>> = BTreeMap::new();
        episodes.iter().for_each(|e| lanes.entry(e.config.lane).or_default().push_back(e));
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
                    self.engine.config(&script.config).unwrap();
                    self.remember(script);
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

impl Script {
    /// The same with another set of demonstrations.
    pub(super) fn remembering(mut self, set: Demonstrations) -> Self {
        self.config.demonstrations = set.bits();
        self
    }
}

/// A replayed demonstration and its origin.
pub(super) struct ReplayedDemonstration {
    pub(super) of: History,
    pub(super) poses: Vec<Pose>,
    /// Their codes, and [`NO_ACTION`] at the end.
    pub(super) actions: Vec<u8>,
}

/// Replays a set of demonstrations for a case.
pub(super) fn replay_set(
    rig: &Rig,
    case: usize,
    set: Demonstrations,
) -> Vec<ReplayedDemonstration> {
    let cases = &rig.cases;
    let demonstration = |of: History| {
        let found = cases.demonstrated(&rig.warehouse, of).expect("a demonstration");
        let actions = found.trajectory.actions.iter();
        let poses = found.replay().poses;
        let actions = actions.map(|&action| action as u8).chain([NO_ACTION]).collect();
        ReplayedDemonstration { of, poses, actions }
    };
    cases.histories(case, set).into_iter().map(demonstration).collect()
}
