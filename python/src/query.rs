//! A step that a memory is asked about, as Python sees it: fields are made when they are first used.

use std::sync::{Arc, Weak};

use domain::{ActionCode, FeedbackCode, State};
use peer::memory::{Demonstration, PastStep, Query, Step};
use pyo3::exceptions::PyAttributeError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyTuple};
use shm_types::{Bank, Frame as SharedFrame};

use crate::classes::{Classes, error};
use crate::declaration::DeclaredWorld;
use crate::frame::Frame;

/// The step behind a served query. It keeps no frame resident.
#[pyclass(frozen, module = "memtransfer._native")]
pub(crate) struct MemoryStep {
    lane: u32,
    episode: u64,
    step: u32,
    state: State,
    last_action: Option<ActionCode>,
    feedback: FeedbackCode,
    frame: Option<Py<Frame>>,
    embedding: Option<Arc<[f32]>>,
    instruction: String,
    window: Vec<Past>,
    image_budget: u32,
    text_budget: u32,
    world: Arc<DeclaredWorld>,
}

/// A past step.
struct Past {
    state: State,
    action: Option<ActionCode>,
    feedback: FeedbackCode,
    frame: Weak<SharedFrame>,
}

impl MemoryStep {
    pub(crate) fn of_step(
        py: Python<'_>,
        world: &Arc<DeclaredWorld>,
        step: &Step<'_>,
    ) -> PyResult<Self> {
        let &Step { lane, episode, step: number, state, last_action, feedback, .. } = step;
        let frame = step.pinned.map(|frame| Py::new(py, Frame::shared(frame))).transpose()?;
        Ok(Self {
            lane,
            episode,
            step: number,
            state,
            last_action,
            feedback,
            frame,
            embedding: step.embedding.map(Arc::from),
            instruction: String::new(),
            window: Vec::new(),
            image_budget: 0,
            text_budget: 0,
            world: Arc::clone(world),
        })
    }

    pub(crate) fn of_query(
        py: Python<'_>,
        world: &Arc<DeclaredWorld>,
        query: &Query<'_>,
    ) -> PyResult<Self> {
        let window = query.window.iter().map(|past| {
            let &PastStep { state, action, feedback, ref frame } = past;
            Past { state, action, feedback, frame: Arc::downgrade(frame) }
        });
        Ok(Self {
            instruction: query.instruction.to_owned(),
            window: window.collect(),
            image_budget: query.image_budget,
            text_budget: query.text_budget,
            ..Self::of_step(py, world, &query.now)?
        })
    }
}

#[pymethods]
impl MemoryStep {
    /// The value of a field of `memtransfer.Query`.
    fn field<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let world = &*self.world;
        Ok(match name {
            "lane" => self.lane.into_pyobject(py)?.into_any(),
            "episode" => self.episode.into_pyobject(py)?.into_any(),
            "step" => self.step.into_pyobject(py)?.into_any(),
            "state" => world.state(py, &self.state)?,
            "pose" => world.pose(py, &self.state)?,
            "last_action" => world.action(py, self.last_action)?,
            "feedback" => world.feedback(py, self.feedback)?,
            "world" => world.object.bind(py).clone(),
            "frame" => self.frame.as_ref().into_pyobject(py)?,
            "embedding" => match &self.embedding {
                Some(embedding) => as_array(py, Numbers::of_query(embedding))?,
                None => py.None().into_bound(py),
            },
            "instruction" => self.instruction.as_str().into_pyobject(py)?.into_any(),
            "window" => {
                let window = self.window.iter().map(|past| {
                    let frame = past.frame.upgrade().ok_or_else(|| window_gone(py))?;
                    let values = (
                        Frame::shared(&frame),
                        world.state(py, &past.state)?,
                        world.action(py, past.action)?,
                        world.feedback(py, past.feedback)?,
                        world.object.bind(py),
                    );
                    Classes::get(py)?.memory.recent_step.bind(py).call1(values)
                });
                PyTuple::new(py, window.collect::<PyResult<Vec<_>>>()?)?.into_any()
            }
            "image_budget" => self.image_budget.into_pyobject(py)?.into_any(),
            "text_budget" => self.text_budget.into_pyobject(py)?.into_any(),
            _ => return Err(PyAttributeError::new_err(format!("a query has no field {name:?}"))),
        })
    }
}

fn window_gone(py: Python<'_>) -> PyErr {
    let message = "the query's window is gone: it was first read after the query was answered; read it in recall, \
                   or copy what you want to keep";
    error(py, "FrameGone", message)
}

/// The owner of the `float32` numbers that an array shows.
#[pyclass(frozen, module = "memtransfer._native")]
pub(crate) struct Numbers {
    owner: Owner,
    /// The first number.
    first: usize,
    /// Rows and columns, or the length of a vector.
    shape: Vec<usize>,
}

enum Owner {
    /// Embeddings in shared memory, which stay mapped while the array exists.
    Bank(Arc<Bank>),
    /// The embedding of a query.
    Own(Arc<[f32]>),
}

impl Numbers {
    /// The embeddings of a demonstration whose first step is `row` of its bank.
    pub(crate) fn of_bank(of: &Demonstration<'_>, row: usize) -> Self {
        let (rows, columns) = (of.steps.len(), of.dimension());
        match of.bank {
            Some(bank) => {
                let owner = Owner::Bank(Arc::clone(bank));
                Self { owner, first: row * columns, shape: vec![rows, columns] }
            }
            None => Self {
                owner: Owner::Own(of.embeddings.into()),
                first: 0,
                shape: vec![rows, columns],
            },
        }
    }

    fn of_query(embedding: &Arc<[f32]>) -> Self {
        Self { owner: Owner::Own(Arc::clone(embedding)), first: 0, shape: vec![embedding.len()] }
    }

    fn numbers(&self) -> &[f32] {
        let all = match &self.owner {
            Owner::Bank(bank) => bank.embeddings(),
            Owner::Own(numbers) => numbers,
        };
        let count: usize = self.shape.iter().product();
        all.get(self.first..self.first + count).unwrap_or_default()
    }
}

#[pymethods]
impl Numbers {
    /// Version 3 of numpy's array interface: the address, and that the memory is read-only.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("shape", PyTuple::new(py, &self.shape)?)?;
        interface.set_item("typestr", "<f4")?;
        interface.set_item("data", (self.numbers().as_ptr() as usize, true))?;
        Ok(interface)
    }
}

/// A numpy array of `numbers`.
pub(crate) fn as_array(py: Python<'_>, numbers: Numbers) -> PyResult<Bound<'_, PyAny>> {
    static AS_ARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    AS_ARRAY.import(py, "numpy", "asarray")?.call1((numbers,))
}
