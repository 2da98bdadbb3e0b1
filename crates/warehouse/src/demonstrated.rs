//! What a [`History`] stands for: a trajectory in a warehouse and a variant of it. This is the only place that knows; frames,
//! documents, memories and the log all ask here.

use std::borrow::Cow;

use domain::{Cell, DemonstrationKind};

use crate::case::{Case, CaseSet, History, TrajectoryKind};
use crate::dynamics::Variant;
use crate::elsewhere::ELSEWHERE_VARIANT;
use crate::plan::{Planner, Prices};
use crate::task::Task;
use crate::trajectory::{Replay, Trajectory};
use crate::world::Warehouse;

/// A demonstration, and the world in which it takes place.
#[derive(Debug, Clone)]
pub struct Demonstrated<'a> {
    /// The warehouse.
    pub warehouse: &'a Warehouse,
    /// The number of the world variant on the wire.
    pub variant: u32,
    /// The closed cells in that variant, sorted.
    pub closed: &'a [Cell],
    /// The task.
    pub task: &'a Task,
    /// The trajectory.
    pub trajectory: Cow<'a, Trajectory>,
}

impl Demonstrated<'_> {
    /// Replays the demonstration where it takes place.
    pub fn replay(&self) -> Replay {
        let variant = Variant::closing(self.closed.iter().copied());
        self.trajectory.replay(self.warehouse, self.task, &variant)
    }

    /// The instruction that it carries out.
    pub fn instruction(&self) -> String {
        self.task.instruction(&self.warehouse.catalogue)
    }
}

impl CaseSet {
    /// The demonstration `history` of one of these cases, which are in `warehouse`. `None` if there is no such case, or
    /// an expert who knows the closed passage has no way to complete the task, or there is no other warehouse.
    pub fn demonstrated<'a>(
        &'a self,
        warehouse: &'a Warehouse,
        History { case: index, kind }: History,
    ) -> Option<Demonstrated<'a>> {
        let case = self.cases.get(index)?;
        let unchanged = Demonstrated {
            warehouse,
            variant: 0,
            closed: &[],
            task: &case.task,
            trajectory: Cow::Borrowed(&case.original),
        };
        match kind {
            DemonstrationKind::Original
            | DemonstrationKind::Opposite
            | DemonstrationKind::Nearby
            | DemonstrationKind::Distant => {
                let trajectory = case.trajectory(TrajectoryKind::demonstration(kind)?);
                let trajectory = Cow::Borrowed(trajectory);
                Some(Demonstrated { trajectory, ..unchanged })
            }
            DemonstrationKind::Elsewhere => {
                let elsewhere = self.elsewhere.as_ref()?;
                let (task, trajectory) = elsewhere.demonstration(index)?;
                let trajectory = Cow::Borrowed(trajectory);
                let (warehouse, variant) = (elsewhere.warehouse(), ELSEWHERE_VARIANT);
                Some(Demonstrated { warehouse, variant, closed: &[], task, trajectory })
            }
            DemonstrationKind::New => {
                Some(Demonstrated { trajectory: Cow::Borrowed(&case.test), ..unchanged })
            }
            DemonstrationKind::Blocked => Some(Demonstrated {
                variant: 1 + index as u32,
                closed: &case.barricade,
                trajectory: Cow::Borrowed(case.trajectory(TrajectoryKind::Blocked)),
                ..unchanged
            }),
            DemonstrationKind::After => Some(Demonstrated {
                variant: 1 + index as u32,
                closed: &case.barricade,
                trajectory: Cow::Owned(planned_after(warehouse, case)?),
                ..unchanged
            }),
        }
    }
}

/// Plans the demonstration [`DemonstrationKind::After`] from the first of the case's demonstrated starts that is not closed: with
/// rare exceptions its original one. Takes milliseconds.
fn planned_after(warehouse: &Warehouse, case: &Case) -> Option<Trajectory> {
    let variant = Variant::closing(case.barricade.iter().copied());
    let planner = Planner::new(warehouse, variant.clone(), Prices::EXPERT);
    let starts = TrajectoryKind::DEMONSTRATIONS.map(|start| case.trajectory(start).start);
    let mut open = starts.into_iter().filter(|start| !variant.is_closed(start.cell));
    planner.plan(open.next()?, &case.task)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_can_be_demonstrated_after_its_passage_has_closed() {
        let (warehouse, set) = (Warehouse::shipped(), CaseSet::shipped());
        let (mut moved, mut broken) = (0, 0);
        for (index, case) in set.cases.iter().enumerate() {
            let of = |kind| set.demonstrated(&warehouse, History { case: index, kind });
            let after = of(DemonstrationKind::After).unwrap();
            assert_eq!((after.variant, after.closed), (1 + index as u32, &*case.barricade));
            assert!(after.replay().length.is_some(), "{}", case.id);
            let original = of(DemonstrationKind::Original).unwrap();
            assert_eq!((original.variant, &*original.trajectory), (0, &case.original));
            let closed = Demonstrated { closed: &case.barricade, ..original };
            broken += usize::from(closed.replay().length.is_none());
            moved += usize::from(after.trajectory.start != case.original.start);
        }
        assert_eq!((moved, broken), (0, 68));
        let unknown = History { case: 100, kind: DemonstrationKind::Original };
        assert!(set.demonstrated(&warehouse, unknown).is_none());
    }
}
