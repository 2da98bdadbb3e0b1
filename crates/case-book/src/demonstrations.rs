//! Demonstrations, and which of them each set holds: all that memory knows about cases.

use std::collections::{BTreeMap, HashSet};

use domain::{ActionCode, DemonstrationKind, Demonstrations, FeedbackCode, Mixture, Route, State};
use serde::{Deserialize, Serialize};

use crate::WorldDeclaration;

/// The demonstrations of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub struct DemonstrationBook {
    /// What the world says of itself.
    pub world: WorldDeclaration,
    /// The demonstrations. Everything else names them by their index.
    pub demonstrations: Vec<Demonstration>,
    /// The cases, in the order of the [`CaseBook`](crate::CaseBook).
    pub cases: Vec<CaseDemonstrations>,
    /// The demonstrations of all cases' own four in the order in which they join banks.
    pub bank_order: Vec<u32>,
    /// The streams of the run.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub streams: Vec<StreamDemonstrations>,
    /// Hashes, in hexadecimal digits, of what the views in each variant depend on beside the state of the agent.
    pub variants: BTreeMap<u32, String>,
}

/// A successful expert trajectory. Index 0 of each list is its begin, index `t` the state after action `t`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Demonstration {
    /// The index of its case.
    pub case: u32,
    /// Which of the case's demonstrations.
    pub kind: DemonstrationKind,
    /// The variant in which it takes place.
    pub variant: u32,
    /// Its task.
    pub instruction: String,
    /// The states.
    pub states: Vec<State>,
    /// The feedback to action `t`; [`FeedbackCode::START`] first.
    pub feedback: Vec<FeedbackCode>,
    /// The steps at which sub-goals were completed, in order.
    pub sub_goals: Vec<u32>,
    /// The actions: one fewer than states.
    pub actions: Vec<ActionCode>,
    /// The view of each step. Steps of the whole book with the same number show the same picture.
    pub views: Vec<u32>,
}

/// The demonstrations that the sets of a case name, as indices.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub struct CaseDemonstrations {
    /// The instruction that an episode of the case carries out.
    pub instruction: String,
    /// The same in other words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paraphrase: Option<String>,
    /// Original, opposite, nearby, distant.
    pub own: Vec<u32>,
    /// Its two irrelevant histories.
    pub irrelevant: Vec<u32>,
    /// Its two confusable histories.
    pub confusable: Vec<u32>,
    /// The one after its passage has closed, if it was asked for and can be planned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<u32>,
    /// The one in another world, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elsewhere: Option<u32>,
    /// The test reference from the new start, in a run with the arm `oracle` only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub new: Option<u32>,
    /// The test reference from there on the blocked route, in a run with the arm `oracle` only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blocked: Option<u32>,
}

/// What the memories of a stream are built from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamDemonstrations {
    /// Its cases, sorted.
    pub cases: Vec<u32>,
    /// By block: the demonstrations of its cases by an expert who knows the world of the block. Empty if none were asked for.
    pub planned: Vec<Vec<u32>>,
}

/// A step of a demonstration in the book.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ViewPlace {
    /// The index of the demonstration.
    pub demonstration: u32,
    /// The step.
    pub step: u32,
}

impl DemonstrationBook {
    /// The `demonstrations` of case number `case`: its own, then its histories of other cases. `None` if there is no such
    /// case, and where the book lacks one that the set names.
    ///
    /// A bank of N demonstrations holds the first N - 1 of the order of banks and the case's original one; the N-th if that is
    /// among them. So a larger bank holds the smaller ones, and cases whose original demonstration comes early have the same
    /// bank.
    pub fn of_case(&self, case: u32, demonstrations: Demonstrations) -> Option<Vec<u32>> {
        let listed = self.cases.get(case as usize)?;
        if let Some(size) = demonstrations.bank_size() {
            let mut bank = self.common_bank(size)?;
            let original = *listed.own.first()?;
            if let (false, Some(last)) = (bank.contains(&original), bank.last_mut()) {
                *last = original;
            }
            return Some(bank);
        }
        if demonstrations.take_place_elsewhere() {
            return Some(vec![listed.elsewhere?]);
        }
        if let Some(route) = demonstrations.reference() {
            return listed.reference(route).map(|of| vec![of]);
        }
        if let Some(count) = demonstrations.wrong() {
            return listed.irrelevant.get(..count).map(<[u32]>::to_vec);
        }
        let own_kinds = demonstrations.own();
        let mut indices: Vec<u32> =
            own_kinds.map(|kind| listed.own.get(kind as usize).copied()).collect::<Option<_>>()?;
        indices.extend(demonstrations.mixture().into_iter().flat_map(|mixture| match mixture {
            Mixture::Irrelevant => &listed.irrelevant,
            Mixture::Confusable => &listed.confusable,
        }));
        if demonstrations.take_place_after() {
            indices.push(listed.after?);
        }
        if demonstrations == Demonstrations::AFTER_BEFORE {
            indices.reverse();
        }
        Some(indices)
    }

    /// The first of `sets` of which case number `case` has no demonstrations. One without a blocked route (`has_blocked`) has no
    /// episode there, and needs no reference of it.
    pub fn missing_set(
        &self,
        case: u32,
        sets: &[Demonstrations],
        has_blocked: bool,
    ) -> Option<Demonstrations> {
        let is_missing = |set: &Demonstrations| {
            let held = self.of_case(case, *set);
            let is_needed = has_blocked || *set != Demonstrations::BLOCKED_REFERENCE;
            is_needed && held.is_none_or(|held| held.is_empty() && set.mixture().is_some())
        };
        sets.iter().copied().find(is_missing)
    }

    /// The `demonstrations` of all cases, each once, in the order of the cases; references on the blocked route of the cases that
    /// have one. `None` as for [`of_case`](Self::of_case).
    pub fn of_all_cases(&self, demonstrations: Demonstrations) -> Option<Vec<u32>> {
        let mut listed = HashSet::new();
        let mut indices = Vec::new();
        let can_lack = demonstrations == Demonstrations::BLOCKED_REFERENCE;
        for case in 0..self.cases.len() as u32 {
            let of_case = self.of_case(case, demonstrations);
            let of_case = if can_lack { of_case.unwrap_or_default() } else { of_case? };
            indices.extend(of_case.into_iter().filter(|index| listed.insert(*index)));
        }
        Some(indices)
    }

    /// The first `size` of the order of banks; `None` if there are fewer.
    pub fn common_bank(&self, size: u16) -> Option<Vec<u32>> {
        self.bank_order.get(..usize::from(size)).map(<[u32]>::to_vec)
    }

    /// The size of the largest bank.
    pub fn largest_bank(&self) -> usize {
        self.bank_order.len()
    }

    /// The demonstration of a case with this kind that takes place in `variant`.
    pub fn find(&self, case: u32, kind: DemonstrationKind, variant: u32) -> Option<u32> {
        let wanted = (case, kind, variant);
        let found =
            self.demonstrations.iter().position(|of| (of.case, of.kind, of.variant) == wanted);
        found.map(|index| index as u32)
    }
}

impl CaseDemonstrations {
    /// The test reference from the new start on `route`.
    pub fn reference(&self, route: Route) -> Option<u32> {
        match route {
            Route::Unchanged => self.new,
            Route::Blocked => self.blocked,
        }
    }
}

impl Demonstration {
    /// The sub-goals that were completed after `t` steps, for each `t`.
    pub fn stages(&self) -> Vec<u32> {
        let completed = |step: u32| self.sub_goals.iter().filter(|at| **at <= step).count() as u32;
        (0..self.states.len() as u32).map(completed).collect()
    }

    /// What is wrong with it, if its lists do not belong together.
    pub fn problem(&self) -> Option<String> {
        let states = self.states.len();
        let lengths = [self.feedback.len(), self.views.len(), self.actions.len() + 1];
        if states == 0 || lengths.iter().any(|length| *length != states) {
            return Some(format!(
                "a demonstration has {states} states, {} feedbacks, {} views and {} actions",
                self.feedback.len(),
                self.views.len(),
                self.actions.len()
            ));
        }
        let are_steps = self.sub_goals.iter().all(|step| (*step as usize) < states);
        (!are_steps || !self.sub_goals.is_sorted()).then(|| {
            format!("a demonstration of {states} states has sub-goals at {:?}", self.sub_goals)
        })
    }
}
