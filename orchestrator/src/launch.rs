//! What a run starts: which processes, with which arguments and limits, attached to what.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use case_book::DEMONSTRATIONS_FILE;
use conditions::settings::{ModelSettings, RunSettings};
use conditions::{Condition, Frames, PolicyKind};
use domain::{MemoryKind, Mismatch, SecretHeader};
use run_log::{DOCUMENTS_FOLDER, ELSEWHERE_FILE, PROMPT_FILE, SNAPSHOTS_FOLDER, STREAMS_FILE};
use shm_types::message::Role;
use shm_types::process::shared_memory_space;
use shm_types::{Attach, FrameControl, FrameSize, Wait};
use supervise::{Launch, System};

use crate::books::Books;
use crate::external_memory::{ExternalMemory, StartedMemories};
use crate::frame_budget::{self, Demand};
use crate::lanes::{ExternalNames, Rules};
use crate::machine::memory_available;
use crate::pipeline::PipelineOptions;
use crate::plan::PlannedEpisode;

/// The flag of `policy-proc` that names a model's server.
const BASE_URL: &str = "--base-url";

/// Time that processes have to end once they are asked to.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(5);

/// How the processes are started, with their logs in the folder `logs`, beside the external memories `memories`. A run that
/// consists of streams has them in its folder already.
///
/// # Errors
/// When a program is missing, or `--policy-cmd` is no command.
pub(crate) fn pipeline_options(
    settings: &RunSettings,
    memories: &[ExternalMemory],
    logs: PathBuf,
) -> Result<PipelineOptions> {
    let step_timeout = Duration::from_secs(settings.step_timeout.into());
    Ok(PipelineOptions {
        launcher: Arc::new(System),
        launches: launches(settings, memories)?,
        external_policy: settings.policy == PolicyKind::External && settings.policy_cmd.is_none(),
        external_world: match settings.world_book {
            // Absolute: the user may start it in another folder.
            Some(_) => Some(std::path::absolute(settings.out.join(DEMONSTRATIONS_FILE))?),
            None => None,
        },
        logs,
        start_timeout: Duration::from_secs(settings.start_timeout.into()),
        answer_timeout: step_timeout,
        // The client of a model has time limits of its own, and always answers.
        decision_timeout: (settings.policy != PolicyKind::Openai).then_some(step_timeout),
        memories: memories.to_vec(),
        memory_timeout: Duration::from_secs(settings.memory_timeout.into()),
        shutdown_timeout: SHUTDOWN_TIMEOUT,
    })
}

/// Lets the simulator share its views with those of other units, through `folder`.
pub(crate) fn share_views(options: &mut PipelineOptions, folder: &Path) {
    let own = |launch: &&mut Launch| launch.role == Role::Sim && launch.command.is_none();
    for sim in options.launches.iter_mut().filter(own) {
        sim.args.extend(["--views".into(), folder.into()]);
    }
}

/// Gives memory the embeddings in `file`, which came with a plan.
pub(crate) fn ship_embeddings(options: &mut PipelineOptions, file: &Path) {
    let memories = options.launches.iter_mut().filter(|launch| launch.role == Role::Memory);
    for memory in memories {
        memory.args.extend(["--shipped-embeddings".into(), file.into()]);
    }
}

/// Tells the policy that asks a model where the address of its server was given, on which the key depends: `source` is a word of
/// `policy-proc serve --base-url-from`.
pub(crate) fn tell_source_of_base_url(options: &mut PipelineOptions, source: &str) {
    let has_address = |launch: &&mut Launch| launch.args.iter().any(|arg| arg == BASE_URL);
    for policy in options.launches.iter_mut().filter(has_address) {
        policy.args.extend(["--base-url-from".into(), source.into()]);
    }
}

/// What all episodes have in common.
///
/// # Errors
/// When a number is too large for the wire, which the settings rule out.
pub(crate) fn rules(settings: &RunSettings, memories: &[ExternalMemory]) -> Result<Rules> {
    let mut external_memories = ExternalNames::default();
    for memory in memories {
        let place = external_memories.get_mut(usize::from(memory.index));
        *place.context("more external memories than a run can have")? = Some(memory.name);
    }
    Ok(Rules {
        horizon: u8::try_from(settings.horizon).context("--horizon")?,
        hits: u8::try_from(settings.hits).context("--hits")?,
        memory_images: u16::try_from(settings.memory_image_budget()).context("--memory-images")?,
        memory_text_bytes: settings.memory_text_budget(),
        keyframes: u8::try_from(settings.keyframes).context("--keyframes")?,
        max_steps: settings.max_steps,
        expert: settings.policy == PolicyKind::Expert,
        external_memories,
    })
}

/// What every process of the run receives.
///
/// # Errors
/// When there is too little shared memory.
pub(crate) fn attach(
    settings: &RunSettings,
    books: &Books,
    episodes: &[PlannedEpisode],
    StartedMemories { memories, run, .. }: &StartedMemories,
) -> Result<Attach> {
    let windows = episodes.iter().map(|episode| episode.key.condition.variation.window);
    // The expert needs no memory and no policy.
    let has_process = settings.policy.has_process();
    let lanes = settings.lanes.min(at_once(episodes));
    let mut attach = Attach {
        participants: if has_process { Role::CHILDREN.to_vec() } else { vec![Role::Sim] },
        external_memories: memories.iter().map(|memory| memory.index).collect(),
        worlds: settings.worlds.min(lanes) as u8,
        lanes,
        window: windows.max().unwrap_or(0),
        frame: FrameSize { width: settings.frame_size, height: settings.frame_size },
        wait: Wait { spin_us: settings.spin_us },
        frame_control: match settings.frames {
            Frames::Rendered => FrameControl::Rendered,
            Frames::Blank => FrameControl::Blank,
            Frames::Swapped => FrameControl::Swapped,
            Frames::BlankAll => FrameControl::BlankAll,
        },
        ..run.attach()
    };
    let most = (settings.keyframes, settings.memory_image_budget());
    let book = &books.cases.book;
    let demonstrations = &books.demonstrations.book;
    let mut demand = Demand::of(&attach, (book, demonstrations), episodes, most);
    if !settings.warm_views {
        demand = demand.of_short_run(episodes.len(), settings.max_steps, demonstrations);
    }
    let (free, _) = shared_memory_space().context("cannot tell how much shared memory is free")?;
    let given = settings.frame_budget;
    attach.frame_capacity = frame_budget::choose(&attach, demand, given, free, memory_available())?;
    let every_view = book.world.views;
    if settings.warm_views && attach.frame_capacity < every_view {
        bail!(
            "--warm-views needs room for {every_view} frames, and there is room for {}: make shared memory larger \
             (in Docker with --shm-size), or leave --warm-views out",
            attach.frame_capacity
        );
    }
    Ok(attach)
}

/// The number of episodes that can run at the same time: of every sequence one.
fn at_once(episodes: &[PlannedEpisode]) -> u32 {
    let alone = episodes.iter().filter(|episode| episode.part.is_none()).count();
    let sequences: BTreeSet<u64> = episodes.iter().filter_map(PlannedEpisode::sequence).collect();
    (alone + sequences.len()) as u32
}

/// The processes that a run starts.
fn launches(settings: &RunSettings, memories: &[ExternalMemory]) -> Result<Vec<Launch>> {
    let assets = ("--assets", path(&settings.assets));
    // Not in the folder to which processes attach: a policy and external memories must not see it.
    let streams = settings.stream.is_some().then(|| settings.out.join(STREAMS_FILE));
    let streams = ("--streams", path(&streams));
    let elsewhere = settings.demonstrates_elsewhere().then(|| settings.out.join(ELSEWHERE_FILE));
    let elsewhere = ("--elsewhere", path(&elsewhere));
    let demonstrations = settings.out.join(DEMONSTRATIONS_FILE).display().to_string();
    let demonstrations = ("--demonstrations", Some(demonstrations));
    let mismatches: Vec<&str> =
        settings.mismatches().filter(|one| one.changes_world()).map(Mismatch::name).collect();
    let mismatches = (!mismatches.is_empty()).then(|| mismatches.join(","));
    let mut renderer = vec![
        assets,
        streams,
        elsewhere,
        ("--mismatch", mismatches),
        demonstrations.clone(),
        ("--backend", settings.backend.clone()),
        ("--adapter", settings.adapter.clone()),
    ];
    renderer.extend(settings.appearance().flags().map(|(flag, value)| (flag, Some(value))));
    let serve = || vec!["serve".into()];
    let mut sim = match (settings.world_cmd.as_deref(), &settings.world_book) {
        (Some(command), _) => {
            let mut sim = Launch { needs_keys: false, ..Launch::command(Role::Sim, command)? };
            sim.args.extend(serve());
            Some(sim.with_flags([demonstrations.clone()]))
        }
        (None, Some(_)) => None,
        (None, None) => Some(Launch::sibling(Role::Sim, "sim-proc", serve())?.with_flags(renderer)),
    };
    if let Some(sim) = sim.as_mut().filter(|_| settings.warm_views) {
        sim.args.push("--warm-views".into());
    }
    if !settings.policy.has_process() {
        return Ok(sim.into_iter().collect());
    }
    let snapshots = settings.stream.is_some().then(|| settings.out.join(SNAPSHOTS_FOLDER));
    let timeout = (!memories.is_empty()).then(|| settings.memory_timeout.to_string());
    let flags = [
        demonstrations,
        ("--snapshots", path(&snapshots)),
        ("--documents", Some(settings.out.join(DOCUMENTS_FOLDER).display().to_string())),
        ("--memory-timeout", timeout),
    ];
    let memory = Launch::sibling(Role::Memory, "memory-proc", serve())?;
    let mut memory = memory.with_flags(encoder_flags(settings)).with_flags(flags);
    if !matches_views(settings, memories) {
        memory.args.push("--no-encoder".into());
    }
    Ok([sim, Some(memory), policy_launch(settings)?].into_iter().flatten().collect())
}

fn path(path: &Option<PathBuf>) -> Option<String> {
    path.as_ref().map(|path| path.display().to_string())
}

/// The flags of `memory-proc` about the encoder.
pub(crate) fn encoder_flags(settings: &RunSettings) -> [(&'static str, Option<String>); 5] {
    [
        ("--assets", path(&settings.assets)),
        ("--encoder", Some(settings.encoder.clone())),
        ("--encoder-file", path(&settings.encoder_file)),
        ("--encoder-threads", settings.encoder_threads.map(|n| n.to_string())),
        ("--provider", settings.provider.clone()),
    ]
}

/// Whether a memory of the run matches views. Decided by all conditions, not by those that are left: the process reports the
/// same when a run is resumed.
pub(crate) fn matches_views(settings: &RunSettings, memories: &[ExternalMemory]) -> bool {
    let embeds = |condition: &Condition| match condition.memory {
        MemoryKind::BuiltIn(representation) => representation.matches_views(),
        MemoryKind::External(name) => {
            memories.iter().any(|memory| memory.name == name && memory.description.embeddings)
        }
    };
    settings.conditions().iter().any(embeds)
}

/// The policy's process, unless it is started by someone else.
fn policy_launch(settings: &RunSettings) -> Result<Option<Launch>> {
    if settings.policy == PolicyKind::External {
        let command = settings.policy_cmd.as_deref();
        return command.map(|command| Launch::command(Role::Policy, command)).transpose();
    }
    let args = vec!["serve".into(), "--policy".into(), settings.policy.to_string().into()];
    let mut policy = Launch::sibling(Role::Policy, "policy-proc", args)?;
    if let Some(model) = &settings.model {
        policy = policy.with_flags(model_flags(model));
        if model.prompt.is_some() {
            // The run's own copy: the user's file may change while the run lasts.
            policy.args.extend(["--prompt".into(), settings.out.join(PROMPT_FILE).into()]);
        }
        policy.needs_keys = true;
        let (variable, headers) = SecretHeader::variable(&model.header);
        policy.env.push((variable.into(), headers.into()));
    }
    Ok(Some(policy))
}

/// The policy process's flags about the model.
fn model_flags(model: &ModelSettings) -> Vec<(&'static str, Option<String>)> {
    let limit_folder = model.endpoint_limit_folder.as_ref().map(|path| path.display().to_string());
    vec![
        ("--model", Some(model.model.clone())),
        (BASE_URL, model.base_url.clone()),
        ("--image-format", Some(model.image_format.to_string())),
        ("--image-budget", Some(model.image_budget.to_string())),
        ("--answer-tokens", Some(model.answer_tokens.to_string())),
        ("--reasoning", Some(model.reasoning.to_string())),
        ("--system-role", Some(model.system_role.to_string())),
        ("--extra-body", model.extra_body.clone()),
        ("--max-connections", Some(model.max_connections.to_string())),
        ("--endpoint-limit", model.endpoint_limit.map(|limit| limit.to_string())),
        ("--endpoint-limit-folder", limit_folder),
        ("--max-retries", Some(model.max_retries.to_string())),
        ("--request-timeout", Some(model.request_timeout.to_string())),
        ("--server-patience", Some(model.server_patience.to_string())),
        ("--response-cache", Some(model.response_cache.to_string())),
    ]
}
