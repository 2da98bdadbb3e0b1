//! Serving a run with a Python world.

use std::sync::Mutex;

use case_book::{BookFile, FailureKind, TaskFacts, WorldDeclaration};
use domain::{ActionCode, FeedbackCode, State};
use peer::world::{
    CaseDeclaration, Environment, EpisodeBegin, Observed, Simulator, WorldFailure, program,
};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Map, Value};

/// What a world is, beside its declaration.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Tasks {
    tasks: Vec<TaskFacts>,
    failures: Vec<FailureKind>,
    cases: Vec<CaseDeclaration>,
}

/// Does what `arguments` say with the world that `create` makes, for each lane one. `declaration` and `tasks` are JSON.
#[pyfunction]
pub(crate) fn world_main(
    create: &Bound<'_, PyAny>,
    declaration: String,
    tasks: &str,
    arguments: Vec<String>,
) -> PyResult<()> {
    let py = create.py();
    let failed = |failure: WorldFailure| PyRuntimeError::new_err(failure.to_string());
    let declared = BookFile::<WorldDeclaration>::parse(declaration, "the declaration of the world");
    let declaration = declared.map_err(|error| failed(error.into()))?.book;
    let tasks = serde_json::from_str(tasks).map_err(|error| failed(error.into()))?;
    let raised = Mutex::new(None);
    let simulator = PythonSimulator { create: create.clone().unbind(), declaration, tasks, raised };
    let ended = py.detach(|| program::run(&simulator, &arguments));
    let raised = simulator.raised.into_inner().ok().flatten();
    match (ended, raised) {
        (Ok(()), _) => Ok(()),
        // With its traceback.
        (Err(_), Some(raised)) => Err(raised),
        (Err(failure), None) => Err(failed(failure)),
    }
}

/// A Python function that makes worlds.
struct PythonSimulator {
    create: Py<PyAny>,
    declaration: WorldDeclaration,
    tasks: Tasks,
    /// What making one has raised.
    raised: Mutex<Option<PyErr>>,
}

impl Simulator for PythonSimulator {
    fn declaration(&self) -> WorldDeclaration {
        self.declaration.clone()
    }

    fn cases(&self) -> Result<Vec<CaseDeclaration>, WorldFailure> {
        Ok(self.tasks.cases.clone())
    }

    fn tasks(&self) -> Vec<TaskFacts> {
        self.tasks.tasks.clone()
    }

    fn failures(&self) -> Vec<FailureKind> {
        self.tasks.failures.clone()
    }

    fn environment(&self) -> Result<Box<dyn Environment>, WorldFailure> {
        Python::attach(|py| match self.create.call0(py) {
            Ok(world) => Ok(Box::new(PythonEnvironment(world)) as Box<dyn Environment>),
            Err(error) => {
                let failure = told(py, &error);
                if let Ok(mut raised) = self.raised.lock() {
                    *raised = Some(error);
                }
                Err(failure)
            }
        })
    }
}

/// A `memtransfer.world.World`.
struct PythonEnvironment(Py<PyAny>);

/// What its methods return: state, feedback, sub-goals and all of them, failed, conflict, hash of the state.
type Told = (Vec<f32>, u8, u32, u32, bool, bool, Option<u64>);

fn observed(py: Python<'_>, told: PyResult<Py<PyAny>>) -> Result<Observed, WorldFailure> {
    let told =
        told.and_then(|told| told.extract::<Told>(py)).map_err(|error| failure(py, &error))?;
    let (state, feedback, sub_goals, required, has_failed, conflict, state_hash) = told;
    Ok(Observed {
        state: State::new(&state)?,
        feedback: FeedbackCode(feedback),
        sub_goals,
        required,
        has_failed,
        conflict,
        state_hash,
    })
}

/// An exception in one line.
fn told(py: Python<'_>, error: &PyErr) -> WorldFailure {
    let kind =
        error.get_type(py).name().map_or_else(|_| "error".to_owned(), |name| name.to_string());
    format!("{kind}: {}", error.value(py)).into()
}

/// As [`told`], with the traceback on standard error.
fn failure(py: Python<'_>, error: &PyErr) -> WorldFailure {
    error.print(py);
    told(py, error)
}

impl Environment for PythonEnvironment {
    fn reset(&mut self, begin: &EpisodeBegin<'_>) -> Result<Observed, WorldFailure> {
        let EpisodeBegin { case, start, is_blocked, seed } = begin;
        Python::attach(|py| {
            let begin = (&case.id, start.name(), *is_blocked, *seed);
            observed(py, self.0.call_method1(py, "_reset", begin))
        })
    }

    fn step(&mut self, ActionCode(action): ActionCode) -> Result<Observed, WorldFailure> {
        Python::attach(|py| observed(py, self.0.call_method1(py, "_step", (action,))))
    }

    fn render(&mut self, width: u32, height: u32, pixels: &mut [u8]) -> Result<(), WorldFailure> {
        Python::attach(|py| {
            let slot = WritablePixels { address: pixels.as_mut_ptr() as usize, width, height };
            let slot = Bound::new(py, slot)?;
            let drawn = self.0.call_method1(py, "_render", (&slot,));
            drawn.map_err(|error| failure(py, &error))?;
            // The memory is published now: nobody may write into it any more.
            if slot.get_refcnt() > 1 {
                return Err("render keeps the array that it was given: copy it instead".into());
            }
            Ok(())
        })
    }

    fn facts(&mut self) -> Map<String, Value> {
        Python::attach(|py| {
            let text =
                self.0.call_method0(py, "_facts").and_then(|text| text.extract::<String>(py));
            let text = text.map_err(|error| failure(py, &error));
            text.ok().and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
        })
    }
}

/// Memory of the frame store that a world draws into, while it draws.
#[pyclass(frozen, module = "memtransfer._native")]
pub(crate) struct WritablePixels {
    address: usize,
    width: u32,
    height: u32,
}

#[pymethods]
impl WritablePixels {
    /// Version 3 of numpy's array interface: the address, and that the memory can be written.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("shape", (self.height, self.width, 4))?;
        interface.set_item("typestr", "|u1")?;
        interface.set_item("data", (self.address, false))?;
        Ok(interface)
    }
}
