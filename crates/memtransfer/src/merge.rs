//! `memtransfer merge`: joins finished units into one run folder.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Args;
use conditions::settings::RunSettings;
use domain::shell_word;
use orchestrator::selection::SelectedCases;
use orchestrator::units::{ReadPlan, UnitPlan};
use run_log::{EPISODES_FILE, Manifest, UnitFolders, merge};
use settings::{Layer, on_this_machine};

use super::{Exit, print};

#[derive(Debug, Args)]
#[command(after_help = "\
The merged folder is that of one `memtransfer run`: the episode log has its lines, byte for byte, in
the order of the plan. Where a unit is in several folders, its episodes must be equal.

Exit status: 0 merged, 2 units disagree or cannot be read, 3 units are missing; they are listed on
stdout, and nothing is written.

Examples:
  memtransfer merge --plan plan.json units --out runs/paper
  memtransfer merge --plan plan.json units-of-a units-of-b --out runs/paper --strict")]
pub(super) struct MergeArgs {
    /// The plan that `memtransfer plan` wrote
    #[arg(long, value_name = "FILE")]
    plan: PathBuf,

    /// Folders of finished units
    #[arg(value_name = "DIR", required = true)]
    folders: Vec<PathBuf>,

    /// The run folder to make
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Refuse units from machines whose pixels or embeddings may differ, instead of a warning
    #[arg(long)]
    strict: bool,

    /// The layout, catalogue and cases of the plan, if they are elsewhere now
    #[arg(long, value_name = "DIR")]
    assets: Option<PathBuf>,
}

pub(super) fn run(args: &MergeArgs) -> Result<Exit> {
    if args.out.is_file() {
        bail!("{} is a file: --out is the run folder to make", args.out.display());
    }
    let read = UnitPlan::read(&args.plan)?;
    let settings = here(&read.plan.manifest.settings, args)?;
    let selection = SelectedCases::of(&settings);
    let selection = selection.with_context(|| format!("cannot use {}", args.plan.display()))?;
    let hashes = selection.books.world_hashes();
    if let Some((name, _)) =
        hashes.iter().find(|(name, hash)| read.plan.manifest.hashes.get(*name) != Some(*hash))
    {
        bail!("the {name} here is not that of the plan: give its folder with --assets");
    }
    read.check_episodes(&selection, &args.plan)?;
    let ReadPlan { plan, digest } = read;
    for folder in args.folders.iter().filter(|folder| !folder.is_dir()) {
        say!("warning: {} is not a folder: no units are taken from there", folder.display());
    }
    let folders = UnitFolders(args.folders.clone());
    let missing = folders.missing(plan.units);
    if !missing.is_empty() {
        say!(
            "{} of {} units are missing; execute them with\n  memtransfer work --plan {} --unit N --out {}",
            missing.len(),
            plan.units,
            shell_word(&args.plan),
            shell_word(&args.folders[0])
        );
        print(&missing.iter().map(u32::to_string).collect::<Vec<_>>().join("\n"))?;
        return Ok(Exit::UnitsMissing);
    }
    let mut manifest = plan.manifest.clone();
    manifest.settings.out.clone_from(&args.out);
    let differences = folders.check(plan.units, &digest, &mut manifest)?;
    if !differences.is_empty() {
        let lines: Vec<String> = differences.iter().map(ToString::to_string).collect();
        let lines = lines.join("\n");
        if args.strict {
            bail!("--strict: units were executed on machines that differ:\n{lines}");
        }
        say!(
            "warning: pixels and embeddings may differ in the last bits, because machines do:\n{lines}"
        );
    }
    if is_merged(&args.out, &manifest)? {
        say!("{}: merged before, {} units", args.out.display(), plan.units);
        return Ok(Exit::Complete);
    }
    let merged = selection.with_episodes(&settings, |episodes| {
        merge(&manifest, &folders, plan.assign(&selection, episodes), &args.out)
    })?;
    say!(
        "{}: {merged} episodes of {} units; `memtransfer score {}` prints its tables",
        args.out.display(),
        plan.units,
        shell_word(&args.out)
    );
    Ok(Exit::Complete)
}

/// Whether the folder `out` is what this merge makes: it has the manifest and as many episodes.
fn is_merged(out: &Path, manifest: &Manifest) -> Result<bool> {
    if !Manifest::read(out).is_ok_and(|before| before == *manifest) {
        return Ok(false);
    }
    let path = out.join(EPISODES_FILE);
    let file = durable::open(&path).with_context(|| format!("cannot open {}", path.display()))?;
    let lines = BufReader::new(file).split(b'\n').count();
    Ok(lines == manifest.episodes as usize)
}

/// The plan's settings with the assets of this machine.
fn here(settings: &RunSettings, args: &MergeArgs) -> Result<RunSettings> {
    let assets = args.assets.as_ref().map(|dir| dir.display().to_string());
    let given = assets.as_deref().map(|dir| ("assets", dir));
    on_this_machine(settings, [Layer::flags(given)?])
}
