//! `memtransfer leaderboard`: many runs in one table and one page.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use export::leaderboard::{Board, read, write_page};

use super::{Exit, print, print_json, warn_of_damage};

#[derive(Debug, Args)]
#[command(after_help = "\
Compares only what can be compared: runs of the same suite, world, seed, limits and version share a
section; all others are apart, and the output says in what they differ. The page is one file that
needs no network.

Examples:
  memtransfer leaderboard runs                    every run in a folder
  memtransfer leaderboard board --out board.html  entries that `export --format leaderboard` wrote
  memtransfer leaderboard runs/a board/b.json")]
pub(super) struct LeaderboardArgs {
    /// Entries, run folders, or folders that hold either
    #[arg(value_name = "PATH", required = true)]
    paths: Vec<PathBuf>,
    /// Write a page
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print the entries as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &LeaderboardArgs) -> Result<Exit> {
    let found = read(&args.paths)?;
    for file in &found.left_out {
        say!("left out: {file}");
    }
    warn_of_damage(&found.damaged);
    if found.entries.is_empty() {
        bail!(
            "there is no run and no entry of a leaderboard: `memtransfer export RUN --format leaderboard` \
             writes one"
        );
    }
    let board = Board::new(&found.entries);
    if let Some(page) = &args.out {
        write_page(&board, page)?;
        say!("wrote {}", page.display());
    }
    if args.json {
        print_json(&found.entries)?;
    } else {
        print(&board.text())?;
    }
    Ok(Exit::Complete)
}
