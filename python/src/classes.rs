//! The package's Python classes, looked up once.

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyString, PyType};

/// The classes that this crate builds or recognises.
pub(crate) struct Classes {
    pub(crate) action: Code,
    pub(crate) feedback: Code,
    pub(crate) outcome: Code,
    pub(crate) document_kind: Code,
    pub(crate) world: Py<PyType>,
    pub(crate) past_step: Py<PyType>,
    pub(crate) remembered_step: Py<PyType>,
    pub(crate) segment: Py<PyType>,
    pub(crate) document: Py<PyType>,
    pub(crate) remembered_view: Py<PyType>,
    pub(crate) planned_actions: Py<PyType>,
    pub(crate) supplied_plan: Py<PyType>,
    pub(crate) served_request: Py<PyType>,
    pub(crate) decision: Py<PyType>,
    pub(crate) failed: Py<PyType>,
    pub(crate) memory: MemoryClasses,
}

/// The classes of `memtransfer.memory`.
pub(crate) struct MemoryClasses {
    pub(crate) memory: Py<PyType>,
    pub(crate) demonstration: Py<PyType>,
    pub(crate) episode: Py<PyType>,
    pub(crate) episode_end: Py<PyType>,
    pub(crate) recent_step: Py<PyType>,
    pub(crate) served_query: Py<PyType>,
    pub(crate) text: Py<PyType>,
    pub(crate) steps: Py<PyType>,
    pub(crate) view: Py<PyType>,
    pub(crate) plan: Py<PyType>,
    pub(crate) source: Py<PyType>,
}

/// An enumeration whose members have the codes 0, 1, 2 and so on.
pub(crate) struct Code {
    class: Py<PyType>,
    members: Vec<Py<PyAny>>,
}

impl Code {
    fn of(module: &Bound<'_, PyModule>, name: &str) -> PyResult<Self> {
        let class = class(module, name)?;
        let members = class.bind(module.py()).try_iter()?;
        let members = members.map(|member| Ok(member?.unbind())).collect::<PyResult<_>>()?;
        Ok(Self { class, members })
    }

    /// The member with `code`.
    pub(crate) fn member<'py>(&self, py: Python<'py>, code: u8) -> Option<Bound<'py, PyAny>> {
        Some(self.members.get(usize::from(code))?.bind(py).clone())
    }

    /// The code of `value`, if it is a member.
    pub(crate) fn code(&self, value: &Bound<'_, PyAny>) -> PyResult<Option<u8>> {
        if value.get_type().is(&self.class) { value.extract().map(Some) } else { Ok(None) }
    }
}

impl Classes {
    /// Returns the classes. The package's modules are loaded by the first call.
    pub(crate) fn get(py: Python<'_>) -> PyResult<&'static Self> {
        static CLASSES: PyOnceLock<Classes> = PyOnceLock::new();
        CLASSES.get_or_try_init(py, || {
            let codes = py.import("memtransfer.codes")?;
            let declarations = py.import("memtransfer.declaration")?;
            let requests = py.import("memtransfer.request")?;
            let memories = py.import("memtransfer.memory")?;
            Ok(Self {
                action: Code::of(&codes, "Action")?,
                feedback: Code::of(&codes, "Feedback")?,
                outcome: Code::of(&codes, "Outcome")?,
                document_kind: Code::of(&codes, "DocumentKind")?,
                world: class(&declarations, "WorldDeclaration")?,
                past_step: class(&requests, "PastStep")?,
                remembered_step: class(&requests, "RememberedStep")?,
                segment: class(&requests, "Segment")?,
                document: class(&requests, "Document")?,
                remembered_view: class(&requests, "RememberedView")?,
                planned_actions: class(&requests, "PlannedActions")?,
                supplied_plan: class(&requests, "SuppliedPlan")?,
                served_request: class(&requests, "ServedRequest")?,
                decision: class(&requests, "Decision")?,
                failed: class(&requests, "Failed")?,
                memory: MemoryClasses {
                    memory: class(&memories, "Memory")?,
                    demonstration: class(&memories, "Demonstration")?,
                    episode: class(&memories, "Episode")?,
                    episode_end: class(&memories, "EpisodeEnd")?,
                    recent_step: class(&memories, "RecentStep")?,
                    served_query: class(&memories, "ServedQuery")?,
                    text: class(&memories, "Text")?,
                    steps: class(&memories, "Steps")?,
                    view: class(&memories, "View")?,
                    plan: class(&memories, "Plan")?,
                    source: class(&memories, "Source")?,
                },
            })
        })
    }
}

fn class(module: &Bound<'_, PyModule>, name: &str) -> PyResult<Py<PyType>> {
    Ok(module.getattr(name)?.cast_into::<PyType>()?.unbind())
}

/// An exception of `memtransfer.errors`.
pub(crate) fn error(py: Python<'_>, name: &str, message: impl Into<String>) -> PyErr {
    let class = py.import("memtransfer.errors").and_then(|errors| errors.getattr(name));
    match class.and_then(|class| class.call1((message.into(),))) {
        Ok(error) => PyErr::from_value(error),
        Err(error) => error,
    }
}

/// A Python string, with `?` for unpaired surrogates, which a model's reply can contain.
pub(crate) fn lossy(text: &Bound<'_, PyString>) -> PyResult<String> {
    let bytes = text.call_method1("encode", ("utf-8", "replace"))?;
    Ok(String::from_utf8_lossy(bytes.extract()?).into_owned())
}
