//! Makes cases from a seed: a task, a start, and the other five starts and the barricade around it, until
//! every constraint holds.
//!
//! Each case draws from a stream of its own, so the first cases of a larger set are those of a smaller one.
//! Whatever is tried is tried in an order that the seed alone decides.

use domain::{Cell, Heading, Pose};

use crate::case::{Case, CaseSet, History, Replay, Start, Trajectory};
use crate::constraints::{
    Edge, does_its_task, edges, enters, faces_targets, is_distant, is_near_optimal, is_nearby,
    is_of_similar_length, shares_at_least_half, shares_at_most_half, target_in_view, target_on,
};
use crate::draw::Draw;
use crate::dynamics::Variant;
use crate::mixed::{self, TooFew};
use crate::plan::{Planner, Prices};
use crate::task::Task;
use crate::world::{Item, Warehouse};

/// The seed of the shipped cases.
pub const SHIPPED_SEED: u64 = 1;

/// How many cases are shipped.
pub const SHIPPED_COUNT: usize = 100;

/// Original demonstrations are this long, in steps: short ones leave nothing to remember, long ones
/// leave no room to get lost within the step limit.
const ORIGINAL_STEPS: std::ops::RangeInclusive<u32> = 10..=80;

/// Any walk has at least this many steps.
const LEAST_STEPS: u32 = 6;

/// With a passage closed the reference is longer than without, and at most this long, in steps.
const MOST_BLOCKED_STEPS: u32 = 120;

/// A test start is at least this far from every demonstration's start, in cells.
const TEST_CELLS: u32 = 3;

/// Original starts tried for one choice of targets, and choices of targets tried for one case.
const STARTS_TRIED: usize = 100;
const TARGETS_TRIED: usize = 50;

/// Test starts tried for one original start.
const TESTS_TRIED: usize = 60;

/// What a case has until the whole set is there to choose histories from.
const NO_HISTORIES: [History; 2] = [History { case: usize::MAX, start: Start::Original }; 2];

/// Why no set of cases could be made.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// The warehouse offers no case of some type.
    #[error(
        "no case of type {number} ({name}) found for seed {seed} after {TARGETS_TRIED} choices of targets with \
         {STARTS_TRIED} starts each; the warehouse has too few items, aisles or passages for it"
    )]
    NoCase {
        /// Of this type.
        number: u8,
        /// What the type is called.
        name: &'static str,
        /// The set's seed.
        seed: u64,
    },
    /// The other cases offer a case too few histories.
    #[error(
        "case {case} needs two {mixture} histories and the other {others} cases offer {found}; make a larger \
         set, or one from another seed"
    )]
    NoHistory {
        /// Which case.
        case: String,
        /// Which kind.
        mixture: &'static str,
        /// How many other cases there are.
        others: usize,
        /// How many histories of the kind they offer.
        found: usize,
    },
}

impl CaseSet {
    /// Makes `count` cases, a tenth of each type and one more of the first types where ten does not
    /// divide `count`. Ids count within the type: `t03-07` is the seventh case of type 3.
    ///
    /// Histories of other tasks are chosen from the whole set, so they do change with its size.
    ///
    /// # Errors
    /// When the warehouse offers no case of some type, such as one with a single aisle, and when so few
    /// cases are made that they offer one of them too few histories of other tasks.
    pub fn generate(warehouse: &Warehouse, seed: u64, count: usize) -> Result<Self, GenerateError> {
        let generator = Generator::new(warehouse, seed);
        let width = count.div_ceil(10).to_string().len().max(2);
        let mut cases: Vec<Case> = Vec::new();
        for number in 1..=10_u8 {
            let of_type = (count + 10 - usize::from(number)) / 10;
            let choices = generator.target_choices(number);
            let first = cases.len();
            for index in 0..of_type {
                let mut case = generator
                    .case(number, index, &choices, &cases[first..])
                    .ok_or_else(|| GenerateError::NoCase {
                        number,
                        name: Task::type_name(number).unwrap_or_default(),
                        seed,
                    })?;
                case.id = format!("t{number:02}-{:0width$}", index + 1);
                cases.push(case);
            }
        }
        let mut set = Self { seed, cases };
        let others = count.saturating_sub(1);
        mixed::assign(warehouse, &mut set).map_err(|TooFew { case, mixture, found }| {
            GenerateError::NoHistory { case, mixture: mixture.name(), others, found }
        })?;
        Ok(set)
    }
}

struct Generator<'w> {
    warehouse: &'w Warehouse,
    seed: u64,
    expert: Planner<'w>,
    fewest: Planner<'w>,
    poses: Vec<Pose>,
    passages: Vec<Vec<Cell>>,
}

/// A planned walk that may serve as a reference.
struct Walk {
    trajectory: Trajectory,
    replay: Replay,
    length: u32,
    edges: Vec<Edge>,
}

impl<'w> Generator<'w> {
    fn new(warehouse: &'w Warehouse, seed: u64) -> Self {
        let facing = |cell| Heading::ALL.map(|heading| Pose { cell, heading });
        Self {
            warehouse,
            seed,
            expert: Planner::new(warehouse, Variant::UNCHANGED, Prices::EXPERT),
            fewest: Planner::new(warehouse, Variant::UNCHANGED, Prices::STEPS),
            poses: warehouse.layout.free_cells().flat_map(facing).collect(),
            passages: warehouse.layout.passages(),
        }
    }

    /// What tasks of type `number` can be about, in the order in which cases take their turn: types with
    /// at least two instances where every one must be visited, categories, or any types.
    fn target_choices(&self, number: u8) -> Vec<usize> {
        let types = 0..self.warehouse.catalogue.types.len();
        let choices = match number {
            2 | 4 => (0..self.warehouse.catalogue.categories.len()).collect(),
            3 | 8 => types.filter(|&a| self.warehouse.instances(a).count() >= 2).collect(),
            _ => types.collect(),
        };
        Draw::new(self.seed, u64::from(number) << 32).shuffled(choices)
    }

    /// Case `index` of type `number`, unlike those in `taken`.
    fn case(&self, number: u8, index: usize, choices: &[usize], taken: &[Case]) -> Option<Case> {
        let mut draw = Draw::new(self.seed, u64::from(number) << 32 | (index as u64 + 1));
        if choices.is_empty() {
            return None;
        }
        for turn in 0..TARGETS_TRIED {
            let task = self.task(number, choices[(index + turn) % choices.len()], &mut draw);
            let Some(task) = task else { continue };
            for _ in 0..STARTS_TRIED {
                let start = draw.pick(&self.poses);
                let known = |case: &Case| case.task == task && case.original.start == start;
                if taken.iter().any(known) {
                    continue;
                }
                if let Some(case) = self.case_from(task, start, &mut draw) {
                    return Some(case);
                }
            }
        }
        None
    }

    /// The task of type `number` about `a`; a second type is drawn.
    fn task(&self, number: u8, a: usize, draw: &mut Draw) -> Option<Task> {
        let others =
            (0..self.warehouse.catalogue.types.len()).filter(|&b| b != a).collect::<Vec<_>>();
        if others.is_empty() {
            return None;
        }
        Some(match number {
            1 => Task::FindType { a },
            2 => Task::FindCategory { c: a },
            3 => Task::EveryOfType { a },
            4 => Task::EveryOfCategory { c: a },
            5 => Task::BothTypes { a, b: draw.pick(&others) },
            6 => Task::InOrder { a, b: draw.pick(&others) },
            7 => Task::FindAndReturn { a },
            8 => Task::EveryAndReturn { a },
            9 => Task::Revisit { a, b: draw.pick(&others) },
            10 => Task::InOrderAndReturn { a, b: draw.pick(&others) },
            _ => return None,
        })
    }

    /// A case of `task` from `start`, if one can be completed around it.
    fn case_from(&self, task: Task, start: Pose, draw: &mut Draw) -> Option<Case> {
        let layout = &self.warehouse.layout;
        let targets = task.targets(self.warehouse);
        if target_in_view(layout, start, &targets).is_some() {
            return None;
        }
        let original = self.walk(&task, start, &targets)?;
        if !ORIGINAL_STEPS.contains(&original.length) {
            return None;
        }
        let turned = Pose { heading: start.heading.opposite(), ..start };
        let opposite = self.walk(&task, turned, &targets)?;
        let nearby = self.first_walk(
            &task,
            &targets,
            draw,
            &|pose| is_nearby(layout, start, pose),
            &|walk| shares_at_least_half(&original.edges, &walk.edges),
        )?;
        let distant = self.first_walk(
            &task,
            &targets,
            draw,
            &|pose| is_distant(layout, start, pose),
            &|walk| shares_at_most_half(&original.edges, &walk.edges),
        )?;
        let demonstrations = [&original, &opposite, &nearby, &distant];

        let is_new = |pose: &Pose| {
            let far = |walk: &&Walk| walk.trajectory.start.cell.distance(pose.cell) >= TEST_CELLS;
            demonstrations.iter().all(far) && target_in_view(layout, *pose, &targets).is_none()
        };
        let tests: Vec<Pose> = self.poses.iter().copied().filter(is_new).collect();
        for pose in draw.shuffled(tests).into_iter().take(TESTS_TRIED) {
            let Some(test) = self.walk(&task, pose, &targets) else { continue };
            if !is_of_similar_length(original.length, test.length) {
                continue;
            }
            if let Some((blocked, barricade)) =
                self.blocked(&task, &targets, &test, &demonstrations, draw)
            {
                let [original, opposite, nearby, distant, test] =
                    [original, opposite, nearby, distant, test].map(|walk| walk.trajectory);
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

    /// The first walk, in random order of starts, with both properties.
    fn first_walk(
        &self,
        task: &Task,
        targets: &[&Item],
        draw: &mut Draw,
        is_start: &dyn Fn(Pose) -> bool,
        is_walk: &dyn Fn(&Walk) -> bool,
    ) -> Option<Walk> {
        let starts = self.poses.iter().copied().filter(|&pose| is_start(pose)).collect();
        let mut starts = draw.shuffled(starts).into_iter();
        starts.find_map(|start| self.walk(task, start, targets).filter(is_walk))
    }

    /// A closed passage that `test` and a demonstration use, and the reference around it.
    fn blocked(
        &self,
        task: &Task,
        targets: &[&Item],
        test: &Walk,
        demonstrations: &[&Walk],
        draw: &mut Draw,
    ) -> Option<(Trajectory, Vec<Cell>)> {
        let start = test.trajectory.start;
        let fits = |cells: &&Vec<Cell>| {
            enters(&test.replay.poses, cells)
                && demonstrations.iter().any(|walk| enters(&walk.replay.poses, cells))
                && !cells.contains(&start.cell)
                && target_on(cells, targets).is_none()
        };
        let passages = self.passages.iter().filter(fits).collect();
        draw.shuffled(passages).into_iter().find_map(|cells| {
            let variant = Variant::closing(cells.iter().copied());
            let expert = Planner::new(self.warehouse, variant.clone(), Prices::EXPERT);
            let walk = self.walk_with(&expert, &variant, task, start, |length| {
                // Closing a passage never shortens a walk, so the cheap answer mostly decides.
                let unchanged = self.fewest.cost(start, task)?;
                if is_near_optimal(length, unchanged) {
                    return Some(unchanged);
                }
                Planner::new(self.warehouse, variant.clone(), Prices::STEPS).cost(start, task)
            })?;
            let detours = walk.length > test.length && walk.length <= MOST_BLOCKED_STEPS;
            detours.then(|| (walk.trajectory, cells.clone()))
        })
    }

    /// The expert's walk in the unchanged warehouse, if it may serve as a reference.
    fn walk(&self, task: &Task, start: Pose, targets: &[&Item]) -> Option<Walk> {
        if target_on(&[start.cell], targets).is_some() {
            return None;
        }
        self.walk_with(&self.expert, &Variant::UNCHANGED, task, start, |_| {
            self.fewest.cost(start, task)
        })
    }

    /// The walk of `expert` in `variant`, if it may serve as a reference. `fewest` is a lower bound of the
    /// steps needed, exact where a walk of the given length would be rejected by it.
    fn walk_with(
        &self,
        expert: &Planner<'_>,
        variant: &Variant,
        task: &Task,
        start: Pose,
        fewest: impl Fn(u32) -> Option<u32>,
    ) -> Option<Walk> {
        let trajectory = expert.plan(start, task)?;
        let replay = trajectory.replay(self.warehouse, task, variant);
        let length = does_its_task(&replay).ok()?;
        faces_targets(self.warehouse, task, &replay).ok()?;
        let good = length >= LEAST_STEPS && is_near_optimal(length, fewest(length)?);
        good.then(|| {
            let edges = edges(&replay.poses);
            Walk { trajectory, replay, length, edges }
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
        let numbers: Vec<u8> = more.cases.iter().map(|case| case.task.number()).collect();
        let of_type = |number| numbers.iter().filter(|&&n| n == number).count();
        assert_eq!((1..=10).map(of_type).collect::<Vec<_>>(), [6, 6, 6, 6, 6, 6, 6, 5, 5, 5]);
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
    fn a_thousand_cases_are_as_good_and_as_varied() {
        let warehouse = Warehouse::shipped();
        let cases = CaseSet::generate(&warehouse, 77, 1000).unwrap();
        let report = crate::validate::check(&warehouse, &cases);
        assert!(report.is_clean(), "{report}");
        let alike = |task| cases.cases.iter().filter(|case| case.task == task).count();
        let most = cases.cases.iter().map(|case| alike(case.task)).max();
        assert!(most <= Some(10), "{most:?} cases have the same task");
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
