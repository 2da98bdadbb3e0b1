//! `sim-proc render`: writes views of the warehouse to PNG files.

use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use domain::Pose;
use png_file::RgbaImage;
use program::AppearanceArgs;
use warehouse::{CaseSet, TrajectoryKind, Variant, Warehouse};

use crate::renderer::{Backend, RenderSettings, Renderer, Samples, ViewSpec, contact_sheet};

/// The flags that choose a backend, and how the world looks.
#[derive(Debug, clap::Args)]
pub(crate) struct RendererArgs {
    /// Render on the CPU, whose pixels are the same on every machine, or on a Vulkan device (wgpu); without this, on a
    /// graphics card if there is one and otherwise on the CPU.
    #[arg(long, value_name = "cpu|wgpu")]
    backend: Option<Backend>,

    /// Render on the best Vulkan adapter whose name contains this.
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,

    #[command(flatten)]
    appearance: AppearanceArgs,
}

impl RendererArgs {
    /// `settings` with this backend, adapter and appearance.
    pub(crate) fn apply(&self, settings: RenderSettings) -> RenderSettings {
        RenderSettings {
            backend: self.backend,
            adapter: self.adapter.clone(),
            appearance: self.appearance.clone().into(),
            ..settings
        }
    }
}

/// Arguments of `sim-proc render`.
#[derive(Debug, clap::Args)]
pub struct RenderArgs {
    #[command(flatten)]
    subject: RenderSubject,

    /// Which of the case's trajectories: original, opposite, nearby, distant, test or blocked.
    #[arg(long, value_name = "NAME", default_value = "original", requires = "case", value_parser = parse_trajectory)]
    trajectory: TrajectoryKind,

    /// The PNG file, or for a trajectory the folder of its numbered PNG files, which is created if missing.
    #[arg(long, value_name = "PATH")]
    out: Option<PathBuf>,

    /// Width and height of an image in pixels; the width is a multiple of 64.
    #[arg(long, value_name = "WxH", default_value = "448x448", value_parser = parse_size)]
    size: (u32, u32),

    /// Render without anti-aliasing.
    #[arg(long)]
    no_anti_aliasing: bool,

    #[command(flatten)]
    renderer: RendererArgs,

    /// The folder with layout.toml, catalogue.toml and cases.toml, instead of what is compiled in.
    #[arg(long, value_name = "DIR", env = "MEMTRANSFER_ASSETS")]
    assets: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct RenderSubject {
    /// One view, from this pose: column,row,heading; for example 3,12,N.
    #[arg(long, value_name = "X,Y,H")]
    pose: Option<Pose>,

    /// Every view of a trajectory of this case; `memtransfer ls cases` lists them.
    #[arg(long, value_name = "ID")]
    case: Option<String>,

    /// A contact sheet of the whole catalogue, seen from 1, 2.5 and 4 metres.
    #[arg(long)]
    catalogue: bool,
}

pub(crate) fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    sides.ok_or_else(|| "expected width x height, for example 448x448".to_owned())
}

fn parse_trajectory(text: &str) -> Result<TrajectoryKind, String> {
    let names = TrajectoryKind::ALL.map(TrajectoryKind::name);
    TrajectoryKind::ALL
        .into_iter()
        .find(|kind| kind.name() == text)
        .ok_or_else(|| format!("expected one of {}", names.join(", ")))
}

/// Renders what `args` select and prints the path of every file written.
///
/// # Errors
/// Assets that cannot be read, a pose or case or adapter that does not exist, a file that cannot be written.
pub fn run(args: &RenderArgs) -> Result<()> {
    let warehouse = match &args.assets {
        Some(folder) => Warehouse::load(folder)?,
        None => Warehouse::shipped(),
    };
    let settings = args.renderer.apply(RenderSettings {
        width_px: args.size.0,
        height_px: args.size.1,
        samples: if args.no_anti_aliasing { Samples::One } else { Samples::Four },
        ..RenderSettings::default()
    });
    let out = |default: &str| args.out.clone().unwrap_or_else(|| default.into());
    if let Some(pose) = args.subject.pose {
        if !warehouse.layout.is_free(pose.cell) {
            bail!(
                "the cell of pose {pose} is not free floor; `memtransfer map` shows the floor plan"
            );
        }
        let mut renderer = renderer(&warehouse, settings)?;
        let image =
            renderer.render_image(ViewSpec { pose, variant: &Variant::UNCHANGED, stock: 0 })?;
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
    tracing::info!(report = ?renderer.report(), "renderer opened");
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
        bail!("there is no case {id:?}; `memtransfer ls cases` lists the cases");
    };
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot create the folder {}", folder.display()))?;
    let mut renderer = renderer(warehouse, settings)?;
    let variant = case.variant(args.trajectory);
    for (step, pose) in case.replay(warehouse, args.trajectory).poses.into_iter().enumerate() {
        let image = renderer.render_image(ViewSpec { pose, variant: &variant, stock: 0 })?;
        save(&image, &folder.join(format!("{step:03}.png")))?;
    }
    Ok(())
}

fn save(image: &RgbaImage, path: &Path) -> Result<()> {
    image.write(path).context("cannot write the image")?;
    writeln!(io::stdout(), "{}", path.display())?;
    Ok(())
}
