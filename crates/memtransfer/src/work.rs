//! `memtransfer work`: executes one unit of a plan as a run of its own.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Error, Result, anyhow, bail};
use clap::Args;
use conditions::settings::Effect;
use domain::cache_folder;
use llm::Source;
use orchestrator::invocation::Invocation;
use orchestrator::run::RunOutcome;
use orchestrator::run_documents::RunDocuments;
use orchestrator::run_plan::{Purpose, RunPlan, Selected};
use orchestrator::selection::SelectedCases;
use orchestrator::units::{ReadPlan, UnitPlan};
use run_log::{Manifest, RunFolder, RunLog, UnitId, finish_unit, unit_folder};
use settings::{KEYS, Key, Layer, on_this_machine, variable};

use super::execution::{
    BUILDING_DOCUMENTS, STARTING_MEMORIES, execute, invocation, note_omissions, over_budget,
    same_command, stopped_before_episodes,
};
use super::run;
use super::run::flags::{MachineFlags, RunOptions};
use super::{Exit, commands, in_one_line, print};
use crate::parent::ParentFlags;
use crate::signals::{self, Signals};

#[derive(Debug, Args)]
#[command(after_help = "\
A finished unit is the folder unit-NUMBER in the folder of --out. It has that name only when it is
complete and on the disk. Until then it is unit-NUMBER.part, from which the same command goes on
after a kill. A unit that is finished is left as it is.

Version, settings and assets must be those of the plan; what differs is named.

Examples:
  memtransfer work --plan plan.json --unit 17 --out units
  memtransfer work --plan plan.json --unit 17 --out units --assets /data/assets --lanes 32")]
pub(super) struct WorkArgs {
    /// The plan that `memtransfer plan` wrote
    #[arg(long, value_name = "FILE")]
    plan: PathBuf,

    /// The number of the unit, from 0
    #[arg(long, value_name = "N")]
    unit: u32,

    /// The folder of finished units
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// The plan's store, if it is elsewhere on this machine
    #[arg(long, value_name = "DIR")]
    store: Option<String>,

    /// Show no progress, only problems
    #[arg(long)]
    quiet: bool,

    /// Start the commands that the plan names; without this they are shown and refused
    #[arg(long)]
    allow_commands: bool,

    #[command(flatten)]
    parent: ParentFlags,

    #[command(flatten)]
    machine: MachineFlags,
}

pub(super) fn run(args: WorkArgs) -> Result<Exit> {
    args.parent.watch()?;
    let plan = UnitPlan::read(&args.plan)?;
    let whole = args.out.join(unit_folder(args.unit));
    if whole.exists() {
        check_unit(&whole, &plan.unit_id(args.unit))?;
        print(&whole.display().to_string())?;
        return Ok(Exit::Complete);
    }
    let used = commands::Use::Start { allowed: args.allow_commands };
    let plan_named = format!("the plan {}", args.plan.display());
    commands::check(&plan_named, &settings::commands(&plan.plan.manifest.settings)?, used)?;
    fs::create_dir_all(&args.out).with_context(|| format!("cannot make {}", args.out.display()))?;
    let part = args.out.join(format!("{}.part", unit_folder(args.unit)));
    if part.join("manifest.json").exists() {
        check_unit(&part, &plan.unit_id(args.unit))?;
    }
    let signals = Signals::listen().context("cannot listen to signals")?;
    let [base_url, header] = ["base-url", "header"].map(|key| source_of(&args, key));
    let options = RunOptions::of(args.quiet, base_url?, header?);
    let cache = cache_folder()?;
    let shipment = plan.plan.shipment.as_ref();
    if let Some(shipment) = shipment {
        shipment.fetch(args.store.as_deref(), &cache)?;
    }
    let invocation = invocation(&options, &signals);
    let unit = unit_run(&plan, &args, part.clone(), &invocation);
    let Some(mut unit) = unit.map_err(of_plan)? else {
        return Ok(stopped_before_episodes(&signals, STARTING_MEMORIES));
    };
    unit.shipped_embeddings = shipment.and_then(|shipment| shipment.embeddings_in(&cache));
    let planned = unit.episodes.len();
    let halted = match execute(unit, &invocation).map_err(of_plan)? {
        RunOutcome::Stopped => return Ok(stopped_before_episodes(&signals, BUILDING_DOCUMENTS)),
        RunOutcome::OverBudget(why) => return Ok(over_budget(&why)),
        RunOutcome::NothingMissing => None,
        RunOutcome::Ended(ending) => ending.halted,
    };
    let log = RunLog::read(&part)?;
    let done = log.episodes.len();
    if done < planned {
        let why = match (signals.received(), &halted) {
            (Some(signal), _) => format!("stopped by {}", signals::name(signal)),
            (None, Some(why)) => format!("stopped: {why}"),
            (None, None) => {
                format!("some episodes could not be finished{}\n", run::reasons(&log.errors))
            }
        };
        say!(
            "unit {}: {why}; {done} of {planned} episodes are finished and kept in {}. To resume:\n  {}",
            args.unit,
            part.display(),
            same_command()
        );
        return Ok(signals.received().map_or(Exit::Failed, Exit::Signal));
    }
    finish_unit(&part, &whole)?;
    print(&whole.display().to_string())?;
    Ok(Exit::Complete)
}

/// Where a setting of the model's server is given: here, or in the plan.
fn source_of(args: &WorkArgs, key: &str) -> Result<Source> {
    Ok(if args.machine.layer()?.has(key) {
        Source::CommandLine
    } else if variable(key)?.is_some() {
        Source::Environment
    } else {
        Source::SettingsFile
    })
}

/// The run that a unit is, with its folder `part`; `None` when a signal asked to stop.
fn unit_run(
    plan: &ReadPlan,
    args: &WorkArgs,
    part: PathBuf,
    invocation: &Invocation<'_>,
) -> Result<Option<RunPlan>> {
    let environment = Layer::environment(std::env::vars_os())?;
    let layers = [environment, args.machine.layer()?];
    let whole = on_this_machine(&plan.plan.manifest.settings, layers.clone())?;
    let selection = SelectedCases::of(&whole);
    let selection = selection.with_context(|| format!("cannot use {}", args.plan.display()))?;
    plan.check_episodes(&selection, &args.plan)?;
    super::plan::check(&whole).with_context(|| format!("cannot use {}", args.plan.display()))?;
    let (mut settings, episodes) = plan.unit(args.unit)?;
    settings.out = part;
    let settings = on_this_machine(&settings, layers)?;
    RunFolder::check(&settings.out)?;
    let selected = Selected::Range(episodes);
    let Some(mut run) = RunPlan::new(settings, &selected, Purpose::Execution, invocation)? else {
        return Ok(None);
    };
    note_omissions(&run.settings);
    check_machine(&run.manifest()?, plan, args)?;
    check_documents(&run, plan)?;
    run.unit = Some(plan.unit_id(args.unit));
    Ok(Some(run))
}

/// The error; where it advises to change a setting that only the plan has, with what to do about that.
fn of_plan(error: Error) -> Error {
    let text = in_one_line(&error);
    // Commands to give, in backticks or on a line of their own, have flags of other verbs.
    let lines = text.lines().filter(|line| !line.trim_start().starts_with("memtransfer "));
    let prose = lines.flat_map(|line| line.split('`').step_by(2)).collect::<Vec<_>>().join(" ");
    let words = || prose.split(|c: char| !c.is_ascii_alphanumeric() && c != '-');
    let is_named = |key: &&Key| words().any(|word| word.strip_prefix("--") == Some(key.name));
    let mut of_plan = KEYS.iter().filter(|key| key.effect != Effect::Machine && key.name != "out");
    match of_plan.find(is_named) {
        None => error,
        Some(key) => anyhow!(
            "{text}\n--{} is a setting of the plan, and `work` does not have it: give it to `memtransfer plan`",
            key.name
        ),
    }
}

/// Checks that the documents that are here already are those of the plan. Others are built, or the run says what is missing.
fn check_documents(run: &RunPlan, ReadPlan { plan, .. }: &ReadPlan) -> Result<()> {
    let here = RunDocuments::of(&run.settings, &run.books, false);
    for (name, facts) in here.facts_now() {
        let Some(there) = plan.manifest.documents.get(&name) else { continue };
        if there.sha256 != facts.sha256 {
            bail!(
                "document {name} is not that of the plan: its SHA-256 is {} there and {} here. Remove it here, and the unit \
                 builds or fetches it again",
                there.sha256,
                facts.sha256
            );
        }
    }
    Ok(())
}

/// Checks that the version, the settings and the assets here are those of the plan.
fn check_machine(here: &Manifest, ReadPlan { plan, .. }: &ReadPlan, args: &WorkArgs) -> Result<()> {
    let (wire, own) = (plan.manifest.wire_version, here.wire_version);
    if wire != own {
        bail!(
            "cannot use {}: its `wire_version` is {wire}, and this program has {own}. Write another with `memtransfer plan`",
            args.plan.display()
        );
    }
    let differences = here.differences(&plan.manifest);
    if differences.is_empty() {
        return Ok(());
    }
    let lines = differences.iter().map(|difference| {
        let (key, there, here) = (&difference.key, &difference.there, &difference.here);
        format!("\n  {key}: {there} in the plan, {here} here")
    });
    bail!(
        "this machine differs from the plan {}:{}\nInstall the same version, and give the same assets with --assets",
        args.plan.display(),
        lines.collect::<String>()
    );
}

/// Checks that the folder `folder` is the unit `id`.
fn check_unit(folder: &Path, id: &UnitId) -> Result<()> {
    let found = Manifest::read(folder)?.unit;
    if found.as_ref() == Some(id) {
        return Ok(());
    }
    let what = match found {
        Some(other) if other.plan == id.plan => format!("unit {} of this plan", other.number),
        Some(_) => "a unit of another plan".to_owned(),
        None => "no unit of a plan".to_owned(),
    };
    bail!("{} is {what}: choose another --out, or remove it", folder.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_that_only_the_plan_can_follow_says_so() {
        let shown = |text: &str| {
            let error = anyhow!("{text}").context("the memory process failed");
            in_one_line(&of_plan(error))
        };
        insta::assert_snapshot!(shown("no CUDA here: pass --provider cpu"), @"
        the memory process failed: no CUDA here: pass --provider cpu
        --provider is a setting of the plan, and `work` does not have it: give it to `memtransfer plan`
        ");
        for text in [
            "--frame-budget is 2: fewer --lanes need fewer",
            "document summary/4 is missing. To build it:\n  memtransfer memory build --demos 4",
            "check it with `memtransfer doctor --policy openai`, or choose another --out",
        ] {
            assert_eq!(shown(text), "the memory process failed: ".to_owned() + text);
        }
    }
}
