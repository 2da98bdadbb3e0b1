//! `sim-proc serve`: the simulator of a run.

use std::path::PathBuf;

use anyhow::{Context, Result};
use case_book::{BookFile, DemonstrationBook};
use domain::Mismatch;
use peer::world::serve_world;
use shm_types::{ATTACH_VARIABLE, Attach};

use crate::renderer::RenderSettings;
use crate::renderer_args::RendererArgs;
use crate::world::{WarehouseRendering, WarehouseWorld};
use crate::worlds::WorldsArgs;

/// Arguments of `sim-proc serve`.
#[derive(Debug, clap::Args)]
pub struct ServeArgs {
    /// The run's folder, which holds attach.json.
    #[arg(long, value_name = "DIR", env = ATTACH_VARIABLE)]
    attach: PathBuf,

    /// The run's demonstrations, whose views memory asks for.
    #[arg(long, value_name = "FILE")]
    demonstrations: PathBuf,

    #[command(flatten)]
    worlds: WorldsArgs,

    /// The mismatches that episodes of the run have.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    mismatch: Vec<Mismatch>,

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
    let ServeArgs { attach, demonstrations, worlds, mismatch, renderer, warm_views, views } = args;
    let make = |attach: &Attach| {
        let demonstrations = BookFile::<DemonstrationBook>::read(&demonstrations)?.book;
        Ok(WarehouseWorld::new(attach, worlds.load(&mismatch)?, demonstrations)?)
    };
    let open = |world: &mut WarehouseWorld, attach: &Attach| {
        let settings = renderer.apply(RenderSettings {
            width_px: attach.frame.width,
            height_px: attach.frame.height,
            ..RenderSettings::default()
        });
        let rendering = WarehouseRendering::open(world.worlds(), settings, views.as_deref())?;
        Ok(rendering.install(world))
    };
    serve_world(&attach, warm_views, make, open).context("the simulator failed")
}
