//! `memtransfer validate`: has the world check its files, or every episode of a run.

use std::path::{Path, PathBuf};

use case_book::BookRequest;
use clap::Args;
use orchestrator::books::{Books, WRITING_TIMEOUT};
use serde_json::json;
use world_client::{RecordedRun, check_run};

use super::{Exit, WorldArgs, print, print_json};

#[derive(Debug, Args)]
#[command(after_help = "\
Prints one line for each constraint: whether it holds, how often it was checked and violated. The
last one renders the first views of original and test starts, on the CPU. Exit status 1 when one is
violated. Of a world of your own: whether every trajectory of every case completes its task.

Of a run, every finished episode is acted out again from its actions, by the world that made it:
task, reference, start, steps, ending, sub-goals, visits, first sights, blocked moves, final pose.
Prints every field that differs. Exit status 1 when one does, or a line of the log is damaged.

Examples:
  memtransfer validate
  memtransfer validate --assets my-assets --json
  memtransfer validate runs/quick-grounded")]
pub(super) struct ValidateArgs {
    /// A run's folder: check its log instead of the world's files
    #[arg(value_name = "RUN")]
    run: Option<PathBuf>,
    #[command(flatten)]
    world: WorldArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ValidateArgs) -> anyhow::Result<Exit> {
    if let Some(dir) = &args.run {
        return check(dir, args);
    }
    if let Some(command) = args.world.other.command() {
        args.world.program()?;
        let books = Books::of_world(Some(command), &BookRequest::default(), WRITING_TIMEOUT)?;
        let cases = books.cases.book.cases.len();
        match args.json {
            true => print_json(&json!({ "cases": cases }))?,
            false => print(&format!(
                "ok {cases:>7} checked    0 violated  every trajectory of every case completes its task"
            ))?,
        }
        return Ok(Exit::Complete);
    }
    let mut flags = args.world.flags();
    flags.extend(args.json.then(|| "--json".into()));
    let (report, is_clean) = args.world.warehouse()?.print("validate", &flags)?;
    print(&report)?;
    Ok(if is_clean { Exit::Complete } else { Exit::Failed })
}

fn check(dir: &Path, args: &ValidateArgs) -> anyhow::Result<Exit> {
    let run = RecordedRun::read(dir, &args.world.other.program()?.access())?;
    let differences = check_run(&run)?;
    let (episodes, damaged) = (run.log.episodes.len(), &run.log.damaged);
    let damaged: Vec<String> = damaged.iter().map(ToString::to_string).collect();
    let is_clean = differences.is_empty() && damaged.is_empty();
    if args.json {
        print_json(&json!({
            "episodes": episodes, "differences": differences, "damaged": damaged,
        }))?;
    } else {
        let lines = differences.iter().map(|one| format!("FAIL {one}\n"));
        let lines: String =
            lines.chain(damaged.iter().map(|one| format!("FAIL {one}\n"))).collect();
        print(&format!(
            "{lines}{episodes} episodes, {} differences, {} damaged lines",
            differences.len(),
            damaged.len()
        ))?;
        if let Some(notice) = run.log.varies().filter(|_| !is_clean) {
            say!("{notice}");
        }
    }
    Ok(if is_clean { Exit::Complete } else { Exit::Failed })
}
