//! `memtransfer score`: a run's table, from its log alone.

use std::path::PathBuf;

use clap::Args;

use super::{Exit, print, print_json};
use crate::log::RunLog;
use crate::{score, table};

#[derive(Debug, Args)]
#[command(after_help = "\
Reads the run's folder and nothing else; a run that is still going can be scored, too.
Exit status 1 when episodes were given up.

Examples:
  memtransfer score runs/quick-grounded
  memtransfer score runs/quick-grounded --json | jq '.conditions[].sr.mean'")]
pub(super) struct ScoreArgs {
    /// The run's folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ScoreArgs) -> anyhow::Result<Exit> {
    let log = RunLog::read(&args.run)?;
    if args.json {
        print_json(&score::score(&log))?;
    } else {
        print(&table::report(&log))?;
    }
    Ok(if log.errors.is_empty() { Exit::Complete } else { Exit::Failed })
}
