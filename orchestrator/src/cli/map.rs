//! `memtransfer map`: a case, or the warehouse, from above.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use results::names::UnknownName;
use warehouse::map;

use super::{Exit, WorldArgs, print};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memtransfer map t03-07 --out map.svg     a case with its six routes
  memtransfer map > floor.svg              the warehouse and its items")]
pub(super) struct MapArgs {
    /// The case [default: the warehouse alone]
    #[arg(value_name = "CASE")]
    case: Option<String>,
    /// Write the SVG to FILE instead of stdout
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    world: WorldArgs,
}

pub(super) fn run(args: &MapArgs) -> anyhow::Result<Exit> {
    let world = args.world.load()?;
    let svg = match &args.case {
        None => map::floor_svg(&world.warehouse),
        Some(id) => {
            let case = world.cases.case(id);
            let case = case.ok_or_else(|| UnknownName::new("case", id, world.case_ids()))?;
            map::svg(&world.warehouse, case)
        }
    };
    match &args.out {
        None => print(&svg)?,
        Some(path) => {
            std::fs::write(path, svg)
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
    }
    Ok(Exit::Complete)
}
