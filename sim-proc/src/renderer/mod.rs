//! Turns poses into pixels. The only place that knows wgpu.
//!
//! A [`Renderer`] holds the warehouse as static meshes with baked light (`scene`) and draws it with one of two backends:
//! a Vulkan device (`gpu`), or the CPU (crate `raster`). Both get the same lists of visible triangles (`visibility`) and
//! write the pixels straight into their destinations. A bay that holds different things in different worlds is there once
//! for each, and a view draws the one of its stock. The bytes of a view depend on its pose and world alone, never on the
//! batch it is in.

mod camera;
#[cfg(feature = "wgpu")]
mod gpu;
#[cfg(not(feature = "wgpu"))]
#[path = "no_gpu.rs"]
mod gpu;
mod job;
mod light;
mod look;
mod mesh;
mod scene;
mod scene_visibility;
mod settings;
mod text;
mod visibility;

#[cfg(test)]
mod backend_tests;
#[cfg(test)]
mod sight_tests;
#[cfg(test)]
mod tests;

use anyhow::{Context, Result, bail, ensure};
use domain::Pose;
use png_file::RgbaImage;
use raster::{FOG_RGB, PackedGeometry, PreparedView, Rasterizer};
use warehouse::{Item, Warehouse};

use gpu::GpuBackend;
pub use job::{Destination, RenderJob, ViewSpec};
use scene::Scene;
pub use scene_visibility::{SceneVisibility, VisibleChanges};
pub use settings::{Backend, FramePath, RenderReport, RenderSettings, Samples};
use visibility::{Triangles, draw_list, draw_list_of};

/// An open backend.
enum OpenBackend {
    /// Opened by the first view.
    Cpu(Option<Box<Rasterizer>>),
    Wgpu(Box<GpuBackend>),
}

impl OpenBackend {
    fn new(scene: &Scene, settings: &RenderSettings) -> Result<Self> {
        let gpu = match (settings.backend, settings.adapter.as_deref()) {
            (Some(Backend::Cpu), None) => None,
            (Some(Backend::Cpu), Some(adapter)) => {
                bail!(
                    "--adapter {adapter:?} names a Vulkan adapter, which --backend cpu does not use: leave one of them out"
                );
            }
            (_, Some(name)) => Some(gpu::open(name)?),
            (Some(Backend::Wgpu), None) => Some(gpu::open("")?),
            (None, None) => gpu::open_graphics_card()?,
        };
        Ok(match gpu {
            Some(device) => {
                Self::Wgpu(Box::new(GpuBackend::new(device, &scene.geometry, settings)))
            }
            None => Self::Cpu(None),
        })
    }
}

/// Renders views of one warehouse.
pub struct Renderer {
    backend: OpenBackend,
    visibility: SceneVisibility,
    settings: RenderSettings,
    /// The colour of pixels that no triangle covers, which only happens outside the hall.
    background: [f32; 3],
}

impl Renderer {
    /// Builds the scene of `warehouse` and opens the backend.
    ///
    /// # Errors
    /// A frame size that cannot be rendered, no Vulkan driver, no adapter of the given name, or a device that cannot be
    /// opened.
    pub fn new(warehouse: &Warehouse, settings: RenderSettings) -> Result<Self> {
        Self::with_stocks(std::slice::from_ref(warehouse), settings)
    }

    /// As [`Self::new`], for several stocks of a hall: warehouses that differ in their items only.
    ///
    /// # Errors
    /// As [`Self::new`]; also when there is no stock.
    pub fn with_stocks(stocks: &[Warehouse], settings: RenderSettings) -> Result<Self> {
        let first = stocks.first().context("a renderer needs a warehouse")?;
        let scene = Scene::new(stocks, settings.appearance);
        let size_px = [settings.width_px, settings.height_px];
        let visibility =
            SceneVisibility::new(scene, first.layout.clone(), settings.camera, size_px);
        Self::with_visibility(visibility, settings)
    }

    /// Opens another renderer of the same scene.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn try_clone(&self) -> Result<Self> {
        Self::with_visibility(self.visibility.clone(), self.settings.clone())
    }

    fn with_visibility(visibility: SceneVisibility, settings: RenderSettings) -> Result<Self> {
        settings.check()?;
        let backend = OpenBackend::new(visibility.scene(), &settings)?;
        Ok(Self { backend, visibility, settings, background: FOG_RGB })
    }

    /// Bytes of a frame.
    pub fn frame_bytes(&self) -> usize {
        self.settings.frame_bytes()
    }

    /// What the renderer runs on and what it has copied.
    pub fn report(&self) -> RenderReport {
        match &self.backend {
            OpenBackend::Wgpu(gpu) => gpu.report(),
            OpenBackend::Cpu(_) => RenderReport {
                backend: Backend::Cpu,
                adapter: None,
                frame_path: FramePath::Direct,
                bytes_copied: 0,
            },
        }
    }

    /// Bytes of the triangles and texts of the scene.
    pub fn scene_bytes(&self) -> usize {
        self.visibility.scene().geometry.bytes()
    }

    /// What is visible from where, as a value of its own.
    pub fn visibility(&self) -> SceneVisibility {
        self.visibility.clone()
    }

    /// Renders every job and returns when all destinations hold their pixels.
    ///
    /// # Errors
    /// A destination of the wrong size (nothing is rendered then), or a device that failed.
    pub fn render(&mut self, batch: &mut [RenderJob<'_>]) -> Result<()> {
        let expected = self.frame_bytes();
        for RenderJob { view, destination } in &*batch {
            let actual = destination.bytes().len();
            let fits = match destination {
                Destination::Slot(_) => actual >= expected,
                Destination::Memory(_) => actual == expected,
            };
            ensure!(
                fits,
                "a frame takes {expected} bytes, but the destination of view {} has {actual}",
                view.pose
            );
        }
        let views: Vec<PreparedView> = batch.iter().map(|job| self.prepare(job.view)).collect();
        let mut destinations: Vec<_> = batch.iter_mut().map(|job| &mut job.destination).collect();
        self.draw(&views, &mut destinations)
    }

    /// As [`SceneVisibility::changes`].
    pub(crate) fn changes(&mut self, view: ViewSpec<'_>) -> VisibleChanges {
        self.visibility.changes(view)
    }

    /// Renders one view into a new image.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn render_image(&mut self, view: ViewSpec<'_>) -> Result<RgbaImage> {
        let prepared = self.prepare(view);
        self.draw_image(prepared)
    }

    /// How many pixels of the view from `pose`, with the first stock and without barricades, `items` change with their plates and
    /// labels: those that differ when these are left out.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn pixels_of(&mut self, pose: Pose, items: &[&Item]) -> Result<usize> {
        let (scene, camera, visible) = self.visibility.at_pose(0, pose);
        let known = &scene.stocks[0].items;
        let left_out: Vec<u32> =
            items.iter().filter_map(|item| known.get(&(item.rack, item.face)).copied()).collect();
        if !visible.objects.iter().any(|object| left_out.contains(object)) {
            return Ok(0);
        }
        let objects = visible.objects.iter().map(|index| {
            let object = &scene.objects[*index as usize];
            if left_out.contains(index) { object.without_item() } else { object.clone() }
        });
        let objects: Vec<_> = objects.collect();
        let clip_from_world = camera.clip_from_world().into();
        let lists = [
            draw_list(scene, &camera, &visible.objects, Triangles::Facing),
            draw_list_of(scene, &camera, objects.iter(), Triangles::Facing),
        ];
        let [with, without] = lists.map(|list| {
            self.draw_image(PreparedView { clip_from_world, list, barricades: Vec::new() })
        });
        let (with, without) = (with?, without?);
        Ok(with.pixels().zip(without.pixels()).filter(|(with, without)| with != without).count())
    }

    /// Forgets the addresses of all slots that were written so far. Call this when the memory behind slots is unmapped
    /// (when a publisher is dropped) and before frames go to other slots: a driver may tie an address to the pages that
    /// were mapped there first.
    pub fn forget_imports(&mut self) {
        if let OpenBackend::Wgpu(gpu) = &mut self.backend {
            gpu.forget_imports();
        }
    }

    /// Draws with the vector instructions of `level`, if the CPU draws.
    #[cfg(test)]
    fn with_level(mut self, level: raster::Level) -> Self {
        if let OpenBackend::Cpu(cpu) = &mut self.backend {
            let opened = rasterizer(self.visibility.scene().packed(), &self.settings);
            *cpu = Some(Box::new(opened.with_level(level)));
        }
        self
    }

    fn prepare(&mut self, ViewSpec { pose, variant, stock }: ViewSpec<'_>) -> PreparedView {
        let barricades = self.visibility.barricades(variant);
        let (scene, camera, visible) = self.visibility.at_pose(stock, pose);
        PreparedView {
            clip_from_world: camera.clip_from_world().into(),
            list: draw_list(scene, &camera, &visible.objects, Triangles::Facing),
            barricades,
        }
    }

    fn draw_image(&mut self, view: PreparedView) -> Result<RgbaImage> {
        let RenderSettings { width_px, height_px, .. } = self.settings;
        let mut image = RgbaImage::filled(width_px, height_px, [0; 4]);
        self.draw(&[view], &mut [&mut Destination::Memory(image.as_bytes_mut())])?;
        Ok(image)
    }

    /// Draws each view into its destination.
    fn draw(
        &mut self,
        views: &[PreparedView],
        destinations: &mut [&mut Destination<'_>],
    ) -> Result<()> {
        let scene = self.visibility.scene();
        let geometry = &scene.geometry;
        let frame_bytes = self.settings.frame_bytes();
        match &mut self.backend {
            OpenBackend::Wgpu(gpu) => gpu.draw(geometry, views, self.background, destinations),
            OpenBackend::Cpu(cpu) => {
                let [r, g, b] = self.background.map(|channel| (channel * 255.0).round() as u8);
                let background = u32::from_le_bytes([r, g, b, 255]);
                let packed = scene.packed();
                let cpu = cpu.get_or_insert_with(|| Box::new(rasterizer(packed, &self.settings)));
                for (view, destination) in views.iter().zip(destinations) {
                    let pixels = &mut destination.bytes_mut()[..frame_bytes];
                    cpu.draw(geometry, packed, view, background, pixels);
                }
                Ok(())
            }
        }
    }
}

fn rasterizer(packed: &PackedGeometry, settings: &RenderSettings) -> Rasterizer {
    let &RenderSettings { width_px, height_px, samples, .. } = settings;
    Rasterizer::new(packed, width_px, height_px, samples)
}
