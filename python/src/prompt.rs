//! The benchmark's own prompt: rendering a request, encoding its images, reading an answer.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use domain::hex;
use domain::{DocumentKind, FeedbackCode, ImageFormat, State};
use peer::{
    ActionCode, CaptionedView, FrameView, Item, PastView, PlanView, PlannedActions, Request,
    StepView, StepsView, TextView,
};
use prompt::image::encode;
use prompt::{PartContent, Prompt, Template};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyString};

use crate::classes::{Classes, lossy};
use crate::declaration::DeclaredWorld;
use crate::frame::Frame;

/// Encoded views that are kept: most views of a request were in the request before.
const MAX_ENCODED: usize = 512;

/// The version of the prompt.
#[pyfunction]
pub(crate) fn version() -> &'static str {
    Template::built_in().version()
}

/// The texts of the prompt, as JSON.
#[pyfunction]
pub(crate) fn template() -> PyResult<String> {
    let texts: toml::Value = toml::from_str(Template::BUILT_IN_FILE)
        .map_err(|e| PyValueError::new_err(e.to_string()))?;
    serde_json::to_string(&texts).map_err(|error| PyValueError::new_err(error.to_string()))
}

/// The settings of the benchmark's requests to a model, as JSON; the choices are those of the warehouse.
#[pyfunction]
pub(crate) fn settings() -> String {
    prompt::request_settings(&warehouse::declaration()).to_string()
}

/// The system message and the parts of the user message: section, text, and the frame where the part is an image.
type Rendered<'py> = (String, Vec<(&'static str, Option<String>, Option<Bound<'py, Frame>>)>);

/// Renders `request`, with at most `image_budget` images.
#[pyfunction]
pub(crate) fn render<'py>(
    request: &Bound<'py, PyAny>,
    image_budget: u32,
) -> PyResult<Rendered<'py>> {
    let mut frames = Frames::default();
    let world = DeclaredWorld::read(&request.getattr("world")?)?;
    let read = ReadRequest::new(&world, request, &mut frames)?;
    let plans: Vec<_> = read.items.iter().map(ReadItem::plan).collect();
    let items: Vec<_> = read.items.iter().zip(&plans).map(|(item, plan)| item.view(plan)).collect();
    let request = Request {
        lane: 0,
        step: 0,
        episode: 0,
        episode_seed: 0,
        repeat: 1,
        instruction: &read.instruction,
        state: read.state,
        feedback: read.feedback,
        frame: read.frame,
        window: &read.window,
        items: &items,
        starts_as_demonstrated: read.starts_as_demonstrated,
        demonstrated_elsewhere: read.demonstrated_elsewhere,
        world: &world.declaration,
    };
    let prompt = Prompt::new(Template::built_in(), &request, image_budget);
    let parts = prompt.parts.into_iter().map(|part| {
        let section = part.section.name();
        match part.content {
            PartContent::Text(text) => (section, Some(text), None),
            PartContent::View(view) => (section, None, frames.of(&view)),
        }
    });
    Ok((prompt.system, parts.collect()))
}

/// Frames of a request. The id of a view is its place here.
#[derive(Default)]
struct Frames<'py>(Vec<Bound<'py, Frame>>);

impl<'py> Frames<'py> {
    fn view(&mut self, frame: &Bound<'py, PyAny>) -> PyResult<FrameView<'static>> {
        self.0.push(frame.cast::<Frame>()?.clone());
        Ok(FrameView { id: self.0.len() as u64 - 1, ..FrameView::NONE })
    }

    fn of(&self, view: &FrameView<'_>) -> Option<Bound<'py, Frame>> {
        self.0.get(usize::try_from(view.id).ok()?).cloned()
    }
}

/// A `memtransfer.Request`, as far as the prompt shows it.
struct ReadRequest {
    instruction: String,
    state: State,
    feedback: FeedbackCode,
    frame: FrameView<'static>,
    window: Vec<PastView<'static>>,
    items: Vec<ReadItem>,
    starts_as_demonstrated: bool,
    demonstrated_elsewhere: bool,
}

impl ReadRequest {
    fn new<'py>(
        world: &DeclaredWorld,
        request: &Bound<'py, PyAny>,
        frames: &mut Frames<'py>,
    ) -> PyResult<Self> {
        let frame = frames.view(&request.getattr("frame")?)?;
        let mut window = Vec::new();
        for past in request.getattr("window")?.try_iter()? {
            let past = past?;
            window.push(PastView {
                frame: frames.view(&past.getattr("frame")?)?,
                action: world.action_in(&past)?,
                feedback: world.feedback_in(&past)?,
            });
        }
        let mut items = Vec::new();
        for item in request.getattr("items")?.try_iter()? {
            items.push(ReadItem::new(world, &item?, frames)?);
        }
        Ok(Self {
            instruction: request.getattr("instruction")?.extract()?,
            state: world.state_in(request)?,
            feedback: world.feedback_in(request)?,
            frame,
            window,
            items,
            starts_as_demonstrated: request.getattr("starts_as_demonstrated")?.is_truthy()?,
            demonstrated_elsewhere: request.getattr("demonstrated_elsewhere")?.is_truthy()?,
        })
    }
}

/// An item of a request.
enum ReadItem {
    Text(DocumentKind, String),
    Steps {
        distance: Option<f32>,
        is_whole: bool,
        instruction: String,
        steps: Vec<StepView<'static>>,
    },
    Frame {
        frame: FrameView<'static>,
        caption: String,
        instruction: String,
    },
    /// For each part the instruction and the actions.
    Plan(Vec<(Option<String>, Vec<ActionCode>)>),
}

impl ReadItem {
    fn new<'py>(
        world: &DeclaredWorld,
        item: &Bound<'py, PyAny>,
        frames: &mut Frames<'py>,
    ) -> PyResult<Self> {
        let py = item.py();
        let classes = Classes::get(py)?;
        if item.is_instance(classes.document.bind(py))? {
            let kind = item.getattr("kind")?.extract::<u8>()?;
            let kind = DocumentKind::try_from(kind);
            let kind = kind.map_err(|problem| PyValueError::new_err(problem.to_string()))?;
            Ok(Self::Text(kind, item.getattr("text")?.extract()?))
        } else if item.is_instance(classes.segment.bind(py))? {
            let mut steps = Vec::new();
            for step in item.getattr("steps")?.try_iter()? {
                let step = step?;
                let frame = step.getattr("frame")?;
                let frame = if frame.is_none() { None } else { Some(frames.view(&frame)?) };
                steps.push(StepView { frame, action: world.action_in(&step)? });
            }
            Ok(Self::Steps {
                distance: item.getattr("distance")?.extract()?,
                is_whole: item.getattr("is_whole")?.is_truthy()?,
                instruction: item.getattr("instruction")?.extract()?,
                steps,
            })
        } else if item.is_instance(classes.remembered_view.bind(py))? {
            Ok(Self::Frame {
                frame: frames.view(&item.getattr("frame")?)?,
                caption: item.getattr("caption")?.extract()?,
                instruction: item.getattr("instruction")?.extract()?,
            })
        } else if item.is_instance(classes.supplied_plan.bind(py))? {
            let mut parts = Vec::new();
            for part in item.getattr("parts")?.try_iter()? {
                let part = part?;
                let mut actions = Vec::new();
                for action in part.getattr("actions")?.try_iter()? {
                    actions.push(world.known_action(&action?)?);
                }
                parts.push((part.getattr("instruction")?.extract()?, actions));
            }
            Ok(Self::Plan(parts))
        } else {
            Err(PyTypeError::new_err(format!(
                "an item of a request is a Document, a Segment, a RememberedView or a SuppliedPlan, but this is a {}",
                item.get_type().name()?
            )))
        }
    }

    /// The parts of a plan; none of another item.
    fn plan(&self) -> Vec<PlannedActions<'_>> {
        let Self::Plan(parts) = self else { return Vec::new() };
        let parts = parts.iter();
        parts
            .map(|(instruction, actions)| PlannedActions {
                instruction: instruction.as_deref(),
                actions,
            })
            .collect()
    }

    /// The item; `plan` are its parts if it is a plan.
    fn view<'a>(&'a self, plan: &'a [PlannedActions<'a>]) -> Item<'a> {
        match self {
            Self::Text(kind, text) => Item::Text(TextView { id: 0, kind: *kind, text }),
            Self::Steps { distance, is_whole, instruction, steps } => Item::Steps(StepsView {
                distance: *distance,
                is_whole: *is_whole,
                instruction,
                steps,
            }),
            Self::Frame { frame, caption, instruction } => {
                Item::Frame(CaptionedView { frame: *frame, caption, instruction })
            }
            Self::Plan(_) => Item::Plan(PlanView { parts: plan }),
        }
    }
}

/// The action of `world` that `text` names, or the outcome that says why there is none.
#[pyfunction]
pub(crate) fn read_answer<'py>(
    text: &Bound<'py, PyString>,
    cut_off: bool,
    world: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = text.py();
    let world = match world {
        Some(world) => DeclaredWorld::read(world)?,
        None => DeclaredWorld::warehouse(py)?,
    };
    let read = if cut_off { prompt::read_cut_off_answer } else { prompt::read_answer };
    match read(&world.declaration, &lossy(text)?) {
        Ok(action) => world.action(py, Some(action)),
        Err(why) => {
            let outcome = Classes::get(py)?.outcome.member(py, why.answer().outcome() as u8);
            Ok(outcome.into_pyobject(py)?)
        }
    }
}

/// The name of a frame's image in logs.
#[pyfunction]
pub(crate) fn image_name(frame: &Frame) -> String {
    format!("image:{}", hex(&frame.content_hash))
}

/// A frame as a PNG file, without its alpha channel.
#[pyfunction]
pub(crate) fn png<'py>(py: Python<'py>, frame: &Frame) -> PyResult<Bound<'py, PyBytes>> {
    if let Some(known) = cache().find(py, frame.content_hash) {
        return Ok(known);
    }
    let pixels = frame.bytes(py)?;
    let &Frame { id, content_hash, width, height, .. } = frame;
    let file = py.detach(|| {
        let view = FrameView { id, content_hash, width, height, pixels: &pixels };
        encode(&view, ImageFormat::Png)
    });
    let file = file.map_err(|problem| PyValueError::new_err(problem.to_string()))?;
    let bytes = PyBytes::new(py, &file);
    cache().insert(content_hash, &bytes);
    Ok(bytes)
}

/// The view that a PNG file shows, if [`png`] made it lately.
pub(crate) fn view_of_png(py: Python<'_>, file: &[u8]) -> Option<[u8; 16]> {
    let cache = cache();
    let mut files = cache.files.iter();
    files.find(|(_, known)| known.file.as_bytes(py) == file).map(|(&view, _)| view)
}

/// The last views that were encoded, by content.
#[derive(Default)]
struct PngCache {
    files: BTreeMap<[u8; 16], CachedFile>,
    /// Uses so far.
    clock: u64,
}

struct CachedFile {
    file: Py<PyBytes>,
    /// [`PngCache::clock`] when it was last used.
    used: u64,
}

fn cache() -> MutexGuard<'static, PngCache> {
    static CACHE: Mutex<PngCache> = Mutex::new(PngCache { files: BTreeMap::new(), clock: 0 });
    CACHE.lock().unwrap_or_else(PoisonError::into_inner)
}

impl PngCache {
    fn find<'py>(&mut self, py: Python<'py>, view: [u8; 16]) -> Option<Bound<'py, PyBytes>> {
        self.clock += 1;
        let known = self.files.get_mut(&view)?;
        known.used = self.clock;
        Some(known.file.bind(py).clone())
    }

    fn insert(&mut self, view: [u8; 16], file: &Bound<'_, PyBytes>) {
        if self.files.len() >= MAX_ENCODED
            && let Some((&oldest, _)) = self.files.iter().min_by_key(|(_, known)| known.used)
        {
            self.files.remove(&oldest);
        }
        self.files.insert(view, CachedFile { file: file.clone().unbind(), used: self.clock });
    }
}
