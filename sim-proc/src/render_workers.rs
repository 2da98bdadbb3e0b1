//! Renderers as render workers: one per core with the CPU backend, two with a Vulkan device.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::thread;

use anyhow::Result;
use domain::Mismatch;
use peer::world::{RenderSetup, RenderTask, RenderWorker, Renderers, WorldFailure};
use warehouse::Warehouse;

use crate::renderer::{
    Backend, Destination, RenderJob, RenderSettings, Renderer, SceneVisibility, ViewSpec,
    VisibleChanges,
};
use crate::view_folder::{KeepingWorker, ViewFolder};
use crate::world::{WarehousePicture, WarehouseRendering};
use crate::worlds::Worlds;

/// Maximum number of renderers on the CPU.
const MAX_RENDERERS: usize = 8;

/// Renderers on a Vulkan device: while one waits for the device, the other prepares its next views.
const GPU_RENDERERS: usize = 2;

/// Maximum number of views that a Vulkan device renders together.
const GPU_BATCH_VIEWS: usize = 8;

/// The renderers of a worker: each hall is a scene of its own.
struct HallRenderers {
    tested: Renderer,
    /// Of the hall in which tasks are only demonstrated. Its stock has the number after those of the hall that is tested.
    elsewhere: Option<Renderer>,
    /// Of the hall that is tested, as episodes with a mismatch see it.
    looks: BTreeMap<Mismatch, Renderer>,
    /// Number of stocks of the hall that is tested.
    stocks: u32,
}

impl RenderWorker<WarehousePicture> for HallRenderers {
    fn render_into(
        &mut self,
        tasks: &mut [RenderTask<'_, WarehousePicture>],
    ) -> Result<u64, WorldFailure> {
        let (mut here, mut there) = (Vec::new(), Vec::new());
        let mut otherwise: BTreeMap<Mismatch, Vec<RenderJob<'_>>> = BTreeMap::new();
        for RenderTask { picture, slot, .. } in tasks {
            let WarehousePicture { stock, look, variant, pose } = picture;
            let is_here = *stock < self.stocks;
            let stock = if is_here { *stock } else { 0 };
            let job = RenderJob {
                view: ViewSpec { pose: *pose, variant, stock },
                destination: Destination::Slot(bytemuck::cast_slice_mut(slot.pages_mut())),
            };
            match (is_here, *look) {
                (false, _) => there.push(job),
                (true, Mismatch::None) => here.push(job),
                (true, look) => otherwise.entry(look).or_default().push(job),
            }
        }
        let mut copied = rendered(&mut self.tested, &mut here)?;
        if let Some(elsewhere) = &mut self.elsewhere {
            copied += rendered(elsewhere, &mut there)?;
        }
        for (look, mut jobs) in otherwise {
            let renderer = self.looks.get_mut(&look);
            let renderer = renderer.ok_or_else(|| format!("there is no renderer for {look}"))?;
            copied += rendered(renderer, &mut jobs)?;
        }
        Ok(copied)
    }
}

/// Renders all `jobs`; returns how many bytes the program itself has copied.
fn rendered(renderer: &mut Renderer, jobs: &mut [RenderJob<'_>]) -> Result<u64> {
    let before = renderer.report().bytes_copied;
    renderer.render(jobs)?;
    Ok(renderer.report().bytes_copied - before)
}

/// Opens renderers that work at the same time: one per core, up to eight, with the CPU backend; otherwise two.
///
/// # Errors
/// As [`Renderer::with_stocks`].
pub fn open_renderers(stocks: &[Warehouse], settings: RenderSettings) -> Result<Vec<Renderer>> {
    let mut renderers = vec![Renderer::with_stocks(stocks, settings)?];
    let count = match renderers[0].report().backend {
        Backend::Cpu => thread::available_parallelism().map_or(1, usize::from).min(MAX_RENDERERS),
        Backend::Wgpu => GPU_RENDERERS,
    };
    for _ in 1..count {
        renderers.push(renderers[0].try_clone()?);
    }
    Ok(renderers)
}

impl WarehouseRendering {
    /// Opens the renderers of a simulator for all `worlds`. With the CPU backend they share their views with other processes
    /// through the folder `views`, if there is one.
    ///
    /// # Errors
    /// As [`Renderer::with_stocks`]; also when the folder cannot be used.
    pub fn open(worlds: &Worlds, settings: RenderSettings, views: Option<&Path>) -> Result<Self> {
        let (stocks, other) = worlds.halls();
        let renderers = open_renderers(stocks, settings.clone())?;
        let report = renderers[0].report();
        let views = views.filter(|_| report.backend == Backend::Cpu);
        let views = views.map(|root| ViewFolder::open(root, worlds, &settings)).transpose()?;
        let views = views.map(Arc::new);
        let mut facts = vec![
            ("backend", report.backend.to_string()),
            ("frame path", report.frame_path.to_string()),
            ("renderers", renderers.len().to_string()),
        ];
        facts.extend(report.adapter.map(|adapter| ("adapter", adapter)));
        let mebibytes = |renderer: &Renderer| renderer.scene_bytes() as f64 / f64::from(1 << 20);
        if stocks.len() > 1 {
            let scene = mebibytes(&renderers[0]);
            facts.push(("scene", format!("{} stocks, {scene:.1} MiB", stocks.len())));
        }
        let of_look = |look: Mismatch| {
            Renderer::new(&stocks[0], settings.with_mismatch(look)).map(|renderer| (look, renderer))
        };
        let looks: BTreeMap<Mismatch, Renderer> =
            worlds.looks().map(of_look).collect::<Result<_>>()?;
        for (look, renderer) in &looks {
            facts.push((look.name(), format!("{:.1} MiB", mebibytes(renderer))));
        }
        let mut elsewhere = Vec::new();
        if let Some(other) = other {
            elsewhere.push(Renderer::new(other, settings)?);
            for _ in 1..renderers.len() {
                elsewhere.push(elsewhere[0].try_clone()?);
            }
            facts.push(("other warehouse", format!("{:.1} MiB", mebibytes(&elsewhere[0]))));
        }
        let mut visibility: BTreeMap<Mismatch, SceneVisibility> =
            looks.iter().map(|(look, renderer)| (*look, renderer.visibility())).collect();
        visibility.insert(Mismatch::None, renderers[0].visibility());
        let stocks = stocks.len() as u32;
        let mut elsewhere = elsewhere.into_iter();
        let worker = |(number, tested)| -> Result<Box<dyn RenderWorker<WarehousePicture> + Send>> {
            let clones = looks.iter().map(|(look, renderer)| Ok((*look, renderer.try_clone()?)));
            let looks = clones.collect::<Result<_>>()?;
            let elsewhere = elsewhere.next();
            let renderers = Box::new(HallRenderers { tested, elsewhere, looks, stocks });
            Ok(match &views {
                None => renderers,
                Some(views) => Box::new(KeepingWorker::new(renderers, views.clone(), number)),
            })
        };
        let batch = if report.backend == Backend::Cpu { 1 } else { GPU_BATCH_VIEWS };
        let workers = renderers.into_iter().enumerate().map(worker).collect::<Result<_>>()?;
        let setup = RenderSetup { renderers: Renderers::Threads { workers, batch }, facts };
        Ok(Self {
            setup,
            find_changes: Box::new(move |look, view| match visibility.get_mut(&look) {
                Some(visibility) if view.stock < stocks => visibility.changes(view),
                Some(_) | None => VisibleChanges { stock: true, barricades: false },
            }),
        })
    }
}
