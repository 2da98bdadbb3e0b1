//! `memtransfer generate`: generates a case file, or a warehouse with its cases, from a seed.

use std::ffi::OsString;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, Subcommand};
use serde::Deserialize;
use world_client::WorldProgram;

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
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Number of cases, spread evenly over the ten tasks
    #[arg(long, value_name = "N", default_value_t = 100)]
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

pub(super) fn run(args: &GenerateArgs) -> Result<Exit> {
    match &args.what {
        Some(GenerateWhat::World(args)) => world::run(args),
        None => cases(args),
    }
}

fn cases(args: &GenerateArgs) -> Result<Exit> {
    ensure!(args.count > 0, "--count is 0, but must be at least 1");
    let program = args.world.warehouse()?;
    let mut flags = args.world.flags();
    flags.extend(["--seed".into(), args.seed.to_string().into()]);
    flags.extend(["--count".into(), args.count.to_string().into()]);
    let text = GeneratedFiles::ask(&program, &flags)?.cases;
    match &args.out {
        None => print(&text)?,
        Some(path) => {
            if !args.force {
                check_not_replaced(path, &text)?;
            }
            write_file(path, &text)?;
            say!("{} cases in {}", args.count, path.display());
        }
    }
    Ok(Exit::Complete)
}

/// What the world generates.
#[derive(Debug, Deserialize)]
struct GeneratedFiles {
    cases: String,
    /// The files of a warehouse, and what it consists of.
    #[serde(default)]
    layout: String,
    #[serde(default)]
    catalogue: String,
    #[serde(default)]
    about: String,
}

impl GeneratedFiles {
    fn ask(program: &WorldProgram, flags: &[OsString]) -> Result<Self> {
        let (files, _) = program.print("generate", flags)?;
        serde_json::from_str(&files).context("sim-proc is another version")
    }
}

/// Refuses to replace the file `path` by one with another text: people edit layouts, catalogues and cases.
fn check_not_replaced(path: &Path, text: &str) -> Result<()> {
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
