//! `sim-proc render`: the warehouse in PNG files, for people.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use domain::Pose;
use warehouse::{CaseSet, Start, Variant, Warehouse};

use crate::contact_sheet::contact_sheet;
use crate::renderer::{FramePath, RenderSettings, Renderer, Samples, View};

/// What `sim-proc render` is told: what to draw, how, and where to.
#[derive(Debug, clap::Args)]
pub struct RenderArgs {
    #[command(flatten)]
    subject: Subject,

    /// Which of the case's trajectories: original, opposite, nearby, distant, test or blocked.
    #[arg(long, value_name = "NAME", default_value = "original", requires = "case", value_parser = parse_start)]
    trajectory: Start,

    /// The PNG file, or for a trajectory the folder of its numbered PNG files; made if missing.
    #[arg(long, value_name = "PATH")]
    out: Option<PathBuf>,

    /// Width and height of a picture in pixels; the width is a multiple of 64.
    #[arg(long, value_name = "WxH", default_value = "448x448", value_parser = parse_size)]
    size: (u32, u32),

    /// Draw without anti-aliasing.
    #[arg(long)]
    no_anti_aliasing: bool,

    /// Draw on the first Vulkan adapter whose name contains this, or on the "processor"; otherwise on a graphics card,
    /// and on the processor where there is none.
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,

    /// The folder with layout.toml, catalogue.toml and cases.toml, instead of what is compiled in.
    #[arg(long, value_name = "DIR")]
    assets: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct Subject {
    /// One view, from this pose: column,row,heading; for example 3,12,N.
    #[arg(long, value_name = "X,Y,H")]
    pose: Option<Pose>,

    /// Every view of a trajectory of this case; `memtransfer ls cases` lists them.
    #[arg(long, value_name = "ID")]
    case: Option<String>,

    /// A contact sheet of the whole catalogue, from 1, 2.5 and 4 metres.
    #[arg(long)]
    catalogue: bool,
}

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    sides.ok_or_else(|| "expected width x height, for example 448x448".to_owned())
}

fn parse_start(text: &str) -> Result<Start, String> {
    let names = Start::ALL.map(Start::name);
    Start::ALL
        .into_iter()
        .find(|start| start.name() == text)
        .ok_or_else(|| format!("expected one of {}", names.join(", ")))
}

/// Draws what `args` ask for and prints the path of every file written.
///
/// # Errors
/// Assets that cannot be read, a pose or case that does not exist, an adapter that is not there, a file that cannot
/// be written.
pub fn run(args: &RenderArgs) -> Result<()> {
    let warehouse = match &args.assets {
        Some(folder) => Warehouse::load(folder)?,
        None => Warehouse::shipped(),
    };
    let settings = RenderSettings {
        width_px: args.size.0,
        height_px: args.size.1,
        samples: if args.no_anti_aliasing { Samples::One } else { Samples::Four },
        adapter: args.adapter.clone(),
        ..RenderSettings::default()
    };
    let out = |default: &str| args.out.clone().unwrap_or_else(|| default.into());
    if let Some(pose) = args.subject.pose {
        if !warehouse.layout.is_free(pose.cell) {
            bail!("the cell of pose {pose} is no free floor; `memtransfer map` shows which is");
        }
        let mut renderer = renderer(&warehouse, settings)?;
        let image = renderer.render_image(View { pose, variant: &Variant::UNCHANGED })?;
        return save(
            &image,
            &out(&format!("view-{}-{}-{}.png", pose.cell.x, pose.cell.y, pose.heading)),
        );
    }
    if let Some(id) = &args.subject.case {
        let folder = out(&format!("{id}-{}", args.trajectory.name()));
        return trajectory(&warehouse, settings, args, id, &folder);
    }
    save(&contact_sheet(&warehouse, settings)?, &out("catalogue.png"))
}

fn renderer(warehouse: &Warehouse, settings: RenderSettings) -> Result<Renderer> {
    let renderer = Renderer::new(warehouse, settings)?;
    let report = renderer.report();
    match &report.frame_path {
        FramePath::Direct => tracing::info!(adapter = report.adapter, "slots are written directly"),
        FramePath::Copied { reason } => {
            tracing::info!(adapter = report.adapter, reason, "slots are written by a copy");
        }
    }
    Ok(renderer)
}

fn trajectory(
    warehouse: &Warehouse,
    settings: RenderSettings,
    args: &RenderArgs,
    id: &str,
    folder: &Path,
) -> Result<()> {
    let cases = match &args.assets {
        Some(assets) => CaseSet::load(&assets.join("cases.toml"), warehouse)?,
        None => CaseSet::shipped(),
    };
    let Some(case) = cases.case(id) else {
        bail!("there is no case {id:?}; `memtransfer ls cases` lists them");
    };
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let mut renderer = renderer(warehouse, settings)?;
    let variant = case.variant(args.trajectory);
    for (step, pose) in case.replay(warehouse, args.trajectory).poses.into_iter().enumerate() {
        let image = renderer.render_image(View { pose, variant: &variant })?;
        save(&image, &folder.join(format!("{step:03}.png")))?;
    }
    Ok(())
}

fn save(image: &image::RgbaImage, path: &Path) -> Result<()> {
    image.save(path).with_context(|| format!("cannot write {}", path.display()))?;
    println!("{}", path.display());
    Ok(())
}
