//! Demonstrations: the expert's views, actions and progress, step by step (specification, section 4).
//!
//! They come from the demonstration book, which the world has written for the run ([`DemonstrationBook`]). Memories are built
//! from them only: the book holds no test reference, except in a run with the arm `oracle`. A memory that learns also has the episodes that it learned from, in the
//! form of demonstrations.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use case_book::{Demonstration, DemonstrationBook, WorldDeclaration};
use domain::{ActionCode, Arm, Demonstrations, FeedbackCode, State};

/// Names a view by a step that shows it. Steps that are known to show the same have the same name: the first of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ViewId {
    /// The sequence of an episode that was learned from; 0 for a demonstration of the book.
    pub sequence: u64,
    /// The index of the demonstration, or the position of the episode in its sequence.
    pub number: u32,
    /// The step.
    pub step: u32,
}

/// A demonstration, or an episode that a memory has learned from.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RememberedDemonstration {
    /// Its case's index; of an episode, its position in its sequence.
    pub case: u32,
    /// Its [code](domain::DemonstrationKind); [`EXPERIENCE`](shm_types::message::EXPERIENCE) for an episode.
    pub number: u16,
    /// Its task.
    pub instruction: String,
    /// The state after `t` steps.
    pub states: Vec<State>,
    /// The feedback to action `t - 1`; [`FeedbackCode::START`] first.
    pub feedback: Vec<FeedbackCode>,
    /// Sub-goals completed after `t` steps.
    pub stages: Vec<u32>,
    /// The view after `t` steps.
    pub views: Vec<ViewId>,
    /// Action `t` leads from state `t` to state `t + 1`: one fewer than states. `None` where an agent has taken none.
    pub actions: Vec<Option<ActionCode>>,
}

impl RememberedDemonstration {
    /// The steps at which sub-goals were completed.
    pub fn sub_goals(&self) -> Vec<u32> {
        let mut completed = 0;
        let mut steps = Vec::new();
        for (at, &stage) in (0..).zip(&self.stages) {
            steps.extend((completed..stage).map(|_| at));
            completed = stage;
        }
        steps
    }

    /// The views of an episode that was learned from: of its steps in one state, the first one's.
    pub(crate) fn lived_views(sequence: u64, position: u32, states: &[State]) -> Vec<ViewId> {
        let mut first = HashMap::new();
        let steps = (0..).zip(states);
        let view = |(step, state)| ViewId {
            sequence,
            number: position,
            step: *first.entry(state).or_insert(step),
        };
        steps.map(view).collect()
    }
}

/// All demonstrations of a run, and which of them each bank holds.
#[derive(Debug)]
pub struct DemonstrationLibrary {
    book: DemonstrationBook,
    /// Those of the book, by index.
    demonstrations: Vec<Arc<RememberedDemonstration>>,
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
}

impl DemonstrationLibrary {
    /// The demonstrations of `book`.
    pub fn new(mut book: DemonstrationBook) -> Self {
        let mut first = HashMap::new();
        let mut remembered = |(number, of): (u32, Demonstration)| {
            let views = (0..).zip(&of.views).map(|(step, &view)| {
                *first.entry(view).or_insert(ViewId { sequence: 0, number, step })
            });
            Arc::new(RememberedDemonstration {
                case: of.case,
                number: of.kind as u16,
                views: views.collect(),
                stages: of.stages(),
                instruction: of.instruction,
                states: of.states,
                feedback: of.feedback,
                actions: of.actions.into_iter().map(Some).collect(),
            })
        };
        let demonstrations = (0..).zip(std::mem::take(&mut book.demonstrations));
        let demonstrations = demonstrations.map(&mut remembered).collect();
        Self { book, demonstrations }
    }

    /// The pose in which a view of the book is seen.
    #[cfg(test)]
    pub(crate) fn pose(&self, view: ViewId) -> domain::Pose {
        let state = self.demonstrations[view.number as usize].states[view.step as usize];
        state.try_into().unwrap()
    }

    /// What the world says of itself.
    pub fn world(&self) -> &WorldDeclaration {
        &self.book.world
    }

    /// The number of cases.
    pub(crate) fn case_count(&self) -> usize {
        self.book.cases.len()
    }

    /// The instruction that an episode of a case carries out, or its paraphrase; `None` if there is no such case or paraphrase.
    pub(crate) fn instruction(&self, case: u32, is_paraphrased: bool) -> Option<&str> {
        let case = self.book.cases.get(case as usize)?;
        if is_paraphrased { case.paraphrase.as_deref() } else { Some(&case.instruction) }
    }

    /// Whether episodes of the run can take place in this world variant as part of a stream.
    pub(crate) fn has_variant(&self, variant: u32) -> bool {
        self.book.variants.contains_key(&variant)
    }

    /// The demonstrations of a set for the case with this index. `None` as for [`DemonstrationBook::of_case`].
    pub fn of_case(
        &self,
        case: u32,
        set: Demonstrations,
    ) -> Option<Vec<Arc<RememberedDemonstration>>> {
        self.book.of_case(case, set).map(|indices| self.listed(&indices))
    }

    /// The demonstrations that a set names for any case, each once, in the order of the cases. `None` as for
    /// [`of_case`](Self::of_case).
    pub fn of_all_cases(&self, set: Demonstrations) -> Option<Vec<Arc<RememberedDemonstration>>> {
        self.book.of_all_cases(set).map(|indices| self.listed(&indices))
    }

    fn listed(&self, indices: &[u32]) -> Vec<Arc<RememberedDemonstration>> {
        indices.iter().map(|index| self.demonstrations[*index as usize].clone()).collect()
    }

    /// Where the bank `set` of a case outside of streams comes from.
    pub(crate) fn bank_of_case(&self, case: u32, set: Demonstrations) -> BankOrigin {
        let common = set.bank_size().and_then(|size| self.book.common_bank(size));
        let is_common = self.book.of_case(case, set) == common;
        let kind = OriginKind::OfCase { case: (!is_common).then_some(case) };
        BankOrigin { stream: 0, set, kind }
    }

    /// The demonstrations of a bank, each once, in the order of the cases.
    ///
    /// # Errors
    /// When there is no such stream or block, or nothing that the bank could be made of.
    pub(crate) fn of_bank(
        &self,
        origin: BankOrigin,
    ) -> Result<Vec<Arc<RememberedDemonstration>>, String> {
        let BankOrigin { stream: number, set, kind } = origin;
        let stream = || {
            let count = self.book.streams.len();
            self.book.streams.get(number as usize).ok_or_else(|| {
                format!(
                    "stream {number} of {count}: is memory-proc started with the run's --demonstrations?"
                )
            })
        };
        let indices: Option<Vec<u32>> = match kind {
            OriginKind::OfCase { case: Some(case) } => self.book.of_case(case, set),
            OriginKind::OfCase { case: None } => {
                set.bank_size().and_then(|size| self.book.common_bank(size))
            }
            OriginKind::Demonstrated => {
                let of = stream()?.cases.iter().map(|&case| self.book.of_case(case, set));
                of.collect::<Option<Vec<_>>>().map(|of| of.into_iter().flatten().collect())
            }
            OriginKind::Irrelevant => {
                let of = &stream()?.cases;
                let cases = of.iter().filter_map(|&case| self.book.cases.get(case as usize));
                let other = cases.flat_map(|case| case.irrelevant.iter().copied());
                // What is irrelevant to one case of the stream may be a demonstration of another.
                let is_other =
                    |index: &u32| !of.contains(&self.demonstrations[*index as usize].case);
                Some(other.filter(is_other).collect())
            }
            OriginKind::Planned { block } => stream()?.planned.get(block as usize).map(|planned| {
                let of_set = |index: &&u32| {
                    let number = self.demonstrations[**index as usize].number;
                    set.own().any(|kind| kind as u16 == number)
                };
                planned.iter().filter(of_set).copied().collect()
            }),
        };
        let mut known = HashSet::new();
        let indices = indices.unwrap_or_default().into_iter();
        let indices: Vec<u32> = indices.filter(|index| known.insert(*index)).collect();
        if indices.is_empty() {
            return Err(match kind {
                OriginKind::OfCase { .. } => format!("there is no bank {set}"),
                _ => format!("stream {number} has no demonstrations of the set {set} ({kind:?})"),
            });
        }
        Ok(self.listed(&indices))
    }
}

#[cfg(test)]
mod tests {
    use case_book::{BookRequest, ElsewhereRequest};
    use domain::{DemonstrationKind, Feedback, Heading, Pose};
    use warehouse::case_book::write_books;
    use warehouse::{CaseSet, TrajectoryKind, Variant, Warehouse};

    use super::*;

    fn library(elsewhere: Option<ElsewhereRequest>) -> DemonstrationLibrary {
        let request = BookRequest { elsewhere, ..BookRequest::default() };
        DemonstrationLibrary::new(write_books(&request).unwrap().demonstrations)
    }

    #[test]
    fn a_demonstration_of_another_case_completes_that_case_s_task() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let library = library(None);
        for set in [Demonstrations::IRRELEVANT, Demonstrations::CONFUSABLE] {
            for index in 0..cases.cases.len() {
                let chosen = library.of_case(index as u32, set).unwrap();
                let histories = cases.histories(index, set);
                assert_eq!((chosen.len(), histories.len()), (4, 4));
                for (demonstration, history) in chosen.iter().zip(histories) {
                    assert_eq!(
                        (demonstration.case, demonstration.number),
                        (history.case as u32, history.kind as u16)
                    );
                    let of = cases.demonstrated(&warehouse, history).unwrap();
                    let replay = of.replay();
                    assert!(replay.length.is_some() && demonstration.stages == replay.stages);
                    let poses = replay.poses.iter().copied().map(State::from);
                    assert!(demonstration.states.iter().copied().eq(poses));
                    assert_eq!(demonstration.instruction, of.instruction());
                    let actions = of.trajectory.actions.iter().map(|&action| Some(action.into()));
                    assert!(demonstration.actions.iter().copied().eq(actions));
                }
            }
        }
    }

    #[test]
    fn demonstrations_elsewhere_are_of_every_case() {
        let set = Demonstrations::ELSEWHERE;
        assert_eq!(library(None).of_case(0, set), None, "there is no other warehouse");
        let library = library(Some(ElsewhereRequest { assets: None, seed: 1 }));
        let all = library.of_all_cases(set).unwrap();
        assert_eq!(all.len(), library.case_count());
        for (index, demonstration) in (0..).zip(&all) {
            assert_eq!(Some(&*demonstration.instruction), library.instruction(index, false));
            assert_eq!(demonstration.number, DemonstrationKind::Elsewhere as u16);
            assert_eq!(demonstration.views.len(), demonstration.states.len());
            assert_eq!(library.of_case(index, set), Some(vec![demonstration.clone()]));
        }
    }

    #[test]
    fn steps_that_show_the_same_have_one_name() {
        let library = library(None);
        let all = library.of_all_cases(Demonstrations::ALL).unwrap();
        let states: Vec<_> = all.iter().flat_map(|of| of.states.iter().zip(&of.views)).collect();
        let mut of_pose = HashMap::new();
        for (pose, view) in &states {
            assert_eq!(of_pose.entry(pose).or_insert(view), &view, "all take place in one variant");
        }
        let views: HashSet<_> = of_pose.values().collect();
        assert_eq!(views.len(), of_pose.len());
        let [north, east] =
            [Heading::N, Heading::E].map(|heading| State::from(Pose::new(1, 1, heading)));
        let lived = RememberedDemonstration::lived_views(7, 3, &[north, east, north]);
        let steps: Vec<_> = lived.iter().map(|of| (of.sequence, of.number, of.step)).collect();
        assert_eq!(steps, [(7, 3, 0), (7, 3, 1), (7, 3, 0)]);
    }

    /// Memories and builders ask whether the pose has changed, and not what the feedback is.
    #[test]
    fn an_action_changes_the_pose_if_its_feedback_is_that_the_agent_moved_or_turned() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let mut blocked = 0;
        for case in &cases.cases {
            let closed = Variant::closing(case.barricade.iter().copied());
            for variant in [Variant::UNCHANGED, closed] {
                let kind = TrajectoryKind::Test;
                let replay = case.trajectory(kind).replay(&warehouse, &case.task, &variant);
                let poses = replay.poses.windows(2).map(|pair| pair[0] != pair[1]);
                for (feedback, has_changed) in replay.feedback.iter().skip(1).zip(poses) {
                    let has_moved = matches!(feedback, Feedback::Moved | Feedback::Turned);
                    assert_eq!(has_moved, has_changed, "{feedback:?}");
                    blocked += u32::from(!has_moved);
                }
            }
        }
        assert!(blocked > 100, "{blocked}");
    }

    #[test]
    fn unknown_cases_and_empty_sets() {
        let library = library(None);
        assert_eq!(library.of_case(100, Demonstrations::ALL), None);
        assert_eq!(library.of_case(0, Demonstrations::NONE), Some(Vec::new()));
        let missing = library.of_bank(library.bank_of_case(0, Demonstrations::bank(401)));
        assert_eq!(missing.unwrap_err(), "there is no bank bank-401");
    }
}
