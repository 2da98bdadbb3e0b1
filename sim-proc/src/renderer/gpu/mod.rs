//! The wgpu backend: draws on a Vulkan device.
//!
//! The scene's geometry stays on the device. A batch of views is one submission, and each view goes straight into its
//! destination where the driver allows that (`readback`).

mod device;
mod pipelines;
mod readback;
#[cfg(test)]
mod shader_tests;
mod target;
mod vertex;

use anyhow::Result;
use raster::{FOG_PER_M, FOG_RGB, Geometry, PreparedView};

use super::job::Destination;
use super::settings::{Backend, RenderReport, RenderSettings};
use device::Gpu;
pub(super) use device::{open, open_graphics_card};
use pipelines::{Pipelines, ViewBatch};
use readback::{Readback, Sink, host_read_barrier};
use target::RenderTarget;
use vertex::ViewUniform;

/// Views per submission.
const BATCH_VIEWS: usize = 16;

/// Draws views of one scene on a Vulkan device.
pub(super) struct GpuBackend {
    gpu: Gpu,
    target: RenderTarget,
    readback: Readback,
    pipelines: Pipelines,
    batch: ViewBatch,
}

impl GpuBackend {
    /// Uploads `geometry` to the device.
    pub(super) fn new(gpu: Gpu, geometry: &Geometry, settings: &RenderSettings) -> Self {
        let samples = settings.samples.count();
        let target = RenderTarget::new(&gpu, settings.width_px, settings.height_px, samples);
        let readback = Readback::new(&gpu, &target, settings.force_copy);
        let pipelines = Pipelines::new(&gpu, geometry, samples);
        let batch = ViewBatch::new(&gpu, &pipelines, BATCH_VIEWS);
        Self { gpu, target, readback, pipelines, batch }
    }

    /// The adapter, and what has been copied.
    pub(super) fn report(&self) -> RenderReport {
        let info = &self.gpu.adapter;
        RenderReport {
            backend: Backend::Wgpu,
            adapter: Some(format!("{} ({})", info.name, info.driver_info)),
            frame_path: self.readback.path().clone(),
            bytes_copied: self.readback.bytes_copied(),
        }
    }

    /// See [`Renderer::forget_imports`](super::Renderer::forget_imports).
    pub(super) fn forget_imports(&mut self) {
        self.readback.forget_imports();
    }

    /// Draws each view into its destination and returns when all hold their pixels.
    pub(super) fn draw(
        &mut self,
        geometry: &Geometry,
        views: &[PreparedView],
        background: [f32; 3],
        destinations: &mut [&mut Destination<'_>],
    ) -> Result<()> {
        let batches = destinations.chunks_mut(BATCH_VIEWS);
        for (views, destinations) in views.chunks(BATCH_VIEWS).zip(batches) {
            self.submit(geometry, views, background, destinations)?;
        }
        Ok(())
    }

    fn submit(
        &mut self,
        geometry: &Geometry,
        views: &[PreparedView],
        background: [f32; 3],
        destinations: &mut [&mut Destination<'_>],
    ) -> Result<()> {
        self.batch.clear();
        for view in views {
            let uniform = ViewUniform {
                clip_from_world: view.clip_from_world,
                fog_rgb: FOG_RGB,
                fog_per_m: FOG_PER_M,
            };
            self.batch.push(geometry, &uniform, view);
        }
        self.batch.upload(&self.gpu);
        let [r, g, b] = background.map(f64::from);
        let background = wgpu::Color { r, g, b, a: 1.0 };
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let mut frames = Vec::with_capacity(destinations.len());
        for (index, destination) in destinations.iter_mut().enumerate() {
            let mut pass = self.target.begin(&mut encoder, background);
            self.batch.draw(&mut pass, &self.pipelines, index);
            drop(pass);
            let sink =
                self.readback.record(&self.gpu, &mut encoder, &self.target, index, destination);
            frames.push((sink, &mut **destination));
        }
        let direct = frames.iter().any(|(sink, _)| matches!(sink, Sink::Imported));
        let barrier = direct.then(|| host_read_barrier(&self.gpu));
        self.gpu.queue.submit([encoder.finish()].into_iter().chain(barrier));
        self.gpu.wait()?;
        self.readback.finish(&self.gpu, frames)
    }
}
