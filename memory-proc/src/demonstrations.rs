//! Demonstrations: the expert's views, actions and progress, step by step (specification, section 4).
//!
//! A demonstration is stored as actions and replayed here with the warehouse's dynamics, in the world where it takes place.
//! Its views are named by pose and world variant.
//!
//! Memories are built from demonstrations only. [`CaseSet::demonstrated`] knows none that is a test reference: those never
//! get into a memory, whatever a set of cases contains. A memory that learns also has the episodes that it learned from, in
//! the form of demonstrations.

use std::collections::HashSet;

use domain::{Action, Feedback, Pose};
use warehouse::{CaseSet, Demonstrations, History, Warehouse};

use crate::bank::Viewpoint;

/// A replayed demonstration, or an episode that a memory has learned from.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ReplayedDemonstration {
    /// Its case's index; of an episode, its position in its sequence.
    pub case: u32,
    /// Its [number](warehouse::Start::demonstration) in that case; [`EXPERIENCE`](shm_types::message::EXPERIENCE) for an episode.
    pub number: u16,
    /// The world variant in which it takes place.
    pub variant: u32,
    /// Its task.
    pub instruction: String,
    /// The expert's pose after `t` steps.
    pub poses: Vec<Pose>,
    /// The feedback to action `t - 1`; [`Feedback::Start`] first.
    pub feedback: Vec<Feedback>,
    /// Sub-goals completed after `t` steps.
    pub stages: Vec<u32>,
    /// Action `t` leads from pose `t` to pose `t + 1`: one fewer than poses. `None` where an agent has taken none.
    pub actions: Vec<Option<Action>>,
}

impl ReplayedDemonstration {
    /// Where its views are seen from.
    pub fn viewpoints(&self) -> impl Iterator<Item = Viewpoint> + '_ {
        self.poses.iter().map(|&pose| Viewpoint { variant: self.variant, pose })
    }

    /// Where the view of a step is seen from.
    ///
    /// # Panics
    /// When there is no such step.
    pub fn viewpoint(&self, step: u32) -> Viewpoint {
        Viewpoint { variant: self.variant, pose: self.poses[step as usize] }
    }
}

/// Replays the demonstrations of a set, given as [`Demonstrations::bits`], for the case at `index`. A mixed set includes
/// demonstrations of other cases, each with its own case's task. `None` when there is no such case or set, or one of the
/// demonstrations is a test reference.
pub fn selected(
    warehouse: &Warehouse,
    cases: &CaseSet,
    index: u32,
    selection: u32,
) -> Option<Vec<ReplayedDemonstration>> {
    cases.cases.get(index as usize)?;
    let histories = cases.histories(index as usize, Demonstrations::from_bits(selection)?);
    histories.into_iter().map(|history| replayed(warehouse, cases, history)).collect()
}

/// Replays the demonstrations that a set names for any case, each once, in the order of the cases. `None` as for
/// [`selected`].
pub fn of_all_cases(
    warehouse: &Warehouse,
    cases: &CaseSet,
    selection: u32,
) -> Option<Vec<ReplayedDemonstration>> {
    let selection = Demonstrations::from_bits(selection)?;
    histories(warehouse, cases, cases.histories_of_all(selection).into_iter())
}

/// Replays these demonstrations, each once. `None` when one of them is a test reference.
pub(crate) fn histories(
    warehouse: &Warehouse,
    cases: &CaseSet,
    histories: impl Iterator<Item = History>,
) -> Option<Vec<ReplayedDemonstration>> {
    let mut known = HashSet::new();
    let each_once = histories.filter(|history| known.insert(*history));
    each_once.map(|history| replayed(warehouse, cases, history)).collect()
}

/// Replays a demonstration. `None` when it is a test reference.
pub(crate) fn replayed(
    warehouse: &Warehouse,
    cases: &CaseSet,
    history: History,
) -> Option<ReplayedDemonstration> {
    let of = cases.demonstrated(warehouse, history)?;
    let replay = of.replay();
    Some(ReplayedDemonstration {
        case: history.case as u32,
        number: history.start as u16,
        variant: of.variant,
        instruction: of.instruction(),
        poses: replay.poses,
        feedback: replay.feedback,
        stages: replay.stages,
        actions: of.trajectory.actions.iter().copied().map(Some).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use warehouse::{ELSEWHERE_VARIANT, Elsewhere, Mixture, Start};

    #[test]
    fn a_demonstration_of_another_case_completes_that_case_s_task() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        for (set, mixture) in [
            (Demonstrations::IRRELEVANT, Mixture::Irrelevant),
            (Demonstrations::CONFUSABLE, Mixture::Confusable),
        ] {
            for index in 0..cases.cases.len() {
                let chosen = selected(&warehouse, &cases, index as u32, set.bits()).unwrap();
                assert_eq!(chosen.len(), 4);
                for (demonstration, start) in chosen.iter().zip([Start::Original, Start::Opposite])
                {
                    assert_eq!(
                        (demonstration.case, demonstration.number),
                        (index as u32, start as u16)
                    );
                }
                for (demonstration, history) in
                    chosen[2..].iter().zip(cases.cases[index].mixed(mixture))
                {
                    let of = &cases.cases[history.case];
                    assert_eq!(
                        (demonstration.case, demonstration.number),
                        (history.case as u32, history.start as u16)
                    );
                    let replay = of.replay(&warehouse, history.start);
                    assert!(replay.length.is_some() && demonstration.stages == replay.stages);
                    assert_eq!(demonstration.poses, replay.poses);
                    let actions: Vec<_> = demonstration.actions.iter().copied().flatten().collect();
                    assert_eq!(actions, of.trajectory(history.start).actions);
                }
            }
        }
    }

    #[test]
    fn a_demonstration_elsewhere_is_seen_in_the_other_warehouse() {
        let (warehouse, mut cases) = (Warehouse::shipped(), CaseSet::shipped());
        let set = Demonstrations::ELSEWHERE.bits();
        assert_eq!(selected(&warehouse, &cases, 0, set), None, "there is no other warehouse");
        cases.elsewhere = Elsewhere::generate(&warehouse, &cases, 1).ok();
        let other = cases.elsewhere.as_ref().unwrap().warehouse();
        let all = of_all_cases(&warehouse, &cases, set).unwrap();
        assert_eq!(all.len(), cases.cases.len());
        for (index, demonstration) in all.iter().enumerate() {
            let task = &cases.cases[index].task;
            assert_eq!(demonstration.instruction, task.instruction(&warehouse.catalogue));
            assert_eq!(demonstration.number, Start::Elsewhere as u16);
            assert!(demonstration.viewpoints().all(|of| of.variant == ELSEWHERE_VARIANT));
            assert!(demonstration.poses.iter().all(|pose| other.layout.is_free(pose.cell)));
            let chosen = selected(&warehouse, &cases, index as u32, set);
            assert_eq!(chosen, Some(vec![demonstration.clone()]));
        }
        // Where the expert went here, which references do too, makes no difference there.
        let demonstrated = all.iter().flat_map(|demonstration| &demonstration.poses);
        assert!(demonstrated.clone().any(|pose| !warehouse.layout.is_free(pose.cell)));
    }

    #[test]
    fn unknown_cases_and_sets_are_refused() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let all = Demonstrations::ALL.bits();
        assert_eq!(selected(&warehouse, &cases, 100, all), None);
        assert_eq!(selected(&warehouse, &cases, 0, 1 << 4), None);
        assert_eq!(selected(&warehouse, &cases, 0, 0), Some(Vec::new()));
    }

    #[test]
    fn a_test_reference_is_refused_whatever_the_cases_say() {
        let (warehouse, mut cases) = (Warehouse::shipped(), CaseSet::shipped());
        let irrelevant = Demonstrations::IRRELEVANT.bits();
        assert!(selected(&warehouse, &cases, 0, irrelevant).is_some());
        for start in [Start::Test, Start::Blocked] {
            cases.cases[0].irrelevant[1].start = start;
            assert_eq!(selected(&warehouse, &cases, 0, irrelevant), None);
        }
    }
}
