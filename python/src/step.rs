//! A step of a run as Python sees it: fields are made of the pinned step when they are first used.

use std::sync::{Arc, Mutex, PoisonError};

use peer::{CaptionedView, Item, PinnedStep, PlanView, StepsView, TextView};
use pyo3::exceptions::PyAttributeError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::classes::{Classes, error};
use crate::declaration::DeclaredWorld;
use crate::frame::Frame;

/// The step behind a served request. Its frames and documents are pinned until the request is answered.
#[pyclass(frozen, module = "memtransfer._native")]
pub(crate) struct Step {
    /// `None` once the request is answered.
    pinned: Mutex<Option<Arc<PinnedStep>>>,
    #[pyo3(get)]
    images: u32,
}

impl Step {
    pub(crate) fn new(pinned: &Arc<PinnedStep>, images: u32) -> Self {
        Self { pinned: Mutex::new(Some(Arc::clone(pinned))), images }
    }

    /// Unpins the step's frames and documents.
    pub(crate) fn release(&self) {
        *self.pinned.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

#[pymethods]
impl Step {
    /// The value of a field of `memtransfer.Request`.
    fn field<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let pinned = self.pinned.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let Some(pinned) = pinned else {
            let message = format!(
                "the request's {name} is gone: it was first read after the request was answered; read it \
                 in act, or copy what you want to keep"
            );
            return Err(error(py, "FrameGone", message));
        };
        match field(py, &pinned, name)? {
            Some(value) => Ok(value),
            None => Err(PyAttributeError::new_err(format!("a request has no field {name:?}"))),
        }
    }
}

fn field<'py>(
    py: Python<'py>,
    step: &PinnedStep,
    name: &str,
) -> PyResult<Option<Bound<'py, PyAny>>> {
    let classes = Classes::get(py)?;
    step.with_request(|request| {
        let world = &*DeclaredWorld::of(py, request.world)?;
        let maker = Maker { py, classes, world };
        // The pinned frames are in this order: current view, window, items.
        let mut frames = step.frames().iter();
        Ok(Some(match name {
            "lane" => request.lane.into_pyobject(py)?.into_any(),
            "step" => request.step.into_pyobject(py)?.into_any(),
            "episode" => request.episode.into_pyobject(py)?.into_any(),
            "episode_seed" => request.episode_seed.into_pyobject(py)?.into_any(),
            "repeat" => request.repeat.into_pyobject(py)?.into_any(),
            "instruction" => request.instruction.into_pyobject(py)?.into_any(),
            "starts_as_demonstrated" => {
                request.starts_as_demonstrated.into_pyobject(py)?.to_owned().into_any()
            }
            "demonstrated_elsewhere" => {
                request.demonstrated_elsewhere.into_pyobject(py)?.to_owned().into_any()
            }
            "state" => world.state(py, &request.state)?,
            "pose" => world.pose(py, &request.state)?,
            "feedback" => world.feedback(py, request.feedback)?,
            "world" => world.object.bind(py).clone(),
            "frame" => maker.frame(frames.next())?,
            "window" => {
                let steps = request.window.iter().zip(frames.skip(1)).map(|(past, frame)| {
                    let action = world.action(py, past.action)?;
                    let feedback = world.feedback(py, past.feedback)?;
                    let values = (maker.frame(Some(frame))?, action, feedback);
                    classes.past_step.bind(py).call1(values)
                });
                maker.tuple(steps)?
            }
            "items" => {
                let mut frames = frames.skip(1 + request.window.len());
                maker.tuple(request.items.iter().map(|item| maker.item(item, &mut frames)))?
            }
            _ => return Ok(None),
        }))
    })
}

struct Maker<'py, 'w> {
    py: Python<'py>,
    classes: &'static Classes,
    world: &'w DeclaredWorld,
}

impl<'py> Maker<'py, '_> {
    /// An item, whose views are the next of `frames`.
    fn item<'f>(
        &self,
        item: &Item<'_>,
        frames: &mut impl Iterator<Item = &'f Arc<shm_types::Frame>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let Self { py, classes, world } = *self;
        match item {
            Item::Text(TextView { id, kind, text }) => {
                let kind = classes.document_kind.member(py, *kind as u8);
                classes.document.bind(py).call1((*id, kind, *text))
            }
            Item::Steps(StepsView { distance, is_whole, instruction, steps }) => {
                let steps = self.tuple(steps.iter().map(|step| {
                    let frame = if step.frame.is_some() { frames.next() } else { None };
                    let values = (self.frame(frame)?, world.action(py, step.action)?);
                    classes.remembered_step.bind(py).call1(values)
                }))?;
                classes.segment.bind(py).call1((*distance, *instruction, steps, *is_whole))
            }
            Item::Frame(CaptionedView { caption, instruction, .. }) => {
                let values = (self.frame(frames.next())?, *caption, *instruction);
                classes.remembered_view.bind(py).call1(values)
            }
            Item::Plan(PlanView { parts }) => {
                let parts = self.tuple(parts.iter().map(|part| {
                    let actions = part.actions.iter();
                    let actions =
                        self.tuple(actions.map(|action| world.action(py, Some(*action))))?;
                    classes.planned_actions.bind(py).call1((actions, part.instruction))
                }))?;
                classes.supplied_plan.bind(py).call1((parts,))
            }
        }
    }

    fn frame(&self, frame: Option<&Arc<shm_types::Frame>>) -> PyResult<Bound<'py, PyAny>> {
        match frame {
            Some(frame) => Ok(Bound::new(self.py, Frame::shared(frame))?.into_any()),
            None => Ok(self.py.None().into_bound(self.py)),
        }
    }

    fn tuple(
        &self,
        values: impl Iterator<Item = PyResult<Bound<'py, PyAny>>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let values = values.collect::<PyResult<Vec<_>>>()?;
        Ok(PyTuple::new(self.py, values)?.into_any())
    }
}
