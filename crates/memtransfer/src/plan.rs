//! `memtransfer plan`: divides a run into units, and prints a script that executes them.

mod scripts;

use std::path::PathBuf;

use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use conditions::PolicyKind;
use conditions::settings::RunSettings;
use domain::cache_folder;
use orchestrator::run_documents::DocumentSupply;
use orchestrator::run_plan::{Purpose, RunPlan, Selected};
use orchestrator::store::{Shipment, Store};
use orchestrator::units::{UNIT_EPISODES, UnitPlan};
use settings::{Layer, resolve};

use super::execution::{
    BUILDING_DOCUMENTS, FILLING_STORE, STARTING_MEMORIES, invocation, note_omissions, over_budget,
    stopped_before_episodes,
};
use super::run::flags::{RunOptions, SettingFlags, source_of};
use super::{Exit, commands, make_folder_of, print};
use crate::signals::Signals;

#[derive(Debug, Args)]
#[command(after_help = "\
A unit has consecutive episodes of the run; in a suite of streams, whole sequences. Units are
executed in any order, on any machine that has this version of the programs and the cache folder
that `cargo xtask setup` fills. Executing a unit again is harmless. docs/machines.md has more.

Examples:
  memtransfer plan --suite paper --out plan.json     settings as for `memtransfer run`
  memtransfer work --plan plan.json --unit 0 --out units
  memtransfer merge --plan plan.json units --out runs/paper
  memtransfer plan --suite paper --out plan.json --store /mnt/shared/memtransfer
  memtransfer plan --suite paper --out plan.json --slurm > paper.sbatch")]
pub(super) struct PlanArgs {
    #[command(flatten)]
    flags: SettingFlags,

    /// Episodes of a unit; a sequence of a stream is never divided
    #[arg(long, value_name = "N", default_value_t = UNIT_EPISODES, value_parser = clap::value_parser!(u32).range(1..))]
    unit_episodes: u32,

    /// Put what workers need beside the programs into this folder, which they reach too: encoder,
    /// documents, known embeddings
    #[arg(long, value_name = "DIR")]
    store: Option<String>,

    /// Print a Slurm array script that executes the units and merges them
    #[arg(long)]
    slurm: bool,

    /// Workers that --slurm starts, each for several units
    #[arg(long, value_name = "N", default_value_t = 100, requires = "slurm", value_parser = clap::value_parser!(u32).range(1..))]
    workers: u32,

    /// Show no progress, only problems
    #[arg(long)]
    quiet: bool,

    /// Start the commands that the suite's file names (policy-cmd, memory-cmd, world-cmd), here and in the
    /// printed script; without this they are shown and refused
    #[arg(long)]
    allow_commands: bool,
}

pub(super) fn run(args: PlanArgs) -> Result<Exit> {
    let environment = Layer::environment(std::env::vars_os())?;
    let mut flags = args.flags.layer()?;
    // Here --out is the plan's file, and the run's folder is named when it is merged.
    let Some(path) = flags.take_text("out").map(PathBuf::from) else {
        bail!("give the plan's file: --out plan.json");
    };
    if path.is_dir() {
        bail!("{0} is a folder: give the plan's file, such as --out {0}/plan.json", path.display());
    }
    let before = path.exists().then(|| UnitPlan::read(&path)).transpose();
    let before = before.map_err(|error| anyhow!("{error:#}. This one is left as it is"))?;
    let resolved = resolve([environment, flags])?;
    let base_url_source = source_of(resolved.origin("base-url"));
    let header_source = source_of(resolved.origin("header"));
    let used = commands::Use::Start { allowed: args.allow_commands };
    let suite = format!("the suite {}", resolved.settings.suite);
    commands::check(&suite, &resolved.commands_of_suite()?, used)?;
    let settings = resolved.settings;
    check(&settings)?;
    let signals = Signals::listen().context("cannot listen to signals")?;
    let options = RunOptions::of(args.quiet, base_url_source, header_source);
    let invocation = invocation(&options, &signals);
    let Some(run) = RunPlan::new(settings, &Selected::All, Purpose::Units, &invocation)? else {
        return Ok(stopped_before_episodes(&signals, STARTING_MEMORIES));
    };
    note_omissions(&run.settings);
    let documents = match run.documents(&invocation, &mut |_| Ok(()))? {
        DocumentSupply::Ready(documents) => documents,
        DocumentSupply::Stopped => {
            return Ok(stopped_before_episodes(&signals, BUILDING_DOCUMENTS));
        }
        DocumentSupply::OverBudget(why) => return Ok(over_budget(&why)),
    };
    let mut manifest = run.manifest()?;
    manifest.documents = documents.facts();
    let mut plan = UnitPlan::new(manifest, args.unit_episodes);
    if let Some(store) = &args.store {
        let paths: Vec<_> = documents.documents.iter().map(|one| one.file.clone()).collect();
        let (store, cache) = (Store::open(store)?, cache_folder()?);
        let encoder = run.matches_views();
        let shipment =
            Shipment::pack(&store, &cache, &run.settings, &paths, encoder, signals.stop())?;
        if shipment.is_none() {
            return Ok(stopped_before_episodes(&signals, FILLING_STORE));
        }
        plan.shipment = shipment;
    }
    make_folder_of(&path)?;
    match before {
        None => plan.write(&path)?,
        // Its units name it by its hash. What they get from the store stays what it was.
        Some(before) if before.plan.is_of_same_units(&plan) => plan = before.plan,
        Some(_) => bail!(
            "{} is the plan of another run, of other units or with another store, and may be in progress: give another \
             --out, or remove it",
            path.display()
        ),
    }
    if !args.quiet {
        let (units, episodes) = (plan.units, plan.manifest.episodes);
        say!("{}: {episodes} episodes in {units} units", path.display());
    }
    if args.slurm {
        let path = std::path::absolute(&path)?;
        let workers = args.workers.min(plan.units);
        let flags = scripts::work_flags(&plan.manifest.settings, base_url_source)?;
        print(&scripts::slurm(&path, plan.units, workers, &flags)?)?;
    }
    Ok(Exit::Complete)
}

/// Refuses what needs one process that sees the whole run.
pub(super) fn check(settings: &RunSettings) -> Result<()> {
    if settings.policy == PolicyKind::External && settings.policy_cmd.is_none() {
        bail!("workers start the policy: give its command with --policy-cmd");
    }
    if settings.external_memory {
        bail!("workers start the memory: give its command with --memory-cmd");
    }
    let limited = |model: &conditions::settings::ModelSettings| {
        model.max_cost.is_some() || model.max_tokens_total.is_some()
    };
    if settings.model.as_ref().is_some_and(limited) {
        bail!("--max-cost and --max-tokens-total limit one run: leave them out of a plan");
    }
    Ok(())
}
