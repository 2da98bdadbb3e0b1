//! `sim-proc serve`: the simulator of a run.

use std::path::PathBuf;
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use case_book::{BookFile, DemonstrationBook};
use peer::world::serve_generation;
use shm_types::message::Role;
use shm_types::process::{check_shared_memory, die_with_parent};
use shm_types::{Attach, Bus};

use crate::renderer::RenderSettings;
use crate::renderer_args::RendererArgs;
use crate::world::{WarehouseRendering, WarehouseWorld};
use crate::worlds::WorldsArgs;

/// How long to wait for the shared memory of the generation before.
const ROOM_TIMEOUT: Duration = Duration::from_secs(30);

/// Arguments of `sim-proc serve`.
#[derive(Debug, clap::Args)]
pub struct ServeArgs {
    /// The run's folder, which holds attach.json.
    #[arg(long, value_name = "DIR")]
    attach: PathBuf,

    /// The run's demonstrations, whose views memory asks for.
    #[arg(long, value_name = "FILE")]
    demonstrations: PathBuf,

    #[command(flatten)]
    worlds: WorldsArgs,

    #[command(flatten)]
    renderer: RendererArgs,

    /// Render every view of the unchanged world before the first step.
    #[arg(long)]
    warm_views: bool,

    /// Share rendered views with other processes through this folder.
    #[arg(long, value_name = "DIR")]
    views: Option<PathBuf>,
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
    // Processes of the generation before may use its frames for a moment longer.
    let patience = if attach.generation > 1 { ROOM_TIMEOUT } else { Duration::ZERO };
    let deadline = Instant::now() + patience;
    while let Err(error) = check_shared_memory(attach.shared_memory_bytes()) {
        if Instant::now() >= deadline {
            return Err(error.into());
        }
        sleep(Duration::from_millis(50));
    }
    let worlds = args.worlds.load()?;
    let demonstrations = BookFile::<DemonstrationBook>::read(&args.demonstrations)?.book;
    let settings = args.renderer.apply(RenderSettings {
        width_px: attach.frame.width,
        height_px: attach.frame.height,
        ..RenderSettings::default()
    });
    let mut world = WarehouseWorld::new(&attach, worlds, demonstrations)?;
    let bus = Bus::join(attach, Role::Sim).context("cannot join the run")?;
    let open = |world: &mut WarehouseWorld| {
        let rendering = WarehouseRendering::open(world.worlds(), settings, args.views.as_deref())?;
        Ok(rendering.install(world))
    };
    serve_generation(&bus, &mut world, args.warm_views, open).context("the simulator failed")
}
