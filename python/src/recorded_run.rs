//! The trajectories of a run and of the demonstrations behind it, and the views of their poses.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use anyhow::{Context, bail, ensure};
use case_book::act::{ActedDemonstration, DemonstrationsRequest, EpisodeParts, Target};
use domain::{Action, Cell, DemonstrationKind, Heading, Mismatch, Pose, Route, Start, State};
use pyo3::exceptions::{PyFileNotFoundError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use run_log::{EpisodeReader, EpisodeRecord, LogError, RunLog};
use scores::Successes;
use serde::Serialize;
use sim_proc::renderer::{Backend, RenderSettings};
use sim_proc::view_source::ViewSource;
use sim_proc::worlds::Worlds;
use warehouse::RunWorlds;
use warehouse::act::Stage;
use world_client::frames::ViewKey;
use world_client::{Asker, EpisodeTimeline, RecordedRun as Recorded, WorldAccess, WorldFiles};

/// A run folder, its worlds, and a renderer once a view is asked for. No `sim-proc` lies beside the package, so both answer in
/// this process.
#[pyclass(module = "memtransfer._native", unsendable)]
pub(crate) struct RecordedRun {
    run: Recorded,
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

fn pose_data(state: &State) -> anyhow::Result<PoseData> {
    let Pose { cell, heading } = Pose::try_from(*state)?;
    Ok((cell.x, cell.y, heading as u8))
}

fn path(states: &[State]) -> anyhow::Result<Vec<CellData>> {
    states.iter().map(|state| Ok(cell_data(Pose::try_from(*state)?.cell))).collect()
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
    environment: Option<EnvironmentStart>,
    closed: Vec<CellData>,
    targets: Vec<TargetData>,
    reference: Vec<CellData>,
    record: Option<&'a EpisodeRecord>,
}

/// Start and route of the Gymnasium environment.
type EnvironmentStart = (&'static str, &'static str);

/// Letter, name, and the cell before it.
type TargetData = (char, String, CellData);

fn targets(targets: Vec<Target>) -> Vec<TargetData> {
    let data = |Target { letter, name, cell }: Target| (letter, name, cell_data(cell));
    targets.into_iter().map(data).collect()
}

fn worlds(files: &WorldFiles) -> anyhow::Result<RunWorlds> {
    let [assets, streams, elsewhere] =
        [&files.assets, &files.streams, &files.elsewhere].map(Option::as_deref);
    Ok(RunWorlds::read(assets, streams, elsewhere)?)
}

/// Access to the worlds of runs in this process.
fn access() -> WorldAccess {
    WorldAccess::new(|log| {
        let (name, own) = (&log.world.declaration.name, warehouse::declaration().name);
        ensure!(
            name.is_empty() || *name == own,
            "the run took place in the world {name}, and trajectories and views are those of the world {own}"
        );
        let mut stage = Stage::new(worlds(&WorldFiles::of(log))?);
        Ok(Asker::new(move |request| Ok(stage.answer(request))))
    })
}

fn invalid(error: &anyhow::Error) -> PyErr {
    PyValueError::new_err(format!("{error:#}"))
}

#[pymethods]
impl RecordedRun {
    /// Reads the run in `folder`. Views have the run's size, or width and height in pixels of `size_px`.
    #[new]
    fn new(folder: PathBuf, size_px: Option<(u32, u32)>) -> PyResult<Self> {
        let log = RunLog::without_journals(&folder).map_err(|error| match error {
            LogError::NoRun(_) => PyFileNotFoundError::new_err(error.to_string()),
            error => invalid(&error.into()),
        })?;
        // Trajectories tell nothing of how failures compare with successes.
        let run = Recorded::of(log, Successes::default(), &access());
        let run = run.map_err(|error| invalid(&error))?;
        let of_run = run.log.manifest.settings.frame_size;
        let (width_px, height_px) = size_px.unwrap_or((of_run, of_run));
        let settings = RenderSettings {
            width_px,
            height_px,
            appearance: run.log.manifest.settings.appearance(),
            backend: Some(Backend::Cpu),
            ..RenderSettings::default()
        };
        Ok(Self { run, settings, views: None })
    }

    /// What the user must know about it.
    #[getter]
    fn notices(&self) -> Vec<String> {
        self.run.notices.clone()
    }

    /// Width and height of a view, in pixels.
    #[getter]
    fn size_px(&self) -> (u32, u32) {
        (self.settings.width_px, self.settings.height_px)
    }

    /// The manifest, as JSON.
    fn manifest(&self) -> PyResult<String> {
        json(&self.run.log.manifest)
    }

    /// The policy as every output names it.
    #[getter]
    fn policy_label(&self) -> String {
        self.run.log.manifest.policy_label().to_string()
    }

    /// The trajectories of the episodes that have a result, each as JSON, in the order of the log.
    fn episodes(slf: Bound<'_, Self>) -> PyResult<EpisodeIterator> {
        let reader = slf.borrow().records().map_err(|error| invalid(&error))?;
        Ok(EpisodeIterator { run: slf.unbind(), reader })
    }

    /// The trajectories of the demonstrations that the run's memories could be built from, as JSON, each once, in the order of the
    /// cases.
    fn demonstrations(&self) -> PyResult<String> {
        let found = self.acted_demonstrations().map_err(|error| invalid(&error))?;
        let found = found.iter().map(demonstration).collect::<anyhow::Result<Vec<_>>>();
        json(&found.map_err(|error| invalid(&error))?)
    }

    /// The floor of world variant `variant`: a text for each row from row 0, the most southern, with `.` for free floor
    /// and `#` for anything else: racks, walls, and the barricades of a closed passage.
    fn floor(&self, variant: u32) -> PyResult<Vec<String>> {
        let scene = self.run.world.scene(variant);
        let scene = scene.map_err(|_| PyValueError::new_err("there is no such world"))?;
        Ok(scene.floor.iter().map(|row| row.replace('x', "#")).collect())
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

/// Acts out the episodes of a run, one at a time.
#[pyclass(module = "memtransfer._native", unsendable)]
pub(crate) struct EpisodeIterator {
    run: Py<RecordedRun>,
    reader: EpisodeReader,
}

#[pymethods]
impl EpisodeIterator {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__(&mut self, py: Python<'_>) -> PyResult<Option<String>> {
        let Some(record) = self.reader.next() else { return Ok(None) };
        let record = record.map_err(|error| invalid(&error.into()))?;
        let run = self.run.borrow(py);
        let trajectory = run.episode(&record).map_err(|error| invalid(&error))?;
        json(&trajectory).map(Some)
    }

    /// The lines until now that cannot be used, and are left out.
    #[getter]
    fn damaged(&self) -> Vec<String> {
        self.reader.damaged().iter().map(ToString::to_string).collect()
    }
}

/// What the environment can begin that an episode began with.
fn environment_of(record: &EpisodeRecord) -> Option<EnvironmentStart> {
    let is_other = record.stream.is_some() || record.mismatch != Mismatch::default();
    (!is_other).then(|| (record.start.name(), record.route.name()))
}

/// What the environment can begin that a demonstration began with.
fn environment_of_demonstration(kind: DemonstrationKind) -> Option<EnvironmentStart> {
    match kind {
        DemonstrationKind::Original
        | DemonstrationKind::Opposite
        | DemonstrationKind::Nearby
        | DemonstrationKind::Distant
        | DemonstrationKind::New => Some((kind.name(), Route::Unchanged.name())),
        DemonstrationKind::Blocked => Some((Start::New.name(), Route::Blocked.name())),
        DemonstrationKind::After | DemonstrationKind::Elsewhere => None,
    }
}

impl RecordedRun {
    /// The run's records, of which nothing has been read yet.
    fn records(&self) -> anyhow::Result<EpisodeReader> {
        Ok(EpisodeReader::open(&self.run.log.dir)?)
    }

    fn episode<'a>(&'a self, record: &'a EpisodeRecord) -> anyhow::Result<TrajectoryData<'a>> {
        let parts = EpisodeParts { reference: true, scenery: true, ..EpisodeParts::default() };
        let timeline = EpisodeTimeline::new(&self.run.world, record, &self.run.successes, parts)?;
        let EpisodeTimeline { instruction, variant, steps, reference, scenery, failure, .. } =
            timeline;
        let scenery = scenery.context("an episode without scenery")?;
        let reference = reference.as_ref().map_or(&[][..], |reference| &reference.states);
        let failure = failure.map(|failure| (failure.kind, failure.step));
        Ok(TrajectoryData {
            id: record.key.clone(),
            case: &record.case,
            task: record.task,
            instruction,
            start: record.start.name(),
            variant,
            poses: steps
                .iter()
                .map(|step| pose_data(&step.state))
                .collect::<anyhow::Result<_>>()?,
            feedback: steps.iter().map(|step| step.feedback_code.0).collect(),
            actions: record.actions.chars().map(action_data).collect(),
            sub_goals: record.sub_goals.clone(),
            required: record.required,
            success: record.is_success(),
            failure,
            environment: environment_of(record),
            closed: scenery.closed.into_iter().map(cell_data).collect(),
            targets: targets(scenery.targets),
            reference: path(reference)?,
            record: Some(record),
        })
    }

    /// The demonstrations of the sets of all episodes, each once, in the order of the cases.
    fn acted_demonstrations(&self) -> anyhow::Result<Vec<ActedDemonstration>> {
        let world = &self.run.world;
        let mut sets = BTreeSet::new();
        for record in self.records()? {
            let record = record?;
            sets.insert((record.case, record.demonstrations));
        }
        let mut found = BTreeMap::new();
        for (case, set) in sets {
            if world.index(&case).is_none() {
                continue;
            }
            let acted = world.demonstrations(DemonstrationsRequest {
                case,
                set,
                more: Vec::new(),
                variant: 0,
                planned: false,
            })?;
            found.extend(acted.into_iter().map(|one| ((world.index(&one.case), one.kind), one)));
        }
        Ok(found.into_values().collect())
    }

    fn render(&mut self, variant: u32, poses: &[[u8; 3]], seen: bool) -> anyhow::Result<Vec<u8>> {
        let Self { run, settings, views } = self;
        let views = match views {
            Some(views) => views,
            none => {
                let RunWorlds { warehouse, cases, states, .. } = worlds(&WorldFiles::of(&run.log))?;
                let mismatches: Vec<Mismatch> = run.log.manifest.settings.mismatches().collect();
                let worlds = Worlds::new(&warehouse, &cases, states, &mismatches);
                none.insert(ViewSource::new(worlds, settings.clone())?)
            }
        };
        let pose = |&[x, y, heading]: &[u8; 3]| {
            Ok(State::from(Pose::new(x, y, Heading::try_from(heading)?)))
        };
        let states: Vec<State> = poses.iter().map(pose).collect::<anyhow::Result<_>>()?;
        let world = &run.world;
        let keys = match seen {
            true => world.seen(variant, &states)?,
            false => world.supplied(variant, &states),
        };
        let mut pixels = Vec::new();
        for key in keys {
            let ViewKey::State(variant, state) = key else { bail!("the view of no state") };
            let view = views.render(variant, Pose::try_from(state)?)?;
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

/// A demonstration. It ends with the step that completes the task; the expert's turn towards the rack, after it, is left out.
fn demonstration(acted: &ActedDemonstration) -> anyhow::Result<TrajectoryData<'_>> {
    let length = acted.length.map_or(acted.actions.len(), |length| length as usize);
    let states = &acted.states[..=length];
    Ok(TrajectoryData {
        id: format!("demonstration/{}/{}", acted.kind.name(), acted.case),
        case: &acted.case,
        task: acted.task,
        instruction: acted.instruction.clone(),
        start: acted.kind.name(),
        variant: acted.variant,
        feedback: acted.feedback[..=length].iter().map(|feedback| feedback.0).collect(),
        actions: acted.actions[..length].iter().map(|action| Some(action.0)).collect(),
        required: acted.sub_goals.len() as u32,
        sub_goals: acted.sub_goals.clone(),
        success: acted.length.is_some(),
        failure: None,
        environment: environment_of_demonstration(acted.kind),
        closed: acted.closed.iter().copied().map(cell_data).collect(),
        targets: targets(acted.targets.clone()),
        reference: path(states)?,
        poses: states.iter().map(pose_data).collect::<anyhow::Result<_>>()?,
        record: None,
    })
}

fn json(value: &impl Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|error| PyValueError::new_err(error.to_string()))
}
