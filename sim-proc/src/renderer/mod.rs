//! Poses in, pixels out: the only place that knows wgpu.
//!
//! A [`Renderer`] holds the warehouse as static meshes with baked light. A batch of [`RenderJob`]s is
//! drawn in one submission, each view straight into its destination where the driver allows it
//! (`output`). A view's bytes depend on its pose and variant alone, never on its batch.

mod camera;
mod device;
mod error;
mod light;
mod lookout;
mod mesh;
mod output;
mod pipelines;
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

use shm_types::Pose;
use warehouse::{Layout, Variant, Warehouse};

use camera::Camera;
use device::Gpu;
use output::{Outputs, Sink};
use pipelines::{Pipelines, ViewSlots};
use scene::Scene;
use target::Target;
use vertex::ViewUniform;
use visibility::{DrawList, Triangles};

pub use error::RenderError;
pub use lookout::Lookout;
pub use output::Destination;
pub use showcase::{Exhibit, exhibits, write};

/// Longest side of a frame, in pixels.
const MAX_SIDE_PX: u32 = 4096;

/// Widths must be a multiple of this, so that rows of pixels follow each other without gaps.
const WIDTH_STEP_PX: u32 = 64;

/// Views that go to the device in one submission; a larger batch takes several.
const VIEWS_IN_FLIGHT: usize = 16;

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
    /// Take the first adapter whose name contains this text, instead of the best one.
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

/// Draws views of one warehouse.
pub struct Renderer {
    gpu: Gpu,
    target: Target,
    outputs: Outputs,
    pipelines: Pipelines,
    slots: ViewSlots,
    lookout: Lookout,
    settings: RenderSettings,
    /// What shows where nothing is drawn, which happens only outside the hall.
    background: wgpu::Color,
}

impl Renderer {
    /// Opens a device and uploads the scene of `warehouse`.
    ///
    /// # Errors
    /// No Vulkan driver, no adapter of the wanted name, a device that cannot be opened, or a frame size
    /// that cannot be rendered.
    pub fn new(warehouse: &Warehouse, settings: RenderSettings) -> Result<Self, RenderError> {
        let scene = Scene::new(warehouse);
        Self::of_scene(scene, warehouse.layout.clone(), settings)
    }

    /// Another one of the same scene, with a device of its own.
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
        let gpu = Gpu::open(settings.adapter.as_deref())?;
        let samples = settings.samples.count();
        let target = Target::new(&gpu, width_px, height_px, samples);
        let outputs = Outputs::new(&gpu, &target, settings.force_copy);
        let pipelines = Pipelines::new(&gpu, lookout.scene(), samples);
        let slots = ViewSlots::new(&gpu, &pipelines, VIEWS_IN_FLIGHT);
        let [r, g, b] = FOG_RGB.map(f64::from);
        Ok(Self {
            gpu,
            target,
            outputs,
            pipelines,
            slots,
            lookout,
            settings,
            background: wgpu::Color { r, g, b, a: 1.0 },
        })
    }

    /// Bytes of one frame.
    pub fn frame_bytes(&self) -> usize {
        self.target.frame_bytes() as usize
    }

    /// What the renderer runs on and what it has copied.
    pub fn report(&self) -> RenderReport {
        let info = &self.gpu.adapter;
        RenderReport {
            adapter: format!("{} ({})", info.name, info.driver_info),
            frame_path: self.outputs.path().clone(),
            bytes_copied: self.outputs.bytes_copied(),
        }
    }

    /// Whether it is the processor that draws.
    pub fn is_on_processor(&self) -> bool {
        self.gpu.adapter.device_type == wgpu::DeviceType::Cpu
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
        for jobs in batch.chunks_mut(VIEWS_IN_FLIGHT) {
            self.submit(jobs)?;
        }
        Ok(())
    }

    /// Draws one view into a new image.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn render_image(&mut self, view: View<'_>) -> Result<image::RgbaImage, RenderError> {
        let mut image = image::RgbaImage::new(self.settings.width_px, self.settings.height_px);
        let destination = Destination::Memory(&mut image);
        self.render(&mut [RenderJob { view, destination }])?;
        Ok(image)
    }

    /// What can be seen from where, to be asked elsewhere.
    pub fn lookout(&self) -> Lookout {
        self.lookout.clone()
    }

    /// Forgets every slot that was written so far. To be called when the memory behind slots is
    /// unmapped, that is when a publisher is dropped, before frames go to another: a driver may tie an
    /// address to the pages that were behind it first.
    pub fn forget_imports(&mut self) {
        self.outputs.forget_imports();
    }

    fn submit(&mut self, jobs: &mut [RenderJob<'_>]) -> Result<(), RenderError> {
        self.slots.clear();
        for job in &*jobs {
            let View { pose, variant } = job.view;
            let barricades = self.lookout.barricades(variant);
            let (scene, camera, sight) = self.lookout.look(pose);
            let list = DrawList::new(scene, &camera, &sight.objects, Triangles::Facing);
            self.slots.push(scene, &uniform(&camera), &list, &barricades);
        }
        self.draw(jobs.iter_mut().map(|job| &mut job.destination).collect())
    }

    /// Draws the views that have been put into the slots, one into each destination.
    fn draw(&mut self, destinations: Vec<&mut Destination<'_>>) -> Result<(), RenderError> {
        self.slots.upload(&self.gpu);
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let mut frames = Vec::with_capacity(destinations.len());
        for (place, destination) in destinations.into_iter().enumerate() {
            let mut pass = self.target.begin(&mut encoder, self.background);
            self.slots.draw(&mut pass, &self.pipelines, place);
            drop(pass);
            let sink =
                self.outputs.record(&self.gpu, &mut encoder, &self.target, place, destination);
            frames.push((sink, destination));
        }
        let direct = frames.iter().any(|(sink, _)| matches!(sink, Sink::Imported));
        let barrier = direct.then(|| output::host_read_barrier(&self.gpu));
        self.gpu.queue.submit([encoder.finish()].into_iter().chain(barrier));
        self.gpu.wait()?;
        self.outputs.finish(&self.gpu, frames)
    }
}

fn uniform(camera: &Camera) -> ViewUniform {
    ViewUniform {
        clip_from_world: camera.clip_from_world().into(),
        fog_rgb: FOG_RGB,
        fog_per_m: FOG_PER_M,
    }
}
