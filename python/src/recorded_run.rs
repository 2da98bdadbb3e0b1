//! The trajectories of a run and of the demonstrations behind it, and the views of their poses.

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::Context;
use domain::{Action, Cell, Feedback, Heading, Pose};
use pyo3::exceptions::{PyFileNotFoundError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use replay::{RecordedRun as Recorded, RunWorld};
use results::log::{EpisodeRecord, LogError, RunLog};
use results::score::Failure;
use serde::Serialize;
use sim_proc::renderer::{Backend, RenderSettings};
use sim_proc::view_source::ViewSource;
use sim_proc::worlds::Worlds;
use warehouse::{Demonstrated, History, Task, Warehouse};

/// A run folder, its worlds, and a renderer once a view is asked for.
#[pyclass(module = "memtransfer._native", unsendable)]
pub(crate) struct RecordedRun {
    log: RunLog,
    world: RunWorld,
    notices: Vec<String>,
    settings: RenderSettings,
    views: Option<ViewSource>,
}

/// Column and row.
type CellData = (u8, u8);

/// Column, row and heading, clockwise from north.
type PoseData = (u8, u8, u8);

fn cell_data(cell: Cell) -> CellData {
    (cell.x, cell.y)
}

fn pose_data(pose: Pose) -> PoseData {
    (pose.cell.x, pose.cell.y, pose.heading as u8)
}

/// The fields of `memtransfer.trajectories.Trajectory`.
#[derive(Serialize)]
struct TrajectoryData<'a> {
    id: String,
    case: &'a str,
    task: u8,
    instruction: String,
    start: &'static str,
    variant: u32,
    poses: Vec<PoseData>,
    feedback: Vec<u8>,
    actions: Vec<Option<u8>>,
    sub_goals: Vec<u32>,
    required: u32,
    success: bool,
    failure: Option<(String, u32)>,
    closed: Vec<CellData>,
    targets: Vec<TargetData>,
    reference: Vec<CellData>,
    record: Option<&'a EpisodeRecord>,
}

/// Letter, name, and the cell before it.
type TargetData = (char, String, CellData);

fn targets(task: &Task, warehouse: &Warehouse) -> Vec<TargetData> {
    let named = task.targets(warehouse).into_iter().filter_map(|item| {
        let name = warehouse.catalogue.types[item.item_type].name.clone();
        Some((task.letter(warehouse, item)?, name, cell_data(item.standpoint)))
    });
    named.collect()
}

fn invalid(error: &anyhow::Error) -> PyErr {
    PyValueError::new_err(format!("{error:#}"))
}

#[pymethods]
impl RecordedRun {
    /// Reads the run in `folder`. Views have the run's size, or width and height in pixels of `size_px`.
    #[new]
    fn new(folder: PathBuf, size_px: Option<(u32, u32)>) -> PyResult<Self> {
        let read = Recorded::read(&folder).map_err(|error| match error.downcast_ref() {
            Some(LogError::NoRun(_)) => PyFileNotFoundError::new_err(error.to_string()),
            _ => invalid(&error),
        })?;
        let Recorded { log, world, notices } = read;
        let of_run = log.manifest.settings.frame_size;
        let (width_px, height_px) = size_px.unwrap_or((of_run, of_run));
        let settings = RenderSettings {
            width_px,
            height_px,
            appearance: log.manifest.settings.appearance(),
            backend: Some(Backend::Cpu),
            ..RenderSettings::default()
        };
        Ok(Self { log, world, notices, settings, views: None })
    }

    /// What the user must know about it.
    #[getter]
    fn notices(&self) -> Vec<String> {
        self.notices.clone()
    }

    /// Width and height of a view, in pixels.
    #[getter]
    fn size_px(&self) -> (u32, u32) {
        (self.settings.width_px, self.settings.height_px)
    }

    /// The manifest, as JSON.
    fn manifest(&self) -> PyResult<String> {
        json(&self.log.manifest)
    }

    /// The policy as every output names it.
    #[getter]
    fn policy_label(&self) -> String {
        self.log.manifest.policy_label().to_string()
    }

    /// The trajectories of the episodes that have a result, as JSON, in the order of the log.
    fn episodes(&self) -> PyResult<String> {
        let episodes = self.log.episodes.iter().map(|record| self.episode(record));
        let episodes = episodes.collect::<anyhow::Result<Vec<_>>>();
        json(&episodes.map_err(|error| invalid(&error))?)
    }

    /// Those of the demonstrations that the run's memories could be built from, as JSON, each once, in the order of the
    /// cases.
    fn demonstrations(&self) -> PyResult<String> {
        let RunWorld { warehouse, cases, .. } = &self.world;
        let histories: BTreeSet<History> = self
            .log
            .episodes
            .iter()
            .filter_map(|record| Some((cases.index(&record.case)?, record.demonstrations)))
            .collect::<BTreeSet<_>>()
            .into_iter()
            .flat_map(|(case, set)| cases.histories(case, set))
            .collect();
        let found = histories.into_iter().filter_map(|history| {
            let demonstrated = cases.demonstrated(warehouse, history)?;
            Some(demonstration(&cases.cases[history.case].id, history, &demonstrated))
        });
        json(&found.collect::<Vec<_>>())
    }

    /// The floor of world variant `variant`: a text for each row from row 0, the most southern, with `.` for free floor
    /// and `#` for anything else: racks, walls, and the barricades of a closed passage.
    fn floor(&self, variant: u32) -> PyResult<Vec<String>> {
        let layout = self.world.layout(variant);
        let layout = layout.ok_or_else(|| PyValueError::new_err("there is no such world"))?;
        let is_free = |x, y| self.world.is_free(variant, Cell { x, y }) == Some(true);
        let row = |y| (0..layout.width()).map(|x| if is_free(x, y) { '.' } else { '#' }).collect();
        Ok((0..layout.height()).map(row).collect())
    }

    /// The views of `poses` in world variant `variant`: their pixels, RGB, one view after the other. `seen`: what the policy was
    /// shown there, otherwise what memory was given.
    fn views<'py>(
        &mut self,
        py: Python<'py>,
        variant: u32,
        poses: Vec<[u8; 3]>,
        seen: bool,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let pixels = self.render(variant, &poses, seen).map_err(|error| invalid(&error))?;
        Ok(PyBytes::new(py, &pixels))
    }
}

impl RecordedRun {
    fn episode<'a>(&'a self, record: &'a EpisodeRecord) -> anyhow::Result<TrajectoryData<'a>> {
        let (index, case) = self.world.case(record)?;
        let state = self.world.state(record, case)?;
        let replay = record.replay();
        let reference = self.world.reference(record, index).map(|reference| {
            let replay = reference.replay(&state.warehouse, &case.task, &state.variant);
            replay.poses.into_iter().map(|pose| cell_data(pose.cell)).collect()
        });
        let failure = Failure::of(record).map(|kind| (kind.to_string(), kind.decided_at(record)));
        Ok(TrajectoryData {
            id: record.key.clone(),
            case: &record.case,
            task: record.task,
            instruction: case.task.instruction(&state.warehouse.catalogue),
            start: record.start.name(),
            variant: self.world.variant(record, index),
            poses: replay.iter().map(|(pose, _)| pose_data(*pose)).collect(),
            feedback: replay.iter().map(|(_, feedback)| *feedback as u8).collect(),
            actions: record.actions.chars().map(action_data).collect(),
            sub_goals: record.sub_goals.clone(),
            required: record.required,
            success: record.is_success(),
            failure,
            closed: state.variant.closed().iter().copied().map(cell_data).collect(),
            targets: targets(&case.task, &state.warehouse),
            reference: reference.unwrap_or_default(),
            record: Some(record),
        })
    }

    fn render(&mut self, variant: u32, poses: &[[u8; 3]], seen: bool) -> anyhow::Result<Vec<u8>> {
        let Self { world, settings, views, .. } = self;
        let views = match views {
            Some(views) => views,
            none => {
                let worlds = Worlds::new(&world.warehouse, &world.cases, world.states().to_vec());
                none.insert(ViewSource::new(worlds, settings.clone())?)
            }
        };
        let mut pixels = Vec::new();
        for &[x, y, heading] in poses {
            let heading =
                Heading::ALL.get(usize::from(heading)).context("there is no such heading")?;
            let pose = Pose::new(x, y, *heading);
            let (variant, pose) =
                if seen { world.seen(variant, pose) } else { world.supplied(variant, pose) };
            let view = views.render(variant, pose)?;
            pixels.extend(
                view.as_bytes().as_chunks::<4>().0.iter().flat_map(|&[r, g, b, _]| [r, g, b]),
            );
        }
        Ok(pixels)
    }
}

/// The number of the action with this letter, or `None` for an answer that could not be read.
fn action_data(letter: char) -> Option<u8> {
    Action::from_letter(letter).map(|action| action as u8)
}

/// A demonstration of the case `case`. It ends with the step that completes the task; the expert's turn towards the rack, after
/// it, is left out.
fn demonstration<'a>(
    case: &'a str,
    history: History,
    demonstrated: &Demonstrated<'a>,
) -> TrajectoryData<'a> {
    let Demonstrated { warehouse, variant, closed, task, ref trajectory } = *demonstrated;
    let replay = demonstrated.replay();
    let length = replay.length.map_or(trajectory.actions.len(), |length| length as usize);
    let poses: Vec<Pose> = replay.poses.into_iter().take(length + 1).collect();
    let feedback = replay.feedback.into_iter().take(length + 1);
    TrajectoryData {
        id: format!("demonstration/{}/{case}", history.kind.name()),
        case,
        task: task.task_type().number(),
        instruction: demonstrated.instruction(),
        start: history.kind.name(),
        variant,
        feedback: feedback.map(|feedback: Feedback| feedback as u8).collect(),
        actions: trajectory.actions.iter().take(length).map(|action| Some(*action as u8)).collect(),
        required: replay.goal_steps.len() as u32,
        sub_goals: replay.goal_steps,
        success: replay.length.is_some(),
        failure: None,
        closed: closed.iter().copied().map(cell_data).collect(),
        targets: targets(task, warehouse),
        reference: poses.iter().map(|pose| cell_data(pose.cell)).collect(),
        poses: poses.into_iter().map(pose_data).collect(),
        record: None,
    }
}

fn json(value: &impl Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|error| PyValueError::new_err(error.to_string()))
}
