//! `memtransfer validate`: checks every constraint on warehouse and cases by replay.

use clap::Args;

use super::{Exit, WorldArgs, print, print_json};

#[derive(Debug, Args)]
#[command(after_help = "\
Prints one line for each constraint: whether it holds, how often it was checked and violated. Exit
status 1 when one is violated.

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
    let report = warehouse::validate(&world.warehouse, &world.cases);
    if args.json {
        print_json(&report)?;
    } else {
        let cases = world.cases.cases.len();
        let trajectories = cases * warehouse::Start::ALL.len();
        print(&format!(
            "{report}{cases} cases, {trajectories} trajectories, {} violations",
            report.violations()
        ))?;
    }
    Ok(if report.is_clean() { Exit::Complete } else { Exit::Failed })
}
