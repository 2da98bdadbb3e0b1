//! `sim-proc first-views`: renders the first view of every case's original and test start, which must show no target.

use std::io::{self, Write as _};
use std::path::PathBuf;

use anyhow::Result;
use domain::Pose;
use warehouse::{CaseSet, Item, TrajectoryKind, Warehouse};

use crate::renderer::{Backend, RenderSettings, Renderer};

/// Arguments of `sim-proc first-views`. Prints a line for each view that shows a target, and last the number of views.
#[derive(Debug, clap::Args)]
pub struct FirstViewsArgs {
    /// The folder with layout.toml, catalogue.toml and cases.toml, instead of what is compiled in.
    #[arg(long, value_name = "DIR", env = "MEMTRANSFER_ASSETS")]
    assets: Option<PathBuf>,
}

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

/// What is wrong with those of `views` that show a target, in the standard appearance and size. The CPU draws, whose pixels are
/// the same on every machine.
///
/// # Errors
/// None that a view of the warehouse can cause.
pub fn shown_targets(warehouse: &Warehouse, views: &[FirstView<'_>]) -> Result<Vec<String>> {
    let settings = RenderSettings { backend: Some(Backend::Cpu), ..RenderSettings::default() };
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

/// Renders the first views and prints the result.
///
/// # Errors
/// Assets that cannot be read.
pub fn run(args: &FirstViewsArgs) -> Result<()> {
    let (warehouse, cases) = CaseSet::with_warehouse(args.assets.as_deref())?;
    let views = first_views(&warehouse, &cases);
    let mut stdout = io::stdout().lock();
    for wrong in shown_targets(&warehouse, &views)? {
        writeln!(stdout, "{wrong}")?;
    }
    writeln!(stdout, "{}", views.len())?;
    Ok(())
}
