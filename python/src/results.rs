//! The folder of a run, as columns.

use std::path::PathBuf;

use pyo3::exceptions::{PyFileNotFoundError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyList;
use report::{DataFrame, Values, episodes_frame, timings_frame};
use run_log::{LogError, RunLog};

/// A column: its name, the kind of its values, and the values, `None` where there is none.
type DataColumn<'py> = (String, &'static str, Bound<'py, PyList>);

/// The manifest and the sessions as JSON, the columns of the episodes and of the timings, and the damaged lines that are left
/// out.
type Run<'py> = (String, String, Vec<DataColumn<'py>>, Vec<DataColumn<'py>>, Vec<String>);

/// Reads the run in `folder`.
#[pyfunction]
pub(crate) fn read_run(py: Python<'_>, folder: PathBuf) -> PyResult<Run<'_>> {
    let log = py.detach(|| RunLog::read(&folder)).map_err(|error| match error {
        LogError::NoRun(_) => PyFileNotFoundError::new_err(error.to_string()),
        error => PyValueError::new_err(error.to_string()),
    })?;
    let json = |text: serde_json::Result<String>| {
        text.map_err(|error| PyValueError::new_err(error.to_string()))
    };
    let manifest = json(serde_json::to_string(&log.manifest))?;
    let sessions = json(serde_json::to_string(&log.sessions))?;
    let damaged = log.damaged.iter().map(ToString::to_string).collect();
    let successes = log.episodes.iter().collect();
    let episodes = columns(py, episodes_frame(&[(&log, &successes)]))?;
    let timings = columns(py, timings_frame(std::slice::from_ref(&log)))?;
    Ok((manifest, sessions, episodes, timings, damaged))
}

fn columns(py: Python<'_>, table: DataFrame) -> PyResult<Vec<DataColumn<'_>>> {
    let columns = table.columns.into_iter().map(|column| {
        let (kind, values) = match column.values {
            Values::Text(values) => ("text", PyList::new(py, values)?),
            Values::Whole(values) => ("whole", PyList::new(py, values)?),
            Values::Real(values) => ("real", PyList::new(py, values)?),
            Values::Flag(values) => ("flag", PyList::new(py, values)?),
        };
        Ok((column.name, kind, values))
    });
    columns.collect()
}
