//! Renderers as render workers: one per core with the CPU backend, one in all with a Vulkan device.

use std::thread;

use anyhow::Result;
use warehouse::Warehouse;

use crate::render_pool::{RenderSetup, RenderTask, RenderWorker};
use crate::renderer::{Backend, Destination, RenderJob, RenderSettings, Renderer, ViewSpec};

/// Maximum number of renderers on the CPU.
const MAX_RENDERERS: usize = 8;

/// Maximum number of views that a Vulkan device renders together.
const GPU_BATCH_VIEWS: usize = 8;

impl RenderWorker for Renderer {
    fn render_into(&mut self, tasks: &mut [RenderTask<'_>]) -> Result<u64> {
        let before = self.report().bytes_copied;
        let mut jobs: Vec<RenderJob<'_>> = tasks
            .iter_mut()
            .map(|task| RenderJob {
                view: ViewSpec { pose: task.pose, variant: task.variant, stock: task.stock },
                destination: Destination::Slot(bytemuck::cast_slice_mut(task.slot.pages_mut())),
            })
            .collect();
        self.render(&mut jobs)?;
        Ok(self.report().bytes_copied - before)
    }
}

/// Opens renderers that work at the same time: one per core, up to eight, with the CPU backend; otherwise one.
///
/// # Errors
/// As [`Renderer::with_stocks`].
pub fn open_renderers(stocks: &[Warehouse], settings: RenderSettings) -> Result<Vec<Renderer>> {
    let mut renderers = vec![Renderer::with_stocks(stocks, settings)?];
    if renderers[0].report().backend == Backend::Cpu {
        let cores = thread::available_parallelism().map_or(1, usize::from);
        for _ in 1..cores.min(MAX_RENDERERS) {
            renderers.push(renderers[0].try_clone()?);
        }
    }
    Ok(renderers)
}

impl RenderSetup {
    /// Opens the renderers of a simulator for all stocks of its worlds.
    ///
    /// # Errors
    /// As [`Renderer::with_stocks`].
    pub fn open(stocks: &[Warehouse], settings: RenderSettings) -> Result<Self> {
        let renderers = open_renderers(stocks, settings)?;
        let report = renderers[0].report();
        let mut facts = vec![
            ("backend", report.backend.to_string()),
            ("frame path", report.frame_path.to_string()),
            ("renderers", renderers.len().to_string()),
        ];
        facts.extend(report.adapter.map(|adapter| ("adapter", adapter)));
        if stocks.len() > 1 {
            let mebibytes = renderers[0].scene_bytes() as f64 / f64::from(1 << 20);
            facts.push(("scene", format!("{} stocks, {mebibytes:.1} MiB", stocks.len())));
        }
        let mut visibility = renderers[0].visibility();
        let worker = |renderer| Box::new(renderer) as Box<dyn RenderWorker>;
        Ok(Self {
            workers: renderers.into_iter().map(worker).collect(),
            batch_views: if report.backend == Backend::Cpu { 1 } else { GPU_BATCH_VIEWS },
            find_changes: Box::new(move |view| visibility.changes(view)),
            facts,
        })
    }
}
