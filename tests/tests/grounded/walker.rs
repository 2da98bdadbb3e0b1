//! Walks cases with the grounded policy, in one process, and counts what is solved.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use domain::{Action, DocumentKind, Feedback, Pose, Representation};
use policy_proc::grounded::Grounded;
use policy_proc::{DocumentView, PastView, Policy, Request, Segment, Trajectory};
use warehouse::{
    Case, CaseSet, Demonstrations, MAX_STEPS, Progress, Start, Variant, Warehouse, step,
};

use crate::documents;
use crate::supply;
use crate::views::{Picture, Views, poses};

/// What is shown to the policy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Frames {
    Rendered,
    Blank,
    Swapped,
}

/// How cases are walked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Setup {
    pub(crate) memory: Representation,
    pub(crate) start: Start,
    /// 1 or 4.
    pub(crate) demonstrations: usize,
    pub(crate) window: usize,
    pub(crate) frames: Frames,
    /// Episodic segments with actions, not with images alone.
    pub(crate) actions: bool,
    pub(crate) hint: bool,
}

impl Setup {
    pub(crate) fn of(memory: Representation) -> Self {
        Self {
            memory,
            start: Start::Original,
            demonstrations: 1,
            window: 6,
            frames: Frames::Rendered,
            actions: true,
            hint: false,
        }
    }
}

pub(crate) struct Walker {
    warehouse: Warehouse,
    cases: CaseSet,
    views: Views,
    poses: Vec<Pose>,
    blank: Arc<Picture>,
    documents: HashMap<(DocumentKind, usize), (u64, String)>,
    policy: Grounded,
}

impl Walker {
    pub(crate) fn new() -> Self {
        let warehouse = Warehouse::shipped();
        let mut poses = poses(&warehouse);
        poses.sort_unstable();
        Self {
            cases: CaseSet::shipped(),
            views: Views::new(&warehouse),
            poses,
            blank: Arc::new(Picture::new(u64::MAX - 1, 448, 448, vec![128; 448 * 448 * 4])),
            documents: HashMap::new(),
            policy: Grounded::default(),
            warehouse,
        }
    }

    /// Cases solved, of every `every`th.
    pub(crate) fn solved(&mut self, setup: Setup, every: usize) -> usize {
        let cases: Vec<Case> = self.cases.cases.iter().step_by(every).cloned().collect();
        cases.iter().filter(|case| self.solves(case, setup)).count()
    }

    fn solves(&mut self, case: &Case, setup: Setup) -> bool {
        let starts = &Start::DEMONSTRATIONS[..setup.demonstrations];
        let remembers =
            matches!(setup.memory, Representation::Episodic | Representation::FullContext);
        let memory = if remembers {
            supply::demonstrations(&self.warehouse, &mut self.views, case, starts)
        } else {
            Vec::new()
        };
        let kinds = setup.memory.describe().documents;
        let texts: Vec<_> =
            kinds.iter().map(|&kind| (kind, self.document(kind, setup.demonstrations))).collect();
        let documents: Vec<_> = texts
            .iter()
            .map(|(kind, (id, text))| DocumentView { id: *id, kind: *kind, text })
            .collect();
        let instruction = case.task.instruction(&self.warehouse.catalogue);
        let variant = case.variant(setup.start);
        let mut pose = case.trajectory(setup.start).start;
        let mut feedback = Feedback::Start;
        let mut progress = Progress::new(&self.warehouse, &case.task, pose.cell);
        let mut window: VecDeque<(Arc<Picture>, Action, Feedback)> = VecDeque::new();
        let views: Vec<_> = match setup.memory {
            Representation::FullContext => memory.iter().map(supply::trajectory).collect(),
            _ => Vec::new(),
        };
        let trajectories: Vec<_> = views.iter().map(|steps| Trajectory { steps }).collect();
        for taken in 0..MAX_STEPS {
            let picture = self.look(pose, &variant, setup.frames);
            let past: Vec<_> = window.iter().map(|past| past_view(past)).collect();
            let segment = is_episodic(setup)
                .then(|| {
                    supply::retrieve(&memory, &picture, progress.stage(), taken, setup.actions)
                })
                .flatten();
            let request = Request {
                lane: 0,
                step: taken,
                episode: 1,
                repeat: 1,
                episode_seed: 20_260_101,
                instruction: &instruction,
                pose,
                feedback,
                frame: picture.frame(),
                window: &past,
                segment: segment
                    .as_ref()
                    .map(|(distance, steps)| Segment { distance: *distance, steps }),
                documents: &documents,
                trajectories: &trajectories,
                starts_as_demonstrated: setup.hint,
            };
            let answer = self.policy.act(&[request])[0].answer;
            let action = answer.action().expect("the grounded policy always acts");
            (pose, feedback) = step(&self.warehouse.layout, &variant, pose, action);
            window.push_back((picture, action, feedback));
            if window.len() > setup.window {
                window.pop_front();
            }
            progress.visit(pose.cell);
            if progress.is_complete() {
                return true;
            }
        }
        false
    }

    /// The document of `kind` made of 1 or 4 `demonstrations` of every case, and its id.
    fn document(&mut self, kind: DocumentKind, demonstrations: usize) -> (u64, String) {
        let id = self.documents.len() as u64 + 1;
        let selection = match demonstrations {
            1 => Demonstrations::ORIGINAL,
            _ => Demonstrations::ALL,
        };
        let write = || (id, documents::document(kind, selection, &mut self.views));
        self.documents.entry((kind, demonstrations)).or_insert_with(write).clone()
    }

    fn look(&mut self, pose: Pose, variant: &Variant, frames: Frames) -> Arc<Picture> {
        match frames {
            Frames::Rendered => self.views.of(pose, variant),
            Frames::Blank => Arc::clone(&self.blank),
            Frames::Swapped => {
                let place = self.poses.binary_search(&pose).expect("agents stand on free cells");
                let other = self.poses[(place * 397 + 211) % self.poses.len()];
                self.views.of(other, variant)
            }
        }
    }
}

fn is_episodic(setup: Setup) -> bool {
    setup.memory == Representation::Episodic
}

fn past_view((picture, action, feedback): &(Arc<Picture>, Action, Feedback)) -> PastView<'_> {
    PastView { frame: picture.frame(), action: Some(*action), feedback: *feedback }
}
