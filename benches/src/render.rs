//! Rendering views for the first time, beside MiniWorld and ViZDoom.
//!
//! Ours renders every view of the unchanged warehouse once, with the renderers of a run ([`open_renderers`]) into plain
//! memory, as the baselines render into arrays; hashing and publishing are not measured. A baseline runs with one
//! process and with one per core, and the better figure counts. Work done once for the first view is not timed on
//! either side.

use std::panic::resume_unwind;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use domain::Pose;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use shm_types::attach::{FrameSize, PAGE_BYTES};
use sim_proc::render_workers::open_renderers;
use sim_proc::renderer::{Destination, RenderJob, RenderSettings, Renderer, Samples, ViewSpec};
use warehouse::every_pose;
use warehouse::{Variant, Warehouse};

use crate::results::median;
use crate::session::threads;
use crate::{Baseline, Bench, BenchSession, Measurement, Target, processes};

/// The bench.
pub const BENCH: Bench = Bench {
    name: "render",
    about: "views rendered for the first time, beside ViZDoom and MiniWorld",
    run,
};

/// Views in a renderer's batch.
const VIEWS_AT_ONCE: usize = 8;

static UNCHANGED: Variant = Variant::UNCHANGED;

/// A measurement of ours and its baseline.
struct Comparison {
    id: &'static str,
    description: &'static str,
    samples: Samples,
    /// Least ratio to the baseline.
    target: f64,
    baseline: &'static str,
    script: &'static str,
    /// Width and height of the baseline's images.
    size_px: (u32, u32),
    /// Images of each baseline process in a round.
    views: u32,
}

const COMPARISONS: [Comparison; 2] = [
    Comparison {
        id: "render.1-sample",
        description: "views, not anti-aliased",
        samples: Samples::One,
        target: 1.0,
        baseline: "ViZDoom",
        script: "render_vizdoom.py",
        // Its size that is nearest to ours: 2 % fewer pixels.
        size_px: (512, 384),
        views: 2000,
    },
    Comparison {
        id: "render.4-samples",
        description: "views, 4x MSAA",
        samples: Samples::Four,
        target: 10.0,
        baseline: "MiniWorld",
        script: "render_miniworld.py",
        size_px: (FrameSize::DEFAULT.width, FrameSize::DEFAULT.height),
        views: 300,
    },
];

fn run(session: &BenchSession<'_>) -> Result<Vec<Measurement>> {
    COMPARISONS.iter().map(|comparison| compare(session, comparison)).collect()
}

fn compare(session: &BenchSession<'_>, comparison: &Comparison) -> Result<Measurement> {
    let mut baseline = match session.python {
        Some(python) => Some(BaselineProcesses::start(session, python, comparison)?),
        None => None,
    };
    let mut rounds = Vec::new();
    for round in 1..=session.rounds {
        session.progress(format_args!("{}, round {round}", comparison.id));
        rounds.push(ours(session, comparison.samples)?);
        if let Some(baseline) = &mut baseline {
            baseline.measure(comparison.views)?;
        }
    }
    let rates = rounds.iter().map(|round| round.views_per_second).collect();
    let Drawn { backend, renderers, views, .. } = rounds.first().context("no round")?;
    let measurement = Measurement::new(comparison.id, comparison.description, "views/s", rates)
        .target(Target::RatioAtLeast(comparison.target))
        .parameter("views", views)
        .parameter("backend", backend)
        .parameter("renderers", renderers);
    Ok(match baseline {
        Some(baseline) => baseline.beside(measurement, comparison),
        None => measurement,
    })
}

/// One baseline process per core, with rates per round.
struct BaselineProcesses {
    processes: Vec<Baseline>,
    /// What they reported about themselves.
    facts: Value,
    /// Rates of one process.
    alone: Vec<f64>,
    /// Rates of all processes.
    together: Vec<f64>,
}

impl BaselineProcesses {
    fn start(session: &BenchSession<'_>, python: &Path, comparison: &Comparison) -> Result<Self> {
        let (mut processes, mut facts) = (Vec::new(), Value::Null);
        let (width, height) = comparison.size_px;
        for number in 1..=threads() {
            let logs = session.scratch().join(format!("{}-{number}", comparison.baseline));
            std::fs::create_dir(&logs)
                .with_context(|| format!("cannot make {}", logs.display()))?;
            let mut baseline = Baseline::start(python, comparison.script, &logs)?;
            facts = baseline.ask(&json!({"do": "start", "width": width, "height": height}))?;
            processes.push(baseline);
        }
        Ok(Self { processes, facts, alone: Vec::new(), together: Vec::new() })
    }

    fn measure(&mut self, views: u32) -> Result<()> {
        self.alone.push(rate(&mut self.processes[..1], views)?);
        self.together.push(rate(&mut self.processes, views)?);
        Ok(())
    }

    /// The measurement with the better rate of this baseline.
    fn beside(self, measurement: Measurement, comparison: &Comparison) -> Measurement {
        let (processes, rates) = if median(&self.alone) >= median(&self.together) {
            (1, self.alone)
        } else {
            (self.processes.len(), self.together)
        };
        let version = self.facts["version"].as_str().unwrap_or_default();
        measurement
            .beside(format!("{} {version}", comparison.baseline), rates)
            .parameter("baseline's processes", processes)
            .parameter("baseline", self.facts)
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
struct Drawn {
    views_per_second: f64,
    views: usize,
    renderers: usize,
    backend: String,
}

/// Measures ours in a new process without any resident view.
fn ours(session: &BenchSession<'_>, samples: Samples) -> Result<Drawn> {
    let arguments = [
        samples.count().to_string(),
        session.size.pick(8, usize::MAX).to_string(),
        session.hardware.backend.to_string(),
    ];
    let printed = processes::output_of(session, "render", &arguments)?;
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
