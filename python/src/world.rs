//! Serving a run with a Python world.

use case_book::{FailureKind, TaskFacts, WorldDeclaration};
use domain::{ActionCode, FeedbackCode, Mismatch, State};
use peer::ServeError;
use peer::world::{
    CaseDeclaration, Environment, EpisodeBegin, Observed, Simulator, WorldFailure, program,
};
use pyo3::call::PyCallArgs;
use pyo3::conversion::FromPyObjectOwned;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Map, Value};

use crate::classes::error;
use crate::declaration::read_declaration;
use crate::raised::{Interrupt, in_words, print};

/// What this package raises where a world breaks its contract.
const WORLD_ERROR: &str = "WorldError";

/// What a world is, beside its declaration.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Tasks {
    tasks: Vec<TaskFacts>,
    failures: Vec<FailureKind>,
    mismatches: Vec<Mismatch>,
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
    let failed = |failure: String| error(py, WORLD_ERROR, failure);
    let declaration = read_declaration(declaration).map_err(failed)?;
    let tasks = serde_json::from_str(tasks);
    let tasks = tasks.map_err(|problem| failed(format!("the cases are not valid: {problem}")))?;
    let (create, interrupt) = (create.clone().unbind(), Interrupt::default());
    let simulator = PythonSimulator { create, declaration, tasks, interrupt };
    let ended = py.detach(|| {
        program::run(&simulator, &arguments).map_err(|failure| in_one_sentence(&*failure))
    });
    ended.map_err(|failure| simulator.interrupt.take().unwrap_or_else(|| failed(failure)))
}

/// A failure with its causes.
fn in_one_sentence(failure: &(dyn std::error::Error + 'static)) -> String {
    let causes = std::iter::successors(Some(failure), |error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

/// A Python function that makes worlds.
struct PythonSimulator {
    create: Py<PyAny>,
    declaration: WorldDeclaration,
    tasks: Tasks,
    interrupt: Interrupt,
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

    fn mismatches(&self) -> Vec<Mismatch> {
        self.tasks.mismatches.clone()
    }

    fn environment(&self) -> Result<Box<dyn Environment>, WorldFailure> {
        Python::attach(|py| {
            let world = self.create.call0(py);
            let world = world.map_err(|raised| failure(py, &raised, &self.interrupt))?;
            let interrupt = self.interrupt.clone();
            Ok(Box::new(PythonEnvironment { world, interrupt }) as Box<dyn Environment>)
        })
    }

    fn check(&self) -> Result<(), ServeError> {
        self.interrupt.check()
    }
}

/// A `memtransfer.world.World`.
struct PythonEnvironment {
    world: Py<PyAny>,
    interrupt: Interrupt,
}

/// What its methods return: state, feedback, sub-goals and all of them, failed, conflict, hash of the state.
type Told = (Vec<f32>, u8, u32, u32, bool, bool, Option<u64>);

fn observed(
    (state, feedback, sub_goals, required, has_failed, conflict, state_hash): Told,
) -> Result<Observed, WorldFailure> {
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

/// The failure that an exception is to the run. The traceback goes to standard error, unless this package has raised it: then it
/// says what is wrong. An interrupt is kept, and ends serving.
fn failure(py: Python<'_>, raised: &PyErr, interrupt: &Interrupt) -> WorldFailure {
    let class = raised.get_type(py).name();
    if class.is_ok_and(|class| class == WORLD_ERROR) {
        return raised.value(py).to_string().into();
    }
    if !interrupt.keep(py, raised) {
        print(py, raised);
    }
    in_words(py, raised).into()
}

impl PythonEnvironment {
    /// Calls a method of the world, and takes what it returns.
    fn call<T: for<'py> FromPyObjectOwned<'py>>(
        &self,
        method: &str,
        arguments: impl for<'py> PyCallArgs<'py>,
    ) -> Result<T, WorldFailure> {
        Python::attach(|py| {
            let told = self.world.bind(py).call_method1(method, arguments);
            let told = told.and_then(|told| told.extract::<T>().map_err(Into::into));
            told.map_err(|raised| failure(py, &raised, &self.interrupt))
        })
    }
}

impl Environment for PythonEnvironment {
    fn reset(&mut self, begin: &EpisodeBegin<'_>) -> Result<Observed, WorldFailure> {
        let EpisodeBegin { case, start, is_blocked, mismatch, seed } = begin;
        let begin = (&case.id, start.name(), *is_blocked, mismatch.name(), *seed);
        observed(self.call("_reset", begin)?)
    }

    fn step(&mut self, ActionCode(action): ActionCode) -> Result<Observed, WorldFailure> {
        observed(self.call("_step", (action,))?)
    }

    fn render(&mut self, width: u32, height: u32, pixels: &mut [u8]) -> Result<(), WorldFailure> {
        let slot = WritablePixels { address: pixels.as_mut_ptr() as usize, width, height };
        // It raises an error if the world kept the array: the memory is published next, and must not change after that.
        self.call::<Py<PyAny>>("_render", (slot,)).map(drop)
    }

    fn facts(&mut self) -> Result<Map<String, Value>, WorldFailure> {
        Ok(serde_json::from_str(&self.call::<String>("_facts", ())?)?)
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
