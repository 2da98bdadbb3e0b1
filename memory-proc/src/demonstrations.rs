//! Demonstrations: what the expert saw, did and had achieved, step by step (SPEC section 4).
//!
//! A demonstration is stored as actions and replayed here by the warehouse's own dynamics. Its frames are
//! named by pose: demonstrations are walked in the unchanged world, where a pose has one view.
//!
//! Memories are made of these and of nothing else. Only [`Start::DEMONSTRATIONS`] are acted out: the two test
//! references are never memory, whatever a set of cases says.

use domain::{Action, Pose};
use warehouse::{CaseSet, Demonstrations, History, Start, Warehouse};

/// One demonstration, acted out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Demonstration {
    /// Index of the case it belongs to.
    pub case: u32,
    /// Which of that case's demonstrations: 0 original, 1 opposite, 2 nearby, 3 distant.
    pub number: u16,
    /// Where the expert was after `t` steps.
    pub poses: Vec<Pose>,
    /// Sub-goals completed after `t` steps.
    pub stages: Vec<u32>,
    /// Action `t` leads from pose `t` to pose `t + 1`: one fewer than poses.
    pub actions: Vec<Action>,
}

/// What the bits of `selection` ([`Demonstrations::bits`]) come to for the case at `index`: its own, and in
/// a mixed set those of other cases, each acted out as a walk of its own case's task. `None` when there
/// is no such case or no such set, or one of them is a test reference.
pub fn selected(
    warehouse: &Warehouse,
    cases: &CaseSet,
    index: u32,
    selection: u32,
) -> Option<Vec<Demonstration>> {
    cases.cases.get(index as usize)?;
    let selection = Demonstrations::from_bits(selection)?;
    let acted = |History { case, start }| {
        let of = cases.cases.get(case).filter(|_| Start::DEMONSTRATIONS.contains(&start))?;
        let replay = of.replay(warehouse, start);
        Some(Demonstration {
            case: case as u32,
            number: start as u16,
            poses: replay.poses,
            stages: replay.stages,
            actions: of.trajectory(start).actions.clone(),
        })
    };
    cases.histories(index as usize, selection).into_iter().map(acted).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use warehouse::Mixture;

    #[test]
    fn a_demonstration_of_another_case_is_a_walk_of_that_case_s_task() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        for (set, mixture) in [
            (Demonstrations::IRRELEVANT, Mixture::Irrelevant),
            (Demonstrations::CONFUSABLE, Mixture::Confusable),
        ] {
            for index in 0..cases.cases.len() {
                let chosen = selected(&warehouse, &cases, index as u32, set.bits()).unwrap();
                assert_eq!(chosen.len(), 4);
                for (walk, start) in chosen.iter().zip([Start::Original, Start::Opposite]) {
                    assert_eq!((walk.case, walk.number), (index as u32, start as u16));
                }
                for (walk, history) in chosen[2..].iter().zip(cases.cases[index].mixed(mixture)) {
                    let of = &cases.cases[history.case];
                    assert_eq!(
                        (walk.case, walk.number),
                        (history.case as u32, history.start as u16)
                    );
                    let replay = of.replay(&warehouse, history.start);
                    assert!(replay.length.is_some() && walk.stages == replay.stages);
                    assert_eq!(walk.poses, replay.poses);
                    assert_eq!(walk.actions, of.trajectory(history.start).actions);
                }
            }
        }
    }

    #[test]
    fn what_is_no_case_or_no_set_is_refused() {
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
