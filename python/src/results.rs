//! The folder of a run, as columns.

use std::path::PathBuf;

use pyo3::exceptions::{PyFileNotFoundError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyList;
use report::{DataFrame, Value, Values, episodes_frame, timings_frame, world_facts};
use run_log::{LogError, RunLog};

/// A column: its name, the type of its values, and the values, `None` where there is none.
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
    let facts = world_facts(&log.episodes);
    let episodes = columns(py, &episodes_frame(&[(&log, &successes)], &facts))?;
    let timings = columns(py, &timings_frame(std::slice::from_ref(&log)))?;
    Ok((manifest, sessions, episodes, timings, damaged))
}

fn columns<'py>(py: Python<'py>, table: &DataFrame<'_>) -> PyResult<Vec<DataColumn<'py>>> {
    fn list<'py, T: IntoPyObject<'py>>(
        py: Python<'py>,
        rows: usize,
        value: &Value<'_, T>,
    ) -> PyResult<Bound<'py, PyList>> {
        PyList::new(py, (0..rows).map(value))
    }
    let columns = table.columns.iter().map(|column| {
        let values = match &column.values {
            Values::Text(value) | Values::Word(value) => list(py, table.rows, value),
            Values::Whole(value) => list(py, table.rows, value),
            Values::Natural(value) => list(py, table.rows, value),
            Values::Real(value) => list(py, table.rows, value),
            Values::Flag(value) => list(py, table.rows, value),
        };
        Ok((column.name.clone(), column.values.type_name(), values?))
    });
    columns.collect()
}
