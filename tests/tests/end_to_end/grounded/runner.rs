//! Runs cases with the grounded policy in one process and counts successes.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use case_book::WorldDeclaration;
use domain::{Action, Demonstrations, DocumentKind, Feedback, MAX_STEPS, Pose, Representation};
use peer::{Item, PastView, Policy, Request, StepsView, TextView};
use policy_proc::grounded::Grounded;
use warehouse::every_pose;
use warehouse::{Case, CaseSet, Progress, TrajectoryKind, Variant, Warehouse, step};

use super::documents;
use super::recall;
use super::views::{Image, Views};

/// The frames that the policy gets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Frames {
    Rendered,
    Blank,
    Swapped,
}

/// The condition under which cases are run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Condition {
    pub(crate) memory: Representation,
    pub(crate) start: TrajectoryKind,
    /// 1 or 4.
    pub(crate) demonstrations: usize,
    pub(crate) window: usize,
    pub(crate) frames: Frames,
    /// Whether episodic segments have actions, not images alone.
    pub(crate) actions: bool,
    pub(crate) hint: bool,
}

impl Condition {
    pub(crate) fn of(memory: Representation) -> Self {
        Self {
            memory,
            start: TrajectoryKind::Original,
            demonstrations: 1,
            window: 6,
            frames: Frames::Rendered,
            actions: true,
            hint: false,
        }
    }
}

pub(crate) struct Runner {
    warehouse: Warehouse,
    cases: CaseSet,
    views: Views,
    poses: Vec<Pose>,
    blank: Arc<Image>,
    documents: HashMap<(DocumentKind, usize), (u64, String)>,
    policy: Grounded,
    world: Arc<WorldDeclaration>,
}

impl Runner {
    pub(crate) fn new() -> Self {
        let warehouse = Warehouse::shipped();
        let mut poses: Vec<Pose> = every_pose(&warehouse.layout).collect();
        poses.sort_unstable();
        Self {
            cases: CaseSet::shipped(),
            views: Views::new(&warehouse),
            poses,
            blank: Arc::new(Image::new(u64::MAX - 1, 448, 448, vec![128; 448 * 448 * 4])),
            documents: HashMap::new(),
            policy: Grounded::default(),
            world: Arc::new(warehouse::declaration()),
            warehouse,
        }
    }

    /// The number of successes among every `every`th case.
    pub(crate) fn successes(&mut self, condition: Condition, every: usize) -> usize {
        let cases: Vec<Case> = self.cases.cases.iter().step_by(every).cloned().collect();
        cases.iter().filter(|case| self.succeeds(case, condition)).count()
    }

    fn succeeds(&mut self, case: &Case, condition: Condition) -> bool {
        let starts = &TrajectoryKind::DEMONSTRATIONS[..condition.demonstrations];
        let uses_demonstrations =
            matches!(condition.memory, Representation::Episodic | Representation::FullContext);
        let memory = if uses_demonstrations {
            recall::demonstrations(&self.warehouse, &mut self.views, case, starts)
        } else {
            Vec::new()
        };
        let kinds = condition.memory.describe().documents;
        let texts: Vec<_> = kinds
            .iter()
            .map(|&kind| (kind, self.document(kind, condition.demonstrations)))
            .collect();
        let texts = texts
            .iter()
            .map(|(kind, (id, text))| Item::Text(TextView { id: (*id).into(), kind: *kind, text }));
        let instruction = case.task.instruction(&self.warehouse.catalogue);
        let variant = case.variant(condition.start);
        let mut pose = case.trajectory(condition.start).start;
        let mut feedback = Feedback::Start;
        let mut progress = Progress::new(&self.warehouse, &case.task, pose.cell);
        let mut window: VecDeque<(Arc<Image>, Action, Feedback)> = VecDeque::new();
        let views: Vec<_> = match condition.memory {
            Representation::FullContext => memory.iter().map(recall::trajectory).collect(),
            _ => Vec::new(),
        };
        let whole = views.iter().map(|steps| StepsView { distance: None, is_whole: true, steps });
        let fixed: Vec<_> = texts.chain(whole.map(Item::Steps)).collect();
        let mut stage = recall::KnownStage::default();
        for taken in 0..MAX_STEPS {
            let image = self.look(pose, &variant, condition.frames);
            let past: Vec<_> = window.iter().map(|past| past_view(past)).collect();
            let segment = is_episodic(condition)
                .then(|| {
                    let last = (taken, window.back().map(|(_, action, _)| *action));
                    recall::retrieve(&memory, &image, &mut stage, last, condition.actions)
                })
                .flatten();
            let segment = segment.as_ref().map(|(distance, steps)| StepsView {
                distance: Some(*distance),
                is_whole: false,
                steps,
            });
            let items: Vec<_> = fixed.iter().copied().chain(segment.map(Item::Steps)).collect();
            let request = Request {
                lane: 0,
                step: taken,
                episode: 1,
                repeat: 1,
                episode_seed: 20_260_101,
                instruction: &instruction,
                state: pose.into(),
                feedback: feedback.into(),
                frame: image.frame(),
                window: &past,
                items: &items,
                starts_as_demonstrated: condition.hint,
                demonstrated_elsewhere: false,
                world: &self.world,
            };
            let answer = self.policy.act(&[request])[0].answer;
            let action = answer.action().expect("the grounded policy always acts");
            let action = Action::try_from(action).expect("the warehouse has the action");
            (pose, feedback) = step(&self.warehouse.layout, &variant, pose, action);
            window.push_back((image, action, feedback));
            if window.len() > condition.window {
                window.pop_front();
            }
            progress.visit(pose.cell);
            if progress.is_complete() {
                return true;
            }
        }
        false
    }

    /// The document of `kind` built from 1 or 4 `demonstrations` of all cases, and its id.
    fn document(&mut self, kind: DocumentKind, demonstrations: usize) -> (u64, String) {
        let id = self.documents.len() as u64 + 1;
        let selection = match demonstrations {
            1 => Demonstrations::ORIGINAL,
            _ => Demonstrations::ALL,
        };
        let build = || (id, documents::document(kind, selection));
        self.documents.entry((kind, demonstrations)).or_insert_with(build).clone()
    }

    fn look(&mut self, pose: Pose, variant: &Variant, frames: Frames) -> Arc<Image> {
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

fn is_episodic(condition: Condition) -> bool {
    condition.memory == Representation::Episodic
}

fn past_view((image, action, feedback): &(Arc<Image>, Action, Feedback)) -> PastView<'_> {
    let (action, feedback) = (Some((*action).into()), (*feedback).into());
    PastView { frame: image.frame(), action, feedback }
}
