//! `memtransfer doctor`: what a run needs, checked by using it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::ensure;
use clap::Args;
use serde::Serialize;
use shm_types::process::{SHARED_MEMORY, check_shared_memory};
use shm_types::{Attach, RunDir, registry};

use super::{Exit, WorldArgs, print, print_json};
use crate::supervise::sibling;

#[derive(Debug, Args)]
#[command(after_help = "Exit status 1 when something is missing.")]
pub(super) struct DoctorArgs {
    #[command(flatten)]
    world: WorldArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// One thing that a run needs.
#[derive(Debug, Serialize)]
struct Finding {
    what: &'static str,
    ok: bool,
    /// What was found, or what is wrong and what to do.
    about: String,
}

impl Finding {
    fn of(what: &'static str, outcome: anyhow::Result<String>) -> Self {
        match outcome {
            Ok(about) => Self { what, ok: true, about },
            Err(error) => Self { what, ok: false, about: format!("{error:#}") },
        }
    }
}

pub(super) fn run(args: &DoctorArgs) -> anyhow::Result<Exit> {
    // One picture is rendered and then embedded: what works here works in a run.
    let scratch = Scratch::new()?;
    let picture = scratch.0.join("view.png");
    let findings = vec![
        Finding::of("warehouse and cases", world(&args.world)),
        Finding::of("programs", programs()),
        Finding::of("shared memory", shared_memory()),
        Finding::of("Vulkan", vulkan(&args.world, &picture)),
        Finding::of("ONNX Runtime and encoder", encoder(&args.world, &picture)),
        Finding::of("leftovers of killed runs", leftovers()),
    ];
    if args.json {
        print_json(&findings)?;
    } else {
        for Finding { what, ok, about } in &findings {
            print(&format!("{} {what}: {about}", if *ok { "ok      " } else { "NOT YET " }))?;
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
    let attach = Attach::new(&run);
    check_shared_memory(&attach)?;
    let mib = attach.shared_memory_bytes() >> 20;
    Ok(format!("{SHARED_MEMORY} has room for a default run ({mib} MiB at most)"))
}

fn vulkan(world: &WorldArgs, picture: &Path) -> anyhow::Result<String> {
    let mut command = Command::new(sibling("sim-proc")?);
    command.args(["render", "--pose", &a_pose(world)?, "--out"]).arg(picture);
    succeed(with_assets(command, world))?;
    Ok("a view was rendered".to_owned())
}

fn encoder(world: &WorldArgs, picture: &Path) -> anyhow::Result<String> {
    ensure!(picture.exists(), "not tried, because no view could be rendered");
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
