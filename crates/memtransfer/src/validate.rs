//! `memtransfer validate`: checks every constraint on warehouse and cases by replay, and the first views by rendering them.

use std::process::Command;

use anyhow::{Context, ensure};
use clap::Args;
use supervise::{QUIET_DRIVER, sibling};
use warehouse::validate::ConstraintResult;

use super::{Exit, WorldArgs, print, print_json};

#[derive(Debug, Args)]
#[command(after_help = "\
Prints one line for each constraint: whether it holds, how often it was checked and violated. The
last one renders the first views of original and test starts, on the CPU. Exit status 1 when one is
violated.

Examples:
  memtransfer validate
  memtransfer validate --assets my-assets --json")]
pub(super) struct ValidateArgs {
    #[command(flatten)]
    world: WorldArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ValidateArgs) -> anyhow::Result<Exit> {
    let world = args.world.load()?;
    let mut report = warehouse::validate(&world.warehouse, &world.cases);
    report.lines.push(first_views(&args.world)?);
    if args.json {
        print_json(&report)?;
    } else {
        let cases = world.cases.cases.len();
        let trajectories = cases * warehouse::TrajectoryKind::ALL.len();
        print(&format!(
            "{report}{cases} cases, {trajectories} trajectories, {} violations",
            report.violations()
        ))?;
    }
    Ok(if report.is_clean() { Exit::Complete } else { Exit::Failed })
}

/// Has the simulator render where cases begin.
fn first_views(world: &WorldArgs) -> anyhow::Result<ConstraintResult> {
    let program = sibling("sim-proc")?;
    let mut command = Command::new(&program);
    command.arg("first-views").env(QUIET_DRIVER.0, QUIET_DRIVER.1);
    if let Some(assets) = &world.assets {
        command.arg("--assets").arg(assets);
    }
    let output = command.output();
    let output = output.with_context(|| format!("cannot start {}", program.display()))?;
    let said = String::from_utf8_lossy(&output.stdout);
    let reason = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "the first views cannot be rendered: {}", reason.trim_end());
    let mut lines: Vec<String> = said.lines().map(str::to_owned).collect();
    let checked = lines.pop().and_then(|count| count.parse().ok());
    Ok(ConstraintResult {
        constraint: "rendered: no pixel of a target in the first views",
        checked: checked.context("the simulator does not say how many views it rendered")?,
        violations: lines,
    })
}
