//! `memtransfer map`: a case, or the warehouse, from above.

use std::path::PathBuf;

use anyhow::{Error, bail};
use clap::Args;
use results::settings::CaseSelector;
use settings::select_cases;
use warehouse::{Elsewhere, map};

use super::{Exit, WorldArgs, print, write_file};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memtransfer map t03-07 --out map.svg     a case with its six routes
  memtransfer map > floor.svg              the warehouse and its items
  memtransfer map --elsewhere > other.svg  the other warehouse of `run --demos elsewhere`")]
pub(super) struct MapArgs {
    /// The case, by id or number [default: the warehouse alone]
    #[arg(value_name = "CASE")]
    case: Option<String>,
    /// The warehouse in which `run --demos elsewhere` demonstrates tasks, drawn from --seed
    #[arg(long, conflicts_with = "case")]
    elsewhere: bool,
    /// The seed of that run
    #[arg(long, value_name = "N", default_value_t = 1, requires = "elsewhere")]
    seed: u64,
    /// Write the SVG to FILE instead of stdout
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    world: WorldArgs,
}

pub(super) fn run(args: &MapArgs) -> anyhow::Result<Exit> {
    let world = args.world.load()?;
    let svg = match &args.case {
        None if args.elsewhere => {
            let other = Elsewhere::generate(&world.warehouse, &world.cases, args.seed)?;
            map::floor_svg(other.warehouse())
        }
        None => map::floor_svg(&world.warehouse),
        Some(id) => {
            let selector: CaseSelector = id.parse().map_err(Error::msg)?;
            match select_cases(&world.case_ids(), &[selector], None)?[..] {
                [case] => map::svg(&world.warehouse, &world.cases.cases[case]),
                ref several => bail!("{id} stands for {} cases: give one", several.len()),
            }
        }
    };
    match &args.out {
        None => print(&svg)?,
        Some(path) => write_file(path, &svg)?,
    }
    Ok(Exit::Complete)
}
