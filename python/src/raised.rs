//! Exceptions of a user's code, and the interrupts among them.
//!
//! Whatever the code raises is a failure of the episode that it was called for, `SystemExit` as well. Only a `KeyboardInterrupt` is not: it
//! ends serving, and the caller of `serve` gets it.

use std::sync::{Arc, Mutex, PoisonError};

use peer::ServeError;
use pyo3::exceptions::{PyKeyboardInterrupt, PySystemExit};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyFrozenSet, PySet, PyString};

/// Whether an exception is an interrupt.
pub(crate) fn is_interrupt(py: Python<'_>, raised: &PyErr) -> bool {
    raised.is_instance_of::<PyKeyboardInterrupt>(py)
}

/// Prints the traceback of an exception, which goes to the log.
pub(crate) fn print(py: Python<'_>, raised: &PyErr) {
    // To print a SystemExit ends the process, which may be a notebook's. The hook only prints it.
    if !raised.is_instance_of::<PySystemExit>(py) {
        raised.print(py);
        return;
    }
    let (kind, traceback) = (raised.get_type(py), raised.traceback(py));
    // A value of its own does not have its traceback.
    let arguments = (kind, raised.clone_ref(py).into_value(py), traceback);
    let hook = py.import("sys").and_then(|sys| sys.getattr("excepthook"));
    if hook.and_then(|hook| hook.call1(arguments)).is_err() {
        raised.display(py);
    }
}

/// Whether a value can be the list that a method returns: anything that has an order, so no set, and is neither a text nor a mapping.
pub(crate) fn is_list(answer: &Bound<'_, PyAny>) -> bool {
    let is_other = answer.is_instance_of::<PyString>()
        || answer.is_instance_of::<PyBytes>()
        || answer.is_instance_of::<PyDict>()
        || answer.is_instance_of::<PySet>()
        || answer.is_instance_of::<PyFrozenSet>();
    !is_other && answer.try_iter().is_ok()
}

/// An exception in words: its class, and its message if it has one.
pub(crate) fn in_words(py: Python<'_>, raised: &PyErr) -> String {
    let class = raised
        .get_type(py)
        .name()
        .map_or_else(|_| "an exception".to_owned(), |name| name.to_string());
    match raised.value(py).str().map(|message| message.to_string()) {
        Ok(message) if message.is_empty() => class,
        Ok(message) => format!("{class}: {message}"),
        Err(_) => format!("{class}, whose message cannot be read"),
    }
}

/// An interrupt that came while user code ran, until serving ends because of it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Interrupt(Arc<Mutex<Option<PyErr>>>);

impl Interrupt {
    /// Keeps an exception if it is an interrupt. Returns whether it is.
    pub(crate) fn keep(&self, py: Python<'_>, raised: &PyErr) -> bool {
        let is_interrupt = is_interrupt(py, raised);
        if is_interrupt {
            *self.lock() = Some(raised.clone_ref(py));
        }
        is_interrupt
    }

    /// Handles signals that have come while no Python code ran.
    ///
    /// # Errors
    /// When there is an interrupt: serving has to end.
    pub(crate) fn check(&self) -> Result<(), ServeError> {
        let mut kept = self.lock();
        if kept.is_none() {
            *kept = Python::attach(|py| py.check_signals()).err();
        }
        if kept.is_some() { Err(ServeError::Interrupted) } else { Ok(()) }
    }

    /// Takes the interrupt, if there is one.
    pub(crate) fn take(&self) -> Option<PyErr> {
        self.lock().take()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<PyErr>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
