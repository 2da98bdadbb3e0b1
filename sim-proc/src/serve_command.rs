//! `sim-proc serve`: the simulator of a run.

use std::path::PathBuf;

use anyhow::{Context, Result};
use shm_types::message::Role;
use shm_types::process::{check_shared_memory, die_with_parent};
use shm_types::{Attach, Bus};
use warehouse::case_file::CASES_FILE;
use warehouse::{CaseSet, Warehouse};

use crate::painter::Studio;
use crate::renderer::RenderSettings;
use crate::serve::{Ahead, serve};

/// What `sim-proc serve` is told.
#[derive(Debug, clap::Args)]
pub struct ServeArgs {
    /// The run's folder, which holds attach.json.
    #[arg(long, value_name = "DIR")]
    attach: PathBuf,

    /// The folder with layout.toml, catalogue.toml and cases.toml, instead of what is compiled in.
    #[arg(long, value_name = "DIR")]
    assets: Option<PathBuf>,

    /// Draw on the first Vulkan adapter whose name contains this, or on the "processor"; otherwise on a graphics card,
    /// and on the processor where there is none.
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,

    /// Draw every view of the unchanged world before taking part.
    #[arg(long)]
    warm_views: bool,
}

/// Takes part in the run until it stops.
///
/// # Errors
/// A run that cannot be joined or does not fit into shared memory, assets that cannot be read, an adapter that is not
/// there; later, a broken transport, a failed device, or more views in use than fit.
pub fn run(args: ServeArgs) -> Result<()> {
    let attach = Attach::read(&args.attach).context("cannot take part in the run")?;
    die_with_parent(attach.orchestrator_pid).context("this process belongs to an orchestrator")?;
    check_shared_memory(attach.shared_memory_bytes())?;
    let (warehouse, cases) = match &args.assets {
        None => (Warehouse::shipped(), CaseSet::shipped()),
        Some(folder) => {
            let warehouse = Warehouse::load(folder)?;
            let cases = CaseSet::load(&folder.join(CASES_FILE), &warehouse)?;
            (warehouse, cases)
        }
    };
    let settings = RenderSettings {
        width_px: attach.frame.width,
        height_px: attach.frame.height,
        adapter: args.adapter,
        ..RenderSettings::default()
    };
    let bus = Bus::join(attach, Role::Sim).context("cannot take part in the run")?;
    let ahead = if args.warm_views { Ahead::EveryView } else { Ahead::Nothing };
    serve(&bus, &warehouse, &cases, ahead, || Studio::open(&warehouse, settings))
        .context("the simulator cannot go on")
}
