//! The worlds of a run: what a world variant stands for, and what the memory of a stream is built from.

use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::Arc;

use domain::Arm;
use warehouse::plan::{Planner, Prices};
use warehouse::{
    CaseSet, Demonstrations, History, Mixture, StreamError, StreamSet, Trajectory, Variant,
    Warehouse, WorldState,
};

use crate::demonstrations::{ReplayedDemonstration, histories, replayed};

/// The warehouse, its cases, and the world states and streams of a run.
#[derive(Debug)]
pub struct WorldStates {
    pub(crate) warehouse: Warehouse,
    pub(crate) cases: CaseSet,
    streams: StreamSet,
    states: Vec<WorldState>,
    /// The demonstrations of banks.
    replayed: RefCell<HashMap<History, Arc<ReplayedDemonstration>>>,
}

/// What a bank is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct BankOrigin {
    stream: u32,
    set: Demonstrations,
    kind: OriginKind,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum OriginKind {
    /// The demonstrations of the stream's cases.
    Demonstrated,
    /// The cases' irrelevant histories.
    Irrelevant,
    /// Demonstrations of the cases by an expert who knows the world of this block.
    Planned { block: u32 },
    /// Outside of streams: the bank of this case; `None`: the one that most cases have.
    OfCase { case: Option<u32> },
}

impl BankOrigin {
    /// The bank of an arm in a block of a stream, from the demonstrations `set` of its cases.
    pub(crate) const fn new(arm: Arm, stream: u32, block: u32, set: Demonstrations) -> Self {
        let kind = match arm {
            Arm::Frozen | Arm::Learning => OriginKind::Demonstrated,
            Arm::Wrong => OriginKind::Irrelevant,
            Arm::Oracle => OriginKind::Planned { block },
        };
        Self { stream, set, kind }
    }

    /// The bank `set` of a case outside of streams.
    pub(crate) fn bank(cases: &CaseSet, case: u32, set: Demonstrations) -> Self {
        let common = set.bank_size().map_or_else(Vec::new, |size| cases.common_bank(size));
        let is_common = cases.histories(case as usize, set) == common;
        Self { stream: 0, set, kind: OriginKind::OfCase { case: (!is_common).then_some(case) } }
    }
}

impl WorldStates {
    /// The worlds of a run without streams.
    pub fn unchanging(warehouse: Warehouse, cases: CaseSet) -> Self {
        let streams = StreamSet { seed: 0, worlds: Vec::new(), streams: Vec::new() };
        Self { warehouse, cases, streams, states: Vec::new(), replayed: RefCell::default() }
    }

    /// The worlds of a run with these streams.
    ///
    /// # Errors
    /// When the streams do not fit the warehouse or the cases.
    pub fn new(
        warehouse: Warehouse,
        cases: CaseSet,
        streams: StreamSet,
    ) -> Result<Self, StreamError> {
        streams.check(&warehouse, &cases)?;
        let states = streams.states(&warehouse)?;
        Ok(Self { warehouse, cases, streams, states, replayed: RefCell::default() })
    }

    /// The stock and the closed cells in a world variant; `None` if there is no such variant.
    pub(crate) fn state(&self, variant: u32) -> Option<(&Warehouse, Variant)> {
        let cases = &self.cases.cases;
        match (variant as usize).checked_sub(1) {
            None => Some((&self.warehouse, Variant::UNCHANGED)),
            Some(case) if case < cases.len() => {
                Some((&self.warehouse, Variant::closing(cases[case].barricade.iter().copied())))
            }
            Some(number) => {
                let WorldState { warehouse, variant } = self.states.get(number - cases.len())?;
                Some((warehouse, variant.clone()))
            }
        }
    }

    /// The demonstrations of a bank, each once, in the order of the cases.
    ///
    /// # Errors
    /// When there is no such stream or block, or nothing that the bank could be made of.
    pub(crate) fn demonstrations(
        &self,
        origin: BankOrigin,
    ) -> Result<Vec<Arc<ReplayedDemonstration>>, String> {
        let BankOrigin { stream: number, set, kind } = origin;
        if let OriginKind::OfCase { case } = kind {
            return self.of_case(case, set).ok_or_else(|| format!("there is no bank {set}"));
        }
        let count = self.streams.streams.len();
        let stream = self.streams.streams.get(number as usize).ok_or_else(|| {
            format!("stream {number} of {count}: is memory-proc started with the run's --streams?")
        })?;
        let of = stream.cases();
        let made = match kind {
            OriginKind::Demonstrated => {
                let of = of.iter().flat_map(|&case| self.cases.histories(case as usize, set));
                histories(&self.warehouse, &self.cases, of)
            }
            OriginKind::Irrelevant => {
                let cases = of.iter().filter_map(|&case| self.cases.cases.get(case as usize));
                let other = cases.flat_map(|case| case.mixed(Mixture::Irrelevant));
                // What is irrelevant to one case of the stream may be a demonstration of another.
                let other = other.filter(|history| !of.contains(&(history.case as u32)));
                histories(&self.warehouse, &self.cases, other)
            }
            OriginKind::Planned { block } => self.planned(number, block, &of, set),
            OriginKind::OfCase { .. } => None,
        };
        match made {
            Some(made) if !made.is_empty() => Ok(made.into_iter().map(Arc::new).collect()),
            _ => Err(format!("stream {number} has no demonstrations of the set {set} ({kind:?})")),
        }
    }

    /// The demonstrations of a bank outside of streams. Each is replayed once, however many banks hold it.
    fn of_case(
        &self,
        case: Option<u32>,
        set: Demonstrations,
    ) -> Option<Vec<Arc<ReplayedDemonstration>>> {
        let of = match case {
            Some(case) => self.cases.histories(case as usize, set),
            None => self.cases.common_bank(set.bank_size()?),
        };
        let mut known = self.replayed.borrow_mut();
        let made = of.into_iter().map(|history| match known.get(&history) {
            Some(made) => Some(made.clone()),
            None => {
                let made = Arc::new(replayed(&self.warehouse, &self.cases, history)?);
                known.insert(history, made.clone());
                Some(made)
            }
        });
        made.collect()
    }

    /// Demonstrations planned in the world of a block, from where the demonstrations of the set begin. One that cannot be
    /// planned is left out.
    fn planned(
        &self,
        stream: u32,
        block: u32,
        cases: &[u32],
        set: Demonstrations,
    ) -> Option<Vec<ReplayedDemonstration>> {
        let block = self.streams.streams[stream as usize].blocks.get(block as usize)?;
        let number = self.streams.variant(block.world, self.cases.cases.len());
        let (warehouse, variant) = self.state(number)?;
        let planner = Planner::new(warehouse, variant.clone(), Prices::EXPERT);
        let starts = cases.iter().flat_map(|&case| set.own().map(move |start| (case, start)));
        let plan = |(index, start)| {
            let case = self.cases.cases.get(index as usize)?;
            let begin = case.trajectory(start).start;
            if variant.is_closed(begin.cell) {
                return None;
            }
            let trajectory: Trajectory = planner.plan(begin, &case.task)?;
            let replay = trajectory.replay(warehouse, &case.task, &variant);
            Some(ReplayedDemonstration {
                case: index,
                number: start as u16,
                variant: number,
                instruction: case.task.instruction(&self.warehouse.catalogue),
                poses: replay.poses,
                feedback: replay.feedback,
                stages: replay.stages,
                actions: trajectory.actions.into_iter().map(Some).collect(),
            })
        };
        Some(starts.filter_map(plan).collect())
    }
}
