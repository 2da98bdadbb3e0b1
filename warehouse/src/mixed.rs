//! Histories of other tasks (SPEC section 6): what makes one irrelevant or confusable to a case, and which
//! two of each kind a case is given.
//!
//! A candidate is a demonstration of another case whose targets are not this one's: no item that counts
//! for one task counts for the other ([`Task::targets`](crate::Task::targets)), so a search for a category and a search for a
//! type of that category exclude each other. What it has to do with the case is measured against the
//! test reference, pose by pose ([`Overlap`]):
//!
//! - *irrelevant*: it shares no pose with the reference;
//! - *confusable*: at one or more shared poses the expert went on in another way than the reference does.
//!
//! A case's two histories of a kind are the first candidate, and the first one after it from another case
//! (from the same case where no other offers any). The candidates' order: the most conflicts first, where
//! they are confusable; then the one that serves fewest cases so far; then as drawn. Cases take their
//! turn in the order of the set, and no history serves more than [`MOST_SERVED`] cases as one kind.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use shm_types::{Action, Pose};

use crate::case::{Case, CaseSet, History, Start};
use crate::draw::Draw;
use crate::world::Warehouse;

/// Most cases that one history is given to as an irrelevant one, and again as a confusable one.
pub const MOST_SERVED: usize = 4;

/// What histories of other tasks are to a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Mixture {
    /// They share no pose with the test reference.
    Irrelevant,
    /// They share poses with it and go on differently from there.
    Confusable,
}

impl Mixture {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Irrelevant, Self::Confusable];

    /// The name in files and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Irrelevant => "irrelevant",
            Self::Confusable => "confusable",
        }
    }

    /// Whether a history with this overlap is of this kind.
    pub const fn admits(self, overlap: Overlap) -> bool {
        match self {
            Self::Irrelevant => overlap.shared_poses == 0,
            Self::Confusable => overlap.conflicts > 0,
        }
    }
}

/// What a history has in common with a case's test reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Overlap {
    /// Poses (cell and heading) that both walks are in at some time.
    pub shared_poses: usize,
    /// Those of them at which both go on and no action that one takes there is taken there by the other.
    pub conflicts: usize,
}

impl Overlap {
    /// Of `history` with the test reference of the case at `case`. `None` when the set lacks one of them.
    pub fn of(warehouse: &Warehouse, set: &CaseSet, case: usize, history: History) -> Option<Self> {
        let reference = Actions::of(warehouse, set.cases.get(case)?, Start::Test);
        let history = Actions::of(warehouse, set.cases.get(history.case)?, history.start);
        Some(reference.dense(warehouse).overlap(&history))
    }
}

/// A set of actions: bit `a` for action `a`.
type ActionBits = u8;

/// The pose was visited, whatever was done there.
const VISITED: ActionBits = 1 << 7;
const _: () = assert!(Action::ALL.len() <= 7);

/// What a walk does at each pose it is in, by [`position`].
struct Actions(Vec<(usize, ActionBits)>);

/// The same with an entry for every pose of the floor.
struct DenseActions(Vec<ActionBits>);

/// Where a pose stands among all poses of the floor.
fn position(warehouse: &Warehouse, pose: Pose) -> usize {
    let row = usize::from(pose.cell.y) * usize::from(warehouse.layout.width());
    4 * (row + usize::from(pose.cell.x)) + pose.heading as usize
}

impl Actions {
    fn of(warehouse: &Warehouse, case: &Case, start: Start) -> Self {
        let poses = case.replay(warehouse, start).poses;
        let actions = case.trajectory(start).actions.iter().map(|&action| 1 << action as u8);
        let mut taken: BTreeMap<usize, ActionBits> = BTreeMap::new();
        // Nothing is done at the last pose.
        for (pose, bit) in poses.into_iter().zip(actions.chain([0])) {
            *taken.entry(position(warehouse, pose)).or_default() |= VISITED | bit;
        }
        Self(taken.into_iter().collect())
    }

    fn dense(&self, warehouse: &Warehouse) -> DenseActions {
        let layout = &warehouse.layout;
        let mut dense = vec![0; 4 * usize::from(layout.width()) * usize::from(layout.height())];
        for &(position, bits) in &self.0 {
            dense[position] = bits;
        }
        DenseActions(dense)
    }
}

impl DenseActions {
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

/// A case that has too few candidates.
pub(crate) struct TooFew {
    pub(crate) case: String,
    pub(crate) mixture: Mixture,
    pub(crate) found: usize,
}

/// Gives every case of `set` its histories; those that it has are forgotten.
pub(crate) fn assign(warehouse: &Warehouse, set: &mut CaseSet) -> Result<(), TooFew> {
    let all = Start::DEMONSTRATIONS.len();
    let walks =
        |case: &Case| Start::DEMONSTRATIONS.map(|start| Actions::of(warehouse, case, start));
    let walks: Vec<[Actions; 4]> = set.cases.iter().map(walks).collect();
    let targets = |case: &Case| -> Vec<u16> {
        case.task.targets(warehouse).iter().map(|item| item.id).collect()
    };
    let targets: Vec<Vec<u16>> = set.cases.iter().map(targets).collect();
    let mut served = Mixture::ALL.map(|_| vec![0_usize; all * walks.len()]);
    for index in 0..walks.len() {
        let reference = Actions::of(warehouse, &set.cases[index], Start::Test).dense(warehouse);
        let is_foreign = |other: &usize| {
            let shared = |item: &u16| targets[index].contains(item);
            *other != index && !targets[*other].iter().any(shared)
        };
        let candidates: Vec<(History, Overlap)> = (0..walks.len())
            .filter(is_foreign)
            .flat_map(|case| {
                let histories = Start::DEMONSTRATIONS.map(|start| History { case, start });
                histories.into_iter().zip(&walks[case])
            })
            .map(|(history, walk)| (history, reference.overlap(walk)))
            .collect();
        for mixture in Mixture::ALL {
            let served = &mut served[mixture as usize];
            let place = |history: &History| all * history.case + history.start as usize;
            let fits = |(history, overlap): &&(History, Overlap)| {
                mixture.admits(*overlap) && served[place(history)] < MOST_SERVED
            };
            let fitting = candidates.iter().filter(fits).copied().collect();
            let stream = (mixture as u64 + 1) << 48 | index as u64;
            let mut ranked: Vec<(History, Overlap)> = Draw::new(set.seed, stream).shuffled(fitting);
            // Stable, so equals stay as drawn.
            ranked.sort_by_key(|(history, overlap)| {
                (Reverse(overlap.conflicts), served[place(history)])
            });
            let chosen = first_two(ranked.iter().map(|(history, _)| *history));
            let case = &mut set.cases[index];
            let chosen = chosen.ok_or_else(|| TooFew {
                case: case.id.clone(),
                mixture,
                found: ranked.len(),
            })?;
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

/// The first, and the first after it from another case; where there is none, the second.
fn first_two(mut ranked: impl Iterator<Item = History> + Clone) -> Option<[History; 2]> {
    let first = ranked.next()?;
    let elsewhere = ranked.clone().find(|history| history.case != first.case);
    Some([first, elsewhere.or_else(|| ranked.next())?])
}
