//! The first view of every case's original and test start, which must show no target.

use anyhow::Result;
use domain::{Appearance, Pose};
use warehouse::{CaseSet, Item, TrajectoryKind, Warehouse};

use crate::renderer::{Backend, RenderSettings, Renderer};

/// A view that must show none of these items.
#[derive(Debug, Clone)]
pub struct FirstView<'w> {
    /// Where it belongs: a case and one of its starts, for example `t01-01 test`.
    pub of: String,
    /// From where.
    pub pose: Pose,
    /// The targets of the task.
    pub targets: Vec<&'w Item>,
}

/// The first views of the original and the test start of all cases.
pub fn first_views<'w>(warehouse: &'w Warehouse, cases: &'w CaseSet) -> Vec<FirstView<'w>> {
    let of_case = |case: &'w warehouse::Case| {
        [TrajectoryKind::Original, TrajectoryKind::Test].map(|start| FirstView {
            of: format!("{} {}", case.id, start.name()),
            pose: case.trajectory(start).start,
            targets: case.task.targets(warehouse),
        })
    };
    cases.cases.iter().flat_map(of_case).collect()
}

/// What is wrong with those of `views` that show a target, with plates and labels, where most of an item is in view, and in the
/// standard size. The CPU draws, whose pixels are the same on every machine.
///
/// # Errors
/// None that a view of the warehouse can cause.
pub fn shown_targets(warehouse: &Warehouse, views: &[FirstView<'_>]) -> Result<Vec<String>> {
    let settings = RenderSettings {
        backend: Some(Backend::Cpu),
        appearance: Appearance::WITH_PLATES,
        ..RenderSettings::default()
    };
    let mut renderer = Renderer::new(warehouse, settings)?;
    let mut wrong = Vec::new();
    for FirstView { of, pose, targets } in views {
        let pixels = renderer.pixels_of(*pose, targets)?;
        if pixels > 0 {
            wrong.push(format!("{of}: {pixels} pixels of a target are in view from {pose}"));
        }
    }
    Ok(wrong)
}
