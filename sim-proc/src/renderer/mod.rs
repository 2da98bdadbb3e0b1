//! Poses in, pixels out: the only place that knows wgpu.
//!
//! A [`Renderer`] holds the warehouse as static meshes with baked light, and draws with one of two hands: a graphics
//! card's (`card`), or the processor's own (`raster`) where there is none. Both get the same lists of what to draw and
//! put the pixels straight into their destinations. A view's bytes depend on its pose and variant alone, never on its
//! batch.

mod camera;
mod card;
mod device;
mod error;
mod light;
mod lookout;
mod mesh;
mod output;
mod pipelines;
mod raster;
mod scene;
mod showcase;
mod target;
mod text;
mod vertex;
mod visibility;

#[cfg(test)]
mod shader_tests;
#[cfg(test)]
mod tests;

use domain::Pose;
use warehouse::{Layout, Variant, Warehouse};

use camera::Camera;
use card::Card;
use device::Gpu;
use raster::Raster;
use scene::Scene;
use vertex::Placement;
use visibility::{DrawList, Triangles};

pub use error::RenderError;
pub use lookout::Lookout;
pub use output::Destination;
pub use showcase::{Exhibit, exhibits, write};

/// Longest side of a frame, in pixels.
const MAX_SIDE_PX: u32 = 4096;

/// Widths must be a multiple of this, so that rows of pixels follow each other without gaps.
const WIDTH_STEP_PX: u32 = 64;

/// The name of the adapter that is no Vulkan adapter: the processor.
pub const PROCESSOR: &str = "processor";

/// The colour of distance, and its share for each metre.
const FOG_RGB: [f32; 3] = [0.80, 0.825, 0.845];
const FOG_PER_M: f32 = 0.011;

/// How frames are to be made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RenderSettings {
    /// Width of a frame, in pixels; a multiple of 64.
    pub width_px: u32,
    /// Height of a frame, in pixels.
    pub height_px: u32,
    /// Anti-aliasing.
    pub samples: Samples,
    /// Whether slots are written by a copy even where the device could write them itself.
    pub force_copy: bool,
    /// Draw on the first Vulkan adapter whose name contains this text, or on the [`PROCESSOR`]; otherwise on a graphics
    /// card, and on the processor where there is none.
    pub adapter: Option<String>,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            width_px: 448,
            height_px: 448,
            samples: Samples::Four,
            force_copy: false,
            adapter: None,
        }
    }
}

/// Samples for each pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Samples {
    /// No anti-aliasing.
    One,
    /// Four, resolved into one.
    Four,
}

impl Samples {
    /// How many.
    pub const fn count(self) -> u32 {
        match self {
            Self::One => 1,
            Self::Four => 4,
        }
    }
}

/// Which way frames take into shared-memory slots.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FramePath {
    /// The device writes into the slot; the program copies nothing.
    Direct,
    /// The program copies each frame once.
    Copied {
        /// Why the direct way is not taken.
        reason: String,
    },
}

/// What a renderer runs on and what it has done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RenderReport {
    /// The adapter's name and driver.
    pub adapter: String,
    /// Which way frames take into slots.
    pub frame_path: FramePath,
    /// Bytes of pixels that the program itself has copied so far.
    pub bytes_copied: u64,
}

/// What is looked at.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// Where from.
    pub pose: Pose,
    /// With which barricades.
    pub variant: &'a Variant,
}

/// A view and where its pixels go: RGBA, 8 bits each, rows top to bottom without gaps.
pub struct RenderJob<'a> {
    /// What to draw.
    pub view: View<'a>,
    /// At least [`Renderer::frame_bytes`] long if a slot, exactly so if ordinary memory.
    pub destination: Destination<'a>,
}

/// What a hand needs to know to draw a view.
struct Picture {
    camera: Camera,
    list: DrawList,
    barricades: Vec<Placement>,
}

/// Who draws.
enum Hand {
    Card(Box<Card>),
    Raster(Box<Raster>),
}

impl Hand {
    fn new(scene: &Scene, settings: &RenderSettings) -> Result<Self, RenderError> {
        let gpu = match settings.adapter.as_deref() {
            Some(PROCESSOR) => None,
            Some(name) => Some(Gpu::open(name)?),
            None => Gpu::open_graphics_card()?,
        };
        Ok(match gpu {
            Some(gpu) => Self::Card(Box::new(Card::new(gpu, scene, settings))),
            None => Self::Raster(Box::new(Raster::new(scene, settings))),
        })
    }

    /// Draws pictures, one into each destination, and returns when these hold their pixels.
    fn draw(
        &mut self,
        scene: &Scene,
        pictures: &[Picture],
        background: [f32; 3],
        destinations: &mut [&mut Destination<'_>],
        frame_bytes: usize,
    ) -> Result<(), RenderError> {
        match self {
            Self::Card(card) => card.draw(scene, pictures, background, destinations),
            Self::Raster(raster) => {
                let [r, g, b] = background.map(|channel| (channel * 255.0).round() as u8);
                let background = u32::from_le_bytes([r, g, b, 255]);
                for (picture, destination) in pictures.iter().zip(destinations) {
                    let pixels = &mut destination.bytes()[..frame_bytes];
                    raster.draw(scene, picture, background, pixels);
                }
                Ok(())
            }
        }
    }
}

/// Draws views of one warehouse.
pub struct Renderer {
    hand: Hand,
    lookout: Lookout,
    settings: RenderSettings,
    /// What shows where nothing is drawn, which happens only outside the hall.
    background: [f32; 3],
}

impl Renderer {
    /// Builds the scene of `warehouse`, and opens a device if that is to draw it.
    ///
    /// # Errors
    /// No Vulkan driver, no adapter of the wanted name, a device that cannot be opened, or a frame size
    /// that cannot be rendered.
    pub fn new(warehouse: &Warehouse, settings: RenderSettings) -> Result<Self, RenderError> {
        let scene = Scene::new(warehouse);
        Self::of_scene(scene, warehouse.layout.clone(), settings)
    }

    /// Another one of the same scene, with a hand of its own.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn beside(&self) -> Result<Self, RenderError> {
        Self::with_lookout(self.lookout.clone(), self.settings.clone())
    }

    fn of_scene(
        scene: Scene,
        layout: Layout,
        settings: RenderSettings,
    ) -> Result<Self, RenderError> {
        let size = (settings.width_px, settings.height_px);
        Self::with_lookout(Lookout::new(scene, layout, size), settings)
    }

    fn with_lookout(lookout: Lookout, settings: RenderSettings) -> Result<Self, RenderError> {
        let (width_px, height_px) = (settings.width_px, settings.height_px);
        let side = 64..=MAX_SIDE_PX;
        if !side.contains(&width_px)
            || !side.contains(&height_px)
            || !width_px.is_multiple_of(WIDTH_STEP_PX)
        {
            return Err(RenderError::FrameSize { width_px, height_px, limit_px: MAX_SIDE_PX });
        }
        let hand = Hand::new(lookout.scene(), &settings)?;
        Ok(Self { hand, lookout, settings, background: FOG_RGB })
    }

    /// Bytes of one frame.
    pub fn frame_bytes(&self) -> usize {
        output::frame_bytes(self.settings.width_px, self.settings.height_px) as usize
    }

    /// What the renderer runs on and what it has copied.
    pub fn report(&self) -> RenderReport {
        match &self.hand {
            Hand::Card(card) => card.report(),
            Hand::Raster(_) => RenderReport {
                adapter: PROCESSOR.to_owned(),
                frame_path: FramePath::Direct,
                bytes_copied: 0,
            },
        }
    }

    /// Whether it draws on the thread that asks it to, so that another one beside it draws as fast.
    pub fn keeps_to_its_thread(&self) -> bool {
        matches!(self.hand, Hand::Raster(_))
    }

    /// Draws every job and returns when all destinations hold their pixels.
    ///
    /// # Errors
    /// A destination of the wrong size (nothing is drawn then), or a device that stopped answering.
    pub fn render(&mut self, batch: &mut [RenderJob<'_>]) -> Result<(), RenderError> {
        let expected = self.frame_bytes();
        for job in &*batch {
            let actual = job.destination.len();
            let fits = match job.destination {
                Destination::Slot(_) => actual >= expected,
                Destination::Memory(_) => actual == expected,
            };
            if !fits {
                let pose = job.view.pose.to_string();
                return Err(RenderError::DestinationSize { pose, expected, actual });
            }
        }
        let pictures: Vec<Picture> = batch.iter().map(|job| self.picture(job.view)).collect();
        let mut destinations: Vec<_> = batch.iter_mut().map(|job| &mut job.destination).collect();
        self.draw(&pictures, &mut destinations)
    }

    /// Draws one view into a new image.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn render_image(&mut self, view: View<'_>) -> Result<image::RgbaImage, RenderError> {
        let picture = self.picture(view);
        self.draw_image(picture)
    }

    /// What can be seen from where, to be asked elsewhere.
    pub fn lookout(&self) -> Lookout {
        self.lookout.clone()
    }

    /// Forgets every slot that was written so far. To be called when the memory behind slots is
    /// unmapped, that is when a publisher is dropped, before frames go to another: a driver may tie an
    /// address to the pages that were behind it first.
    pub fn forget_imports(&mut self) {
        if let Hand::Card(card) = &mut self.hand {
            card.forget_imports();
        }
    }

    fn picture(&mut self, View { pose, variant }: View<'_>) -> Picture {
        let barricades = self.lookout.barricades(variant);
        let (scene, camera, sight) = self.lookout.look(pose);
        let list = DrawList::new(scene, &camera, &sight.objects, Triangles::Facing);
        Picture { camera, list, barricades }
    }

    fn draw_image(&mut self, picture: Picture) -> Result<image::RgbaImage, RenderError> {
        let mut image = image::RgbaImage::new(self.settings.width_px, self.settings.height_px);
        self.draw(&[picture], &mut [&mut Destination::Memory(&mut image)])?;
        Ok(image)
    }

    /// Draws pictures, one into each destination.
    fn draw(
        &mut self,
        pictures: &[Picture],
        destinations: &mut [&mut Destination<'_>],
    ) -> Result<(), RenderError> {
        let (scene, bytes) = (self.lookout.scene(), self.frame_bytes());
        self.hand.draw(scene, pictures, self.background, destinations, bytes)
    }
}
