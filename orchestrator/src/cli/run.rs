//! `memtransfer run`: settings, plan, run folder, processes, table, in this order.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::parser::ValueSource;
use clap::{ArgMatches, Args};
use domain::prompt_log::session_folder;
use serde_json::{Map, Value};
use shm_types::message::{Role, WIRE_VERSION};
use shm_types::process::{check_shared_memory, shared_memory_space};
use shm_types::{Attach, FrameControl, FrameSize, RunDir, Wait, registry};

use super::documents::RunDocuments;
use super::{Exit, print};
use crate::budget::Budget;
use crate::estimate::{Basis, Estimate};
use crate::frame_budget;
use crate::lanes::{Lanes, Rules};
use crate::machine::memory_available;
use crate::pipeline::{self, Crewing, Ending};
use crate::plan::{Episode, plan};
use crate::progress::Progress;
use crate::session::Session;
use crate::settings::{Layer, Origin, Resolved, load_suite, resolve, select_cases};
use crate::signals::{self, Signals};
use crate::trace::Trace;
use crate::world::World;
use results::conditions::{Demonstrations, Frames, PolicyKind, Route, Start};
use results::cost::ModelPrices;
use results::log::{EpisodeRecord, FORMAT, Manifest, Opened, RunFolder, RunLog};
use results::settings::{Group, ModelSettings, RunSettings};
use results::table;
use supervise::Launch;

#[derive(Debug, Args)]
#[command(after_help = "\
The same command again resumes a run that was stopped or killed: finished episodes stay, the
others are walked again. Ctrl-C stops cleanly, a second one at once.

Precedence: defaults < suite file < MEMTRANSFER_* variables < flags.

Examples:
  memtransfer run                                       the suite `quick` with the scripted stand-in
  memtransfer run --policy random --limit 10            ten cases, spread over the tasks
  memtransfer run --policy expert --starts original,new --routes unchanged,blocked
  memtransfer run --memory episodic --demos original,4  one against four demonstrations
  memtransfer run --suite paper --dry-run               all that the paper reports, counted
  memtransfer run --frames blank --out runs/blank       a control: does it collapse without pixels?
  memtransfer run --cases t03,t09-01 --dry-run          what would run")]
pub(super) struct RunArgs {
    #[command(flatten)]
    layer: Layer,

    /// Remove what the run's folder holds of an earlier run, and start over
    #[arg(long)]
    fresh: bool,

    /// Show no progress, only what goes wrong
    #[arg(long)]
    quiet: bool,

    /// Write a trace of every process and step, to be opened with Perfetto (https://ui.perfetto.dev)
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,

    /// Print the resolved settings, each with where it comes from, and stop
    #[arg(long)]
    show_settings: bool,

    /// Print what would run, and stop
    #[arg(long, conflicts_with = "show_settings")]
    dry_run: bool,
}

pub(super) fn run(args: RunArgs, matches: &ArgMatches) -> Result<Exit> {
    let resolved = settings(args.layer, matches)?;
    if args.show_settings {
        print(&resolved.to_string())?;
        return Ok(Exit::Complete);
    }
    let settings = resolved.settings;
    say_what_is_left_out(&settings);
    let world = World::load(settings.assets.as_deref())?;
    let episodes = episodes(&settings, &world)?;
    let mut manifest = manifest(&settings, &world, episodes.len());
    manifest.prices = prices(&settings)?;
    let documents = RunDocuments::of(&settings, args.fresh);
    if args.dry_run {
        manifest.documents = documents.facts_now();
        print(&dry_run(&settings, &world, &manifest, &episodes, args.fresh)?)?;
        return Ok(Exit::Complete);
    }

    let signals = Signals::listen().context("cannot listen to signals")?;
    let Some(supply) = documents.supply(&signals, args.quiet)? else {
        return Ok(Exit::Signal(signals.received().unwrap_or_default()));
    };
    manifest.documents = supply.facts();
    let Opened { mut folder, finished, requests, notes } =
        RunFolder::open(&settings.out, manifest, args.fresh)?;
    for note in notes {
        eprintln!("{note}");
    }
    supply.copy_to(&RunFolder::documents_of(folder.dir()))?;
    drop(supply);
    let missing: Vec<Episode> = episodes
        .into_iter()
        .filter(|episode| !folder.is_finished(&episode.key.to_string()))
        .collect();
    let model = settings.model.as_ref();
    if model.is_some_and(|model| model.max_cost.is_some()) && folder.manifest().prices.is_none() {
        bail!("--max-cost needs prices: give --prices FILE (docs/costs.md says what is in it)");
    }
    let budget = Budget::new(model, folder.manifest().prices.as_ref(), &requests);
    let mut halted = budget.exceeded().filter(|_| !missing.is_empty());
    if !missing.is_empty() && halted.is_none() {
        let successes = finished.iter().filter(|record| record.is_success()).count();
        let total = finished.len() + missing.len();
        if !finished.is_empty() && !args.quiet {
            eprintln!(
                "resuming {}: {} of {total} are done",
                settings.out.display(),
                finished.len()
            );
        }
        let progress = Progress::new(total, finished.len(), successes, args.quiet);
        let trace = args.trace.as_deref().map(Trace::create).transpose()?;
        let shown = (progress, budget, trace);
        halted = walk(&settings, &world, missing, &mut folder, shown, &signals)?;
    }

    if let Some(signal) = signals.received() {
        let log = RunLog::read(&settings.out)?;
        eprintln!(
            "stopped by {}: {} of {} episodes are done and kept in {}. To go on:\n  {}",
            signals::name(signal),
            log.episodes.len(),
            log.manifest.episodes,
            settings.out.display(),
            same_command()
        );
        return Ok(Exit::Signal(signal));
    }
    let log = RunLog::read(&settings.out)?;
    print(&results::report::summary(&log))?;
    if let Some(why) = halted {
        eprintln!("stopped: {why}\nWhat is done is kept. To go on:\n  {}", same_command());
    }
    let complete = log.episodes.len() >= log.manifest.episodes as usize;
    Ok(if complete { Exit::Complete } else { Exit::Failed })
}

/// Puts the layers together.
fn settings(said: Layer, matches: &ArgMatches) -> Result<Resolved> {
    let defaults = Layer::defaults();
    let suite = said.suite.clone().or(defaults.suite.clone()).context("no suite")?;
    let suite = load_suite(&suite, said.assets.as_deref())?;
    let from = |source| {
        let Value::Object(said) = serde_json::to_value(&said)? else { return Ok(Layer::default()) };
        // clap names an argument as the field, a layer's key has hyphens.
        let of_source = |key: &str| matches.value_source(&key.replace('-', "_")) == Some(source);
        let said: Map<String, Value> = said.into_iter().filter(|(key, _)| of_source(key)).collect();
        serde_json::from_value(Value::Object(said))
    };
    Ok(resolve([
        (Origin::Default, defaults),
        (Origin::Suite, suite),
        (Origin::Environment, from(ValueSource::EnvVariable)?),
        (Origin::CommandLine, from(ValueSource::CommandLine)?),
    ])?)
}

/// A combination that was asked for and does not exist should not go without a word.
fn say_what_is_left_out(settings: &RunSettings) {
    let groups = &settings.groups;
    let both = |group: &Group| {
        group.routes.contains(&Route::Blocked) && group.starts.contains(&Start::Original)
    };
    if groups.iter().any(both) {
        eprintln!(
            "a blocked route is defined for the new start only: left out for the original start"
        );
    }
    let without = |group: &Group| {
        group.demos.contains(&Demonstrations::NONE)
            && group.memory.iter().any(|memory| memory.uses_demonstrations())
    };
    if groups.iter().any(without) {
        eprintln!("a memory of demonstrations needs some: left out with `--demos none`");
    }
}

fn episodes(settings: &RunSettings, world: &World) -> Result<Vec<Episode>> {
    let ids = world.case_ids();
    let cases = select_cases(&ids, &settings.cases, settings.limit)?;
    let episodes = plan(&settings.runs(), &cases, &ids, settings.seed);
    if episodes.is_empty() {
        bail!("no case is left: --limit is 0, or --cases names none");
    }
    Ok(episodes)
}

/// What the model's tokens cost, where that is said.
fn prices(settings: &RunSettings) -> Result<Option<ModelPrices>> {
    let Some(model) = &settings.model else { return Ok(None) };
    model.prices.as_deref().map(|file| ModelPrices::read(file, &model.model)).transpose()
}

fn manifest(settings: &RunSettings, world: &World, episodes: usize) -> Manifest {
    let program = std::env::current_exe().ok();
    Manifest {
        format: FORMAT,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        wire_version: WIRE_VERSION,
        commit: program.as_deref().and_then(Path::parent).and_then(crate::commit::commit_of),
        settings: settings.clone(),
        hashes: world.hashes.clone(),
        documents: BTreeMap::new(),
        prices: None,
        episodes: episodes as u32,
        processes: BTreeMap::new(),
    }
}

/// What would run, touching nothing.
fn dry_run(
    settings: &RunSettings,
    world: &World,
    manifest: &Manifest,
    episodes: &[Episode],
    fresh: bool,
) -> Result<String> {
    let mut done: Vec<EpisodeRecord> = Vec::new();
    if settings.out.join("manifest.json").exists() && !fresh {
        let log = RunLog::read(&settings.out)?;
        let differences = manifest.differences(&log.manifest);
        if !differences.is_empty() && !log.episodes.is_empty() {
            let dir = settings.out.clone();
            return Err(results::log::LogError::OtherSettings { dir, differences }.into());
        }
        done = log.episodes;
    }
    let header = ["condition", "runs", "episodes", "done", "requests", "images/req", "images"];
    let mut table = table::table(&header, 1);
    let (mut all, mut missing, mut images) = (0, 0, 0);
    // At most: no episode ends early, every window is full.
    let requests = |episodes: u64| {
        if settings.policy.has_process() { episodes * u64::from(settings.max_steps) } else { 0 }
    };
    let plan = RunDocuments::of(settings, fresh);
    let sizes = if settings.model.is_some() { plan.sizes() } else { BTreeMap::new() };
    let basis = settings.model.as_ref().map(|model| Basis {
        settings,
        model,
        world,
        documents: &sizes,
        done: &done,
    });
    let mut estimates = Vec::new();
    for (condition, runs) in settings.runs() {
        let of = || episodes.iter().filter(|episode| episode.key.condition == condition);
        let is_done = |episode: &&Episode| {
            let key = episode.key.to_string();
            done.binary_search_by(|record| record.key.cmp(&key)).is_ok()
        };
        let (planned, done) =
            (of().count() as u64, of().filter(|episode| is_done(episode)).count() as u64);
        estimates.extend(basis.as_ref().map(|basis| {
            let missing: Vec<&Episode> = of().filter(|episode| !is_done(episode)).collect();
            (condition.to_string(), basis.estimate(&condition, &missing))
        }));
        let requests = requests(planned - done);
        let budget = settings.model.as_ref().map_or(u32::MAX, |model| model.image_budget);
        let each = u64::from(settings.images(&condition).min(budget));
        (all, missing, images) =
            (all + planned, missing + planned - done, images + requests * each);
        table.add_row([
            condition.to_string(),
            runs.to_string(),
            planned.to_string(),
            done.to_string(),
            requests.to_string(),
            each.to_string(),
            (requests * each).to_string(),
        ]);
    }
    Ok(format!(
        "{table}\n\n{missing} of {all} episodes of {} conditions would run with policy {}, into {}.\n\
         At most {} requests with {images} images.{}{}",
        settings.conditions().len(),
        settings.policy,
        settings.out.display(),
        requests(missing),
        plan.plan(),
        if estimates.is_empty() {
            String::new()
        } else {
            estimate(&estimates, manifest.prices.as_ref())
        }
    ))
}

/// What would be sent to a model, in words that leave no doubt that it is an estimate.
fn estimate(estimates: &[(String, Estimate)], prices: Option<&ModelPrices>) -> String {
    let absent = || "-".to_owned();
    let mega = |tokens: u64| format!("{:.2}", tokens as f64 / 1e6);
    let cost =
        prices.map(|prices| [format!("at least, {}", prices.currency), "at most".to_owned()]);
    let mut header =
        vec!["condition", "requests", "at most", "images/req", "tokens/req", "Mtok", "at most"];
    header.extend(cost.iter().flatten().map(String::as_str));
    let mut table = table::table(&header, 1);
    let (mut requests, mut tokens, mut costs) = ([0; 2], Some([0; 2]), Some([0; 2]));
    let sum = |sum: Option<[u64; 2]>, more: Option<[u64; 2]>| {
        let ([a, b], [c, d]) = (sum?, more?);
        Some([a + c, b + d])
    };
    let shown = |tokens: Option<[u64; 2]>| match tokens {
        Some(tokens) => tokens.map(mega).to_vec(),
        None => vec![absent(), absent()],
    };
    let money = |cost: Option<[u64; 2]>| match cost {
        Some(cost) => cost.map(|millionths| format!("{:.2}", millionths as f64 / 1e6)).to_vec(),
        None => vec![absent(), absent()],
    };
    for (condition, one) in estimates {
        let cost = prices.map(|prices| one.cost(prices).map(|cost| cost.map(|c| c.millionths)));
        requests = [requests[0] + one.requests[0], requests[1] + one.requests[1]];
        tokens = sum(tokens, one.tokens());
        costs = sum(costs, cost.flatten());
        let mut row = vec![condition.clone()];
        row.extend(one.requests.map(|requests| requests.to_string()));
        row.push(one.images_each.to_string());
        row.push(one.prompt_each.map_or_else(absent, |tokens| tokens.to_string()));
        row.extend(shown(one.tokens()));
        row.extend(cost.into_iter().flat_map(money));
        table.add_row(row);
    }
    let mut row = vec!["all".to_owned()];
    row.extend(requests.map(|requests| requests.to_string()));
    row.extend([absent(), absent()]);
    row.extend(shown(tokens));
    row.extend(prices.into_iter().flat_map(|_| money(costs)));
    table.add_row(row);
    let steps = estimates.iter().filter(|(_, one)| one.measured_steps).count();
    let measured = estimates.iter().filter(|(_, one)| one.measured_tokens).count();
    let all = estimates.len();
    let mut text = format!(
        "\n\nAn estimate of what would be sent to the model. Nothing has been sent.\n{table}\n\
         Requests: at least as many as the expert's reference has steps, at most all steps of every episode; the mean of \
         the\nepisodes that the folder has, for {steps} of {all} conditions. Tokens of a prompt: a full window, four \
         characters of text a\ntoken, 256 tokens an image, documents as long as they are; as measured in this folder, for \
         {measured} of {all} conditions.\nMtok: million tokens of prompts and answers, answers at their full length. \
         A model may count otherwise."
    );
    if tokens.is_none() {
        text += "\n-: a document is not built yet, so nobody knows how long the prompts are.";
    }
    text += match prices {
        Some(_) => "\nMoney: without what the server's own cache would save.",
        None => "\nMoney: not known; give --prices FILE (docs/costs.md).",
    };
    text
}

/// Walks the missing episodes, and writes down how that ended. Returns why it stopped early, if a process said
/// that it should.
fn walk(
    settings: &RunSettings,
    world: &World,
    missing: Vec<Episode>,
    folder: &mut RunFolder,
    (progress, budget, trace): (Progress, Budget, Option<Trace>),
    signals: &Signals,
) -> Result<Option<String>> {
    let base = registry::default_base();
    for gone in registry::clean(&base)?.removed {
        progress.note(&format!("removed what a killed run left in {}", gone.display()));
    }
    let run = RunDir::create(&base)?;
    let mut attach = attach(settings, world, &missing, &run, folder.session())?;
    attach.spans = trace.as_ref().map(|trace| trace.spans().to_owned());
    if settings.warm_views {
        let views = frame_budget::every_view(&world.warehouse);
        progress.note(&format!("drawing {views} views before the first step"));
    }
    let (crewing, rules) = (crewing(settings, folder.dir().join("logs"))?, rules(settings)?);
    let mut lanes = Lanes::new(&world.warehouse, &world.cases, rules, attach.lanes as usize);
    let mut session =
        Session::new(folder, progress, budget, attach.lanes, attach.frame_capacity, trace);
    let outcome =
        pipeline::walk(&mut lanes, missing, &attach, &crewing, signals.stop(), &mut session);
    let reason = match (&outcome, signals.received()) {
        (Err(error), _) => format!("{error:#}"),
        (Ok(_), Some(signal)) => signals::name(signal).to_owned(),
        (Ok(Ending { halted: Some(why), .. }), None) => why.clone(),
        (Ok(_), None) => "complete".to_owned(),
    };
    session.end(&outcome, &reason)?;
    Ok(outcome?.halted)
}

/// How the processes are started, with their logs in the folder `logs`, and how long they may take.
pub(super) fn crewing(settings: &RunSettings, logs: PathBuf) -> Result<Crewing> {
    let deadline = Duration::from_secs(settings.step_timeout.into());
    Ok(Crewing {
        launches: launches(settings)?,
        guest: settings.policy == PolicyKind::External && settings.policy_cmd.is_none(),
        logs,
        start_deadline: Duration::from_secs(settings.start_timeout.into()),
        answer_deadline: deadline,
        // The client of a model has deadlines of its own, and always answers.
        decision_deadline: (settings.policy != PolicyKind::Openai).then_some(deadline),
    })
}

/// What all episodes have in common.
pub(super) fn rules(settings: &RunSettings) -> Result<Rules> {
    Ok(Rules {
        horizon: u8::try_from(settings.horizon).context("--horizon")?,
        keyframes: u8::try_from(settings.keyframes).context("--keyframes")?,
        max_steps: settings.max_steps,
        expert: settings.policy == PolicyKind::Expert,
    })
}

/// What every process of the run is told.
pub(super) fn attach(
    settings: &RunSettings,
    world: &World,
    missing: &[Episode],
    run: &RunDir,
    session: u32,
) -> Result<Attach> {
    let windows = missing.iter().map(|episode| episode.key.condition.variation.window);
    // Absolute: a process of somebody else's may work elsewhere.
    let prompts = settings
        .log_prompts
        .then(|| session_folder(&RunFolder::prompts_of(&settings.out), session));
    let prompts = prompts.map(std::path::absolute).transpose()?;
    let mut attach = Attach {
        // The expert needs a world and nobody else.
        participants: if settings.policy.has_process() {
            Role::CHILDREN.to_vec()
        } else {
            vec![Role::Sim]
        },
        lanes: settings.lanes.min(missing.len() as u32),
        window: windows.max().unwrap_or(0),
        frame: FrameSize { width: settings.frame_size, height: settings.frame_size },
        wait: Wait { spin_us: settings.spin_us },
        frame_control: frame_control(settings.frames),
        prompts,
        ..run.attach()
    };
    let World { warehouse, cases, .. } = world;
    let demand = frame_budget::demand(&attach, warehouse, cases, missing, settings.keyframes);
    attach.frame_capacity = match settings.frame_budget {
        None => {
            let (free, _) =
                shared_memory_space().context("cannot tell how much shared memory is free")?;
            frame_budget::choose(&attach, demand, free, memory_available())?
        }
        Some(frames) if frames < demand.least => bail!(
            "--frame-budget is {frames}, but {} lanes and the demonstrations need at least {}",
            attach.lanes,
            demand.least
        ),
        Some(frames) => frames,
    };
    let every_view = frame_budget::every_view(warehouse);
    if settings.warm_views && attach.frame_capacity < every_view {
        bail!(
            "--warm-views needs room for {every_view} frames and there is room for {}: raise --frame-budget, \
             make shared memory larger (in Docker with --shm-size), or leave --warm-views out",
            attach.frame_capacity
        );
    }
    check_shared_memory(attach.shared_memory_bytes())?;
    Ok(attach)
}

/// The control that the simulator applies to frames.
const fn frame_control(frames: Frames) -> FrameControl {
    match frames {
        Frames::Rendered => FrameControl::Rendered,
        Frames::Blank => FrameControl::Blank,
        Frames::Swapped => FrameControl::Swapped,
    }
}

/// The processes that a run starts.
fn launches(settings: &RunSettings) -> Result<Vec<Launch>> {
    let launch = |role, program, arguments: &[(&str, Option<String>)]| {
        let mut args = vec!["serve".into()];
        for (flag, value) in arguments {
            args.extend(value.iter().flat_map(|value| [flag.into(), value.into()]));
        }
        Launch::sibling(role, program, args)
    };
    let path = |path: &Option<std::path::PathBuf>| path.as_ref().map(|p| p.display().to_string());
    let assets = ("--assets", path(&settings.assets));
    let renderer = [assets.clone(), ("--adapter", settings.adapter.clone())];
    let mut sim = launch(Role::Sim, "sim-proc", &renderer)?;
    if settings.warm_views {
        sim.args.push("--warm-views".into());
    }
    let mut launches = vec![sim];
    if settings.policy.has_process() {
        let encoder = [
            assets,
            ("--encoder", Some(settings.encoder.clone())),
            ("--encoder-file", path(&settings.encoder_file)),
            ("--encoder-threads", settings.encoder_threads.map(|n| n.to_string())),
            ("--documents", Some(RunFolder::documents_of(&settings.out).display().to_string())),
        ];
        let mut memory = launch(Role::Memory, "memory-proc", &encoder)?;
        // Not by what is left to run: what memory says of itself stays the same when a run is resumed.
        if !settings.conditions().iter().any(|condition| condition.memory.matches_views()) {
            memory.args.push("--no-encoder".into());
        }
        launches.push(memory);
        launches.extend(policy_launch(settings)?);
    }
    Ok(launches)
}

/// The policy's process, unless somebody else starts it.
fn policy_launch(settings: &RunSettings) -> Result<Option<Launch>> {
    if settings.policy == PolicyKind::External {
        let command = settings.policy_cmd.as_deref();
        return command.map(|command| Launch::command(Role::Policy, command)).transpose();
    }
    let mut args = vec!["serve".into(), "--policy".into(), settings.policy.to_string().into()];
    let model = settings.model.as_ref().map(model_flags).unwrap_or_default();
    for (flag, value) in model {
        args.extend(value.iter().flat_map(|value| [flag.into(), value.into()]));
    }
    Ok(Some(Launch::sibling(Role::Policy, "policy-proc", args)?))
}

/// What the policy process is told about the model.
fn model_flags(model: &ModelSettings) -> Vec<(&'static str, Option<String>)> {
    vec![
        ("--model", Some(model.model.clone())),
        ("--base-url", model.base_url.clone()),
        ("--image-format", Some(model.image_format.to_string())),
        ("--image-budget", Some(model.image_budget.to_string())),
        ("--answer-tokens", Some(model.answer_tokens.to_string())),
        ("--max-connections", Some(model.max_connections.to_string())),
        ("--max-retries", Some(model.max_retries.to_string())),
        ("--request-timeout", Some(model.request_timeout.to_string())),
        ("--response-cache", Some(model.response_cache.to_string())),
    ]
}

/// The command line that was given, to be given again: without `--fresh`, which would start over.
fn same_command() -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,=+:".contains(c);
    let quoted = |argument: String| {
        if !argument.is_empty() && argument.chars().all(plain) {
            argument
        } else {
            format!("'{}'", argument.replace('\'', r"'\''"))
        }
    };
    let arguments = std::env::args().filter(|argument| argument != "--fresh");
    arguments.map(quoted).collect::<Vec<_>>().join(" ")
}
