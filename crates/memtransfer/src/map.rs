//! `memtransfer map`: a case, or the warehouse, from above.

use std::path::PathBuf;

use anyhow::{Error, bail};
use clap::Args;
use conditions::settings::CaseSelector;
use settings::select_cases;

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
    let program = args.world.warehouse()?;
    let mut flags = args.world.flags();
    if args.elsewhere {
        flags.extend(["--elsewhere".into(), args.seed.to_string().into()]);
    }
    if let Some(id) = &args.case {
        let world = program.describe(&args.world.flags())?;
        let (ids, selector) = (world.case_ids(), id.parse::<CaseSelector>().map_err(Error::msg)?);
        match select_cases(&ids, &[selector])?[..] {
            [case] => flags.push(ids[case].into()),
            ref several => bail!("{id} stands for {} cases: give one", several.len()),
        }
    }
    let (svg, _) = program.print("map", &flags)?;
    match &args.out {
        None => print(&svg)?,
        Some(path) => write_file(path, &svg)?,
    }
    Ok(Exit::Complete)
}
