//! `memtransfer doctor`: checks what a run needs by using it.

use std::borrow::Cow;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail, ensure};
use clap::{Args, ValueEnum};
use documents::DocumentName;
use llm::Endpoint;
use orchestrator::documents::needed;
use orchestrator::scratch::{self, ScratchFolder};
use results::settings::RunSettings;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use settings::{Layer, resolve};
use shm_types::process::{SHARED_MEMORY, check_shared_memory};
use shm_types::{RunDir, registry};
use supervise::sibling;

use super::documents::{RunDocuments, listed};
use super::{Exit, WorldArgs, print, print_json};
use crate::signals::{self, Signals};

/// The name of findings about a model's server.
const ENDPOINT: &str = "endpoint";

/// Why a check has no result.
const STOPPED: &str = "stopped by a signal";

#[derive(Debug, Args)]
#[command(after_help = "\
Exit status 1 when something is missing. Frame size, image budget and time limit of the request to a
model are those of a run: set MEMTRANSFER_FRAME_SIZE, MEMTRANSFER_IMAGE_BUDGET or
MEMTRANSFER_REQUEST_TIMEOUT as for `memtransfer run`.

Examples:
  memtransfer doctor
  memtransfer doctor --policy openai --model NAME --base-url http://localhost:8000/v1")]
pub(super) struct DoctorArgs {
    #[command(flatten)]
    world: WorldArgs,
    /// Also check the server of this policy's model, with about twenty short requests and one of the
    /// size that a run sends
    #[arg(long, value_name = "POLICY", value_enum, requires = "model")]
    policy: Option<ModelPolicy>,
    /// With --policy openai: the model, by the name that the server knows
    #[arg(long, value_name = "NAME", env = "MEMTRANSFER_MODEL")]
    model: Option<String>,
    /// With --policy openai: the server, up to /v1, or several, each of which is checked [default:
    /// $OPENAI_BASE_URL; the key is $OPENAI_API_KEY]
    #[arg(long, value_name = "URL,...", env = "MEMTRANSFER_BASE_URL")]
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
    /// Whether a run works, but with doubtful results.
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

/// The parts of `policy-proc probe`'s report that are used here.
#[derive(Deserialize)]
struct Probed {
    endpoint: String,
    model: String,
    findings: Vec<ProbedFinding>,
}

#[derive(Deserialize)]
struct ProbedFinding {
    what: String,
    mark: ProbedMark,
    about: String,
}

#[derive(Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
enum ProbedMark {
    Ok,
    Doubtful,
    Bad,
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
        DoctorFinding::of("warehouse and cases", world(&args.world)),
        DoctorFinding::of("programs", programs()),
        DoctorFinding::of("shared memory", shared_memory()),
        DoctorFinding::of("rendering", rendering(&args.world, &view, stop)),
        DoctorFinding::of("ONNX Runtime and encoder", encoder(&args.world, &view, stop)),
        DoctorFinding::of("leftovers of killed runs", leftovers()),
    ];
    if let (Some(ModelPolicy::Openai), Some(model)) = (args.policy, &args.model) {
        let servers = match Endpoint::from_environment(args.base_url.as_deref(), Path::new(".")) {
            Ok((first, others)) => std::iter::once(first).chain(others).map(Ok).collect(),
            Err(error) => vec![Err(error.into())],
        };
        for server in servers {
            match server.and_then(|server| endpoint(model, &server.base(), stop)) {
                Ok(found) => findings.extend(found),
                Err(error) => findings.push(DoctorFinding::of(ENDPOINT, Err(error))),
            }
        }
    }
    Ok(findings)
}

fn world(args: &WorldArgs) -> anyhow::Result<String> {
    let world = args.load()?;
    let (items, cases) = (world.warehouse.items.len(), world.cases.cases.len());
    Ok(format!("{items} items, {cases} cases (`memtransfer validate` checks them all)"))
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

fn rendering(world: &WorldArgs, view: &Path, stop: &AtomicBool) -> anyhow::Result<String> {
    let mut command = Command::new(sibling("sim-proc")?);
    command.args(["render", "--pose", &a_pose(world)?, "--out"]).arg(view);
    succeed(with_assets(command, world), stop)?;
    Ok("a view was rendered".to_owned())
}

fn encoder(world: &WorldArgs, view: &Path, stop: &AtomicBool) -> anyhow::Result<String> {
    ensure!(view.exists(), "not checked, because no view could be rendered");
    let mut command = Command::new(sibling("memory-proc")?);
    command.arg("embed").arg(view);
    succeed(with_assets(command, world), stop)?;
    Ok("the view was embedded".to_owned())
}

fn leftovers() -> anyhow::Result<String> {
    let runs = registry::list(&registry::default_base())?;
    let dead = runs.iter().filter(|run| !run.alive).count();
    ensure!(dead == 0, "{dead} runs hold shared memory: `memtransfer clean` removes them");
    let folders = scratch::abandoned_folders().context("cannot search for temporary folders")?;
    let count = folders.len();
    ensure!(count == 0, "{count} temporary folders: `memtransfer clean` removes them");
    Ok("none".to_owned())
}

/// What the server of a model can do. The whole report is the data of the first finding.
fn endpoint(model: &str, base_url: &str, stop: &AtomicBool) -> anyhow::Result<Vec<DoctorFinding>> {
    let mut command = Command::new(sibling("policy-proc")?);
    command.args(["probe", "--json", "--model", model, "--base-url", base_url]);
    let flags = Layer::flags([("policy", "openai"), ("model", model)])?;
    let settings = resolve([Layer::environment(std::env::vars_os())?, flags])?.settings;
    let documents = RunDocuments::of(&settings, None, false);
    command.args(request_size(&settings, &documents));
    let output = supervise::output(&mut command, stop)?.context(STOPPED)?;
    if output.stdout.is_empty() {
        bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
    }
    let report: Value = serde_json::from_slice(&output.stdout).context("cannot read the probe")?;
    let Probed { endpoint, model, findings } = Probed::deserialize(&report)?;
    let fingerprint = report["fingerprint"].to_string();
    let whole = DoctorFinding {
        data: Some(report),
        ..DoctorFinding::of(ENDPOINT, Ok(format!("{model} at {endpoint}")))
    };
    let parts = findings.into_iter().map(|ProbedFinding { what, mark, about }| DoctorFinding {
        what: format!("{ENDPOINT}, {what}").into(),
        ok: mark != ProbedMark::Bad,
        doubtful: mark == ProbedMark::Doubtful,
        about,
        data: None,
    });
    let who = DoctorFinding::of("endpoint, fingerprint", Ok(fingerprint));
    let too_small = size_without(&documents.missing()).into_iter();
    Ok(std::iter::once(whole).chain(parts).chain(too_small).chain([who]).collect())
}

/// That the request of the run's size had no documents, if they are not built yet.
fn size_without(missing: &[DocumentName]) -> Option<DoctorFinding> {
    (!missing.is_empty()).then(|| DoctorFinding {
        doubtful: true,
        ..DoctorFinding::of(
            "endpoint, documents",
            Ok(format!(
                "the request of the run's size was without {}, which are not built yet: `memtransfer memory build` \
                 builds them, then check again",
                listed(missing)
            )),
        )
    })
}

/// The probe's flags about the largest request of a run with these settings and documents.
fn request_size(settings: &RunSettings, documents: &RunDocuments) -> Vec<String> {
    let window = settings.groups.iter().flat_map(|group| &group.window).max();
    let sizes = documents.sizes();
    let size = |condition| needed([condition]).iter().filter_map(|name| sizes.get(name)).sum();
    let largest: u64 = settings.conditions().iter().map(size).max().unwrap_or(0);
    let mut flags = vec![
        ("--frame-size", settings.frame_size.to_string()),
        ("--document-chars", largest.to_string()),
        ("--keyframes", settings.keyframes.to_string()),
        ("--window", window.copied().unwrap_or(0).to_string()),
    ];
    if let Some(model) = &settings.model {
        flags.extend([
            ("--image-budget", model.image_budget.to_string()),
            ("--image-format", model.image_format.to_string()),
            ("--request-timeout", model.request_timeout.to_string()),
        ]);
    }
    flags.into_iter().flat_map(|(flag, value)| [flag.to_owned(), value]).collect()
}

/// A pose in the warehouse.
fn a_pose(world: &WorldArgs) -> anyhow::Result<String> {
    let world = world.load()?;
    let case = world.cases.cases.first();
    Ok(case.map_or_else(|| "1,1,N".to_owned(), |case| case.original.start.to_string()))
}

fn with_assets(mut command: Command, world: &WorldArgs) -> Command {
    if let Some(assets) = &world.assets {
        command.arg("--assets").arg(assets);
    }
    command
}

/// Runs `command`; what it prints on stderr is the error.
fn succeed(mut command: Command, stop: &AtomicBool) -> anyhow::Result<()> {
    let output = supervise::output(&mut command, stop)?.context(STOPPED)?;
    let message = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{}", message.trim());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The request that the probe sends and times has the size of the run's.
    #[test]
    fn a_probe_has_the_size_of_the_run_and_says_what_it_lacks() {
        let empty = tempfile::tempdir().unwrap();
        let environment = Layer::flags([
            ("frame-size", "128"),
            ("image-budget", "12"),
            ("window", "3,9"),
            ("request-timeout", "77"),
            ("memory", "working,hybrid"),
            ("demos", "original"),
            ("documents", empty.path().to_str().unwrap()),
        ]);
        let flags = Layer::flags([("policy", "openai"), ("model", "m")]);
        let settings = resolve([environment.unwrap(), flags.unwrap()]).unwrap().settings;
        let documents = RunDocuments::of(&settings, None, false);
        insta::assert_snapshot!(
            request_size(&settings, &documents).join(" "),
            @"--frame-size 128 --document-chars 0 --keyframes 40 --window 9 --image-budget 12 --image-format png --request-timeout 77"
        );
        let finding = size_without(&documents.missing()).unwrap();
        assert!(finding.ok && finding.doubtful);
        assert!(finding.about.contains("without summary/original, semantic/original, which"));
        assert!(size_without(&[]).is_none());
    }
}
