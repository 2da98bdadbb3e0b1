//! `memtransfer doctor`: checks what a run needs by using it.

pub(super) mod endpoint;

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, anyhow, ensure};
use case_book::BookRequest;
use clap::{Args, ValueEnum};
use domain::{Pose, cache_folder};
use orchestrator::books::{Books, WRITING_TIMEOUT};
use orchestrator::scratch::{self, ScratchFolder};
use rustix::fs::{Access, access};
use rustix::io::Errno;
use rustix::process::{Resource, getrlimit};
use serde::Serialize;
use serde_json::Value;
use shm_types::process::{SHARED_MEMORY, check_shared_memory};
use shm_types::{RunDir, registry};
use supervise::sibling;

use super::list::list;
use super::{Exit, WorldArgs, print, print_json};
use crate::signals::{self, Signals};

/// Files that a process of a run opens, rounded up. The memory process opened most, 149, with 1 and with 1024 lanes.
const OPEN_FILES: u64 = 256;

/// Why a check has no result.
const STOPPED: &str = "stopped by a signal";

#[derive(Debug, Args)]
#[command(after_help = "\
Exit status 1 when something is missing. Requests to a model are those of a run with the settings of
the environment: set MEMTRANSFER_IMAGE_BUDGET, MEMTRANSFER_REASONING and others as for
`memtransfer run`.

Examples:
  memtransfer doctor
  memtransfer doctor --world-cmd ./my-world
  memtransfer doctor --policy openai --model NAME --base-url http://localhost:8000/v1")]
pub(super) struct DoctorArgs {
    #[command(flatten)]
    world: WorldArgs,
    /// Also check the server of this policy's model, with about thirty requests, some of them of the size
    /// that a run sends
    #[arg(long, value_name = "POLICY", value_enum, requires = "model")]
    policy: Option<ModelPolicy>,
    /// With --policy openai: the model, by the name that the server knows
    #[arg(long, value_name = "NAME", env = "MEMTRANSFER_MODEL")]
    model: Option<String>,
    /// With --policy openai: the server, up to /v1, or several, each of which is checked [default:
    /// $MEMTRANSFER_BASE_URL, else $OPENAI_BASE_URL; the key is $OPENAI_API_KEY]
    #[arg(long, value_name = "URL,...")]
    base_url: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A policy that asks a model.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum ModelPolicy {
    /// A model behind an OpenAI-compatible endpoint
    Openai,
}

/// The result of one check.
#[derive(Debug, Serialize)]
struct DoctorFinding {
    what: Cow<'static, str>,
    ok: bool,
    /// Whether a run works, but with doubtful results, or without keeping some of them for later runs.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    doubtful: bool,
    /// What was found, or what is wrong and how to fix it.
    about: String,
    /// Details, as data.
    #[serde(skip_serializing_if = "Option::is_none")]
    data: Option<Value>,
}

impl DoctorFinding {
    fn of(what: &'static str, outcome: anyhow::Result<String>) -> Self {
        let (ok, about) = match outcome {
            Ok(about) => (true, about),
            Err(error) => (false, format!("{error:#}")),
        };
        Self { what: what.into(), ok, doubtful: false, about, data: None }
    }
}

pub(super) fn run(args: &DoctorArgs) -> anyhow::Result<Exit> {
    let signals = Signals::listen().context("cannot listen to signals")?;
    let findings = check(args, signals.stop())?;
    if let Some(signal) = signals.received() {
        say!("stopped by {}", signals::name(signal));
        return Ok(Exit::Signal(signal));
    }
    if args.json {
        print_json(&findings)?;
    } else {
        for DoctorFinding { what, ok, doubtful, about, .. } in &findings {
            let mark = match (ok, doubtful) {
                (false, _) => "NOT YET ",
                (true, true) => "doubtful",
                (true, false) => "ok      ",
            };
            print(&format!("{mark} {what}: {about}"))?;
        }
    }
    let all = findings.iter().all(|finding| finding.ok);
    Ok(if all { Exit::Complete } else { Exit::Failed })
}

/// All findings; those of programs are failures once `stop` is set.
fn check(args: &DoctorArgs, stop: &AtomicBool) -> anyhow::Result<Vec<DoctorFinding>> {
    // One view is rendered and then embedded, as in a run.
    let scratch = ScratchFolder::new().context("cannot make a temporary folder")?;
    let view = scratch.path().join("view.png");
    let mut findings = vec![
        match args.world.other.command() {
            Some(command) => DoctorFinding::of("world and cases", other_world(command)),
            None => DoctorFinding::of("warehouse and cases", world(&args.world)),
        },
        DoctorFinding::of("programs", programs()),
        DoctorFinding::of("shared memory", shared_memory()),
        DoctorFinding::of("open files", open_files(args)),
        cache(),
        DoctorFinding::of("rendering", rendering(&args.world, &view, stop)),
        DoctorFinding::of("ONNX Runtime and encoder", encoder(&args.world, &view, stop)),
        DoctorFinding::of("leftovers of killed runs", leftovers()),
    ];
    if let (Some(ModelPolicy::Openai), Some(model)) = (args.policy, &args.model) {
        findings.extend(endpoint::check(model, args.base_url.as_deref(), stop));
    }
    Ok(findings)
}

fn world(args: &WorldArgs) -> anyhow::Result<String> {
    let items = list::<Value>(args, "items", args.flags())?.len();
    let cases = args.program()?.describe(&args.flags())?.cases.len();
    Ok(format!("{items} items, {cases} cases (`memtransfer validate` checks them all)"))
}

/// The case book of the world that `command` starts.
fn other_world(command: &str) -> anyhow::Result<String> {
    let book = Books::of_world(Some(command), &BookRequest::default(), WRITING_TIMEOUT)?.cases.book;
    let world = &book.world.declaration;
    Ok(format!(
        "{} {}, {} cases, {} actions (`memtransfer conformance` checks how it takes part in runs)",
        world.name,
        world.version,
        book.cases.len(),
        world.actions.len()
    ))
}

fn programs() -> anyhow::Result<String> {
    let names = ["sim-proc", "memory-proc", "policy-proc"];
    names.into_iter().try_for_each(|name| sibling(name).map(drop))?;
    Ok(format!("{} lie beside this one", names.join(", ")))
}

fn shared_memory() -> anyhow::Result<String> {
    let run = RunDir::create(&registry::default_base())?;
    let attach = run.attach();
    check_shared_memory(attach.shared_memory_bytes())?;
    let mib = attach.shared_memory_bytes() >> 20;
    Ok(format!("{SHARED_MEMORY} has room for a default run ({mib} MiB at most)"))
}

/// Checks the limit on open files. A process of a run opens the services of the wire, the same number whatever the number of
/// lanes, and for a model a connection for each request in flight.
fn open_files(args: &DoctorArgs) -> anyhow::Result<String> {
    let mut needed = OPEN_FILES;
    if let (Some(ModelPolicy::Openai), Some(model)) = (args.policy, &args.model) {
        needed += endpoint::connections(model, args.base_url.as_deref())?;
    }
    let limit = getrlimit(Resource::Nofile).current;
    enough_files(needed, limit)
}

/// Whether a process may open `needed` files; no limit is `None`.
fn enough_files(needed: u64, limit: Option<u64>) -> anyhow::Result<String> {
    match limit {
        None => Ok("not limited".to_owned()),
        Some(limit) => {
            ensure!(
                limit >= needed,
                "a process of a run may open {limit} files, and needs up to {needed}: `ulimit -n {needed}`"
            );
            Ok(format!("{limit} in a process, of which a run needs up to {needed}"))
        }
    }
}

/// Checks that what runs keep for each other can be read and written.
fn cache() -> DoctorFinding {
    const WHAT: &str = "cache folder";
    let folder = match cache_folder().context("no folder") {
        Ok(folder) => folder,
        Err(error) => return DoctorFinding::of(WHAT, Err(error)),
    };
    let shown = folder.display();
    match access(&folder, Access::READ_OK | Access::EXEC_OK) {
        Ok(()) | Err(Errno::NOENT) => {}
        Err(error) => return DoctorFinding::of(WHAT, Err(anyhow!("cannot read {shown}: {error}"))),
    }
    match unwritable(&folder) {
        None if !folder.exists() => {
            DoctorFinding::of(WHAT, Ok(format!("{shown} is not there yet: the first run makes it")))
        }
        None => DoctorFinding::of(WHAT, Ok(format!("{shown} can be read and written"))),
        Some((path, error)) => DoctorFinding {
            doubtful: true,
            ..DoctorFinding::of(
                WHAT,
                Ok(format!(
                    "{} cannot be written ({error}): runs use what is there, and can neither build documents that are \
                     missing nor keep embeddings and replies. Make it writable for this user, or set MEMTRANSFER_CACHE",
                    path.display()
                )),
            )
        },
    }
}

/// What a run would write in the cache folder `cache` and cannot, and why; what is not there yet would be made.
fn unwritable(cache: &Path) -> Option<(PathBuf, Errno)> {
    let mut written = Vec::new();
    let cache = std::path::absolute(cache).unwrap_or_else(|_| cache.to_owned());
    // A folder that is missing is made in the first one above it that is there.
    let nearest = cache.ancestors().find(|folder| folder.exists()).unwrap_or(&cache);
    for name in ["documents", "embeddings", "model-hashes", "responses"] {
        let folder = cache.join(name);
        if !folder.exists() {
            written.push(nearest.to_owned());
            continue;
        }
        written.push(folder.clone());
        // These are written again, and not replaced.
        let is_kept = |path: &PathBuf| {
            path.ends_with("documents/lock") || path.extension().is_some_and(|ext| ext == "redb")
        };
        let files = folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
        written.extend(files.filter(is_kept));
    }
    written.into_iter().find_map(|path| {
        let wanted =
            if path.is_dir() { Access::WRITE_OK | Access::EXEC_OK } else { Access::WRITE_OK };
        access(&path, wanted).err().map(|error| (path, error))
    })
}

fn rendering(world: &WorldArgs, view: &Path, stop: &AtomicBool) -> anyhow::Result<String> {
    // Another process, because this one must notice when it is asked to stop.
    let mut command = Command::new(sibling("memtransfer")?);
    match world.other.command() {
        Some(other) => {
            let folder = view.with_extension("");
            let described = world.program()?.describe(&[])?;
            let case = described.cases.first().context("the world has no cases")?;
            command
                .args(["render", "--world-cmd", other, "--case", &case.id, "--out"])
                .arg(&folder);
            succeed(command, stop)?;
            std::fs::rename(folder.join("000.png"), view)?;
        }
        None => {
            command.args(["render", "--pose", &a_pose(world)?, "--out"]).arg(view);
            succeed(with_assets(command, world), stop)?;
        }
    }
    Ok("a view was rendered".to_owned())
}

fn encoder(world: &WorldArgs, view: &Path, stop: &AtomicBool) -> anyhow::Result<String> {
    ensure!(view.exists(), "not checked, because no view could be rendered");
    let mut command = Command::new(sibling("memory-proc")?);
    command.arg("embed").arg(view);
    succeed(with_assets(command, world), stop)?;
    Ok("the view was embedded".to_owned())
}

/// How many runs that have ended hold shared memory.
fn left_by(runs: usize) -> String {
    match runs {
        1 => "1 run that has ended holds shared memory".to_owned(),
        _ => format!("{runs} runs that have ended hold shared memory"),
    }
}

fn leftovers() -> anyhow::Result<String> {
    let runs = registry::list(&registry::default_base())?;
    let dead = runs.iter().filter(|run| !run.alive).count();
    ensure!(dead == 0, "{}: `memtransfer clean` removes what is left", left_by(dead));
    let folders = scratch::abandoned_folders().context("cannot search for temporary folders")?;
    let count = folders.len();
    let noun = if count == 1 { "folder" } else { "folders" };
    ensure!(count == 0, "{count} temporary {noun}: `memtransfer clean` removes what is left");
    Ok("none".to_owned())
}

/// A pose in the warehouse.
fn a_pose(world: &WorldArgs) -> anyhow::Result<String> {
    let world = world.program()?.describe(&world.flags())?;
    let begin = world.cases.first().and_then(|case| Some(case.references.first()?.begin));
    let begin = begin.context("the world has no case that begins anywhere")?;
    Ok(Pose::try_from(begin)?.to_string())
}

fn with_assets(mut command: Command, world: &WorldArgs) -> Command {
    if let Some(assets) = &world.assets {
        command.arg("--assets").arg(assets);
    }
    command
}

/// Runs `command`; what it prints on stderr is the error.
fn succeed(mut command: Command, stop: &AtomicBool) -> anyhow::Result<()> {
    let output =
        supervise::output(supervise::without_keys(&mut command), stop)?.context(STOPPED)?;
    let message = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{}", message.trim());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cache_folder_that_is_not_there_yet_can_be_made() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(unwritable(&folder.path().join("home/.cache/memtransfer")), None);
        std::fs::write(folder.path().join("file"), "").unwrap();
        assert_eq!(unwritable(folder.path()), None);
    }

    #[test]
    fn too_few_open_files_are_reported_with_the_command_that_raises_them() {
        assert!(enough_files(256, None).is_ok() && enough_files(256, Some(256)).is_ok());
        let error = enough_files(272, Some(128)).unwrap_err().to_string();
        assert!(
            error.contains("may open 128 files") && error.contains("`ulimit -n 272`"),
            "{error}"
        );
    }
}
