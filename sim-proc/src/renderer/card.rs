//! The hand that draws on a graphics card, or whatever else a Vulkan driver drives.
//!
//! The scene's meshes lie on the device. A batch of pictures is drawn in one submission, each straight into its
//! destination where the driver allows it (`output`).

use super::device::Gpu;
use super::output::{self, Destination, Outputs, Sink};
use super::pipelines::{Pipelines, ViewSlots};
use super::scene::Scene;
use super::target::Target;
use super::vertex::ViewUniform;
use super::{FOG_PER_M, FOG_RGB, Picture, RenderError, RenderReport, RenderSettings};

/// Pictures that go to the device in one submission; a larger batch takes several.
const PICTURES_IN_FLIGHT: usize = 16;

/// Draws pictures of one scene on a Vulkan device.
pub(super) struct Card {
    gpu: Gpu,
    target: Target,
    outputs: Outputs,
    pipelines: Pipelines,
    slots: ViewSlots,
}

impl Card {
    /// Uploads `scene` to the device.
    pub(super) fn new(gpu: Gpu, scene: &Scene, settings: &RenderSettings) -> Self {
        let samples = settings.samples.count();
        let target = Target::new(&gpu, settings.width_px, settings.height_px, samples);
        let outputs = Outputs::new(&gpu, &target, settings.force_copy);
        let pipelines = Pipelines::new(&gpu, scene, samples);
        let slots = ViewSlots::new(&gpu, &pipelines, PICTURES_IN_FLIGHT);
        Self { gpu, target, outputs, pipelines, slots }
    }

    /// What it runs on and what it has copied.
    pub(super) fn report(&self) -> RenderReport {
        let info = &self.gpu.adapter;
        RenderReport {
            adapter: format!("{} ({})", info.name, info.driver_info),
            frame_path: self.outputs.path().clone(),
            bytes_copied: self.outputs.bytes_copied(),
        }
    }

    /// Forgets every slot that was written so far. See [`super::Renderer::forget_imports`].
    pub(super) fn forget_imports(&mut self) {
        self.outputs.forget_imports();
    }

    /// Draws pictures, one into each destination, and returns when these hold their pixels.
    pub(super) fn draw(
        &mut self,
        scene: &Scene,
        pictures: &[Picture],
        background: [f32; 3],
        destinations: &mut [&mut Destination<'_>],
    ) -> Result<(), RenderError> {
        let batches = destinations.chunks_mut(PICTURES_IN_FLIGHT);
        for (pictures, destinations) in pictures.chunks(PICTURES_IN_FLIGHT).zip(batches) {
            self.submit(scene, pictures, background, destinations)?;
        }
        Ok(())
    }

    fn submit(
        &mut self,
        scene: &Scene,
        pictures: &[Picture],
        background: [f32; 3],
        destinations: &mut [&mut Destination<'_>],
    ) -> Result<(), RenderError> {
        self.slots.clear();
        for Picture { camera, list, barricades } in pictures {
            let uniform = ViewUniform {
                clip_from_world: camera.clip_from_world().into(),
                fog_rgb: FOG_RGB,
                fog_per_m: FOG_PER_M,
            };
            self.slots.push(scene, &uniform, list, barricades);
        }
        self.slots.upload(&self.gpu);
        let [r, g, b] = background.map(f64::from);
        let background = wgpu::Color { r, g, b, a: 1.0 };
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let mut frames = Vec::with_capacity(destinations.len());
        for (place, destination) in destinations.iter_mut().enumerate() {
            let mut pass = self.target.begin(&mut encoder, background);
            self.slots.draw(&mut pass, &self.pipelines, place);
            drop(pass);
            let sink =
                self.outputs.record(&self.gpu, &mut encoder, &self.target, place, destination);
            frames.push((sink, &mut **destination));
        }
        let direct = frames.iter().any(|(sink, _)| matches!(sink, Sink::Imported));
        let barrier = direct.then(|| output::host_read_barrier(&self.gpu));
        self.gpu.queue.submit([encoder.finish()].into_iter().chain(barrier));
        self.gpu.wait()?;
        self.outputs.finish(&self.gpu, frames)
    }
}
