//! Serving a run with a Python policy.

use std::path::PathBuf;

use peer::ServeError;
use pyo3::prelude::*;
use shm_types::BusError;

use crate::classes::error;
use crate::policy::PythonPolicy;

/// Serves the run in `folder`, or without one the run that `MEMTRANSFER_ATTACH` names, until the run ends.
#[pyfunction]
pub(crate) fn serve(policy: &Bound<'_, PyAny>, folder: Option<PathBuf>) -> PyResult<()> {
    let py = policy.py();
    let mut policy = PythonPolicy::new(policy)?;
    let served = py.detach(|| match &folder {
        Some(folder) => peer::serve(&mut policy, folder),
        None => peer::serve_from_environment(&mut policy),
    });
    let Err(failure) = served else { return Ok(()) };
    if let Some(raised) = policy.take_raised() {
        return Err(raised);
    }
    let class = match &failure {
        // The run was killed: there is nothing left to serve, and nothing that the policy could do about it.
        ServeError::Abandoned(_) => {
            tracing::warn!("{failure}");
            return Ok(());
        }
        ServeError::NoRun(_)
        | ServeError::NotARun(_)
        | ServeError::NoOrchestrator { .. }
        | ServeError::Parent(_)
        | ServeError::Bus(BusError::Attach(_) | BusError::Taken { .. }) => "AttachError",
        ServeError::Bus(_) | ServeError::Spans(_) => "BusError",
        ServeError::PromptLog(_) => "PromptLogError",
        ServeError::Answers { .. } | ServeError::Facts(_) | ServeError::Policy(_) => "PolicyError",
    };
    Err(error(py, class, failure.to_string()))
}
