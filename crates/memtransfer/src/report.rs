//! `memtransfer report`: pages and data files of runs, from their logs alone.

use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use report::{Options, Published};
use run_log::RunLog;
use run_log::tell_apart;

use super::{Exit, print};

#[derive(Debug, Args)]
#[command(after_help = "\
Reads the runs' folders and nothing else. Writes report.html (one page, everything inside),
its figures as SVG and PDF, every table as CSV, and conditions and episodes as CSV and Parquet;
prints the path of the page. Every caption names the policy. Exit status 1 when episodes are
missing, given up or not run yet.
Of several runs the page ranks the conditions, and compares every two runs pair by pair.
The tables have the paper's figures beside the run's. --against has those of another publication
there, and a section about all of them: which lie in this run's intervals, and what was configured
differently. docs/reproduction.md defines the format; each report of one run has its figures in it,
in published.toml.

Examples:
  memtransfer report runs/paper-grounded
  memtransfer report runs/paper-grounded runs/paper-random --out reports/both
  memtransfer report runs/* --out reports/all
  memtransfer report runs/paper-mine --against figures.toml
  memtransfer report runs/paper-mine --against paper")]
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
    /// Set the run beside the published figures in FILE, or beside those of the paper (`paper`)
    #[arg(long, value_name = "FILE|paper")]
    against: Option<PathBuf>,
}

pub(super) fn run(args: &ReportArgs) -> anyhow::Result<Exit> {
    let logs = args.runs.iter().map(|dir| RunLog::read(dir));
    let mut logs = logs.collect::<Result<Vec<_>, _>>()?;
    tell_apart(&mut logs);
    for (number, log) in logs.iter().enumerate() {
        if logs[..number].iter().any(|other| other.is_same_run(log)) {
            bail!("{} is given twice", log.dir.display());
        }
    }
    let against = match &args.against {
        Some(_) if logs.len() > 1 => {
            bail!(
                "--against sets one run beside published figures, and {} runs are given",
                logs.len()
            )
        }
        Some(file) if file.as_os_str() == "paper" => Some(Published::paper()?),
        Some(file) => Some(Published::read(file)?),
        None => None,
    };
    let options = Options { against: against.as_ref(), latex: args.latex };
    let page = match (&args.out, &logs[..]) {
        (Some(out), _) => report::write(&logs, out, options)?,
        (None, [log]) => {
            let (page, others) = report::write_in_place(log, options)?;
            for other in others {
                say!("kept {}, which is no part of a report", other.display());
            }
            page
        }
        (None, _) => bail!("a report about several runs needs a folder of its own: give --out DIR"),
    };
    print(&page.display().to_string())?;
    let are_complete = logs.iter().all(RunLog::is_complete);
    Ok(if are_complete { Exit::Complete } else { Exit::Failed })
}
