//! `memtransfer generate`: generates a case file, or a warehouse with its cases, from a seed.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use clap::{Args, Subcommand};
use warehouse::{CaseSet, SHIPPED_COUNT, SHIPPED_SEED, Warehouse};

use super::{Exit, WorldArgs, print, write_file};

mod world;

#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
#[command(after_help = "\
The same seed and count give the same file on every machine; the defaults give the built-in cases.
To run other cases, put the file as cases.toml into a folder with layout.toml and catalogue.toml,
and pass that folder to `run`, `validate` and other verbs with --assets. Mixed sets of
demonstrations come from other cases; a set of a few dozen cases may have too few for some case,
which is then named.

Examples:
  memtransfer generate --seed 7 --count 1000 --out my-assets/cases.toml
  memtransfer generate | diff - assets/cases.toml
  memtransfer generate world --seed 7 --size 24x40 --out my-assets")]
pub(super) struct GenerateArgs {
    #[command(subcommand)]
    what: Option<GenerateWhat>,
    /// The seed
    #[arg(long, value_name = "N", default_value_t = SHIPPED_SEED)]
    seed: u64,
    /// Number of cases, spread evenly over the ten tasks
    #[arg(long, value_name = "N", default_value_t = SHIPPED_COUNT)]
    count: usize,
    /// Write to FILE instead of stdout
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace a file that is there
    #[arg(long, requires = "out")]
    force: bool,
    #[command(flatten)]
    world: WorldArgs,
}

#[derive(Debug, Subcommand)]
enum GenerateWhat {
    /// Generate a warehouse and its cases: a folder for --assets
    World(world::WorldGenerateArgs),
}

pub(super) fn run(args: &GenerateArgs) -> anyhow::Result<Exit> {
    match &args.what {
        Some(GenerateWhat::World(args)) => world::run(args),
        None => cases(args),
    }
}

fn cases(args: &GenerateArgs) -> anyhow::Result<Exit> {
    ensure!(args.count > 0, "--count is 0, but must be at least 1");
    // An existing case file is not read: it is to be replaced.
    let warehouse = match &args.world.assets {
        None => Warehouse::shipped(),
        Some(dir) => Warehouse::load(dir)?,
    };
    let cases = CaseSet::generate(&warehouse, args.seed, args.count)?;
    let text = cases.to_toml(&warehouse.catalogue);
    match &args.out {
        None => print(&text)?,
        Some(path) => {
            if !args.force {
                check_not_replaced(path, &text)?;
            }
            write_file(path, &text)?;
            say!("{} cases in {}", cases.cases.len(), path.display());
        }
    }
    Ok(Exit::Complete)
}

/// Refuses to replace the file `path` by one with another text: people edit layouts, catalogues and cases.
fn check_not_replaced(path: &Path, text: &str) -> anyhow::Result<()> {
    match durable::input::read(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error).with_context(|| format!("cannot read {}", path.display())),
        Ok(found) if found == text.as_bytes() => Ok(()),
        Ok(_) => {
            bail!(
                "{} is there already and differs: choose another --out, or give --force to replace it",
                path.display()
            )
        }
    }
}
