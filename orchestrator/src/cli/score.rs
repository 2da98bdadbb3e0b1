//! `memtransfer score`: a run's table, or comparisons of conditions and runs, from logs alone.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::{Exit, print, print_json};
use results::compare::{compare_conditions, compare_runs};
use results::log::RunLog;
use results::score::Comparison;
use results::{score, table};

#[derive(Debug, Args)]
#[command(after_help = "\
Reads the runs' folders and nothing else; a run that is still going can be scored, too.
A comparison is paired: it takes the cases that both sides have.
Exit status 1 when episodes were given up.

Examples:
  memtransfer score runs/quick-grounded
  memtransfer score runs/quick-grounded --json | jq '.conditions[].sr.mean'
  memtransfer score runs/quick-grounded \\
      --compare episodic/new/unchanged/original working/new/unchanged/none
  memtransfer score runs/quick-grounded runs/quick-random   every condition that both have")]
pub(super) struct ScoreArgs {
    /// The run's folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Compare with this run, condition by condition
    #[arg(value_name = "RUN2")]
    other: Option<PathBuf>,
    /// Compare two conditions (of RUN; the second one of RUN2 where that is given)
    #[arg(long, num_args = 2, value_names = ["CONDITION", "CONDITION"])]
    compare: Option<Vec<String>>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ScoreArgs) -> anyhow::Result<Exit> {
    let log = RunLog::read(&args.run)?;
    let other = args.other.as_deref().map(RunLog::read).transpose()?;
    match (&args.compare, &other) {
        (None, None) => args.show(&score::score(&log), || table::report(&log))?,
        (None, Some(other)) => args.show_compared(&compare_runs(&log, other)?)?,
        (Some(conditions), other) => {
            let [a, b] = [0, 1].map(|side| conditions[side].as_str());
            let second = other.as_ref().unwrap_or(&log);
            args.show_compared(&[compare_conditions((&log, a), (second, b))?])?;
        }
    }
    let given_up =
        [Some(&log), other.as_ref()].into_iter().flatten().any(|log| !log.errors.is_empty());
    Ok(if given_up { Exit::Failed } else { Exit::Complete })
}

impl ScoreArgs {
    fn show_compared(&self, compared: &[Comparison]) -> anyhow::Result<()> {
        self.show(&compared, || table::comparisons(compared))
    }

    fn show(&self, value: &impl Serialize, text: impl Fn() -> String) -> anyhow::Result<()> {
        if self.json { print_json(value) } else { print(&text()) }
    }
}
