//! `memtransfer clean`: removes what killed runs left.

use std::path::PathBuf;

use clap::Args;
use orchestrator::progress::say;
use serde_json::json;
use shm_types::registry;

use super::{Exit, print, print_json};

#[derive(Debug, Args)]
#[command(after_help = "\
Removes what belongs to runs whose processes are all gone: shared memory, sockets, temporary
folders. Run folders with results are never touched.

Examples:
  memtransfer clean --dry-run
  memtransfer clean")]
pub(super) struct CleanArgs {
    /// Print what would be removed, and stop
    #[arg(long)]
    dry_run: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &CleanArgs) -> anyhow::Result<Exit> {
    let base = registry::default_base();
    let (dead, alive, failed): (Vec<PathBuf>, Vec<PathBuf>, Vec<_>) = if args.dry_run {
        let (alive, dead): (Vec<_>, Vec<_>) =
            registry::list(&base)?.into_iter().partition(|run| run.alive);
        let paths = |runs: Vec<registry::ListedRun>| runs.into_iter().map(|run| run.path).collect();
        (paths(dead), paths(alive), Vec::new())
    } else {
        let cleaned = registry::clean(&base)?;
        (cleaned.removed, cleaned.alive, cleaned.failed)
    };
    if args.json {
        let key = if args.dry_run { "dead" } else { "removed" };
        print_json(&json!({ key: dead, "alive": alive }))?;
    } else {
        let verb = if args.dry_run { "dead, would be removed:" } else { "removed" };
        for path in &dead {
            print(&format!("{verb} {}", path.display()))?;
        }
        for path in &alive {
            print(&format!("alive, not touched: {}", path.display()))?;
        }
        if dead.is_empty() && alive.is_empty() && failed.is_empty() {
            print("nothing to clean")?;
        }
    }
    for error in &failed {
        say(&error.to_string());
    }
    Ok(if failed.is_empty() { Exit::Complete } else { Exit::Failed })
}
