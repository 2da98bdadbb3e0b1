//! `sim-proc views`: renders the views that another program names, for as long as it asks.

use std::io::{BufRead, Write};
use std::path::PathBuf;

use anyhow::{Context, Result};
use case_book::{BookFile, DemonstrationBook};
use domain::{Mismatch, Pose, State};

use crate::renderer::RenderSettings;
use crate::renderer_args::RendererArgs;
use crate::view_source::ViewSource;
use crate::worlds::WorldsArgs;

/// Arguments of `sim-proc views`. Every line of stdin names a view: the number of a world variant and a pose (for grey, that of no world), for example
/// `0 3,12,N`. Its answer on stdout is width x height x 4 bytes: red, green, blue and alpha, row by row from the top left
/// corner.
#[derive(Debug, clap::Args)]
pub struct ViewsArgs {
    /// Width and height of an image in pixels; the width is a multiple of 64.
    #[arg(long, value_name = "WxH", default_value = "448x448", value_parser = parse_size)]
    size: (u32, u32),

    /// The demonstrations of a run. A line then names a view by the index of a demonstration and a step: `17 3`.
    #[arg(long, value_name = "FILE")]
    demonstrations: Option<PathBuf>,

    #[command(flatten)]
    worlds: WorldsArgs,

    /// The mismatches in whose variants there are views.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    mismatch: Vec<Mismatch>,

    #[command(flatten)]
    renderer: RendererArgs,
}

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    sides.ok_or_else(|| "expected width x height, for example 448x448".to_owned())
}

/// A pose, written with the letter of its heading or as a state.
fn pose(text: &str) -> Option<Pose> {
    let of_state = || text.parse::<State>().ok()?.try_into().ok();
    text.parse().ok().or_else(of_state)
}

/// Answers until stdin ends.
///
/// # Errors
/// Assets that cannot be read, an adapter that does not exist, a line that names no view, a device that failed.
pub fn run(args: &ViewsArgs) -> Result<()> {
    let settings = args.renderer.apply(RenderSettings {
        width_px: args.size.0,
        height_px: args.size.1,
        ..RenderSettings::default()
    });
    let mut views = ViewSource::new(args.worlds.load(&args.mismatch)?, settings)?;
    let book = args.demonstrations.as_deref().map(BookFile::<DemonstrationBook>::read);
    let book = book.transpose()?.map(|file| file.book);
    let named = |line: &str| {
        let (first, second) = line.split_once(' ')?;
        let Some(book) = &book else { return Some((first.parse().ok()?, pose(second)?)) };
        let of = book.demonstrations.get(first.parse::<usize>().ok()?)?;
        Some((of.variant, Pose::try_from(*of.states.get(second.parse::<usize>().ok()?)?).ok()?))
    };
    let mut stdout = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let line = line.context("cannot read the names of views")?;
        let (variant, pose): (u32, Pose) = named(&line).with_context(|| {
            let form = if book.is_some() { "DEMONSTRATION STEP" } else { "VARIANT X,Y,H" };
            format!("{line:?} is no view: write {form}")
        })?;
        let image = views.render(variant, pose)?;
        // A pipe that closed means that no more views are wanted.
        if stdout.write_all(image.as_bytes()).and_then(|()| stdout.flush()).is_err() {
            break;
        }
    }
    Ok(())
}
