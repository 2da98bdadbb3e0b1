//! Lanes of the Gymnasium environment: the dynamics and the CPU renderer in this process.
//!
//! Each lane has a slot for its view, and the slots are one array, which numpy reads through `__array_interface__`
//! without a copy. Nothing that leaves this module says where targets are or how far an episode has got, but whether it
//! has succeeded.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::thread;

use domain::{Action, Appearance, Feedback, Pose};
use pyo3::exceptions::{PyIndexError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sim_proc::renderer::{
    Backend, Destination, RenderJob, RenderSettings, Renderer, Samples, ViewSpec,
};
use warehouse::{CaseSet, Progress, TrajectoryKind, Variant, Warehouse, step};

/// Maximum number of renderers, as in the simulator.
const MAX_RENDERERS: usize = 8;

/// Episodes in one world, one in each lane.
#[pyclass(module = "memtransfer._native")]
pub(crate) struct Lanes {
    warehouse: Warehouse,
    cases: CaseSet,
    lanes: Vec<Option<EnvironmentEpisode>>,
    renderers: Vec<LaneRenderer>,
    /// The views of all lanes, RGB. Never reallocated, because arrays show it.
    views: Box<[u8]>,
    /// Height and width of a view, in pixels.
    size: (usize, usize),
}

/// The episode of a lane.
struct EnvironmentEpisode {
    variant: Variant,
    pose: Pose,
    progress: Progress,
    /// Whether the lane's slot holds the view from `pose`.
    is_drawn: bool,
}

/// A renderer and the memory that it renders into, RGBA.
struct LaneRenderer {
    renderer: Renderer,
    pixels: Vec<u8>,
}

impl LaneRenderer {
    /// Draws what the agent of `episode` sees into `view`, RGB.
    fn draw(&mut self, episode: &mut EnvironmentEpisode, view: &mut [u8]) -> anyhow::Result<()> {
        let EnvironmentEpisode { variant, pose, .. } = &*episode;
        let view_spec = ViewSpec { pose: *pose, variant, stock: 0 };
        let destination = Destination::Memory(&mut self.pixels);
        self.renderer.render(&mut [RenderJob { view: view_spec, destination }])?;
        let (from, to) = (self.pixels.as_chunks::<4>().0, view.as_chunks_mut::<3>().0);
        for (to, &[r, g, b, _]) in to.iter_mut().zip(from) {
            *to = [r, g, b];
        }
        episode.is_drawn = true;
        Ok(())
    }
}

/// Column, row and heading of a pose.
type PoseTuple = (u8, u8, u8);

fn place(pose: Pose) -> PoseTuple {
    (pose.cell.x, pose.cell.y, pose.heading as u8)
}

fn invalid(problem: impl ToString) -> PyErr {
    PyValueError::new_err(problem.to_string())
}

#[pymethods]
impl Lanes {
    /// `lanes` idle lanes in the world of the folder `assets`, or in the shipped one.
    #[new]
    fn new(
        py: Python<'_>,
        lanes: usize,
        size_px: (u32, u32),
        appearance: (bool, bool, u64),
        anti_aliasing: bool,
        assets: Option<PathBuf>,
    ) -> PyResult<Self> {
        let ((width_px, height_px), (plates, labels, seed)) = (size_px, appearance);
        let (warehouse, cases) = CaseSet::with_warehouse(assets.as_deref()).map_err(invalid)?;
        let settings = RenderSettings {
            width_px,
            height_px,
            samples: if anti_aliasing { Samples::Four } else { Samples::One },
            appearance: Appearance { plates, labels, seed },
            backend: Some(Backend::Cpu),
            ..RenderSettings::default()
        };
        let cores = thread::available_parallelism().map_or(1, usize::from);
        let count = lanes.min(cores).clamp(1, MAX_RENDERERS);
        let open = || -> anyhow::Result<Vec<Renderer>> {
            let mut renderers = vec![Renderer::new(&warehouse, settings)?];
            for _ in 1..count {
                renderers.push(renderers[0].try_clone()?);
            }
            Ok(renderers)
        };
        let opened = py.detach(open).map_err(|error| invalid(format!("{error:#}")))?;
        let with_buffer = |renderer: Renderer| {
            let pixels = vec![0; renderer.frame_bytes()];
            LaneRenderer { renderer, pixels }
        };
        let size = (height_px as usize, width_px as usize);
        Ok(Self {
            renderers: opened.into_iter().map(with_buffer).collect(),
            views: vec![0; lanes * size.0 * size.1 * 3].into(),
            lanes: std::iter::repeat_with(|| None).take(lanes).collect(),
            warehouse,
            cases,
            size,
        })
    }

    /// The ids of the cases, in order.
    #[getter]
    fn cases(&self) -> Vec<&str> {
        self.cases.cases.iter().map(|case| case.id.as_str()).collect()
    }

    /// The length of the longest instruction.
    #[getter]
    fn longest_instruction(&self) -> usize {
        let instructions = self.cases.cases.iter();
        let lengths =
            instructions.map(|case| case.task.instruction(&self.warehouse.catalogue).len());
        lengths.max().unwrap_or_default()
    }

    /// Version 3 of numpy's array interface: the views, as (lanes, height, width, 3), read-only.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("shape", (self.lanes.len(), self.size.0, self.size.1, 3))?;
        interface.set_item("typestr", "|u1")?;
        interface.set_item("data", (self.views.as_ptr() as usize, true))?;
        Ok(interface)
    }

    /// Begins an episode where the reference `reference` of case `case` starts. Returns the instruction, the pose, and the length of the
    /// reference: the steps in which the expert completes the task.
    fn begin(
        &mut self,
        lane: usize,
        case: &str,
        reference: &str,
    ) -> PyResult<(String, PoseTuple, u32)> {
        let Self { warehouse, cases, lanes, .. } = self;
        let case = cases.case(case).ok_or_else(|| invalid("there is no such case"))?;
        let reference = TrajectoryKind::ALL.into_iter().find(|kind| kind.name() == reference);
        let reference = reference.ok_or_else(|| invalid("there is no such reference"))?;
        let length = case.replay(warehouse, reference).length;
        let length = length.ok_or_else(|| invalid("the reference does not complete the task"))?;
        let pose = case.trajectory(reference).start;
        let episode = EnvironmentEpisode {
            variant: case.variant(reference),
            pose,
            progress: Progress::new(warehouse, &case.task, pose.cell),
            is_drawn: false,
        };
        let instruction = case.task.instruction(&warehouse.catalogue);
        *lanes.get_mut(lane).ok_or_else(|| no_lane(lane))? = Some(episode);
        Ok((instruction, place(pose), length))
    }

    /// Executes an action. Returns the pose, the feedback and whether the task is complete.
    fn act(&mut self, lane: usize, action: u8) -> PyResult<(PoseTuple, u8, bool)> {
        let action = Action::try_from(action).map_err(invalid)?;
        let episode = self.lanes.get_mut(lane).and_then(Option::as_mut);
        let episode = episode.ok_or_else(|| no_lane(lane))?;
        let (pose, feedback) = step(&self.warehouse.layout, &episode.variant, episode.pose, action);
        episode.is_drawn &= feedback == Feedback::Blocked;
        episode.pose = pose;
        episode.progress.visit(pose.cell);
        Ok((place(pose), feedback as u8, episode.progress.is_complete()))
    }

    /// Draws the views that have changed.
    fn draw(&mut self, py: Python<'_>) -> PyResult<()> {
        let Self { lanes, renderers, views, size, .. } = self;
        let slots = lanes.iter_mut().zip(views.chunks_exact_mut(size.0 * size.1 * 3));
        let stale: Vec<_> = slots
            .filter_map(|(lane, view)| Some((lane.as_mut().filter(|it| !it.is_drawn)?, view)))
            .collect();
        let drawn = py.detach(|| draw_all(renderers, stale));
        drawn.map_err(|error| PyRuntimeError::new_err(format!("{error:#}")))
    }
}

fn no_lane(lane: usize) -> PyErr {
    PyIndexError::new_err(format!("lane {lane} has no episode"))
}

/// Shares the views among the renderers, each on a thread of its own.
fn draw_all(
    renderers: &mut [LaneRenderer],
    stale: Vec<(&mut EnvironmentEpisode, &mut [u8])>,
) -> anyhow::Result<()> {
    if let ([renderer, ..], 1) | ([renderer], _) = (&mut *renderers, stale.len()) {
        return stale.into_iter().try_for_each(|(episode, view)| renderer.draw(episode, view));
    }
    let count = stale.len();
    let queue = Mutex::new(stale.into_iter());
    let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = |renderer: &mut LaneRenderer| {
        while let Some((episode, view)) = next() {
            renderer.draw(episode, view)?;
        }
        anyhow::Ok(())
    };
    thread::scope(|scope| {
        let renderers = renderers.iter_mut().take(count);
        let start = |renderer| thread::Builder::new().spawn_scoped(scope, move || work(renderer));
        let threads = renderers.map(start).collect::<std::io::Result<Vec<_>>>()?;
        threads.into_iter().try_for_each(|thread| match thread.join() {
            Ok(drawn) => drawn,
            Err(panic) => std::panic::resume_unwind(panic),
        })
    })
}
