//! Rendering views for the first time, beside MiniWorld and ViZDoom, and the cost of a view that is already resident,
//! beside a memcpy of a frame.
//!
//! Ours renders every view of the unchanged warehouse once, with the renderers of a run ([`open_renderers`]) into plain
//! memory, as the baselines render into arrays; hashing and publishing are not measured. A baseline runs with one
//! process and with one per core, and the better figure counts. Work done once for the first view is not timed on
//! either side.

use std::hint::black_box;
use std::panic::resume_unwind;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use domain::Pose;
use orchestrator::machine::floors::frame_copy_ns;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use shm_types::attach::{DEFAULT_WINDOW, FrameSize, PAGE_BYTES};
use sim_proc::render_workers::open_renderers;
use sim_proc::renderer::{Destination, RenderJob, RenderSettings, Renderer, Samples, ViewSpec};
use sim_proc::view_cache::{FrameKey, ViewCache};
use sim_proc::view_control::every_pose;
use sim_proc::worlds::WorldParts;
use warehouse::{Variant, Warehouse};

use crate::Bench;
use crate::baselines::Baseline;
use crate::figure::{Better, FigureBound, Measurement, MeasurementSummary};
use crate::processes;
use crate::search::threads;
use crate::session::BenchSession;

/// The bench.
pub const BENCH: Bench = Bench {
    name: "render",
    about: "views rendered for the first time, beside MiniWorld and ViZDoom; resident views, beside a memcpy of a frame",
    run,
};

/// Views in a renderer's batch.
const VIEWS_AT_ONCE: usize = 8;

/// Lanes of the resident-view figure.
const LANES: usize = 64;

static UNCHANGED: Variant = Variant::UNCHANGED;

/// A figure of cold rendering and its baseline.
struct Cold {
    id: &'static str,
    what: &'static str,
    samples: Samples,
    target: (f64, &'static str),
    baseline: &'static str,
    script: &'static str,
    /// Width and height of the baseline's images.
    size_px: (u32, u32),
    /// Images per round of each baseline process.
    views: u32,
}

const COLD: [Cold; 2] = [
    Cold {
        id: "render.1-sample",
        what: "views rendered for the first time, without anti-aliasing",
        samples: Samples::One,
        target: (1.0, "faster than ViZDoom"),
        baseline: "ViZDoom",
        script: "render_vizdoom.py",
        // Its size that is nearest to ours: 2 % fewer pixels.
        size_px: (512, 384),
        views: 2000,
    },
    Cold {
        id: "render.4-samples",
        what: "views rendered for the first time, with 4x MSAA",
        samples: Samples::Four,
        target: (10.0, "ten times MiniWorld"),
        baseline: "MiniWorld",
        script: "render_miniworld.py",
        size_px: (FrameSize::DEFAULT.width, FrameSize::DEFAULT.height),
        views: 300,
    },
];

fn run(session: &mut BenchSession<'_>) -> Result<Vec<Measurement>> {
    let mut figures = Vec::new();
    for cold in &COLD {
        figures.push(measured(session, cold)?);
    }
    figures.push(repeated(session)?);
    Ok(figures)
}

fn measured(session: &BenchSession<'_>, cold: &Cold) -> Result<Measurement> {
    let mut rival = match session.python {
        Some(python) => Some(Rival::start(session, python, cold)?),
        None => None,
    };
    let mut drawn = Vec::new();
    for round in 1..=session.rounds() {
        session.say(format_args!("{}, round {round}", cold.id));
        drawn.push(ours(session, cold.samples)?);
        if let Some(rival) = &mut rival {
            rival.measure(cold.views)?;
        }
    }
    let Drawn { backend, renderers, views, .. } = drawn.first().context("no round")?;
    let rates: Vec<f64> = drawn.iter().map(|drawn| drawn.views_per_second).collect();
    let FrameSize { width, height } = FrameSize::DEFAULT;
    let figure = Measurement::new(cold.id, cold.what, "views/s", Better::Higher)
        .ours(rates)
        .target(FigureBound::Ratio(cold.target.0), cold.target.1)
        .parameter("size", format_args!("{width} x {height}"))
        .parameter("views", views)
        .parameter("backend", backend)
        .parameter("renderers", renderers);
    Ok(match rival {
        Some(rival) => rival.beside(figure, cold),
        None => figure,
    })
}

/// One baseline process per core, with rates per round.
struct Rival {
    processes: Vec<Baseline>,
    /// What they reported about themselves.
    said: Value,
    alone: Vec<f64>,
    together: Vec<f64>,
}

impl Rival {
    fn start(session: &BenchSession<'_>, python: &Path, cold: &Cold) -> Result<Self> {
        let (mut processes, mut said) = (Vec::new(), Value::Null);
        let (width, height) = cold.size_px;
        for number in 1..=threads() {
            let logs = session.scratch().join(format!("{}-{number}", cold.baseline));
            std::fs::create_dir(&logs)
                .with_context(|| format!("cannot make {}", logs.display()))?;
            let mut baseline = Baseline::start(python, cold.script, &logs)?;
            said = baseline.ask(&json!({"do": "start", "width": width, "height": height}))?;
            processes.push(baseline);
        }
        Ok(Self { processes, said, alone: Vec::new(), together: Vec::new() })
    }

    fn measure(&mut self, views: u32) -> Result<()> {
        self.alone.push(rate(&mut self.processes[..1], views)?);
        self.together.push(rate(&mut self.processes, views)?);
        Ok(())
    }

    /// The figure with the best rate of this baseline.
    fn beside(self, figure: Measurement, cold: &Cold) -> Measurement {
        let median = |rates: &[f64]| MeasurementSummary::of(rates).map(|summary| summary.median);
        let (processes, rates) = if median(&self.alone) >= median(&self.together) {
            (1, self.alone)
        } else {
            (self.processes.len(), self.together)
        };
        let (width, height) = cold.size_px;
        let figure = figure
            .baseline(cold.baseline, self.said["version"].as_str().unwrap_or_default(), rates)
            .parameter("baseline's size", format_args!("{width} x {height}"))
            .parameter("baseline's processes", processes);
        let told = [
            ("renderer", self.said["renderer"].as_str().map(str::to_owned)),
            ("samples", self.said["samples"].as_u64().map(|count| count.to_string())),
        ];
        let told = told.into_iter().filter_map(|(name, value)| Some((name, value?)));
        told.fold(figure, |figure, (name, value)| {
            figure.parameter(format!("baseline's {name}"), value)
        })
    }
}

/// Images per second of these processes together, each rendering `count`.
fn rate(processes: &mut [Baseline], views: u32) -> Result<f64> {
    let request = json!({"do": "time", "views": views});
    let began = Instant::now();
    let drawn: f64 = thread::scope(|scope| {
        let asked: Vec<_> = processes
            .iter_mut()
            .map(|baseline| scope.spawn(|| baseline.ask_number(&request, "views")))
            .collect();
        let answers =
            asked.into_iter().map(|asked| asked.join().unwrap_or_else(|p| resume_unwind(p)));
        answers.sum::<Result<f64>>()
    })?;
    Ok(drawn / began.elapsed().as_secs_f64())
}

/// Result of the render process.
#[derive(Serialize, Deserialize)]
pub(crate) struct Drawn {
    pub(crate) views_per_second: f64,
    views: usize,
    renderers: usize,
    backend: String,
}

/// Measures ours in a new process without any resident view.
pub(crate) fn ours(session: &BenchSession<'_>, samples: Samples) -> Result<Drawn> {
    let arguments = [
        samples.count().to_string(),
        session.size.pick(8, usize::MAX).to_string(),
        session.hardware.backend.to_string(),
    ];
    let printed = processes::output_of(session, "render", &arguments, &[])?;
    serde_json::from_str(&printed)
        .with_context(|| format!("the helper process render printed {printed:?}"))
}

/// A renderer and the memory it renders into, which must outlive it.
struct BenchRenderer {
    renderer: Renderer,
    memory: Vec<u8>,
}

impl BenchRenderer {
    fn new(renderer: Renderer) -> Self {
        let slot = renderer.frame_bytes().next_multiple_of(PAGE_BYTES);
        Self { renderer, memory: vec![0; slot * VIEWS_AT_ONCE + PAGE_BYTES] }
    }

    fn draw(&mut self, poses: &[Pose]) -> Result<()> {
        let slot = self.renderer.frame_bytes().next_multiple_of(PAGE_BYTES);
        let first = self.memory.as_ptr().align_offset(PAGE_BYTES);
        let slots = self.memory[first..].chunks_exact_mut(slot);
        let job = |(&pose, slot)| RenderJob {
            view: ViewSpec { pose, variant: &UNCHANGED, stock: 0 },
            destination: Destination::Slot(slot),
        };
        let mut jobs: Vec<RenderJob<'_>> = poses.iter().zip(slots).map(job).collect();
        self.renderer.render(&mut jobs)
    }
}

/// The helper process of [`ours`]: renders views and prints the rate.
pub(crate) fn render_process(arguments: &[String]) -> Result<()> {
    let [samples, most, backend] = arguments else {
        bail!("expected the number of samples, the number of views and the backend")
    };
    let samples = if samples == "1" { Samples::One } else { Samples::Four };
    let warehouse = Warehouse::shipped();
    let backend = Some(backend.parse().map_err(anyhow::Error::msg)?);
    let settings = RenderSettings { samples, backend, ..RenderSettings::default() };
    let renderers = open_renderers(std::slice::from_ref(&warehouse), settings)?;
    let mut workers: Vec<BenchRenderer> = renderers.into_iter().map(BenchRenderer::new).collect();
    let poses: Vec<Pose> = every_pose(&warehouse.layout).collect();
    let (first, rest) = poses.split_at(workers.len());
    let rest = &rest[..rest.len().min(most.parse()?)];
    for (worker, pose) in workers.iter_mut().zip(first.chunks(1)) {
        worker.draw(pose)?;
    }
    let batches = Mutex::new(rest.chunks(VIEWS_AT_ONCE));
    let next = || batches.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = |worker: &mut BenchRenderer| -> Result<()> {
        while let Some(poses) = next() {
            worker.draw(poses)?;
        }
        Ok(())
    };
    let began = Instant::now();
    thread::scope(|scope| {
        let drawing: Vec<_> =
            workers.iter_mut().map(|worker| scope.spawn(|| work(worker))).collect();
        drawing.into_iter().try_for_each(|drawn| drawn.join().unwrap_or_else(|p| resume_unwind(p)))
    })?;
    let report = workers[0].renderer.report();
    let drawn = Drawn {
        views_per_second: rest.len() as f64 / began.elapsed().as_secs_f64(),
        views: rest.len(),
        renderers: workers.len(),
        backend: report.adapter.unwrap_or_else(|| report.backend.to_string()),
    };
    println!("{}", serde_json::to_string(&drawn)?);
    Ok(())
}

/// A step to a resident view: the simulator's bookkeeping alone.
fn repeated(session: &mut BenchSession<'_>) -> Result<Measurement> {
    let layout = Warehouse::shipped().layout;
    let keys: Vec<FrameKey> = every_pose(&layout)
        .map(|pose| FrameKey::WorldParts { world: WorldParts::UNCHANGED, pose })
        .collect();
    let mut views = ViewCache::new(keys.len(), LANES, DEFAULT_WINDOW as usize);
    for (frame, &view) in (1..).zip(&keys) {
        views.pin_for_memory(view);
        views.start_rendering(view);
        views.insert(view, frame);
        views.release(frame)?;
    }
    let (steps, copies) = (session.size.pick(1000, 2_000_000), session.size.pick(3, 500));
    let (ours, copy) = session
        .in_turns(|_| look_up_ns(&mut views, &keys, steps), |_| Ok(frame_copy_ns(copies)))?;
    ensure!(views.missing() == 0, "a resident view was to be rendered");
    let what = "a step to a resident view: noted as shown, looked up, room checked";
    Ok(Measurement::new("render.repeated", what, "ns", Better::Lower)
        .ours(ours)
        .baseline("a memcpy of the frame", "", copy)
        .target(FigureBound::Ratio(1.0), "no work on pixels")
        .parameter("lanes", LANES)
        .parameter("views", keys.len())
        .note("only the bookkeeping of views; pixels are not touched"))
}

/// Mean duration of a step in nanoseconds: lanes take turns, each step far from the last view.
fn look_up_ns(views: &mut ViewCache, keys: &[FrameKey], steps: usize) -> Result<f64> {
    /// A prime, so that every view is visited.
    const STRIDE: usize = 367;
    let began = Instant::now();
    for step in 0..steps {
        let view = keys[step * STRIDE % keys.len()];
        views.show(step % LANES, view);
        ensure!(views.make_room()?.is_empty(), "a view was evicted");
        black_box(views.frame(view).context("a view is not resident")?);
    }
    Ok(began.elapsed().as_nanos() as f64 / steps as f64)
}
