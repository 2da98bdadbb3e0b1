//! Memories that persist: arms, learning, snapshots, abandoned episodes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use case_book::{BookRequest, Demonstration, DemonstrationBook, StreamDemonstrations};
use domain::Representation::{self, Adaptive, Episodic, Working};
use domain::{
    Action, ActionCode, Arm, DemonstrationKind, Demonstrations, Feedback, FeedbackCode,
    FeedbackLevel, Pose, State,
};
use shm_types::message::{EXPERIENCE, SnapshotId};
use tempfile::TempDir;
use warehouse::case_book::write_books;
use warehouse::plan::{Planner, Prices};
use warehouse::{CaseSet, TrajectoryKind, Variant, Warehouse};

use super::super::*;
use super::rig::{Rig, Script, pose_of};
use crate::demonstrations::BankOrigin;
use crate::external::{ExternalLimits, ExternalMemories};

/// The cases of the stream.
const CASES: [u32; 3] = [3, 5, 20];

/// The index of the first demonstration that is planned: the shipped cases have four each.
const FIRST_PLANNED: u32 = 400;

/// The world variant of the second block.
const CLOSED: u32 = 102;

/// A run with one stream of two blocks; in the world of the second, the test passage of the first case is closed.
pub(super) fn library() -> DemonstrationLibrary {
    DemonstrationLibrary::new(book())
}

fn book() -> DemonstrationBook {
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
    let closed = Variant::closing(cases.cases[3].barricade.iter().copied());
    let planner = Planner::new(&warehouse, closed.clone(), Prices::EXPERT);
    let mut book = write_books(&BookRequest::default()).unwrap().demonstrations;
    let planned = CASES.map(|number| {
        let case = &cases.cases[number as usize];
        let trajectory = planner.plan(case.original.start, &case.task).unwrap();
        let replay = trajectory.replay(&warehouse, &case.task, &closed);
        assert!(!replay.poses.iter().any(|pose| closed.is_closed(pose.cell)));
        let states = replay.poses.len() as u32;
        book.demonstrations.push(Demonstration {
            case: number,
            kind: DemonstrationKind::Original,
            variant: CLOSED,
            instruction: book.cases[number as usize].instruction.clone(),
            states: replay.poses.into_iter().map(State::from).collect(),
            feedback: replay.feedback.into_iter().map(FeedbackCode::from).collect(),
            sub_goals: replay.goal_steps,
            actions: trajectory.actions.into_iter().map(ActionCode::from).collect(),
            // None is one of the unchanged world.
            views: (0..states).map(|step| 100_000 + 1000 * number + step).collect(),
        });
        book.demonstrations.len() as u32 - 1
    });
    let original = CASES.map(|number| book.cases[number as usize].own[0]);
    book.streams.push(StreamDemonstrations {
        cases: CASES.to_vec(),
        planned: vec![original.to_vec(), planned.to_vec()],
    });
    book.variants.insert(CLOSED, "closed".to_owned());
    book
}

/// A run with a stream, its folder of snapshots, and what has been reported.
struct StreamRig {
    rig: Rig,
    folder: TempDir,
    last: SnapshotId,
    next_id: u64,
}

impl StreamRig {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let rig = Rig::with(Self::engine(folder.path()));
        Self { rig, folder, last: SnapshotId::default(), next_id: 0 }
    }

    fn engine(folder: &Path) -> Engine<Pose> {
        let externals = ExternalMemories::new(BTreeMap::new(), ExternalLimits::default());
        let snapshots = SnapshotFolder::new(folder.to_owned());
        let embeddings = EmbeddingCache::in_memory();
        Engine::new(library(), 2, 300, embeddings, externals, Some(snapshots))
    }

    /// The process is started again.
    fn restart(&mut self) {
        self.rig = self.rig.restarted(Self::engine(self.folder.path()));
    }

    /// An episode of the sequence, from the test start of a case.
    fn script(&mut self, case: u32, arm: Arm, memory: Representation) -> Script {
        self.next_id += 1;
        let mut script = self.rig.script(0, self.next_id, case, TrajectoryKind::Test, memory);
        script.config.demonstrations = Demonstrations::ORIGINAL.bits();
        script.config.sequence = 77;
        script.config.snapshot = self.last;
        script.config.arm = arm as u8;
        script.config.position = self.next_id as u32;
        script.config.feedback = FeedbackLevel::Success as u8;
        script
    }

    fn learning(&mut self, case: u32) -> Script {
        let mut script = self.script(case, Arm::Learning, Adaptive);
        script.config.learns = 1;
        script
    }

    /// Plays an episode that is learned from to its end.
    fn learn(&mut self, script: &Script) -> SnapshotReport {
        self.rig.play(std::slice::from_ref(script), std::iter::empty());
        self.rig.collect();
        assert_eq!(self.rig.engine.take_failures(), []);
        let reports = self.rig.engine.take_snapshot_reports();
        let [report] = reports[..] else { panic!("{reports:?}") };
        assert_eq!((report.episode, report.lane), (script.config.episode, 0));
        assert_ne!(report.snapshot, self.last);
        self.last = report.snapshot;
        report
    }

    /// What an episode that is not learned from is supplied: case, demonstration and step of each step's source.
    fn sources(&mut self, script: &Script) -> Vec<(u32, u16, u16)> {
        self.rig.answers.clear();
        self.rig.play(std::slice::from_ref(script), std::iter::empty());
        assert!(self.rig.engine.take_snapshot_reports().is_empty());
        assert_eq!(self.rig.engine.take_failures(), []);
        assert_eq!(self.rig.answers.len(), script.poses.len() - 1);
        self.rig.answers.values().map(|answer| answer.source.unwrap()).collect()
    }

    fn snapshot(&self, id: SnapshotId) -> PathBuf {
        self.folder.path().join(format!("{:016x}", 77)).join(domain::hex(&id))
    }

    /// The reason why an episode gets no answer.
    fn failure(&mut self, script: &Script) -> String {
        self.rig.engine.config(&script.config).unwrap();
        self.rig.observe(script.observations[0]).unwrap();
        while self.rig.work(0) {
            assert!(self.rig.collect().is_empty());
        }
        assert!(self.rig.collect().is_empty());
        let failures = self.rig.engine.take_failures();
        let [EpisodeFailure { episode, why, .. }] = &failures[..] else { panic!("{failures:?}") };
        assert_eq!(*episode, script.config.episode);
        why.clone()
    }
}

#[test]
fn an_arm_decides_what_the_memory_is_built_from() {
    let all = library();
    let bank = |arm, block| all.of_bank(BankOrigin::new(arm, 0, block, Demonstrations::ORIGINAL));
    let of = |made: &[std::sync::Arc<crate::demonstrations::RememberedDemonstration>]| -> Vec<_> {
        made.iter()
            .map(|made| (made.case, made.number, made.views[0].number >= FIRST_PLANNED))
            .collect()
    };
    let original = CASES.map(|case| (case, 0, false));
    for (arm, block) in [(Arm::Frozen, 0), (Arm::Frozen, 1), (Arm::Learning, 1), (Arm::Oracle, 0)] {
        assert_eq!(of(&bank(arm, block).unwrap()), original, "{arm:?}");
    }
    let planned = bank(Arm::Oracle, 1).unwrap();
    assert_eq!(of(&planned), original.map(|(case, number, _)| (case, number, true)));
    let (book, wrong) = (book(), bank(Arm::Wrong, 0).unwrap());
    assert!((1..=6).contains(&wrong.len()));
    for made in wrong {
        assert!(!CASES.contains(&made.case));
        let irrelevant =
            CASES.iter().flat_map(|&case| book.cases[case as usize].irrelevant.clone());
        let mut irrelevant = irrelevant.map(|index| &book.demonstrations[index as usize]);
        assert!(irrelevant.any(|of| (of.case, of.kind as u16) == (made.case, made.number)));
    }
    let unknown = BankOrigin::new(Arm::Frozen, 1, 0, Demonstrations::ORIGINAL);
    assert!(all.of_bank(unknown).unwrap_err().contains("stream 1 of 1"));
}

#[test]
fn a_memory_of_a_stream_is_embedded_once_and_pins_only_what_it_recalls() {
    let mut run = StreamRig::new();
    let first = run.script(3, Arm::Frozen, Episodic);
    run.sources(&first);
    let views = run.rig.embedded;
    assert!(views > 64, "the bank's views and the agent's own: {views}");
    assert_eq!(run.rig.pins, run.rig.releases);
    let pins = run.rig.pins;
    let second = run.script(5, Arm::Frozen, Episodic);
    run.sources(&second);
    assert!(run.rig.pins - pins < 64 + second.poses.len(), "the bank is not pinned again");
    let mut other = run.script(5, Arm::Frozen, Working);
    other.config.sequence = 78;
    run.rig.play(&[other], std::iter::empty());
    assert_eq!(run.rig.engine.take_failures(), []);
}

#[test]
fn what_an_episode_taught_is_supplied_in_the_next_and_after_a_restart() {
    let mut run = StreamRig::new();
    let before = run.script(3, Arm::Learning, Adaptive);
    let frozen = run.sources(&before);
    assert!(frozen.iter().all(|&(case, number, _)| (case, number) == (3, 0)));
    let lesson = run.learning(3);
    let report = run.learn(&lesson);
    assert!(report.store_bytes > 0);
    let again = run.script(3, Arm::Learning, Adaptive);
    let learned = run.sources(&again);
    for (step, source) in learned.iter().enumerate() {
        let own = (lesson.config.position, EXPERIENCE, step as u16);
        assert_eq!(*source, own, "the own episode is the nearest");
    }
    // The same after a restart, for another learning episode as well.
    let answers = run.rig.answers.clone();
    run.restart();
    run.next_id -= 1;
    let again = run.script(3, Arm::Learning, Adaptive);
    assert_eq!(run.sources(&again), learned);
    assert_eq!(run.rig.answers, answers);
    let next = run.learning(5);
    let continued = run.learn(&next).snapshot;
    run.last = report.snapshot;
    run.restart();
    assert_eq!(run.learn(&next).snapshot, continued, "the same content, the same name");
    // Another arm of the sequence's stream knows nothing of it.
    let mut frozen_arm = run.script(3, Arm::Frozen, Adaptive);
    (frozen_arm.config.sequence, frozen_arm.config.snapshot) = (78, SnapshotId::default());
    assert_eq!(run.sources(&frozen_arm), frozen);
}

#[test]
fn an_abandoned_episode_teaches_nothing() {
    let mut run = StreamRig::new();
    let first = run.learning(3);
    run.learn(&first);
    let expected = {
        let script = run.script(20, Arm::Learning, Adaptive);
        run.sources(&script)
    };
    let abandoned = run.learning(20);
    run.rig.answers.clear();
    run.rig.engine.config(&abandoned.config).unwrap();
    for seen in &abandoned.observations[..5] {
        run.rig.observe(*seen).unwrap();
        while run.rig.work(0) || run.rig.answers.len() as u32 == seen.step {
            run.rig.collect();
        }
    }
    let script = run.script(20, Arm::Learning, Adaptive);
    assert_eq!(run.sources(&script), expected);
    // An episode of an earlier snapshot gets just that.
    let second = run.learning(20);
    let earlier = run.last;
    run.learn(&second);
    run.last = earlier;
    let script = run.script(20, Arm::Learning, Adaptive);
    assert_eq!(run.sources(&script), expected);
}

#[test]
fn a_torn_or_missing_snapshot_is_never_loaded() {
    let mut run = StreamRig::new();
    let lesson = run.learning(3);
    run.learn(&lesson);
    let file = run.snapshot(run.last).join("experience.json");
    let text = fs::read(&file).unwrap();
    fs::write(&file, &text[..text.len() - 1]).unwrap();
    let script = run.script(3, Arm::Learning, Adaptive);
    assert_eq!(run.sources(&script).len(), script.poses.len() - 1, "it is still in memory");
    run.restart();
    let script = run.script(3, Arm::Learning, Adaptive);
    let why = run.failure(&script);
    assert!(why.contains("is damaged") && why.contains("--fresh"), "{why}");
    fs::remove_dir_all(run.snapshot(run.last)).unwrap();
    let script = run.script(3, Arm::Learning, Adaptive);
    assert!(run.failure(&script).contains("is missing"));
    fs::create_dir(run.snapshot(run.last)).unwrap();
    let script = run.script(3, Arm::Learning, Adaptive);
    assert!(run.failure(&script).contains("is damaged"));
    // The sequence begins anew.
    run.last = SnapshotId::default();
    run.learn(&lesson);
    let entries = fs::read_dir(run.snapshot(run.last).parent().unwrap()).unwrap();
    assert_eq!(entries.count(), 1, "what is neither this snapshot nor the one before is removed");
}

#[test]
fn an_experience_is_read_again_as_it_was() {
    let mut run = StreamRig::new();
    let mut lesson = run.learning(20);
    lesson.config.variant = 102;
    // An answer that could not be read, after three steps.
    let mut seen = lesson.observations.clone();
    seen.truncate(5);
    seen[3].state = seen[2].state;
    (seen[3].action, seen[3].feedback) = (u8::MAX, Feedback::NotUnderstood as u8);
    seen[4].state = seen[3].state;
    (seen[4].action, seen[4].feedback) = (Action::TurnAround as u8, Feedback::Turned as u8);
    let turned = {
        let mut pose = pose_of(&seen[4].state);
        pose.heading = pose.heading.turned(2);
        pose
    };
    seen[4].state = State::from(turned).padded();
    seen[4].last = 1;
    lesson.observations = seen;
    run.learn(&lesson);
    let bank = |run: &mut StreamRig| {
        let known = run.rig.engine.sequences.of(77).unwrap();
        known.bank.demonstrations.last().unwrap().clone()
    };
    let lived = bank(&mut run);
    assert_eq!((lived.case, lived.number), (1, EXPERIENCE));
    assert_eq!(lived.actions[2..], [None, Some(Action::TurnAround.into())]);
    run.restart();
    let script = run.script(3, Arm::Learning, Adaptive);
    run.sources(&script);
    assert_eq!(bank(&mut run), lived);
}

#[test]
fn what_a_stream_needs_is_checked() {
    let mut run = StreamRig::new();
    let script = run.learning(3);
    let mut refuse = |config: MemoryEpisodeConfig, expected: &str| {
        let error = run.rig.engine.config(&config).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    refuse(MemoryEpisodeConfig { arm: 4, ..script.config }, "4 is not an arm");
    refuse(MemoryEpisodeConfig { feedback: 3, ..script.config }, "3 is not a feedback level");
    refuse(MemoryEpisodeConfig { variant: 103, ..script.config }, "no world variant 103");
    let mut other = run.script(3, Arm::Learning, Adaptive);
    other.config.stream = 4;
    assert!(run.failure(&other).contains("stream 4 of 1"));
    let mut without = Rig::new(1, 300);
    let error = without.engine.config(&script.config).unwrap_err().to_string();
    assert!(error.contains("without --snapshots"), "{error}");
}
