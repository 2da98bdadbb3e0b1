//! Serving a run with a Python policy or memory.

use std::path::PathBuf;

use peer::{ServeError, Until};
use pyo3::prelude::*;
use shm_types::BusError;

use crate::classes::error;
use crate::memory::{Described, PythonMethod};
use crate::policy::PythonPolicy;

/// Serves the run in `folder`, or without one the run that `MEMTRANSFER_ATTACH` names, until the run ends, or its `generation` if
/// that is true. `code` tells the files of its code.
#[pyfunction]
pub(crate) fn serve(
    policy: &Bound<'_, PyAny>,
    code: String,
    folder: Option<PathBuf>,
    generation: bool,
) -> PyResult<()> {
    let py = policy.py();
    let mut policy = PythonPolicy::new(policy, code)?;
    let served = py.detach(|| match &folder {
        Some(folder) => peer::serve_until(&mut policy, folder, until(generation)),
        None => peer::serve_from_environment(&mut policy),
    });
    match policy.take_raised() {
        Some(raised) if served.is_err() => Err(raised),
        _ => ended(py, served),
    }
}

/// Serves the run as an external memory, as [`serve`] does. `create` makes the memory of a bank.
#[pyfunction]
pub(crate) fn serve_memory(
    create: &Bound<'_, PyAny>,
    description: Described,
    folder: Option<PathBuf>,
    generation: bool,
) -> PyResult<()> {
    let py = create.py();
    let method = PythonMethod::new(create, description)?;
    let served = py.detach(|| match &folder {
        Some(folder) => peer::memory::serve_until(&method, folder, until(generation)),
        None => peer::memory::serve_from_environment(&method),
    });
    match method.take_interrupt() {
        Some(raised) if served.is_err() => Err(raised),
        _ => ended(py, served),
    }
}

fn until(generation: bool) -> Until {
    if generation { Until::GenerationEnds } else { Until::RunEnds }
}

/// The exception that an end of serving is to the caller.
fn ended(py: Python<'_>, served: Result<(), ServeError>) -> PyResult<()> {
    let Err(failure) = served else { return Ok(()) };
    let class = match &failure {
        // The run was killed: there is nothing left to serve, and nothing that the program could do about it.
        ServeError::Abandoned(_) => {
            tracing::warn!("{failure}");
            return Ok(());
        }
        ServeError::NoRun(_)
        | ServeError::NotARun(_)
        | ServeError::NotAMemoryFolder(_)
        | ServeError::NoOrchestrator { .. }
        | ServeError::World(_)
        | ServeError::OwnCode(_)
        | ServeError::Parent(_)
        | ServeError::Bus(BusError::Attach(_) | BusError::Taken { .. }) => "AttachError",
        ServeError::Bus(_)
        | ServeError::Interrupted
        | ServeError::Spans(_)
        | ServeError::Frame(_)
        | ServeError::Frames(_)
        | ServeError::WorldFailed(_) => "BusError",
        ServeError::PromptLog(_) => "PromptLogError",
        ServeError::Answers { .. } | ServeError::Facts(_) | ServeError::Policy(_) => "PolicyError",
    };
    Err(error(py, class, failure.to_string()))
}
