//! The world of a run as Python sees it: its declaration, and its states, actions and feedback as Python values.

use std::sync::{Arc, LazyLock, Mutex, PoisonError};

use case_book::{BookError, BookFile, WorldDeclaration};
use domain::{Action, ActionCode, Feedback, FeedbackCode, State};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyInt, PyString, PyTuple};

use crate::classes::Classes;

/// The declaration of the warehouse.
static WAREHOUSE: LazyLock<Arc<WorldDeclaration>> =
    LazyLock::new(|| Arc::new(warehouse::declaration()));

/// The worlds that this process has met: few, and mostly one.
static KNOWN: Mutex<Vec<Arc<DeclaredWorld>>> = Mutex::new(Vec::new());

/// The declaration of the warehouse, as JSON.
#[pyfunction]
pub(crate) fn warehouse_declaration() -> PyResult<String> {
    json(&WAREHOUSE)
}

/// A world.
pub(crate) struct DeclaredWorld {
    pub(crate) declaration: Arc<WorldDeclaration>,
    /// The same as a `memtransfer.WorldDeclaration`: one object for all requests of a run.
    pub(crate) object: Py<PyAny>,
    /// Whether its actions are the members of `memtransfer.Action`.
    names_actions: bool,
    /// Whether its feedback is the members of `memtransfer.Feedback`.
    names_feedback: bool,
}

impl DeclaredWorld {
    /// The world of `declaration`.
    pub(crate) fn of(py: Python<'_>, declaration: &Arc<WorldDeclaration>) -> PyResult<Arc<Self>> {
        if let Some(known) = find(|known| known.declaration == *declaration) {
            return Ok(known);
        }
        let module = py.import("memtransfer.declaration")?;
        let object = module.call_method1("parse", (json(declaration)?,))?.unbind();
        let words = declaration.actions.iter().map(|action| &*action.words);
        let sentences = declaration.feedback.iter().map(String::as_str);
        let world = Arc::new(Self {
            declaration: Arc::clone(declaration),
            object,
            names_actions: words.eq(Action::ALL.map(Action::words)),
            names_feedback: sentences.eq(Feedback::ALL.map(Feedback::words)),
        });
        KNOWN.lock().unwrap_or_else(PoisonError::into_inner).push(Arc::clone(&world));
        Ok(world)
    }

    /// The warehouse.
    pub(crate) fn warehouse(py: Python<'_>) -> PyResult<Arc<Self>> {
        Self::of(py, &WAREHOUSE)
    }

    /// The world that a `memtransfer.WorldDeclaration` declares.
    pub(crate) fn read(object: &Bound<'_, PyAny>) -> PyResult<Arc<Self>> {
        let py = object.py();
        if let Some(known) = find(|known| known.object.bind(py).is(object)) {
            return Ok(known);
        }
        if !object.get_type().is(&Classes::get(py)?.world) {
            let kind = object.get_type().name()?;
            return Err(PyTypeError::new_err(format!(
                "a world is a WorldDeclaration, not a {kind}"
            )));
        }
        let text: String = object.call_method0("json")?.extract()?;
        let declaration = read_declaration(text).map_err(PyValueError::new_err)?;
        Self::of(py, &Arc::new(declaration))
    }

    /// A state, as a tuple of numbers.
    pub(crate) fn state<'py>(&self, py: Python<'py>, state: &State) -> PyResult<Bound<'py, PyAny>> {
        Ok(PyTuple::new(py, state.numbers())?.into_any())
    }

    /// The `memtransfer.Pose` that a state is.
    ///
    /// # Errors
    /// `AttributeError` where states are no poses.
    pub(crate) fn pose<'py>(&self, py: Python<'py>, state: &State) -> PyResult<Bound<'py, PyAny>> {
        self.object.bind(py).call_method1("pose", (self.state(py, state)?,))
    }

    /// An action: a `memtransfer.Action`, or its number where the actions are others; `None` if there is none.
    pub(crate) fn action<'py>(
        &self,
        py: Python<'py>,
        action: Option<ActionCode>,
    ) -> PyResult<Bound<'py, PyAny>> {
        match action {
            None => Ok(py.None().into_bound(py)),
            Some(ActionCode(code)) => {
                let member = if self.names_actions {
                    Classes::get(py)?.action.member(py, code)
                } else {
                    None
                };
                or_number(py, member, code)
            }
        }
    }

    /// A feedback: a `memtransfer.Feedback`, or its number where the sentences are others.
    pub(crate) fn feedback<'py>(
        &self,
        py: Python<'py>,
        FeedbackCode(code): FeedbackCode,
    ) -> PyResult<Bound<'py, PyAny>> {
        let member =
            if self.names_feedback { Classes::get(py)?.feedback.member(py, code) } else { None };
        or_number(py, member, code)
    }

    /// The action that `value` is: a `memtransfer.Action`, a number or words. `None` for anything else.
    pub(crate) fn read_action(&self, value: &Bound<'_, PyAny>) -> PyResult<Option<ActionCode>> {
        let py = value.py();
        if let Ok(words) = value.cast::<PyString>() {
            return Ok(self.declaration.action_named(&words.to_string_lossy()));
        }
        if let Some(code) = Classes::get(py)?.action.code(value)? {
            // An action of the benchmark is one of another world only if that has the same words for it.
            let words = Action::try_from(code).map(Action::words).ok();
            return Ok(words.and_then(|words| self.declaration.action_named(words)));
        }
        // Not one of the other enumerations, or `True`.
        let is_number = match value.cast::<PyInt>() {
            Ok(_) => value.is_exact_instance_of::<PyInt>(),
            Err(_) => value.hasattr("__index__")?,
        };
        let code = if is_number { value.extract::<u8>().ok() } else { None };
        Ok(code.and_then(|code| self.declaration.action(code)))
    }

    /// What is wrong with an answer that is an action of the warehouse, or a decision for one, which this world does not have.
    pub(crate) fn foreign_action(&self, answer: &Bound<'_, PyAny>) -> PyResult<Option<String>> {
        let classes = Classes::get(answer.py())?;
        let of_decision = answer.get_type().is(&classes.decision);
        let value = if of_decision { answer.getattr("action")? } else { answer.clone() };
        if classes.action.code(&value)?.is_none() || self.read_action(&value)?.is_some() {
            return Ok(None);
        }
        let (world, forms) = (&self.declaration.name, self.action_forms());
        Ok(Some(format!(
            "answered {}, an action of the warehouse that the world {world} does not have: return {forms}, from \
             request.world.actions",
            value.repr()?
        )))
    }

    /// What an action can be given as.
    pub(crate) fn action_forms(&self) -> String {
        let last = self.declaration.actions.len() - 1;
        let an_action = if self.names_actions { "an Action, " } else { "" };
        format!("{an_action}the number (0 to {last}) or the words of an action")
    }

    /// The action in the attribute `action` of `of`.
    ///
    /// # Errors
    /// When it is none of this world.
    pub(crate) fn action_in(&self, of: &Bound<'_, PyAny>) -> PyResult<Option<ActionCode>> {
        let value = of.getattr("action")?;
        if value.is_none() { Ok(None) } else { self.known_action(&value).map(Some) }
    }

    /// The action that `value` is.
    ///
    /// # Errors
    /// When it is none of this world.
    pub(crate) fn known_action(&self, value: &Bound<'_, PyAny>) -> PyResult<ActionCode> {
        self.read_action(value)?.ok_or_else(|| {
            let (world, forms) = (&self.declaration.name, self.action_forms());
            let problem = format!("{value:?} is no action of the world {world}: give {forms}");
            PyValueError::new_err(problem)
        })
    }

    /// The feedback in the attribute `feedback` of `of`.
    ///
    /// # Errors
    /// When it is none of this world.
    pub(crate) fn feedback_in(&self, of: &Bound<'_, PyAny>) -> PyResult<FeedbackCode> {
        let code = of.getattr("feedback")?.extract()?;
        let feedback = self.declaration.read_feedback(code);
        feedback.map_err(|unknown| PyValueError::new_err(unknown.to_string()))
    }

    /// The state in the attribute `state` of `of`.
    ///
    /// # Errors
    /// When it is none of this world.
    pub(crate) fn state_in(&self, of: &Bound<'_, PyAny>) -> PyResult<State> {
        let numbers = of.getattr("state")?.try_iter()?;
        let numbers = numbers.map(|number| number?.extract()).collect::<PyResult<Vec<f32>>>()?;
        let state =
            State::new(&numbers).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let checked = self.declaration.check_state(&state);
        checked.map(|()| state).map_err(|foreign| PyValueError::new_err(foreign.to_string()))
    }
}

fn find(is_it: impl Fn(&DeclaredWorld) -> bool) -> Option<Arc<DeclaredWorld>> {
    let known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    known.iter().find(|known| is_it(known)).cloned()
}

/// The member of an enumeration, or the number.
fn or_number<'py>(
    py: Python<'py>,
    member: Option<Bound<'py, PyAny>>,
    code: u8,
) -> PyResult<Bound<'py, PyAny>> {
    match member {
        Some(member) => Ok(member),
        None => Ok(code.into_pyobject(py)?.into_any()),
    }
}

fn json(declaration: &WorldDeclaration) -> PyResult<String> {
    serde_json::to_string(declaration).map_err(|error| PyValueError::new_err(error.to_string()))
}

/// Reads a declaration.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn read_declaration(text: String) -> Result<WorldDeclaration, String> {
    match BookFile::<WorldDeclaration>::parse(text, "") {
        Ok(file) => Ok(file.book),
        Err(BookError::Invalid { problem, .. }) => {
            Err(format!("the declaration of the world is not valid: {problem}"))
        }
        Err(error) => Err(error.to_string()),
    }
}
