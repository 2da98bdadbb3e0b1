//! A Python memory as the SDK sees one: banks and queries go in as Python objects, answers come back as items.

use std::collections::HashMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use domain::ActionCode;
use peer::memory::{
    Demonstration, Episode, EpisodeEnd, Memory, MemoryDescription, MemoryError, MemoryItem,
    MemoryMethod, PlanPart, Query, Scope, Source, Step, Views,
};
use peer::{ServeError, WorldDeclaration};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyList, PyString, PyTuple};
use shm_types::{Bank, Frame as SharedFrame};

use crate::classes::Classes;
use crate::declaration::DeclaredWorld;
use crate::frame::Frame;
use crate::query::{MemoryStep, Numbers, as_array};
use crate::raised::{Interrupt, in_words, is_list, print};

/// Name, version, scope, whether it uses embeddings, whether it looks at frames, whether it is deterministic, whether it
/// learns, the files of its code.
pub(crate) type Described = (String, String, String, bool, bool, bool, bool, String);

/// The file beside a memory's own that holds the number of steps of each episode it has learned from.
const LENGTHS_FILE: &str = "steps-of-episodes.txt";

/// A Python function that makes memories.
pub(crate) struct PythonMethod {
    create: Py<PyAny>,
    description: MemoryDescription,
    interrupt: Interrupt,
}

impl PythonMethod {
    pub(crate) fn new(create: &Bound<'_, PyAny>, described: Described) -> PyResult<Self> {
        let (name, version, scope, embeddings, frames, deterministic, learns, code) = described;
        let scope = match &*scope {
            "case" => Scope::Case,
            "all" => Scope::All,
            scope => return Err(PyValueError::new_err(format!("{scope:?} is not a scope"))),
        };
        let sdk = "python".to_owned();
        let description = MemoryDescription {
            name,
            version,
            scope,
            embeddings,
            frames,
            deterministic,
            learns,
            sdk,
            code,
        };
        let create = create.clone().unbind();
        Ok(Self { create, description, interrupt: Interrupt::default() })
    }

    /// Takes the interrupt because of which serving has ended, if there is one.
    pub(crate) fn take_interrupt(&self) -> Option<PyErr> {
        self.interrupt.take()
    }
}

impl MemoryMethod for PythonMethod {
    fn describe(&self) -> MemoryDescription {
        self.description.clone()
    }

    fn create(&self, world: &Arc<WorldDeclaration>) -> Box<dyn Memory + '_> {
        let object = Python::attach(|py| {
            let object = self.create.bind(py).call0();
            object
                .and_then(|object| Object::new(&object, DeclaredWorld::of(py, world)?))
                .map_err(|raised| failure(py, &raised, &self.interrupt))
        });
        Box::new(PythonMemory {
            object,
            interrupt: self.interrupt.clone(),
            bank: None,
            lengths: Vec::new(),
            demonstrations: 0,
            observed: HashMap::new(),
        })
    }

    fn check(&self) -> Result<(), ServeError> {
        self.interrupt.check()
    }
}

/// A memory of one bank.
struct PythonMemory {
    /// The Python object, or why it could not be made.
    object: Result<Object, MemoryError>,
    interrupt: Interrupt,
    /// Keeps the bank mapped as long as the memory exists.
    bank: Option<Arc<Bank>>,
    /// Number of steps of each demonstration, then of each episode that it has learned from.
    lengths: Vec<u32>,
    /// Number of demonstrations.
    demonstrations: usize,
    /// Steps of the running episodes.
    observed: HashMap<u64, u32>,
}

struct Object {
    memory: Py<PyAny>,
    /// The optional methods that its class overrides.
    overrides: Overrides,
    /// The world of its demonstrations and episodes.
    world: Arc<DeclaredWorld>,
}

#[expect(clippy::struct_excessive_bools, reason = "one for each optional method")]
struct Overrides {
    begin_episode: bool,
    observe: bool,
    end_episode: bool,
    store_bytes: bool,
    tokens: bool,
}

impl Object {
    fn new(memory: &Bound<'_, PyAny>, world: Arc<DeclaredWorld>) -> PyResult<Self> {
        let py = memory.py();
        let (class, base) = (memory.get_type(), Classes::get(py)?.memory.memory.bind(py));
        let overrides = |name: &str| PyResult::Ok(!class.getattr(name)?.is(&base.getattr(name)?));
        let overrides = Overrides {
            begin_episode: overrides("begin_episode")?,
            observe: overrides("observe")?,
            end_episode: overrides("end_episode")?,
            store_bytes: overrides("store_bytes")?,
            tokens: overrides("tokens")?,
        };
        Ok(Self { memory: memory.clone().unbind(), overrides, world })
    }
}

impl PythonMemory {
    /// Calls `work` with the Python object; an exception is printed to the log.
    fn call<T>(
        &self,
        work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>, &Object) -> PyResult<T>,
    ) -> Result<T, MemoryError> {
        let object = self.object.as_ref().map_err(Clone::clone)?;
        Python::attach(|py| {
            work(py, object.memory.bind(py), object)
                .map_err(|raised| failure(py, &raised, &self.interrupt))
        })
    }

    fn items(&self, answer: &Bound<'_, PyAny>, world: &DeclaredWorld) -> PyResult<Vec<MemoryItem>> {
        if !is_list(answer) {
            let problem = format!(
                "recall returned {}, but must return a list of items, which may be empty",
                answer.repr()?
            );
            return Err(PyTypeError::new_err(problem));
        }
        answer.try_iter()?.map(|item| self.item(&item?, world)).collect()
    }

    fn item(&self, item: &Bound<'_, PyAny>, world: &DeclaredWorld) -> PyResult<MemoryItem> {
        let py = item.py();
        let classes = &Classes::get(py)?.memory;
        let distance = || match item.getattr(intern!(py, "distance"))?.extract::<Option<f32>>()? {
            Some(distance) if distance.is_nan() => Err(PyValueError::new_err(
                "the distance of an item is nan, but must be a number or None",
            )),
            distance => Ok(distance),
        };
        if let Ok(text) = item.cast::<PyString>() {
            return Ok(MemoryItem::text(text.to_str()?));
        }
        if item.is_instance(classes.steps.bind(py))? {
            let views = item.getattr(intern!(py, "views"))?;
            return Ok(MemoryItem::Steps {
                source: self.source(item)?,
                views: match views.cast::<PyBool>() {
                    Ok(all) if all.is_true() => Views::All,
                    Ok(_) => Views::None,
                    Err(_) => {
                        Views::Keyframes(views.try_iter()?.map(number).collect::<PyResult<_>>()?)
                    }
                },
                actions: item.getattr(intern!(py, "actions"))?.is_truthy()?,
                distance: distance()?,
            });
        }
        if item.is_instance(classes.text.bind(py))? {
            let sources = item.getattr(intern!(py, "sources"))?.try_iter()?;
            let text = item.getattr(intern!(py, "text"))?;
            return Ok(MemoryItem::Text {
                text: text.cast::<PyString>()?.to_str()?.into(),
                sources: sources.map(|source| self.source(&source?)).collect::<PyResult<_>>()?,
            });
        }
        if item.is_instance(classes.view.bind(py))? {
            let caption = item.getattr(intern!(py, "caption"))?;
            return Ok(MemoryItem::Frame {
                demonstration: number(item.getattr(intern!(py, "demonstration")))?,
                step: number(item.getattr(intern!(py, "step")))?,
                caption: caption.cast::<PyString>()?.to_str()?.into(),
                distance: distance()?,
            });
        }
        if item.is_instance(classes.plan.bind(py))? {
            let part = |part: PyResult<Bound<'_, PyAny>>| {
                let part = part?;
                Ok(if part.is_instance(classes.source.bind(py))? {
                    PlanPart::Steps(self.source(&part)?)
                } else {
                    PlanPart::Own(world.known_action(&part)?)
                })
            };
            let parts = item.getattr(intern!(py, "parts"))?.try_iter()?;
            return Ok(MemoryItem::Plan { parts: parts.map(part).collect::<PyResult<_>>()? });
        }
        let problem = format!(
            "recall returned {}, but an item is a Text, Steps, a View, a Plan or a str",
            item.repr()?
        );
        Err(PyValueError::new_err(problem))
    }

    /// The attributes `demonstration`, `first` and `count` of `of`.
    fn source(&self, of: &Bound<'_, PyAny>) -> PyResult<Source> {
        let py = of.py();
        let demonstration = number(of.getattr(intern!(py, "demonstration")))?;
        let first = number(of.getattr(intern!(py, "first")))?;
        let most = of.getattr(intern!(py, "count"))?;
        let most = if most.is_none() { u32::MAX } else { number(Ok(most))? };
        // The host refuses a demonstration or step that does not exist.
        let length = self.lengths.get(demonstration as usize).copied().unwrap_or_default();
        let count = most.min(length.saturating_sub(first).max(1));
        Ok(Source { demonstration, first, count })
    }
}

impl Memory for PythonMemory {
    fn build(&mut self, demonstrations: &[Demonstration<'_>]) -> Result<(), MemoryError> {
        self.bank = demonstrations.first().and_then(|of| of.bank).cloned();
        self.lengths = demonstrations.iter().map(|of| of.steps.len() as u32).collect();
        self.demonstrations = self.lengths.len();
        self.call(|py, memory, object| {
            let mut rows = 0;
            let mut values = Vec::with_capacity(demonstrations.len());
            for of in demonstrations {
                values.push(demonstration(py, &object.world, of, rows)?);
                rows += of.steps.len();
            }
            memory.call_method1(intern!(py, "build"), (PyList::new(py, values)?,)).map(drop)
        })
    }

    fn begin_episode(&mut self, episode: &Episode<'_>) -> Result<(), MemoryError> {
        self.call(|py, memory, object| {
            if !object.overrides.begin_episode {
                return Ok(());
            }
            let &Episode {
                lane,
                episode,
                instruction,
                seed,
                repeat,
                image_budget,
                text_budget,
                learns,
            } = episode;
            let values =
                (episode, lane, instruction, seed, repeat, image_budget, text_budget, learns);
            let episode = Classes::get(py)?.memory.episode.bind(py).call1(values)?;
            memory.call_method1(intern!(py, "begin_episode"), (episode,)).map(drop)
        })
    }

    fn observe(&mut self, step: &Step<'_>) -> Result<(), MemoryError> {
        self.observed.insert(step.episode, step.step + 1);
        if !self.object.as_ref().is_ok_and(|object| object.overrides.observe) {
            return Ok(());
        }
        self.call(|py, memory, object| {
            let step = MemoryStep::of_step(py, &object.world, step)?;
            memory.call_method1(intern!(py, "observe"), (served(py, step)?,)).map(drop)
        })
    }

    fn recall(&mut self, query: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError> {
        self.call(|py, memory, object| {
            let query = MemoryStep::of_query(py, &object.world, query)?;
            let query = served(py, query)?;
            self.items(&memory.call_method1(intern!(py, "recall"), (query,))?, &object.world)
        })
    }

    fn end_episode(&mut self, end: &EpisodeEnd<'_>) -> Result<(), MemoryError> {
        let steps = self.observed.remove(&end.episode);
        if end.demonstration.is_some() {
            self.lengths.push(steps.unwrap_or_default());
        }
        self.call(|py, memory, object| {
            if !object.overrides.end_episode {
                return Ok(());
            }
            let &EpisodeEnd { lane, episode, demonstration, success, sub_goals } = end;
            let sub_goals = sub_goals.map(|steps| PyTuple::new(py, steps)).transpose()?;
            let values = (episode, lane, demonstration, success, sub_goals);
            let end = Classes::get(py)?.memory.episode_end.bind(py).call1(values)?;
            memory.call_method1(intern!(py, "end_episode"), (end,)).map(drop)
        })
    }

    fn save(&mut self, folder: &Path) -> Result<(), MemoryError> {
        let learned = self.lengths[self.demonstrations..].iter().map(u32::to_string);
        let lines: Vec<String> = learned.collect();
        fs::write(folder.join(LENGTHS_FILE), lines.join("\n")).map_err(MemoryError::new)?;
        self.call(|py, memory, _| memory.call_method1(intern!(py, "save"), (folder,)).map(drop))
    }

    fn load(&mut self, folder: &Path) -> Result<(), MemoryError> {
        let lines = fs::read_to_string(folder.join(LENGTHS_FILE)).map_err(MemoryError::new)?;
        let learned: Result<Vec<u32>, _> = lines.lines().map(str::parse).collect();
        self.lengths.truncate(self.demonstrations);
        self.lengths.extend(learned.map_err(MemoryError::new)?);
        self.call(|py, memory, _| memory.call_method1(intern!(py, "load"), (folder,)).map(drop))
    }

    fn store_bytes(&self) -> Option<u64> {
        let bytes = self.call(|py, memory, object| {
            if !object.overrides.store_bytes {
                return Ok(None);
            }
            memory.call_method0(intern!(py, "store_bytes"))?.extract()
        });
        bytes.ok().flatten()
    }

    fn tokens(&self) -> Option<u32> {
        let tokens = self.call(|py, memory, object| {
            if !object.overrides.tokens {
                return Ok(None);
            }
            memory.call_method0(intern!(py, "tokens"))?.extract()
        });
        tokens.ok().flatten()
    }
}

impl Drop for PythonMemory {
    fn drop(&mut self) {
        Python::attach(|py| {
            self.object = Err(MemoryError::new("the memory is gone"));
            // Arrays in reference cycles keep the bank mapped until they are collected.
            if self.bank.as_ref().is_some_and(|bank| Arc::strong_count(bank) > 1) {
                let _ = py.import("gc").and_then(|gc| gc.call_method0("collect"));
            }
        });
    }
}

/// A `memtransfer.ServedQuery`.
fn served(py: Python<'_>, step: MemoryStep) -> PyResult<Bound<'_, PyAny>> {
    Classes::get(py)?.memory.served_query.bind(py).call1((step,))
}

/// A `memtransfer.Demonstration`, whose embeddings begin in the bank's row `first_row`.
fn demonstration<'py>(
    py: Python<'py>,
    world: &DeclaredWorld,
    of: &Demonstration<'_>,
    first_row: usize,
) -> PyResult<Bound<'py, PyAny>> {
    let steps = of.steps;
    let states = steps.iter().flat_map(|step| step.state.numbers()).copied();
    let states = numbers(py, "float32", states.map(f32::to_ne_bytes))?;
    let actions = steps.iter().map(|step| step.action.map_or(-1, |ActionCode(code)| code.into()));
    let feedback = steps.iter().map(|step| i32::from(step.feedback.0));
    let embeddings = Numbers::of_bank(of, first_row);
    let frames: Vec<Frame> =
        of.frames.iter().map(|frame: &Arc<SharedFrame>| Frame::shared(frame)).collect();
    Classes::get(py)?.memory.demonstration.bind(py).call1((
        of.instruction,
        states.call_method1("reshape", (steps.len(), world.declaration.state.len()))?,
        numbers(py, "int32", actions.map(i32::to_ne_bytes))?,
        numbers(py, "int32", feedback.map(i32::to_ne_bytes))?,
        as_array(py, embeddings)?,
        PyTuple::new(py, frames)?,
        world.object.bind(py),
    ))
}

/// A read-only array of numbers of four bytes.
fn numbers<'py>(
    py: Python<'py>,
    kind: &str,
    values: impl Iterator<Item = [u8; 4]>,
) -> PyResult<Bound<'py, PyAny>> {
    let bytes: Vec<u8> = values.flatten().collect();
    py.import("numpy")?.call_method1("frombuffer", (PyBytes::new(py, &bytes), kind))
}

/// A number of a demonstration or step.
fn number(value: PyResult<Bound<'_, PyAny>>) -> PyResult<u32> {
    let value = value?;
    value.extract().map_err(|_| {
        let value = value.repr().map_or_else(|_| "?".to_owned(), |value| value.to_string());
        PyValueError::new_err(format!("{value} is not the number of a demonstration or step"))
    })
}

/// The failure that an exception is to the run, which adds the memory's name. The traceback goes to the log. An interrupt is kept, and
/// ends serving.
fn failure(py: Python<'_>, raised: &PyErr, interrupt: &Interrupt) -> MemoryError {
    if !interrupt.keep(py, raised) {
        print(py, raised);
    }
    MemoryError::new(format_args!("raised {}", in_words(py, raised)))
}
