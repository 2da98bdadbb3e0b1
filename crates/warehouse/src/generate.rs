//! Generates cases from a seed: draws a task and a start, then the other five starts and the barricade, until every
//! constraint holds.
//!
//! Each case draws from its own stream, so the first cases of a larger set are those of a smaller one, apart from cases that
//! are drawn again because the set offers too few histories for them. The seed alone
//! determines the order in which candidates are tried.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use domain::{Cell, DemonstrationKind, Heading, Pose};

use crate::case::{Case, CaseSet, History};
use crate::constraints::{
    FloorEdge, completes_task, edges, enters, faces_targets, is_distant, is_near_optimal,
    is_nearby, is_of_similar_length, shares_at_least_half, shares_at_most_half, target_in_view,
    target_on,
};
use crate::draw::Draw;
use crate::dynamics::Variant;
use crate::layout::Layout;
use crate::mixed::{self, TooFew};
use crate::plan::{Planner, Prices};
use crate::sight::shows_face;
use crate::task::Task;
use crate::task_type::TaskType;
use crate::trajectory::{Replay, Trajectory};
use crate::world::{Item, Warehouse};

/// The seed of the shipped cases.
pub const SHIPPED_SEED: u64 = 1;

/// How many cases are shipped.
pub const SHIPPED_COUNT: usize = 100;

/// Lengths of original demonstrations, in steps. Short ones need no memory; long ones leave no room for detours within the
/// step limit.
const ORIGINAL_STEPS: std::ops::RangeInclusive<u32> = 10..=80;

/// Minimum number of steps of any trajectory.
pub(crate) const LEAST_STEPS: u32 = 6;

/// Maximum number of steps of the blocked reference, which is longer than the test reference.
pub(crate) const MOST_BLOCKED_STEPS: u32 = 120;

/// Minimum distance between the test start and every demonstration's start, in cells.
const TEST_CELLS: u32 = 3;

/// Original starts tried for a choice of targets, and choices of targets tried for a case.
const STARTS_TRIED: usize = 100;
const TARGETS_TRIED: usize = 50;

/// Test starts tried for an original start.
const TESTS_TRIED: usize = 60;

/// Cases of a set that are drawn again for want of histories of other tasks.
const REDRAWN: usize = 100;

/// Planners that are kept at a time, of up to 7 MB each in the largest warehouse.
const MOST_DETOURS: usize = 32;

/// A placeholder until the whole set exists, from which histories are chosen.
const NO_HISTORIES: [History; 2] =
    [History { case: usize::MAX, kind: DemonstrationKind::Original }; 2];

/// The most cases of a set, far more than a run needs.
pub const MAX_CASES: usize = 1_000_000;

/// Why a warehouse or a set of cases cannot be generated.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct GenerateError(pub(crate) String);

impl CaseSet {
    /// Generates `count` cases, a tenth of each type, and one more of the first types if ten does not divide `count`. Ids
    /// count within the type: `t03-07` is the seventh case of type 3.
    ///
    /// Histories of other tasks are chosen from the whole set, so they change with its size. A case for which the others
    /// offer too few is drawn again, at most 100 times over the whole set.
    ///
    /// # Errors
    /// When there are more than [`MAX_CASES`], the warehouse allows no case of some type, or there are too few cases to choose
    /// histories from.
    pub fn generate(warehouse: &Warehouse, seed: u64, count: usize) -> Result<Self, GenerateError> {
        if count > MAX_CASES {
            let message = format!("{count} cases are too many: at most {MAX_CASES}");
            return Err(GenerateError(message));
        }
        let generator = Generator::new(warehouse, seed);
        let width = count.div_ceil(10).to_string().len().max(2);
        let mut cases: Vec<Case> = Vec::new();
        for task_type in TaskType::ALL {
            let number = task_type.number();
            let of_type = (count + 10 - usize::from(number)) / 10;
            let choices = generator.target_choices(task_type);
            let first = cases.len();
            for index in 0..of_type {
                let mut case = generator.case(task_type, index, 0, &choices, &cases[first..])?;
                case.id = format!("t{number:02}-{:0width$}", index + 1);
                cases.push(case);
            }
        }
        let mut set = Self { seed, cases, elsewhere: None };
        for redrawn in 0.. {
            let Err(TooFew { case: at, mixture, found }) = mixed::assign(warehouse, &mut set)
            else {
                break;
            };
            if redrawn == REDRAWN {
                return Err(GenerateError(format!(
                    "case {} needs two {} histories and the other {} cases offer {found}; generate a larger set, \
                     or use another seed",
                    set.cases[at].id,
                    mixture.name(),
                    count - 1
                )));
            }
            let task_type = set.cases[at].task.task_type();
            let is_of_type = |case: &Case| case.task.task_type() == task_type;
            let first = set.cases.iter().position(is_of_type).unwrap_or(at);
            let last = set.cases.iter().rposition(is_of_type).unwrap_or(at);
            let choices = generator.target_choices(task_type);
            let taken = &set.cases[first..=last];
            let case = generator.case(task_type, at - first, redrawn + 1, &choices, taken)?;
            set.cases[at] = Case { id: std::mem::take(&mut set.cases[at].id), ..case };
        }
        Ok(set)
    }
}

/// Whether `pose` shows the face of one of `targets`. What shows a target's face shows the target; what shows the target
/// otherwise is left out only where a case is complete, so that a seed gives the cases that it gave when only faces counted,
/// wherever these satisfy the constraint.
fn shows_a_face(layout: &Layout, pose: Pose, targets: &[&Item]) -> bool {
    targets.iter().any(|item| shows_face(layout, pose, item))
}

pub(crate) struct Generator<'w> {
    warehouse: &'w Warehouse,
    seed: u64,
    expert: Planner<'w>,
    fewest: Planner<'w>,
    poses: Vec<Pose>,
    passages: Vec<Vec<Cell>>,
    detours: RefCell<Detours<'w>>,
}

/// Planners of the latest task with a passage closed, by the number of the passage. A task tries the same passages for many
/// starts, and most of the work of a plan does not depend on the start.
#[derive(Default)]
struct Detours<'w> {
    task: Option<Task>,
    planners: BTreeMap<usize, Rc<Planner<'w>>>,
}

/// A planned trajectory with what the constraints need to know about it.
struct Candidate {
    trajectory: Trajectory,
    replay: Replay,
    length: u32,
    edges: Vec<FloorEdge>,
}

impl<'w> Generator<'w> {
    pub(crate) fn new(warehouse: &'w Warehouse, seed: u64) -> Self {
        let facing = |cell| Heading::ALL.map(|heading| Pose { cell, heading });
        Self {
            warehouse,
            seed,
            expert: Planner::new(warehouse, Variant::UNCHANGED, Prices::EXPERT),
            fewest: Planner::new(warehouse, Variant::UNCHANGED, Prices::STEPS),
            poses: warehouse.layout.free_cells().flat_map(facing).collect(),
            passages: warehouse.layout.passages(),
            detours: RefCell::default(),
        }
    }

    /// The possible targets of tasks of `task_type`, in the order in which cases use them: types with at least two
    /// instances if every one must be visited, categories, or any types.
    fn target_choices(&self, task_type: TaskType) -> Vec<usize> {
        let types = 0..self.warehouse.catalogue.types.len();
        let choices = match task_type {
            TaskType::FindCategory | TaskType::EveryOfCategory => {
                (0..self.warehouse.catalogue.categories.len()).collect()
            }
            TaskType::EveryOfType | TaskType::EveryAndReturn => {
                types.filter(|&a| self.warehouse.instances(a).count() >= 2).collect()
            }
            TaskType::FindType
            | TaskType::BothTypes
            | TaskType::InOrder
            | TaskType::FindAndReturn
            | TaskType::Revisit
            | TaskType::InOrderAndReturn => types.collect(),
        };
        Draw::new(self.seed, u64::from(task_type.number()) << 32).shuffled(choices)
    }

    /// Case `index` of `task_type`, different from those in `taken`; another one for each value of `redrawn`.
    fn case(
        &self,
        task_type: TaskType,
        index: usize,
        redrawn: usize,
        choices: &[usize],
        taken: &[Case],
    ) -> Result<Case, GenerateError> {
        let stream =
            (redrawn as u64) << 40 | u64::from(task_type.number()) << 32 | (index as u64 + 1);
        let mut draw = Draw::new(self.seed, stream);
        let turns = if choices.is_empty() { 0 } else { TARGETS_TRIED };
        for turn in 0..turns {
            let choice = choices[(index + redrawn + turn) % choices.len()];
            let task = self.task(task_type, choice, &mut draw);
            let Some(task) = task else { continue };
            for _ in 0..STARTS_TRIED {
                let start = draw.pick(&self.poses);
                let known = |case: &Case| case.task == task && case.original.start == start;
                if taken.iter().any(known) {
                    continue;
                }
                if let Some(case) = self.case_from(task, start, &mut draw) {
                    return Ok(case);
                }
            }
        }
        let (number, name) = (task_type.number(), task_type.name());
        Err(GenerateError(format!(
            "no case of type {number} ({name}) found for seed {} after {TARGETS_TRIED} choices of targets with \
             {STARTS_TRIED} starts each; the warehouse has too few items, aisles or passages for it",
            self.seed
        )))
    }

    /// A task of `task_type` for `a`. A second type is drawn.
    fn task(&self, task_type: TaskType, a: usize, draw: &mut Draw) -> Option<Task> {
        let others =
            (0..self.warehouse.catalogue.types.len()).filter(|&b| b != a).collect::<Vec<_>>();
        if others.is_empty() {
            return None;
        }
        Some(match task_type {
            TaskType::FindType => Task::FindType { a },
            TaskType::FindCategory => Task::FindCategory { c: a },
            TaskType::EveryOfType => Task::EveryOfType { a },
            TaskType::EveryOfCategory => Task::EveryOfCategory { c: a },
            TaskType::BothTypes => Task::BothTypes { a, b: draw.pick(&others) },
            TaskType::InOrder => Task::InOrder { a, b: draw.pick(&others) },
            TaskType::FindAndReturn => Task::FindAndReturn { a },
            TaskType::EveryAndReturn => Task::EveryAndReturn { a },
            TaskType::Revisit => Task::Revisit { a, b: draw.pick(&others) },
            TaskType::InOrderAndReturn => Task::InOrderAndReturn { a, b: draw.pick(&others) },
        })
    }

    /// A case of `task` from `start`, if there is one that satisfies all constraints.
    fn case_from(&self, task: Task, start: Pose, draw: &mut Draw) -> Option<Case> {
        let layout = &self.warehouse.layout;
        let targets = task.targets(self.warehouse);
        let original = self.original(&task, start, &targets)?;
        let turned = Pose { heading: start.heading.opposite(), ..start };
        let opposite = self.candidate(&task, turned, &targets)?;
        let nearby = self.first_candidate(
            &task,
            &targets,
            draw,
            &|pose| is_nearby(layout, start, pose),
            &|candidate| shares_at_least_half(&original.edges, &candidate.edges),
        )?;
        let distant = self.first_candidate(
            &task,
            &targets,
            draw,
            &|pose| is_distant(layout, start, pose),
            &|candidate| shares_at_most_half(&original.edges, &candidate.edges),
        )?;
        let demonstrations = [&original, &opposite, &nearby, &distant];

        let is_new = |pose: &Pose| {
            let far = |candidate: &&Candidate| {
                candidate.trajectory.start.cell.distance(pose.cell) >= TEST_CELLS
            };
            demonstrations.iter().all(far) && !shows_a_face(layout, *pose, &targets)
        };
        let tests: Vec<Pose> = self.poses.iter().copied().filter(is_new).collect();
        for pose in draw.shuffled(tests).into_iter().take(TESTS_TRIED) {
            let Some(test) = self.candidate(&task, pose, &targets) else { continue };
            if !is_of_similar_length(original.length, test.length) {
                continue;
            }
            if let Some((blocked, barricade)) =
                self.blocked(&task, &targets, &test, &demonstrations, draw)
            {
                if target_in_view(self.warehouse, start, &targets).is_some() {
                    return None;
                }
                if target_in_view(self.warehouse, pose, &targets).is_some() {
                    continue;
                }
                let [original, opposite, nearby, distant, test] =
                    [original, opposite, nearby, distant, test]
                        .map(|candidate| candidate.trajectory);
                let id = String::new();
                return Some(Case {
                    id,
                    task,
                    original,
                    opposite,
                    nearby,
                    distant,
                    test,
                    blocked,
                    barricade,
                    irrelevant: NO_HISTORIES,
                    confusable: NO_HISTORIES,
                });
            }
        }
        None
    }

    /// A demonstration of `task` from a start that is drawn, with the constraints on an original demonstration.
    pub(crate) fn demonstration(&self, task: &Task, draw: &mut Draw) -> Option<Trajectory> {
        let targets = task.targets(self.warehouse);
        let found = draw.shuffled(self.poses.clone()).into_iter();
        let shows_none = |start: &Pose| target_in_view(self.warehouse, *start, &targets).is_none();
        let mut found = found.take(STARTS_TRIED).filter(shows_none);
        let found = found.find_map(|start| self.original(task, start, &targets));
        found.map(|candidate| candidate.trajectory)
    }

    /// The original demonstration from `start`, if that shows no target's face and it is neither too short nor too long.
    fn original(&self, task: &Task, start: Pose, targets: &[&Item]) -> Option<Candidate> {
        if shows_a_face(&self.warehouse.layout, start, targets) {
            return None;
        }
        self.candidate(task, start, targets)
            .filter(|original| ORIGINAL_STEPS.contains(&original.length))
    }

    /// The first trajectory, in random order of starts, with both properties.
    fn first_candidate(
        &self,
        task: &Task,
        targets: &[&Item],
        draw: &mut Draw,
        is_start: &dyn Fn(Pose) -> bool,
        is_accepted: &dyn Fn(&Candidate) -> bool,
    ) -> Option<Candidate> {
        let starts = self.poses.iter().copied().filter(|&pose| is_start(pose)).collect();
        let mut starts = draw.shuffled(starts).into_iter();
        starts.find_map(|start| self.candidate(task, start, targets).filter(is_accepted))
    }

    /// A passage that `test` and a demonstration use, and the reference that avoids it.
    fn blocked(
        &self,
        task: &Task,
        targets: &[&Item],
        test: &Candidate,
        demonstrations: &[&Candidate],
        draw: &mut Draw,
    ) -> Option<(Trajectory, Vec<Cell>)> {
        let start = test.trajectory.start;
        let fits = |&passage: &usize| {
            let cells = &self.passages[passage];
            enters(&test.replay.poses, cells)
                && demonstrations.iter().any(|candidate| enters(&candidate.replay.poses, cells))
                && !cells.contains(&start.cell)
                && target_on(cells, targets).is_none()
                && {
                    let reached = self.warehouse.layout.reachable(start.cell, cells);
                    targets.iter().all(|item| reached.binary_search(&item.standpoint).is_ok())
                }
        };
        let passages = (0..self.passages.len()).filter(fits).collect();
        draw.shuffled(passages).into_iter().find_map(|passage| {
            let cells = &self.passages[passage];
            let variant = Variant::closing(cells.iter().copied());
            let expert = self.detour(task, passage);
            let candidate = self.candidate_in(&expert, &variant, task, start, |length| {
                // Closing a passage never shortens a route, so the cheap bound decides in most cases.
                let unchanged = self.fewest.cost(start, task)?;
                if is_near_optimal(length, unchanged) {
                    return Some(unchanged);
                }
                Planner::new(self.warehouse, variant.clone(), Prices::STEPS).cost(start, task)
            })?;
            let detours = candidate.length > test.length && candidate.length <= MOST_BLOCKED_STEPS;
            detours.then(|| (candidate.trajectory, cells.clone()))
        })
    }

    /// The expert with `passage` closed.
    fn detour(&self, task: &Task, passage: usize) -> Rc<Planner<'w>> {
        let mut detours = self.detours.borrow_mut();
        let is_full =
            detours.planners.len() == MOST_DETOURS && !detours.planners.contains_key(&passage);
        if detours.task != Some(*task) || is_full {
            *detours = Detours { task: Some(*task), planners: BTreeMap::new() };
        }
        let planner = detours.planners.entry(passage).or_insert_with(|| {
            let variant = Variant::closing(self.passages[passage].iter().copied());
            Rc::new(Planner::new(self.warehouse, variant, Prices::EXPERT))
        });
        Rc::clone(planner)
    }

    /// The expert's trajectory in the unchanged world, if it satisfies the constraints on all trajectories.
    fn candidate(&self, task: &Task, start: Pose, targets: &[&Item]) -> Option<Candidate> {
        if target_on(&[start.cell], targets).is_some() {
            return None;
        }
        self.candidate_in(&self.expert, &Variant::UNCHANGED, task, start, |_| {
            self.fewest.cost(start, task)
        })
    }

    /// The trajectory of `expert` in `variant`, if it satisfies the constraints on all trajectories. `fewest` is a lower bound
    /// of the steps needed, and exact where a trajectory of the given length is rejected because of it.
    fn candidate_in(
        &self,
        expert: &Planner<'_>,
        variant: &Variant,
        task: &Task,
        start: Pose,
        fewest: impl Fn(u32) -> Option<u32>,
    ) -> Option<Candidate> {
        let trajectory = expert.plan(start, task)?;
        let replay = trajectory.replay(self.warehouse, task, variant);
        let length = completes_task(&replay).ok()?;
        faces_targets(self.warehouse, task, &replay).ok()?;
        let good = length >= LEAST_STEPS && is_near_optimal(length, fewest(length)?);
        good.then(|| {
            let edges = edges(&replay.poses);
            Candidate { trajectory, replay, length, edges }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::tiny;

    #[test]
    fn a_larger_set_begins_with_the_cases_of_a_smaller_one() {
        let warehouse = Warehouse::shipped();
        let (few, more) = (
            CaseSet::generate(&warehouse, 3, 40).unwrap(),
            CaseSet::generate(&warehouse, 3, 57).unwrap(),
        );
        assert_eq!(few.cases.len(), 40);
        assert_eq!(more.cases.len(), 57);
        for case in &few.cases {
            // Histories are chosen from the whole set.
            let same = more.case(&case.id).map(|same| Case {
                irrelevant: case.irrelevant,
                confusable: case.confusable,
                ..same.clone()
            });
            assert_eq!(same.as_ref(), Some(case));
        }
        let of_type =
            |task_type| more.cases.iter().filter(|case| case.task.task_type() == task_type).count();
        assert_eq!(TaskType::ALL.map(of_type), [6, 6, 6, 6, 6, 6, 6, 5, 5, 5]);
    }

    #[test]
    fn more_cases_than_a_set_has_are_refused() {
        let warehouse = Warehouse::shipped();
        for count in [MAX_CASES + 1, usize::MAX] {
            let error = CaseSet::generate(&warehouse, 1, count).unwrap_err().to_string();
            assert!(error.contains("too many: at most 1000000"), "{error}");
        }
    }

    #[test]
    fn another_seed_gives_other_cases() {
        let warehouse = Warehouse::shipped();
        let [one, two] = [1, 2].map(|seed| CaseSet::generate(&warehouse, seed, 40).unwrap());
        for (one, two) in one.cases.iter().zip(&two.cases) {
            assert_ne!((one.task, one.original.start), (two.task, two.original.start));
        }
    }

    #[test]
    fn hundreds_of_cases_satisfy_every_constraint_and_vary() {
        let warehouse = Warehouse::shipped();
        let cases = CaseSet::generate(&warehouse, 77, 300).unwrap();
        let report = crate::validate::check(&warehouse, &cases);
        assert!(report.is_clean(), "{report}");
        let alike = |task| cases.cases.iter().filter(|case| case.task == task).count();
        let most = cases.cases.iter().map(|case| alike(case.task)).max();
        assert!(most <= Some(4), "{most:?} cases have the same task");
    }

    #[test]
    fn a_warehouse_too_small_for_cases_is_refused() {
        let error = CaseSet::generate(&tiny(), 1, 10).unwrap_err().to_string();
        assert!(
            error.contains("no case of type 1 (single object search) found for seed 1"),
            "{error}"
        );
        assert_eq!(CaseSet::generate(&tiny(), 1, 0).unwrap().cases, []);
    }
}
