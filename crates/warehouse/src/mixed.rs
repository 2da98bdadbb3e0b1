//! Histories of other tasks (specification, section 6): when a history is irrelevant or confusable for a case, and which
//! two of each kind a case gets.
//!
//! A candidate is a demonstration of another case with other targets: no item counts for both tasks ([`Task::targets`]), so
//! a search for a category and a search for a type of that category exclude each other. A candidate is compared with the
//! case's test reference, pose by pose ([`Overlap`]):
//!
//! - *irrelevant*: it shares no pose with the reference;
//! - *confusable*: at one or more shared poses it continues differently.
//!
//! A case gets the first candidate of each kind, and the next one from another case (or from the same case if no other has
//! any). Candidates are ordered by the number of conflicts (most first), then by how many cases they serve so far (fewest
//! first), then randomly. Cases choose in the order of the set, and no history serves more than [`MOST_SERVED`] cases as
//! one kind.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use domain::{Action, DemonstrationKind, Mixture, Pose};

use crate::case::{Case, CaseSet, History, TrajectoryKind};
use crate::draw::Draw;
use crate::task::Task;
use crate::world::Warehouse;

/// Maximum number of cases that one history serves as an irrelevant one, and again as a confusable one.
pub const MOST_SERVED: usize = 4;

/// What a history has in common with a case's test reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Overlap {
    /// Poses (cell and heading) that occur in both.
    pub shared_poses: usize,
    /// Shared poses from which both continue, the reference before its task is complete, with no action in common.
    pub conflicts: usize,
}

impl Overlap {
    /// The overlap of `history` with the test reference of case number `case`. `None` if the set lacks one of them.
    pub fn of(warehouse: &Warehouse, set: &CaseSet, case: usize, history: History) -> Option<Self> {
        let reference = DenseActions::of_reference(warehouse, set.cases.get(case)?);
        let start = TrajectoryKind::demonstration(history.kind)?;
        let history = Actions::of_history(warehouse, set.cases.get(history.case)?, start);
        Some(reference.overlap(&history))
    }

    /// Whether a history with this overlap is of the kind `mixture`.
    pub const fn is(self, mixture: Mixture) -> bool {
        match mixture {
            Mixture::Irrelevant => self.shared_poses == 0,
            Mixture::Confusable => self.conflicts > 0,
        }
    }
}

/// The ids of the items that count for `task`, sorted.
pub(crate) fn target_ids(warehouse: &Warehouse, task: &Task) -> Vec<u16> {
    let mut ids: Vec<u16> = task.targets(warehouse).iter().map(|item| item.id).collect();
    ids.sort_unstable();
    ids
}

/// The first id in both of two lists of [`target_ids`].
pub(crate) fn in_common(one: &[u16], other: &[u16]) -> Option<u16> {
    one.iter().copied().find(|id| other.binary_search(id).is_ok())
}

/// A set of actions: bit `a` for action `a`.
type ActionBits = u8;

/// Set if the pose was visited at all.
const VISITED: ActionBits = 1 << 7;
const _: () = assert!(Action::ALL.len() <= 7);

/// The actions that a trajectory takes at each of its poses, sorted by [`position`].
struct Actions(Vec<(usize, ActionBits)>);

/// The same with an entry for every pose of the floor plan.
struct DenseActions(Vec<ActionBits>);

/// The number of a pose among all poses of the floor plan.
fn position(warehouse: &Warehouse, pose: Pose) -> usize {
    let row = usize::from(pose.cell.y) * usize::from(warehouse.layout.width());
    4 * (row + usize::from(pose.cell.x)) + pose.heading as usize
}

impl Actions {
    fn of_history(warehouse: &Warehouse, case: &Case, start: TrajectoryKind) -> Self {
        let actions = &case.trajectory(start).actions;
        Self::of(warehouse, &case.replay(warehouse, start).poses, actions)
    }

    /// From the start pose and the pose after each of `actions`; there may be more poses.
    fn of(warehouse: &Warehouse, poses: &[Pose], actions: &[Action]) -> Self {
        let actions = actions.iter().map(|&action| 1 << action as u8);
        let mut taken: BTreeMap<usize, ActionBits> = BTreeMap::new();
        for (&pose, bit) in poses.iter().zip(actions.chain(std::iter::repeat(0))) {
            *taken.entry(position(warehouse, pose)).or_default() |= VISITED | bit;
        }
        Self(taken.into_iter().collect())
    }
}

impl DenseActions {
    /// An episode ends when its task is complete, so later actions of the test reference do not count.
    fn of_reference(warehouse: &Warehouse, case: &Case) -> Self {
        let replay = case.replay(warehouse, TrajectoryKind::Test);
        let all = &case.test.actions;
        let until = replay.length.map_or(all.len(), |length| length as usize);
        let layout = &warehouse.layout;
        let mut dense = vec![0; 4 * usize::from(layout.width()) * usize::from(layout.height())];
        for (position, bits) in Actions::of(warehouse, &replay.poses, &all[..until]).0 {
            dense[position] = bits;
        }
        Self(dense)
    }

    fn overlap(&self, other: &Actions) -> Overlap {
        let mut overlap = Overlap { shared_poses: 0, conflicts: 0 };
        for &(position, theirs) in &other.0 {
            let ours = self.0[position];
            if ours & VISITED == 0 {
                continue;
            }
            overlap.shared_poses += 1;
            let (ours, theirs) = (ours & !VISITED, theirs & !VISITED);
            overlap.conflicts += usize::from(ours != 0 && theirs != 0 && ours & theirs == 0);
        }
        overlap
    }
}

/// A case with too few candidates.
pub(crate) struct TooFew {
    /// Its index in the set.
    pub(crate) case: usize,
    pub(crate) mixture: Mixture,
    pub(crate) found: usize,
}

/// Gives every case of `set` its histories, replacing those that it has.
pub(crate) fn assign(warehouse: &Warehouse, set: &mut CaseSet) -> Result<(), TooFew> {
    let all = TrajectoryKind::DEMONSTRATIONS.len();
    let actions = |case: &Case| {
        TrajectoryKind::DEMONSTRATIONS.map(|start| Actions::of_history(warehouse, case, start))
    };
    let actions: Vec<[Actions; 4]> = set.cases.iter().map(actions).collect();
    let targets: Vec<Vec<u16>> =
        set.cases.iter().map(|case| target_ids(warehouse, &case.task)).collect();
    let mut served = Mixture::ALL.map(|_| vec![0_usize; all * actions.len()]);
    for index in 0..actions.len() {
        let reference = DenseActions::of_reference(warehouse, &set.cases[index]);
        let is_foreign = |other: &usize| {
            *other != index && in_common(&targets[index], &targets[*other]).is_none()
        };
        let candidates: Vec<(History, Overlap)> = (0..actions.len())
            .filter(is_foreign)
            .flat_map(|case| {
                let histories = DemonstrationKind::OWN.map(|kind| History { case, kind });
                histories.into_iter().zip(&actions[case])
            })
            .map(|(history, actions)| (history, reference.overlap(actions)))
            .collect();
        for mixture in Mixture::ALL {
            let served = &mut served[mixture as usize];
            let place = |history: &History| all * history.case + history.kind as usize;
            let fits = |(history, overlap): &&(History, Overlap)| {
                overlap.is(mixture) && served[place(history)] < MOST_SERVED
            };
            let fitting = candidates.iter().filter(fits).copied().collect();
            let stream = (mixture as u64 + 1) << 48 | index as u64;
            let mut ranked: Vec<(History, Overlap)> = Draw::new(set.seed, stream).shuffled(fitting);
            // The sort is stable, so equal candidates stay in random order.
            ranked.sort_by_key(|(history, overlap)| {
                (Reverse(overlap.conflicts), served[place(history)])
            });
            let chosen = first_two(ranked.iter().map(|(history, _)| *history));
            let case = &mut set.cases[index];
            let chosen = chosen.ok_or(TooFew { case: index, mixture, found: ranked.len() })?;
            for history in &chosen {
                served[place(history)] += 1;
            }
            match mixture {
                Mixture::Irrelevant => case.irrelevant = chosen,
                Mixture::Confusable => case.confusable = chosen,
            }
        }
    }
    Ok(())
}

/// The first history, and the next one from another case; if there is none, the second.
fn first_two(mut ranked: impl Iterator<Item = History> + Clone) -> Option<[History; 2]> {
    let first = ranked.next()?;
    let elsewhere = ranked.clone().find(|history| history.case != first.case);
    Some([first, elsewhere.or_else(|| ranked.next())?])
}

#[cfg(test)]
mod tests {
    use domain::Heading;

    use super::*;
    use crate::testing::{BLUE_BARREL, CONES, GREEN_CONE, ORANGE_CONE, RED_BARREL, tiny};
    use crate::trajectory::Trajectory;

    /// The overlap of a demonstration and a test reference in the tiny warehouse.
    fn overlap(test: (Pose, &str), original: (Pose, &str)) -> Overlap {
        let trajectory = |(start, letters): (Pose, &str)| Trajectory {
            start,
            actions: letters.chars().filter_map(Action::from_letter).collect(),
        };
        let (test, original) = (trajectory(test), trajectory(original));
        let own = [History { case: 0, kind: DemonstrationKind::Original }; 2];
        let case = Case {
            id: "t01-01".into(),
            task: Task::FindType { a: BLUE_BARREL },
            opposite: original.clone(),
            nearby: original.clone(),
            distant: original.clone(),
            original,
            blocked: test.clone(),
            test,
            barricade: Vec::new(),
            irrelevant: own,
            confusable: own,
        };
        let set = CaseSet { seed: 0, cases: vec![case], elsewhere: None };
        Overlap::of(&tiny(), &set, 0, own[0]).unwrap()
    }

    #[test]
    fn poses_are_shared_with_their_heading_and_conflict_where_all_actions_differ() {
        let at = |x, y, heading| Pose::new(x, y, heading);
        // To the blue barrel at (6, 3); the turn there comes after the task is complete.
        let east = (at(3, 3, Heading::E), "fffR");
        for (history, shared_poses, conflicts, why) in [
            (east, 5, 0, "the same trajectory"),
            ((at(6, 3, Heading::W), "fff"), 0, 0, "the same cells, facing the other way"),
            ((at(5, 3, Heading::E), "fb"), 2, 0, "it continues where the reference ends"),
            ((at(4, 3, Heading::E), "f"), 2, 0, "it ends where the reference continues"),
            ((at(4, 3, Heading::E), "fR"), 2, 1, "another action at (5, 3)"),
            ((at(5, 3, Heading::E), "bbfff"), 4, 0, "the same action, too, where it acts twice"),
            ((at(4, 3, Heading::E), "bU"), 2, 2, "another action at both"),
        ] {
            let found = overlap(east, history);
            assert_eq!(found, Overlap { shared_poses, conflicts }, "{why}");
        }
    }

    #[test]
    fn a_category_excludes_its_types_and_a_type_itself_only() {
        let warehouse = tiny();
        let ids = |task: Task| target_ids(&warehouse, &task);
        let (a, b) = (ORANGE_CONE, BLUE_BARREL);
        for (one, other, shared) in [
            (Task::FindType { a }, Task::FindType { a: GREEN_CONE }, false),
            (Task::FindType { a }, Task::FindCategory { c: CONES }, true),
            (Task::EveryOfCategory { c: CONES }, Task::EveryOfType { a: GREEN_CONE }, true),
            (Task::FindCategory { c: CONES }, Task::EveryAndReturn { a: b }, false),
            (Task::InOrder { a, b }, Task::Revisit { a: RED_BARREL, b: GREEN_CONE }, false),
            (Task::InOrder { a, b }, Task::BothTypes { a: RED_BARREL, b }, true),
        ] {
            let found = [in_common(&ids(one), &ids(other)), in_common(&ids(other), &ids(one))];
            assert_eq!(found.map(|item| item.is_some()), [shared; 2], "{one:?} and {other:?}");
        }
    }

    #[test]
    fn the_second_history_is_from_another_case_where_there_is_one() {
        let histories = |cases: &[usize]| -> Vec<History> {
            let kinds = DemonstrationKind::OWN.into_iter().cycle();
            cases.iter().zip(kinds).map(|(&case, kind)| History { case, kind }).collect()
        };
        for (cases, expected) in [
            (&[3, 3, 5, 4][..], Some([0, 2])),
            (&[3, 3, 3], Some([0, 1])),
            (&[3], None),
            (&[], None),
        ] {
            let ranked = histories(cases);
            let chosen = first_two(ranked.iter().copied());
            assert_eq!(chosen, expected.map(|at| at.map(|i| ranked[i])), "{cases:?}");
        }
    }

    #[test]
    fn a_set_that_offers_too_little_is_refused() {
        let error = CaseSet::generate(&Warehouse::shipped(), 3, 1).unwrap_err();
        insta::assert_snapshot!(
            error,
            @"case t01-01 needs two irrelevant histories and the other 0 cases offer 0; generate a larger set, or use another seed"
        );
    }

    /// Compares with a brute-force choice.
    #[test]
    fn no_candidate_that_was_free_has_more_conflicts_than_the_first_one_chosen() {
        let warehouse = Warehouse::shipped();
        let set = CaseSet::shipped();
        let mut served = std::collections::BTreeMap::<History, usize>::new();
        for (index, case) in set.cases.iter().enumerate().take(20) {
            let own = target_ids(&warehouse, &case.task);
            let most = (0..set.cases.len())
                .filter(|&other| {
                    in_common(&own, &target_ids(&warehouse, &set.cases[other].task)).is_none()
                })
                .flat_map(|case| DemonstrationKind::OWN.map(|kind| History { case, kind }))
                .filter(|history| served.get(history).is_none_or(|&times| times < MOST_SERVED))
                .filter_map(|history| Overlap::of(&warehouse, &set, index, history))
                .map(|overlap| overlap.conflicts)
                .max();
            let first = Overlap::of(&warehouse, &set, index, case.confusable[0]).unwrap();
            assert_eq!(Some(first.conflicts), most, "{}", case.id);
            for history in case.confusable {
                *served.entry(history).or_default() += 1;
            }
        }
    }
}
