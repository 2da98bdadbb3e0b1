//! `memtransfer render`: views of an agent as PNG files.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use case_book::CaseVariant;
use case_book::act::DemonstrationsRequest;
use clap::Args;
use conditions::Frames;
use domain::{Appearance, DemonstrationKind, Demonstrations, Mismatch, Pose, Route, Start};
use png_file::{Channels, encode};
use program::AppearanceArgs;
use world_client::RunWorld;
use world_client::frames::{ViewFormat, ViewKey, ViewRenderer};

use super::export::view_edge;
use super::{Exit, WorldArgs, print};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memtransfer render --pose 3,12,N                         one view, as view-3-12-N.png
  memtransfer render --case t01-01 --trajectory blocked    a folder of numbered views
  memtransfer render --pose 3,12,N --backend cpu --size 256 --out view.png
  memtransfer render --case t01-01 --trajectory new --mismatch stock")]
pub(super) struct RenderArgs {
    #[command(flatten)]
    subject: RenderSubject,
    /// Which of the case's trajectories: original, opposite, nearby, distant, new or blocked
    #[arg(long, value_name = "NAME", default_value = "original", requires = "case", value_parser = CaseTrajectory::parse)]
    trajectory: CaseTrajectory,
    /// Render as an episode with this mismatch sees it (see `run --mismatch`): a pose, or the trajectory new or blocked
    #[arg(long, value_name = "WORD", default_value_t = Mismatch::None)]
    mismatch: Mismatch,
    /// The PNG file, or for a trajectory the folder of its numbered PNG files
    #[arg(long, value_name = "PATH")]
    out: Option<PathBuf>,
    /// Width and height of a view in pixels, a multiple of 64
    #[arg(long, value_name = "PIXELS", default_value_t = 448, value_parser = view_edge())]
    size: u16,
    /// Render on the CPU, or on a Vulkan device (wgpu) [default: a graphics card if there is one]
    #[arg(long, value_name = "cpu|wgpu")]
    backend: Option<String>,
    /// Render on the best Vulkan adapter whose name contains this
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    #[command(flatten)]
    appearance: AppearanceArgs,
    #[command(flatten)]
    world: WorldArgs,
}

#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
struct RenderSubject {
    /// One view, from this pose: column,row,heading; for example 3,12,N
    #[arg(long, value_name = "X,Y,H")]
    pose: Option<Pose>,
    /// Every view of a trajectory of this case; `memtransfer ls cases` lists them
    #[arg(long, value_name = "ID")]
    case: Option<String>,
}

/// A trajectory of a case.
#[derive(Debug, Clone, Copy)]
enum CaseTrajectory {
    Demonstration(DemonstrationKind),
    New,
    Blocked,
}

impl CaseTrajectory {
    const ALL: [Self; 6] = {
        let [original, opposite, nearby, distant] = DemonstrationKind::OWN;
        let of = Self::Demonstration;
        [of(original), of(opposite), of(nearby), of(distant), Self::New, Self::Blocked]
    };

    const fn name(self) -> &'static str {
        match self {
            Self::Demonstration(kind) => kind.name(),
            Self::New => "new",
            Self::Blocked => "blocked",
        }
    }

    fn parse(text: &str) -> Result<Self, String> {
        // `test` is the name in case files of the warehouse.
        let name = if text == "test" { Self::New.name() } else { text };
        let found = Self::ALL.into_iter().find(|one| one.name() == name);
        found.ok_or_else(|| format!("expected one of {}", Self::ALL.map(Self::name).join(", ")))
    }

    /// Its views, as an episode with `mismatch` sees them.
    fn act(self, world: &RunWorld, case: &str, mismatch: Mismatch) -> Result<Vec<ViewKey>> {
        let Some(index) = world.index(case) else {
            bail!("there is no case {case:?}; `memtransfer ls cases` lists the cases");
        };
        let route = match self {
            Self::Demonstration(kind) => {
                ensure!(
                    mismatch == Mismatch::None,
                    "demonstrations are always seen as they were recorded: give --trajectory new or blocked with --mismatch"
                );
                let acted = world.demonstrations(DemonstrationsRequest {
                    case: case.to_owned(),
                    set: Demonstrations::NONE,
                    more: vec![(case.to_owned(), kind)],
                    variant: 0,
                    planned: false,
                })?;
                let acted = acted.into_iter().next().context("there is no such demonstration")?;
                return Ok(world.supplied_of(&acted));
            }
            Self::New => Route::Unchanged,
            Self::Blocked => Route::Blocked,
        };
        let is_blocked = route == Route::Blocked;
        let variant = CaseVariant { case: index as u32, is_blocked, mismatch }.number();
        let reference = world.reference(case, variant, (Start::New, route))?;
        Ok(match world.has_map() {
            true => world.supplied(variant, &reference.states),
            false => {
                let begin = if is_blocked { route.name() } else { Start::New.name() };
                let begin = match mismatch.changes_world() {
                    true => format!("{begin}-{mismatch}"),
                    false => begin.to_owned(),
                };
                world.views_after(case, &begin, reference.actions.into_iter().map(Some))
            }
        })
    }
}

pub(super) fn run(args: &RenderArgs) -> Result<Exit> {
    let world = RunWorld::of(args.world.program()?.asker(&args.world.flags())?, Frames::Rendered)?;
    let offered = &world.description().world.mismatches;
    ensure!(
        args.mismatch == Mismatch::None || offered.contains(&args.mismatch),
        "the world {} does not offer the mismatch {}",
        world.declaration().name,
        args.mismatch
    );
    let (views, files) = match (args.subject.pose, &args.subject.case) {
        (Some(pose), _) => {
            ensure!(
                world.has_map(),
                "the world {} draws no view of a pose: give --case in place of --pose",
                world.declaration().name
            );
            ensure!(
                world.scene(0)?.is_floor(pose.cell),
                "the cell of pose {pose} is not free floor; `memtransfer map` shows the floor plan"
            );
            ensure!(
                args.mismatch != Mismatch::Stock,
                "each case has other stock of its own: give --case with --mismatch stock"
            );
            let of = CaseVariant { case: 0, is_blocked: false, mismatch: args.mismatch };
            let name = format!("view-{}-{}-{}.png", pose.cell.x, pose.cell.y, pose.heading);
            (
                vec![ViewKey::State(of.number(), pose.into())],
                vec![args.out.clone().unwrap_or_else(|| name.into())],
            )
        }
        (None, Some(id)) => {
            let views = args.trajectory.act(&world, id, args.mismatch)?;
            let folder = args.out.clone().unwrap_or_else(|| args.trajectory_folder(id));
            fs::create_dir_all(&folder)
                .with_context(|| format!("cannot create the folder {}", folder.display()))?;
            let files = (0..views.len()).map(|step| folder.join(format!("{step:03}.png")));
            let files = files.collect();
            (views, files)
        }
        (None, None) => bail!("give --pose or --case"),
    };
    args.render(&views, &files)?;
    Ok(Exit::Complete)
}

impl RenderArgs {
    fn trajectory_folder(&self, id: &str) -> PathBuf {
        let name = format!("{id}-{}", self.trajectory.name());
        match self.mismatch {
            Mismatch::None => name.into(),
            mismatch => format!("{name}-{mismatch}").into(),
        }
    }

    /// Writes each of `views` to the file of the same place in `files`, and prints the paths.
    fn render(&self, views: &[ViewKey], files: &[PathBuf]) -> Result<()> {
        // The quality is that of JPEG files, which are not made here.
        let format = ViewFormat { edge: self.size, quality: 100 };
        let mut renderer = ViewRenderer::start(&self.world.program()?, &self.flags(), format)?;
        let mut files = files.iter();
        renderer.render_pixels(views, |_, rgba| {
            let file: &Path = files.next().context("a view without a file")?;
            let edge = u32::from(self.size);
            let written = encode(edge, edge, Channels::Rgba, rgba)?;
            durable::output::write(file, &written)
                .with_context(|| format!("cannot write {}", file.display()))?;
            print(&file.display().to_string())
        })
    }

    /// The flags of the renderer.
    fn flags(&self) -> Vec<OsString> {
        let mut flags = self.world.flags();
        if self.world.other.command().is_some() {
            return flags;
        }
        if self.mismatch.changes_world() {
            flags.extend(["--mismatch".into(), self.mismatch.name().into()]);
        }
        let mut flag = |name: &str, value: OsString| flags.extend([name.into(), value]);
        if let Some(backend) = &self.backend {
            flag("--backend", backend.into());
        }
        if let Some(adapter) = &self.adapter {
            flag("--adapter", adapter.into());
        }
        for (name, value) in Appearance::from(self.appearance.clone()).flags() {
            flag(name, value.into());
        }
        flags
    }
}
