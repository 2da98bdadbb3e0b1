//! Cases walked with the grounded policy, in one process.

use std::collections::VecDeque;
use std::sync::Arc;

use policy_proc::grounded::Grounded;
use policy_proc::{FrameView, PastView, Policy, Request, Segment, SegmentView};
use shm_types::{Action, Feedback, Pose};
use warehouse::{Case, CaseSet, MAX_STEPS, Progress, Start, Variant, Warehouse, step};

use crate::views::{Picture, Views, poses};

/// Every how many cases one is walked: two of each type.
const EVERY: usize = 5;

/// Window length and actions after a retrieved view (SPEC section 5).
const WINDOW: usize = 6;
const HORIZON: usize = 6;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Frames {
    Rendered,
    Blank,
    Swapped,
}

struct Walker {
    warehouse: Warehouse,
    cases: CaseSet,
    views: Views,
    poses: Vec<Pose>,
    blank: Arc<Picture>,
    policy: Grounded,
}

/// A demonstration's view, what the expert did there, and how far it had got.
struct Remembered {
    picture: Arc<Picture>,
    action: Option<Action>,
    stage: u32,
}

impl Walker {
    fn new() -> Self {
        let warehouse = Warehouse::shipped();
        let mut poses = poses(&warehouse);
        poses.sort_unstable();
        Self {
            cases: CaseSet::shipped(),
            views: Views::new(&warehouse),
            poses,
            blank: Arc::new(Picture::new(u64::MAX, 448, 448, vec![128; 448 * 448 * 4])),
            policy: Grounded::default(),
            warehouse,
        }
    }

    /// Cases solved, of those walked, from the original start.
    fn solved(&mut self, remembers: bool, frames: Frames) -> (usize, usize) {
        let cases: Vec<Case> = self.cases.cases.iter().step_by(EVERY).cloned().collect();
        let solved = cases.iter().filter(|case| self.solves(case, remembers, frames)).count();
        (solved, cases.len())
    }

    fn solves(&mut self, case: &Case, remembers: bool, frames: Frames) -> bool {
        let memory = if remembers { self.memory(case) } else { Vec::new() };
        let instruction = case.task.instruction(&self.warehouse.catalogue);
        let mut pose = case.trajectory(Start::Original).start;
        let mut feedback = Feedback::Start;
        let mut progress = Progress::new(&self.warehouse, &case.task, pose.cell);
        let mut window: VecDeque<(Arc<Picture>, Action, Feedback)> = VecDeque::new();
        for taken in 0..MAX_STEPS {
            let picture = self.look(pose, frames);
            let past: Vec<_> = window.iter().map(|past| past_view(past)).collect();
            let segment = retrieve(&memory, &picture, progress.stage(), taken);
            let request = Request {
                lane: 0,
                step: taken,
                episode_seed: 20_260_101,
                instruction: &instruction,
                pose,
                feedback,
                frame: picture.frame(),
                window: &past,
                segment: segment
                    .as_ref()
                    .map(|(distance, steps)| Segment { distance: *distance, steps }),
                documents: &[],
                trajectories: &[],
                starts_as_demonstrated: false,
            };
            let answer = self.policy.act(&[request])[0].answer;
            let action = answer.action().expect("the grounded policy always acts");
            (pose, feedback) = step(&self.warehouse.layout, &Variant::UNCHANGED, pose, action);
            window.push_back((picture, action, feedback));
            if window.len() > WINDOW {
                window.pop_front();
            }
            progress.visit(pose.cell);
            if progress.is_complete() {
                return true;
            }
        }
        false
    }

    /// The original demonstration.
    fn memory(&mut self, case: &Case) -> Vec<Remembered> {
        let replay = case.replay(&self.warehouse, Start::Original);
        let actions = case.original.actions.iter().copied().map(Some).chain([None]);
        let mut remembered = Vec::new();
        for ((&pose, action), &stage) in replay.poses.iter().zip(actions).zip(&replay.stages) {
            remembered.push(Remembered { picture: self.views.of(pose), action, stage });
        }
        remembered
    }

    fn look(&mut self, pose: Pose, frames: Frames) -> Arc<Picture> {
        match frames {
            Frames::Rendered => self.views.of(pose),
            Frames::Blank => Arc::clone(&self.blank),
            Frames::Swapped => {
                let place = self.poses.binary_search(&pose).expect("agents stand on free cells");
                self.views.of(self.poses[(place * 397 + 211) % self.poses.len()])
            }
        }
    }
}

fn past_view((picture, action, feedback): &(Arc<Picture>, Action, Feedback)) -> PastView<'_> {
    PastView { frame: picture.frame(), action: Some(*action), feedback: *feedback }
}

/// The nearest remembered view and what follows it; ties by task stage, then by elapsed steps.
fn retrieve<'a>(
    memory: &'a [Remembered],
    picture: &Picture,
    stage: u32,
    taken: u32,
) -> Option<(f32, Vec<SegmentView<'a>>)> {
    let rank = |(at, view): &(usize, &Remembered)| {
        let elapsed = (*at as u32).abs_diff(taken);
        (picture.distance(&view.picture), stage.abs_diff(view.stage), elapsed)
    };
    let (at, nearest) = memory.iter().enumerate().min_by_key(rank)?;
    let end = (at + HORIZON).min(memory.len() - 1);
    let view = |i: usize| {
        let frame: FrameView<'a> = memory[i].picture.frame();
        SegmentView { frame, action: memory[i].action.filter(|_| i < end) }
    };
    let distance = if picture.distance(&nearest.picture) == 0 { 0.0 } else { 1.0 };
    Some((distance, (at..=end).map(view).collect()))
}

#[test]
fn memory_is_followed_through_the_pixels_and_only_through_them() {
    let mut walker = Walker::new();
    let (episodic, cases) = walker.solved(true, Frames::Rendered);
    let (working, _) = walker.solved(false, Frames::Rendered);
    let (blank, _) = walker.solved(true, Frames::Blank);
    let (swapped, _) = walker.solved(true, Frames::Swapped);
    let told = format!(
        "of {cases}: episodic {episodic}, working {working}, blank {blank}, swapped {swapped}"
    );
    assert_eq!(cases, 20, "{told}");
    assert!(episodic >= 19, "{told}");
    assert!(working + 5 <= episodic, "{told}");
    assert!(blank <= 2 && swapped <= 3, "{told}");
}
