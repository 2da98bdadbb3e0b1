//! `sim-proc serve`: the simulator of a run.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use shm_types::message::Role;
use shm_types::process::{check_shared_memory, die_with_parent};
use shm_types::{Attach, Bus};
use warehouse::case_file::CASES_FILE;
use warehouse::{CaseSet, Elsewhere, StreamSet, Warehouse};

use crate::render_command::RendererArgs;
use crate::render_pool::RenderSetup;
use crate::renderer::RenderSettings;
use crate::serve::serve;
use crate::worlds::Worlds;

/// Arguments of `sim-proc serve`.
#[derive(Debug, clap::Args)]
pub struct ServeArgs {
    /// The run's folder, which holds attach.json.
    #[arg(long, value_name = "DIR")]
    attach: PathBuf,

    /// The folder with layout.toml, catalogue.toml and cases.toml, instead of what is compiled in.
    #[arg(long, value_name = "DIR")]
    assets: Option<PathBuf>,

    #[command(flatten)]
    renderer: RendererArgs,

    /// The run's streams, whose world states are world variants after those of the cases.
    #[arg(long, value_name = "FILE")]
    streams: Option<PathBuf>,

    /// The other warehouse, in which tasks are demonstrated: one more world variant.
    #[arg(long, value_name = "FILE")]
    elsewhere: Option<PathBuf>,

    /// Render every view of the unchanged world before the first step.
    #[arg(long)]
    warm_views: bool,
}

/// Serves the run until it stops.
///
/// # Errors
/// A run that cannot be joined or does not fit into shared memory, assets that cannot be read, an adapter that does not
/// exist; later a broken transport, a failed device, or more views in use than fit.
pub fn run(args: ServeArgs) -> Result<()> {
    let attach = Attach::read(&args.attach).context("cannot join the run")?;
    die_with_parent(attach.orchestrator_pid)
        .context("cannot tie this process to its orchestrator")?;
    check_shared_memory(attach.shared_memory_bytes())?;
    let (warehouse, mut cases) = match &args.assets {
        None => (Warehouse::shipped(), CaseSet::shipped()),
        Some(folder) => {
            let warehouse = Warehouse::load(folder)?;
            let cases = CaseSet::load(&folder.join(CASES_FILE), &warehouse)?;
            (warehouse, cases)
        }
    };
    let states = match &args.streams {
        None => Vec::new(),
        Some(file) => {
            let text = fs::read_to_string(file)
                .with_context(|| format!("cannot read {}", file.display()))?;
            let streams = StreamSet::parse(&text, &warehouse, &cases);
            let states = streams.and_then(|streams| streams.states(&warehouse));
            states.with_context(|| file.display().to_string())?
        }
    };
    if let Some(file) = &args.elsewhere {
        cases.elsewhere = Some(Elsewhere::read(file, &warehouse, &cases)?);
    }
    let worlds = Worlds::new(&warehouse, &cases, states);
    let settings = args.renderer.apply(RenderSettings {
        width_px: attach.frame.width,
        height_px: attach.frame.height,
        ..RenderSettings::default()
    });
    let bus = Bus::join(attach, Role::Sim).context("cannot join the run")?;
    let rendered = worlds.clone();
    serve(&bus, worlds, args.warm_views, || RenderSetup::open(&rendered, settings))
        .context("the simulator failed")
}
