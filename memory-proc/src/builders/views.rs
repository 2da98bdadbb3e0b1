//! The views that a model is shown: rendered by the world when a prompt needs them, and encoded as policies send them.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::io::{BufReader, Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, ensure};
use case_book::ViewPlace;
use documents::Sources;
use domain::{ImageFormat, hex};
use llm::ImageUrl;
use peer::FrameView;
use prompt::image::data_url;
use sha2::{Digest, Sha256};

/// Draws views of demonstrations.
pub trait DrawViews {
    /// The view with this number in the book.
    ///
    /// # Errors
    /// When the world does not draw it.
    fn draw(&mut self, view: u32) -> Result<DrawnView>;
}

/// A view, as it is sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DrawnView {
    /// Its file as a data URL.
    pub url: ImageUrl,
    /// SHA-256 of its pixels, in hexadecimal digits.
    pub sha256: String,
}

impl DrawnView {
    /// The view with these pixels (red, green, blue and alpha, row by row) in a square of `edge` pixels.
    ///
    /// # Errors
    /// When there are not as many pixels.
    pub fn of_pixels(edge: u32, rgba: &[u8], format: ImageFormat) -> Result<Self> {
        let pixels = FrameView { width: edge, height: edge, pixels: rgba, ..FrameView::NONE };
        let url = data_url(&pixels, format)?;
        Ok(Self { url: ImageUrl { url: url.into() }, sha256: hex(&Sha256::digest(rgba)) })
    }
}

/// The program that renders views of the warehouse.
const RENDERER: &str = "sim-proc";

/// The world whose views are rendered.
#[derive(Debug, Clone)]
pub enum ViewedWorld {
    /// The warehouse.
    Warehouse {
        /// The file of demonstrations.
        demonstrations: PathBuf,
        /// The arguments of `sim-proc views` that say what the world is.
        arguments: Vec<OsString>,
    },
    /// Another world.
    Other {
        /// The command that starts it; `None` if the user starts it.
        command: Option<String>,
        /// The ids of the cases, in the order of the book.
        cases: Vec<String>,
    },
}

/// Draws views by `sim-proc views`, or that of another world, as a child process. It starts with the first view, and ends when
/// this is dropped.
#[derive(Debug)]
pub struct ViewRenderer {
    world: ViewedWorld,
    sources: Sources,
    /// Where each view is seen first.
    places: BTreeMap<u32, ViewPlace>,
    /// How views are encoded.
    format: ImageFormat,
    process: Option<RendererProcess>,
}

#[derive(Debug)]
struct RendererProcess {
    child: Child,
    requests: ChildStdin,
    pixels: BufReader<ChildStdout>,
}

impl ViewRenderer {
    /// Draws the views of `sources` in `world`, encoded as `format`.
    pub fn new(world: ViewedWorld, sources: Sources, format: ImageFormat) -> Self {
        let mut places = BTreeMap::new();
        for (demonstration, of) in (0..).zip(&sources.book().demonstrations) {
            for (step, &view) in (0..).zip(&of.views) {
                places.entry(view).or_insert(ViewPlace { demonstration, step });
            }
        }
        Self { world, sources, places, format, process: None }
    }

    /// The name of a view, as the world's program reads it.
    fn name(&self, ViewPlace { demonstration, step }: ViewPlace) -> Result<String> {
        let ViewedWorld::Other { cases, .. } = &self.world else {
            return Ok(format!("{demonstration} {step}"));
        };
        let book = self.sources.book();
        let of = &book.demonstrations[demonstration as usize];
        let case = cases.get(of.case as usize);
        let case = case.with_context(|| format!("case {} of the book has no id", of.case))?;
        let taken = of.actions[..step as usize].iter().copied().map(Some);
        Ok(format!("{case}.{}.{}", of.kind.name(), book.world.letters(taken)))
    }

    fn start(&self) -> Result<RendererProcess> {
        let mut command = match &self.world {
            ViewedWorld::Warehouse { .. } => {
                Command::new(std::env::current_exe()?.with_file_name(RENDERER))
            }
            ViewedWorld::Other { command, .. } => {
                let name = &self.sources.book().world.name;
                let command = command.as_deref().with_context(|| {
                    format!(
                        "the world {name} is started by its user, so none of its views can be drawn for a model: give its \
                         command as --world-cmd, or have documents written from words alone (--views 0)"
                    )
                })?;
                let words = shlex::split(command).unwrap_or_default();
                let (program, arguments) =
                    words.split_first().context("--world-cmd is no command")?;
                let mut command = Command::new(program);
                command.args(arguments);
                command
            }
        };
        let size = self.sources.frame_size();
        command.args(["views", "--size", &format!("{size}x{size}")]);
        if let ViewedWorld::Warehouse { demonstrations, arguments } = &self.world {
            let flags = self.sources.appearance().flags();
            command.arg("--demonstrations").arg(demonstrations).args(arguments);
            command.args(flags.into_iter().flat_map(|(flag, value)| [flag.into(), value]));
        }
        for variable in domain::KEY_VARIABLES {
            command.env_remove(variable);
        }
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start {}", command.get_program().display()))?;
        let pipes = child.stdin.take().zip(child.stdout.take());
        let (requests, pixels) = pipes.context("a child process without pipes")?;
        Ok(RendererProcess { child, requests, pixels: BufReader::new(pixels) })
    }
}

impl DrawViews for ViewRenderer {
    fn draw(&mut self, view: u32) -> Result<DrawnView> {
        let place = self.places.get(&view).copied();
        let name = self.name(place.with_context(|| format!("the book has no view {view}"))?)?;
        let process = match self.process.take() {
            Some(process) => process,
            None => self.start()?,
        };
        let RendererProcess { requests, pixels, .. } = self.process.insert(process);
        let edge = self.sources.frame_size();
        let mut rgba = vec![0; edge as usize * edge as usize * 4];
        let drawn = writeln!(requests, "{name}")
            .and_then(|()| requests.flush())
            .and_then(|()| pixels.read_exact(&mut rgba));
        ensure!(
            drawn.is_ok(),
            "the world {} draws no view for `{name}`; its own messages are in the log. --views 0 has documents written from words alone",
            self.sources.book().world.name
        );
        DrawnView::of_pixels(edge, &rgba, self.format)
    }
}

impl Drop for RendererProcess {
    fn drop(&mut self) {
        // Nobody waits for a view that it may be rendering.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use domain::Appearance;

    use super::super::testing::book;
    use super::*;

    fn renderer(command: &str) -> ViewRenderer {
        let sources = Sources::new(book(), 2, Appearance::STANDARD);
        let cases = vec!["first".to_owned(), "second".to_owned()];
        let command = (!command.is_empty()).then(|| command.to_owned());
        ViewRenderer::new(ViewedWorld::Other { command, cases }, sources, ImageFormat::Png)
    }

    /// A world that answers with the length of a view's name in every byte.
    const WORLD: &str = r#"sh -c 'while read -r name; do for i in 1 2 3 4 5 6 7 8; do printf "%02d" ${#name}; done; done' -"#;

    #[test]
    fn views_of_other_worlds_are_named_by_case_start_and_actions() {
        let renderer = renderer("true");
        let named = |demonstration, step| renderer.name(ViewPlace { demonstration, step }).unwrap();
        assert_eq!(named(0, 0), "first.original.");
        assert_eq!(named(1, 3), "second.original.eeo");
    }

    #[test]
    fn a_view_has_the_pixels_that_the_world_sent() {
        let mut renderer = renderer(WORLD);
        // `first.original.`, then one action more each.
        for (view, length) in [(0, "15"), (2, "17"), (1, "16")] {
            let pixels = length.repeat(8);
            let expected = DrawnView::of_pixels(2, pixels.as_bytes(), ImageFormat::Png).unwrap();
            assert_eq!(renderer.draw(view).unwrap(), expected);
        }
        assert!(renderer.draw(99).is_err(), "the book has no such view");
    }

    #[test]
    fn a_world_without_views_is_told_how_to_go_on() {
        for (command, expected) in [
            ("", "is started by its user"),
            ("'", "--world-cmd is no command"),
            ("/nowhere/at-all", "cannot start /nowhere/at-all"),
            ("false", "draws no view for `first.original.`"),
        ] {
            let error = format!("{:#}", renderer(command).draw(0).unwrap_err());
            assert!(error.contains(expected), "{error}");
        }
    }
}
