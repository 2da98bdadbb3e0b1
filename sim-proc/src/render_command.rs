//! `sim-proc render`: views of the warehouse as PNG files.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use shm_types::Pose;
use warehouse::{Variant, Warehouse};

use crate::renderer::{FramePath, RenderSettings, Renderer, Samples, View};

/// What `sim-proc render` is told.
#[derive(Debug, clap::Args)]
pub struct RenderArgs {
    /// The pose to look from: column,row,heading; for example 3,12,N.
    #[arg(long, value_name = "X,Y,H")]
    pose: Pose,

    /// Where the picture goes.
    #[arg(long, value_name = "FILE", default_value = "view.png")]
    out: PathBuf,

    /// Width and height of a picture in pixels; the width is a multiple of 64.
    #[arg(long, value_name = "WxH", default_value = "448x448", value_parser = parse_size)]
    size: (u32, u32),

    /// Draw without anti-aliasing.
    #[arg(long)]
    no_anti_aliasing: bool,

    /// The folder with layout.toml and catalogue.toml, instead of the warehouse that is compiled in.
    #[arg(long, value_name = "DIR")]
    assets: Option<PathBuf>,
}

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    sides.ok_or_else(|| "expected width x height, for example 448x448".to_owned())
}

/// Renders what `args` ask for.
///
/// # Errors
/// Assets that cannot be read, no Vulkan driver, a file that cannot be written.
pub fn run(args: &RenderArgs) -> Result<()> {
    let warehouse = match &args.assets {
        Some(folder) => Warehouse::load(folder)?,
        None => Warehouse::shipped(),
    };
    let settings = RenderSettings {
        width_px: args.size.0,
        height_px: args.size.1,
        samples: if args.no_anti_aliasing { Samples::One } else { Samples::Four },
        ..RenderSettings::default()
    };
    let mut renderer = Renderer::new(&warehouse, settings)?;
    let report = renderer.report();
    match &report.frame_path {
        FramePath::Direct => tracing::info!(adapter = report.adapter, "slots are written directly"),
        FramePath::Copied { reason } => {
            tracing::info!(adapter = report.adapter, reason, "slots are written by a copy");
        }
    }
    let view = View { pose: args.pose, variant: &Variant::UNCHANGED };
    save(&renderer.render_image(view)?, &args.out)
}

fn save(image: &image::RgbaImage, path: &Path) -> Result<()> {
    image.save(path).with_context(|| format!("cannot write {}", path.display()))
}
