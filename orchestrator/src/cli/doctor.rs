//! `memtransfer doctor`: what a run needs, checked by using it.

use std::borrow::Cow;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail, ensure};
use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use shm_types::process::{SHARED_MEMORY, check_shared_memory};
use shm_types::{RunDir, registry};

use super::{Exit, WorldArgs, print, print_json};
use supervise::sibling;

/// What is found out about a model's server stands under this name.
const ENDPOINT: &str = "endpoint";

#[derive(Debug, Args)]
#[command(after_help = "\
Exit status 1 when something is missing.

Examples:
  memtransfer doctor
  memtransfer doctor --policy openai --model NAME --base-url http://localhost:8000/v1")]
pub(super) struct DoctorArgs {
    #[command(flatten)]
    world: WorldArgs,
    /// Also find out what the server of this policy's model can do, by some thirty short requests
    #[arg(long, value_name = "POLICY", value_enum)]
    policy: Option<Asking>,
    /// With --policy openai: the model, as the server calls it
    #[arg(
        long,
        value_name = "NAME",
        env = "MEMTRANSFER_MODEL",
        required_if_eq("policy", "openai")
    )]
    model: Option<String>,
    /// With it: where the server is, up to /v1 [default: $OPENAI_BASE_URL; the key is $OPENAI_API_KEY]
    #[arg(long, value_name = "URL", env = "MEMTRANSFER_BASE_URL")]
    base_url: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Policies that ask somebody else.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Asking {
    /// A model behind an OpenAI-compatible endpoint
    Openai,
}

/// One thing that a run needs.
#[derive(Debug, Serialize)]
struct Finding {
    what: Cow<'static, str>,
    ok: bool,
    /// It does, but results may be worth less than they look.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    doubtful: bool,
    /// What was found, or what is wrong and what to do.
    about: String,
    /// The same as data, where there is more.
    #[serde(skip_serializing_if = "Option::is_none")]
    data: Option<Value>,
}

impl Finding {
    fn of(what: &'static str, outcome: anyhow::Result<String>) -> Self {
        let (ok, about) = match outcome {
            Ok(about) => (true, about),
            Err(error) => (false, format!("{error:#}")),
        };
        Self { what: what.into(), ok, doubtful: false, about, data: None }
    }
}

/// What `policy-proc probe` tells, as far as it is looked into here.
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
    // One picture is drawn and then embedded: what works here works in a run.
    let scratch = Scratch::new()?;
    let picture = scratch.0.join("view.png");
    let mut findings = vec![
        Finding::of("warehouse and cases", world(&args.world)),
        Finding::of("programs", programs()),
        Finding::of("shared memory", shared_memory()),
        Finding::of("drawing", drawing(&args.world, &picture)),
        Finding::of("ONNX Runtime and encoder", encoder(&args.world, &picture)),
        Finding::of("leftovers of killed runs", leftovers()),
    ];
    if let (Some(Asking::Openai), Some(model)) = (args.policy, &args.model) {
        match endpoint(model, args.base_url.as_deref()) {
            Ok(found) => findings.extend(found),
            Err(error) => findings.push(Finding::of(ENDPOINT, Err(error))),
        }
    }
    if args.json {
        print_json(&findings)?;
    } else {
        for Finding { what, ok, doubtful, about, .. } in &findings {
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

fn drawing(world: &WorldArgs, picture: &Path) -> anyhow::Result<String> {
    let mut command = Command::new(sibling("sim-proc")?);
    command.args(["render", "--pose", &a_pose(world)?, "--out"]).arg(picture);
    succeed(with_assets(command, world))?;
    Ok("a view was drawn".to_owned())
}

fn encoder(world: &WorldArgs, picture: &Path) -> anyhow::Result<String> {
    ensure!(picture.exists(), "not tried, because no view could be drawn");
    let mut command = Command::new(sibling("memory-proc")?);
    command.arg("embed").arg(picture);
    succeed(with_assets(command, world))?;
    Ok("the view was embedded".to_owned())
}

fn leftovers() -> anyhow::Result<String> {
    let runs = registry::list(&registry::default_base())?;
    let dead = runs.iter().filter(|run| !run.alive).count();
    ensure!(
        dead == 0,
        "there are {dead}, which hold shared memory: `memtransfer clean` removes them"
    );
    Ok("none".to_owned())
}

/// What the server of a model can do; the whole report as data of the first finding.
fn endpoint(model: &str, base_url: Option<&str>) -> anyhow::Result<Vec<Finding>> {
    let mut command = Command::new(sibling("policy-proc")?);
    command.args(["probe", "--json", "--model", model]);
    if let Some(base_url) = base_url {
        command.args(["--base-url", base_url]);
    }
    let output = command.output()?;
    if output.stdout.is_empty() {
        bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
    }
    let report: Value = serde_json::from_slice(&output.stdout).context("cannot read the probe")?;
    let Probed { endpoint, model, findings } = Probed::deserialize(&report)?;
    let fingerprint = report["fingerprint"].to_string();
    let whole = Finding {
        data: Some(report),
        ..Finding::of(ENDPOINT, Ok(format!("{model} at {endpoint}")))
    };
    let parts = findings.into_iter().map(|ProbedFinding { what, mark, about }| Finding {
        what: format!("{ENDPOINT}, {what}").into(),
        ok: mark != ProbedMark::Bad,
        doubtful: mark == ProbedMark::Doubtful,
        about,
        data: None,
    });
    let who = Finding::of("endpoint, fingerprint", Ok(fingerprint));
    Ok(std::iter::once(whole).chain(parts).chain([who]).collect())
}

/// Some pose in the warehouse.
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

/// Runs `command`; what it said on stderr is the error.
fn succeed(mut command: Command) -> anyhow::Result<()> {
    let output = command.output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{}", said.trim());
    Ok(())
}

/// A folder that goes when it is dropped.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> anyhow::Result<Self> {
        let path = std::env::temp_dir().join(format!("memtransfer-doctor-{}", std::process::id()));
        fs::create_dir_all(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // Nothing depends on it, and nothing can be done about a folder that does not go.
        let _ = fs::remove_dir_all(&self.0);
    }
}
