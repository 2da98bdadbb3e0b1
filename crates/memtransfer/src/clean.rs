//! `memtransfer clean`: removes what killed runs left.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use domain::cache_folder;
use orchestrator::progress::say;
use orchestrator::scratch;
use serde_json::json;
use shm_types::registry;

use super::{Exit, print, print_json};

#[derive(Debug, Args)]
#[command(after_help = "\
Removes what belongs to programs that are all gone: shared memory, sockets, temporary folders, and
unfinished copies in the cache folder. Run folders with results are never touched.

Examples:
  memtransfer clean --dry-run
  memtransfer clean
  memtransfer clean --store /mnt/shared/memtransfer    and unfinished copies of `plan --store`")]
pub(super) struct CleanArgs {
    /// Print what would be removed, and stop
    #[arg(long)]
    dry_run: bool,
    /// Also remove unfinished copies from this folder of `memtransfer plan --store`
    #[arg(long, value_name = "DIR")]
    store: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &CleanArgs) -> anyhow::Result<Exit> {
    let base = registry::default_base();
    let (mut dead, alive, failed): (Vec<PathBuf>, Vec<PathBuf>, Vec<registry::RegistryError>) =
        if args.dry_run {
            let (alive, dead): (Vec<_>, Vec<_>) =
                registry::list(&base)?.into_iter().partition(|run| run.alive);
            let paths =
                |runs: Vec<registry::ListedRun>| runs.into_iter().map(|run| run.path).collect();
            (paths(dead), paths(alive), Vec::new())
        } else {
            let cleaned = registry::clean(&base)?;
            (cleaned.removed, cleaned.alive, cleaned.failed)
        };
    let mut failed: Vec<String> = failed.iter().map(ToString::to_string).collect();
    for left in abandoned(args.store.as_deref())? {
        match if args.dry_run { Ok(()) } else { scratch::remove(&left) } {
            Ok(()) => dead.push(left),
            Err(error) => failed.push(format!("cannot remove {}: {error}", left.display())),
        }
    }
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
        say(error);
    }
    Ok(if failed.is_empty() { Exit::Complete } else { Exit::Failed })
}

/// The temporary folders and unfinished copies that killed programs left.
fn abandoned(store: Option<&Path>) -> anyhow::Result<Vec<PathBuf>> {
    let mut left = scratch::abandoned_folders().context("cannot search for temporary folders")?;
    let mut folders: Vec<PathBuf> = store.into_iter().map(Path::to_owned).collect();
    // Copies are made in the folder of the file, one level below that of the cache.
    if let Ok(cache) = cache_folder() {
        folders.extend(folders_in(&cache).with_context(|| cache.display().to_string())?);
        folders.push(cache);
    }
    for folder in folders {
        let drafts = scratch::abandoned_drafts(&folder);
        left.extend(drafts.with_context(|| format!("cannot search {}", folder.display()))?);
    }
    Ok(left)
}

/// The folders in `folder`; none if there is no such folder.
fn folders_in(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?.collect::<io::Result<Vec<_>>>()?,
    };
    let folders = entries.iter().filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()));
    Ok(folders.map(fs::DirEntry::path).collect())
}
