//! Views of poses, rendered by a child process, as JPEG.

use std::ffi::OsString;
use std::fmt;
use std::io::{self, BufReader, Read, Write};
use std::process::{Child, ChildStdin, ChildStdout};
use std::rc::Rc;
use std::thread;

use anyhow::{Context, Result, anyhow};
use domain::State;
use jpeg_encoder::{ColorType, Encoder};
use run_log::RunLog;

use crate::program::{WorldFiles, WorldProgram};

/// Size and quality of the JPEG files of views.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ViewFormat {
    /// Width and height, in pixels.
    pub edge: u16,
    /// Quality, in percent.
    pub quality: u8,
}

/// What a view shows.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum ViewKey {
    /// A state in the world variant with this number; grey for [`GREY_VARIANT`](case_book::GREY_VARIANT).
    State(u32, State),
    /// What is seen after some steps, in a world whose states do not say what is seen: the id of the case, the name of the
    /// trajectory that begins alike, and the letters of the actions, with a point between each two.
    Steps(Rc<str>),
}

impl fmt::Display for ViewKey {
    /// As the renderer reads it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::State(variant, state) => write!(f, "{variant} {state}"),
            Self::Steps(steps) => f.write_str(steps),
        }
    }
}

/// `sim-proc views`, or that of another world, as a child process. It ends when this is dropped.
#[derive(Debug)]
pub struct ViewRenderer {
    child: Child,
    requests: Option<ChildStdin>,
    pixels: BufReader<ChildStdout>,
    format: ViewFormat,
}

/// The arguments of the renderer that say what the world of the run `log` is, and how it looks.
pub fn view_arguments(log: &RunLog) -> Vec<OsString> {
    if log.manifest.settings.own_world().is_some() {
        return Vec::new();
    }
    let settings = &log.manifest.settings;
    let mut arguments = WorldFiles::of(log).arguments();
    for mismatch in settings.mismatches().filter(|one| one.changes_world()) {
        arguments.extend(["--mismatch".into(), mismatch.name().into()]);
    }
    for (name, value) in settings.appearance().flags() {
        arguments.extend([name.into(), value.into()]);
    }
    arguments
}

impl ViewRenderer {
    /// Starts `program` with `arguments`, which are the [`view_arguments`] of a run.
    ///
    /// # Errors
    /// When it cannot be started.
    pub fn start(
        program: &WorldProgram,
        arguments: &[OsString],
        format: ViewFormat,
    ) -> Result<Self> {
        let edge = format.edge;
        let mut command = program.command("views");
        command.args(["--size", &format!("{edge}x{edge}")]).args(arguments);
        let (child, requests, pixels) = program.start(command)?;
        Ok(Self { child, requests: Some(requests), pixels, format })
    }

    /// Renders `views` and passes each to `take`, in order, as a JPEG file.
    ///
    /// # Errors
    /// When the child process ends early, or `take` fails.
    pub fn render(
        &mut self,
        views: &[ViewKey],
        mut take: impl FnMut(&ViewKey, Vec<u8>) -> Result<()>,
    ) -> Result<()> {
        let ViewFormat { edge, quality } = self.format;
        self.render_pixels(views, |view, rgba| take(view, jpeg((edge, edge), quality, rgba)?))
    }

    /// Renders `views` and passes red, green, blue and alpha of each to `take`, in order.
    ///
    /// # Errors
    /// When the child process ends early, or `take` fails.
    pub fn render_pixels(
        &mut self,
        views: &[ViewKey],
        mut take: impl FnMut(&ViewKey, &[u8]) -> Result<()>,
    ) -> Result<()> {
        let edge = self.format.edge;
        let ended = || anyhow!("the renderer ended early; its messages are above");
        let mut requests = self.requests.take().ok_or_else(ended)?;
        let requests = thread::scope(|scope| {
            // Asked for from another thread, so that rendering and encoding overlap and neither pipe is stuck.
            let asked: Vec<String> = views.iter().map(ToString::to_string).collect();
            let asking = thread::Builder::new().spawn_scoped(scope, move || {
                for view in asked {
                    writeln!(requests, "{view}")?;
                }
                requests.flush()?;
                Ok::<_, io::Error>(requests)
            });
            let asking = asking.context("cannot start a thread")?;
            let mut rgba = vec![0; usize::from(edge) * usize::from(edge) * 4];
            let taken = views.iter().try_for_each(|view| {
                self.pixels.read_exact(&mut rgba).map_err(|_| ended())?;
                take(view, &rgba)
            });
            if taken.is_err() {
                // It may wait until its pixels are read, and the thread until it reads.
                let _ = self.child.kill();
            }
            let requests = asking.join().map_err(|_| ended())?;
            taken?;
            requests.map_err(|_| ended())
        })?;
        self.requests = Some(requests);
        Ok(())
    }
}

impl Drop for ViewRenderer {
    fn drop(&mut self) {
        // Its input ends, and so does it.
        self.requests = None;
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Encodes red, green, blue and alpha of an image of `size` pixels; the alpha channel is left out.
///
/// # Errors
/// When there are fewer pixels than the size says.
pub fn jpeg((width, height): (u16, u16), quality: u8, rgba: &[u8]) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    Encoder::new(&mut bytes, quality).encode(rgba, width, height, ColorType::Rgba)?;
    Ok(bytes)
}

/// Half the width and height of a square image of `edge` pixels: the mean of each four. The edge is even.
pub fn half(edge: u16, rgba: &[u8]) -> Vec<u8> {
    let row = usize::from(edge) * 4;
    let rows = rgba.chunks_exact(2 * row).map(|rows| rows.split_at(row));
    let pixels = rows.flat_map(|(upper, lower)| upper.chunks_exact(8).zip(lower.chunks_exact(8)));
    let mean = |(upper, lower): (&[u8], &[u8])| {
        [0, 1, 2, 3].map(|channel| {
            let four = [upper[channel], upper[channel + 4], lower[channel], lower[channel + 4]];
            ((four.map(u16::from).iter().sum::<u16>() + 2) / 4) as u8
        })
    };
    pixels.flat_map(mean).collect()
}

/// The name of the file of a view.
pub fn file_name(view: &ViewKey) -> String {
    match view {
        ViewKey::State(variant, state) => {
            format!("{variant}-{}.jpg", state.to_string().replace(',', "_"))
        }
        ViewKey::Steps(steps) => format!("{steps}.jpg"),
    }
}

/// Whether a part of the name of steps is one that a case, a trajectory or letters can have.
fn is_word(text: &str) -> bool {
    text.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
}

/// The view whose file has this name.
pub fn of_file_name(name: &str) -> Option<ViewKey> {
    let name = name.strip_suffix(".jpg")?;
    let of_state = || {
        let (variant, state) = name.split_once('-')?;
        let state = state.replace('_', ",").parse().ok()?;
        Some(ViewKey::State(variant.parse().ok()?, state))
    };
    let of_steps = || Some(ViewKey::Steps(name.into()));
    let is_steps = name.matches('.').count() == 2 && name.split('.').all(is_word);
    let is_it = |view: &ViewKey| file_name(view).strip_suffix(".jpg") == Some(name);
    of_state().filter(is_it).or_else(|| of_steps().filter(|_| is_steps))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_is_found_by_the_name_of_its_file() {
        for (numbers, name) in [(&[3.0, 12.0, 3.0][..], "17-3_12_3.jpg"), (&[-0.5], "17--0.5.jpg")]
        {
            let view = ViewKey::State(17, State::new(numbers).unwrap());
            assert_eq!(file_name(&view), name);
            assert_eq!(of_file_name(name), Some(view));
        }
        let view = ViewKey::Steps("g1-1.new.fF3".into());
        assert_eq!(of_file_name(&file_name(&view)), Some(view));
        assert_eq!(of_file_name("g1 1.new.f.jpg"), None);
        for name in
            ["", "..", "17-3_12_3", "17-3_12_W.jpg", "17-03_12_3.jpg", "-3_12_3.jpg", "017-3_1.jpg"]
        {
            assert_eq!(of_file_name(name), None, "{name}");
        }
    }

    #[test]
    fn half_an_image_is_the_mean_of_each_four_pixels() {
        let pixel = |grey: u8| [grey, grey + 1, 7, 255];
        let image = [[0, 4, 100, 100], [8, 12, 100, 100], [9, 9, 50, 52], [9, 9, 54, 56]];
        let rgba: Vec<u8> = image.as_flattened().iter().flat_map(|grey| pixel(*grey)).collect();
        assert_eq!(half(4, &rgba), [6, 100, 9, 53].map(pixel).as_flattened());
    }

    #[test]
    fn pixels_become_a_jpeg_file() {
        let bytes = jpeg((8, 8), 62, &[90; 4 * 64]).unwrap();
        assert_eq!(bytes[..3], [0xff, 0xd8, 0xff]);
    }
}
