//! `memtransfer report`: pages and data files of runs, from their logs alone.

use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use run_log::RunLog;
use run_log::tell_apart;

use super::{Exit, print};

#[derive(Debug, Args)]
#[command(after_help = "\
Reads the runs' folders and nothing else. Writes report.html (one page, everything inside),
its figures as SVG and PDF, every table as CSV, and conditions and episodes as CSV and Parquet;
prints the path of the page. Every caption names the policy. Exit status 1 when episodes were given up.
Of several runs the page ranks the conditions, and compares every two runs pair by pair.

Examples:
  memtransfer report runs/paper-grounded
  memtransfer report runs/paper-grounded runs/paper-random --out reports/both
  memtransfer report runs/* --out reports/all")]
pub(super) struct ReportArgs {
    /// The runs' folders; several are ranked and compared
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// Write into DIR [default: `report` in the folder of a single run]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write every table as LaTeX as well, with booktabs: tables/*.tex
    #[arg(long)]
    latex: bool,
}

pub(super) fn run(args: &ReportArgs) -> anyhow::Result<Exit> {
    let logs = args.runs.iter().map(|dir| RunLog::read(dir));
    let mut logs = logs.collect::<Result<Vec<_>, _>>()?;
    tell_apart(&mut logs);
    let page = match (&args.out, &logs[..]) {
        (Some(out), _) => report::write(&logs, out, args.latex)?,
        (None, [log]) => {
            let (page, others) = report::write_in_place(log, args.latex)?;
            for other in others {
                say!("kept {}, which is no part of a report", other.display());
            }
            page
        }
        (None, _) => bail!("a report about several runs needs a folder of its own: give --out DIR"),
    };
    print(&page.display().to_string())?;
    let given_up = logs.iter().any(|log| !log.errors.is_empty());
    Ok(if given_up { Exit::Failed } else { Exit::Complete })
}
