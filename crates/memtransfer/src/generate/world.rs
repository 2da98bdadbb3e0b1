//! `memtransfer generate world`: a folder with a warehouse and its cases, drawn from a seed.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use clap::Args;

use super::{GeneratedFiles, check_not_replaced};
use crate::{Exit, WorldArgs, write_file};

const FILES: [&str; 3] = ["layout.toml", "catalogue.toml", "cases.toml"];

#[derive(Debug, Args)]
#[command(after_help = "\
Draws banks of racks with parallel aisles, a cross-aisle between any two banks, and what stands on
the racks; then generates cases in it. The folder has layout.toml, catalogue.toml and cases.toml;
pass it to `run`, `validate`, `map` and other verbs with --assets. The same flags give the same
files on every machine.

Examples:
  memtransfer generate world --seed 7 --size 24x40 --out my-assets
  memtransfer validate --assets my-assets
  memtransfer map --assets my-assets --out floor.svg
  memtransfer run --assets my-assets --limit 5")]
pub(super) struct WorldGenerateArgs {
    /// The seed of the warehouse and of its cases
    #[arg(long, value_name = "N")]
    seed: u64,
    /// Columns and rows, each 12 to 64
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: (usize, usize),
    /// Parallel aisles in each bank of racks [default: one for every 5 or 6 columns]
    #[arg(long, value_name = "N")]
    aisles: Option<usize>,
    /// Number of cases, spread evenly over the ten tasks
    #[arg(long, value_name = "N", default_value_t = 50)]
    cases: usize,
    /// The folder: a new one, an empty one, or one with the same files
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Replace a layout, a catalogue and cases that are there
    #[arg(long)]
    force: bool,
}

fn parse_size(text: &str) -> Result<(usize, usize), String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    sides.ok_or_else(|| "expected columns and rows, such as 24x40".into())
}

pub(super) fn run(args: &WorldGenerateArgs) -> anyhow::Result<Exit> {
    ensure!(args.cases > 0, "--cases is 0, but must be at least 1");
    check_folder(&args.out)?;
    let (width, height) = args.size;
    let number = |number: usize| number.to_string().into();
    let mut flags: Vec<OsString> = vec!["--seed".into(), args.seed.to_string().into()];
    flags.extend(["--count".into(), number(args.cases)]);
    flags.extend(["--size".into(), number(width), number(height)]);
    flags.extend(args.aisles.into_iter().flat_map(|aisles| ["--aisles".into(), number(aisles)]));
    let GeneratedFiles { layout, catalogue, cases, about } =
        GeneratedFiles::ask(&WorldArgs::default().warehouse()?, &flags)?;
    let texts = [layout, catalogue, cases];
    let files: Vec<(PathBuf, String)> =
        FILES.into_iter().map(|file| args.out.join(file)).zip(texts).collect();
    if !args.force {
        files.iter().try_for_each(|(path, text)| check_not_replaced(path, text))?;
    }
    files.iter().try_for_each(|(path, text)| write_file(path, text))?;
    say!("{about} in {}", args.out.display());
    Ok(Exit::Complete)
}

/// Refuses a folder with files that are not of a generated world.
fn check_folder(folder: &Path) -> anyhow::Result<()> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => {
            return Err(error).with_context(|| format!("cannot read {}", folder.display()));
        }
    };
    for entry in entries {
        let name = entry.with_context(|| format!("cannot read {}", folder.display()))?.file_name();
        if !FILES.iter().any(|file| name == *file) {
            bail!(
                "{} has other files, {:?} for one; choose a new folder with --out",
                folder.display(),
                name.to_string_lossy()
            );
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_is_columns_and_rows() {
        assert_eq!(parse_size("24x40"), Ok((24, 40)));
        for wrong in ["24", "24x", "x40", "24X40", "24x40x3", "-1x40", ""] {
            assert_eq!(
                parse_size(wrong),
                Err("expected columns and rows, such as 24x40".into()),
                "{wrong:?}"
            );
        }
    }
}
