//! A step with everything that its request shows: pixels stay in shared memory, texts in their documents.

use std::ops::{Deref, Range};
use std::sync::Arc;

use case_book::WorldDeclaration;
use domain::ActionCode;
use shm_types::Frame;
use shm_types::documents::{Content, Document};
use shm_types::message::{
    DocumentId, FrameId, NO_FRAME, RequestId, TrajectoryStep, read_action, read_flag,
};

use super::join::{ItemContent, Ready, StepsKind, SuppliedStep, TextPart, bad_item};
use super::request::{
    CaptionedView, FrameView, Item, PastView, PlanView, PlannedActions, Request, StepView,
    StepsView, TextView,
};

/// The requests that wait at this moment, each of another lane. Dereferences to the requests.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    steps: &'a [Arc<PinnedStep>],
    requests: &'a [Request<'a>],
}

impl<'a> Batch<'a> {
    /// The same requests, each as an owned step that can be kept until it is answered.
    pub fn steps(&self) -> &'a [Arc<PinnedStep>] {
        self.steps
    }
}

impl<'a> Deref for Batch<'a> {
    type Target = [Request<'a>];

    fn deref(&self) -> &Self::Target {
        self.requests
    }
}

/// Calls `f` with the batch of `steps`.
pub(super) fn with_batch<R>(steps: &[Arc<PinnedStep>], f: impl FnOnce(&Batch<'_>) -> R) -> R {
    let views: Vec<StepViews<'_>> = steps.iter().map(|step| step.views()).collect();
    let items: Vec<_> = steps.iter().zip(&views).map(|(step, views)| step.items(views)).collect();
    let requests: Vec<Request<'_>> = steps
        .iter()
        .zip(views.iter().zip(&items))
        .map(|(step, (views, items))| step.request(views, items))
        .collect();
    f(&Batch { steps, requests: &requests })
}

/// A request that owns what it shows. Its frames and documents stay readable while it lives.
#[derive(Debug)]
pub struct PinnedStep {
    step: Ready,
    items: Vec<PinnedItem>,
    /// The steps of all items, in order.
    steps: Vec<SuppliedStep>,
    /// The parts of all plans, in order.
    plan_parts: Vec<PinnedPlanPart>,
    frames: Vec<Arc<Frame>>,
}

/// An item with its document.
#[derive(Debug)]
enum PinnedItem {
    Text(PinnedText),
    /// Steps in [`PinnedStep::steps`], and their demonstration's instruction.
    Steps {
        kind: StepsKind,
        steps: Range<usize>,
        instruction: Option<PinnedText>,
    },
    /// A step in [`PinnedStep::steps`] that has a view.
    Frame {
        step: usize,
        caption: Option<PinnedText>,
        instruction: Option<PinnedText>,
    },
    /// Parts in [`PinnedStep::plan_parts`].
    Plan(Range<usize>),
}

/// A part of a plan.
#[derive(Debug)]
struct PinnedPlanPart {
    /// Whether memory chose the actions itself.
    is_own: bool,
    instruction: Option<PinnedText>,
    actions: Vec<ActionCode>,
}

/// A part of a document, on character boundaries.
#[derive(Debug)]
struct PinnedText {
    document: Arc<Document>,
    bytes: Range<usize>,
}

impl PinnedStep {
    /// `step` with those of `documents` that it names.
    pub(super) fn new(step: Ready, documents: &[Arc<Document>]) -> Result<Self, String> {
        let (items, steps) = (Vec::with_capacity(step.recalled.items.len()), Vec::new());
        let (lane, number) = (step.lane, step.observed.step);
        let mut pinned = Self { step, items, steps, plan_parts: Vec::new(), frames: Vec::new() };
        for item in 0..pinned.step.recalled.items.len() {
            let added = pinned.add(item, documents);
            added.map_err(|problem| bad_item(lane, number, item, &problem))?;
        }
        Ok(pinned)
    }

    /// Adds an item of the recall, in the order of which frames are pinned.
    fn add(&mut self, item: usize, documents: &[Arc<Document>]) -> Result<(), String> {
        let recalled = &self.step.recalled;
        let named = |id: DocumentId| {
            let document = documents.iter().find(|document| document.id == id);
            document.ok_or_else(|| format!("names document {id}, which was never published"))
        };
        let text = |part: &TextPart| {
            let (document, bytes) = (Arc::clone(named(part.document)?), part.bytes.clone());
            let pinned = PinnedText { document, bytes };
            pinned.check().map(|()| pinned)
        };
        let text_if_any = |part: &Option<TextPart>| part.as_ref().map(text).transpose();
        let first = self.steps.len();
        match &recalled.items[item] {
            ItemContent::Text(part) => self.items.push(PinnedItem::Text(text(part)?)),
            ItemContent::Steps { kind, steps, instruction } => {
                let instruction = text_if_any(instruction)?;
                self.steps.extend_from_slice(&recalled.steps[steps.clone()]);
                let (kind, steps) = (*kind, first..self.steps.len());
                self.items.push(PinnedItem::Steps { kind, steps, instruction });
            }
            ItemContent::Trajectory { kind, document, steps, instructions } => {
                let document = named(*document)?;
                let demonstrations =
                    trajectories(document, steps)?.chunk_by(|a, b| a.trajectory == b.trajectory);
                check_count(instructions, demonstrations.clone().count())?;
                let world = &self.step.episode.world;
                for (demonstration, instruction) in demonstrations.zip(instructions) {
                    let instruction = text_if_any(instruction)?;
                    let first = self.steps.len();
                    for step in demonstration {
                        self.steps.push((step.frame, action_of(step, world, document.id)?));
                    }
                    let (kind, steps) = (*kind, first..self.steps.len());
                    self.items.push(PinnedItem::Steps { kind, steps, instruction });
                }
            }
            ItemContent::Frame { frame, caption, instruction } => {
                let (caption, instruction) = (text_if_any(caption)?, text_if_any(instruction)?);
                self.steps.push((*frame, None));
                self.items.push(PinnedItem::Frame { step: first, caption, instruction });
            }
            ItemContent::Plan { document, steps, instructions } => {
                let document = named(*document)?;
                let parts = trajectories(document, steps)?
                    .chunk_by(|a, b| (a.trajectory, a.own) == (b.trajectory, b.own));
                let supplied = parts.clone().filter(|part| part[0].own == 0).count();
                check_count(instructions, supplied)?;
                let mut instructions = instructions.iter();
                let world = &self.step.episode.world;
                let first = self.plan_parts.len();
                for part in parts {
                    let is_own = read_flag(part[0].own).map_err(|unknown| {
                        format!("has steps of document {}: {unknown}", document.id)
                    })?;
                    let instruction = if is_own { None } else { instructions.next() };
                    let instruction = text_if_any(instruction.unwrap_or(&None))?;
                    let action = |step: &TrajectoryStep| {
                        let action = action_of(step, world, document.id)?;
                        action.ok_or_else(|| "is a plan that has a step without action".to_owned())
                    };
                    let actions = part.iter().map(action).collect::<Result<_, _>>()?;
                    self.plan_parts.push(PinnedPlanPart { is_own, instruction, actions });
                }
                self.items.push(PinnedItem::Plan(first..self.plan_parts.len()));
            }
        }
        Ok(())
    }

    /// Identifies the request in its answer.
    pub fn id(&self) -> RequestId {
        RequestId {
            lane: self.step.lane,
            episode: self.step.episode.id,
            step: self.step.observed.step,
        }
    }

    /// All frames of the request, in order: the current view, the window, the items.
    pub fn frames(&self) -> &[Arc<Frame>] {
        &self.frames
    }

    /// Calls `f` with the request.
    pub fn with_request<R>(&self, f: impl FnOnce(&Request<'_>) -> R) -> R {
        let views = self.views();
        let items = self.items(&views);
        f(&self.request(&views, &items))
    }

    /// The ids of [`Self::frames`].
    pub(super) fn frame_ids(&self) -> Vec<FrameId> {
        let window = self.step.window.iter().map(|past| past.frame);
        let supplied = self.steps.iter().map(|&(frame, _)| frame);
        std::iter::once(self.step.observed.frame)
            .chain(window)
            .chain(supplied.filter(|&frame| frame != NO_FRAME))
            .collect()
    }

    /// Sets the frames of [`Self::frame_ids`].
    pub(super) fn pin(&mut self, frames: Vec<Arc<Frame>>) {
        self.frames = frames;
    }

    fn views(&self) -> StepViews<'_> {
        // In the order of `frame_ids`.
        let mut frames = self.frames.iter().map(|frame| FrameView::of(frame));
        let mut next = || frames.next().unwrap_or(FrameView::NONE);
        let frame = next();
        let window = self.step.window.iter();
        let window = window
            .map(|past| PastView { frame: next(), action: past.action, feedback: past.feedback })
            .collect();
        let steps = self.steps.iter();
        let steps = steps
            .map(|&(frame, action)| StepView { frame: (frame != NO_FRAME).then(&mut next), action })
            .collect();
        let plan_parts = self.plan_parts.iter();
        let plan_parts = plan_parts
            .map(|PinnedPlanPart { is_own, instruction, actions }| {
                let task = instruction.as_ref().map_or("", PinnedText::text);
                PlannedActions { instruction: (!is_own).then_some(task), actions }
            })
            .collect();
        StepViews { frame, window, steps, plan_parts }
    }

    fn items<'a>(&'a self, views: &'a StepViews<'a>) -> Vec<Item<'a>> {
        let text = |part: &'a Option<PinnedText>| part.as_ref().map_or("", PinnedText::text);
        let item = |item: &'a PinnedItem| match item {
            PinnedItem::Text(text) => Item::Text(text.view()),
            PinnedItem::Steps { kind: StepsKind { distance, is_whole }, steps, instruction } => {
                Item::Steps(StepsView {
                    distance: *distance,
                    is_whole: *is_whole,
                    instruction: text(instruction),
                    steps: &views.steps[steps.clone()],
                })
            }
            PinnedItem::Frame { step, caption, instruction } => Item::Frame(CaptionedView {
                frame: views.steps[*step].frame.unwrap_or(FrameView::NONE),
                caption: text(caption),
                instruction: text(instruction),
            }),
            PinnedItem::Plan(parts) => {
                Item::Plan(PlanView { parts: &views.plan_parts[parts.clone()] })
            }
        };
        self.items.iter().map(item).collect()
    }

    fn request<'a>(&'a self, views: &'a StepViews<'a>, items: &'a [Item<'a>]) -> Request<'a> {
        let Ready { lane, episode, observed, .. } = &self.step;
        Request {
            lane: *lane,
            step: observed.step,
            episode: episode.id,
            episode_seed: episode.seed,
            repeat: episode.repeat,
            instruction: &episode.instruction,
            state: observed.state,
            feedback: observed.feedback,
            frame: views.frame,
            window: &views.window,
            items,
            starts_as_demonstrated: episode.starts_as_demonstrated,
            demonstrated_elsewhere: episode.demonstrated_elsewhere,
            world: &episode.world,
        }
    }
}

impl PinnedText {
    /// Checks that the document has this text; an error continues "item 2 ...".
    fn check(&self) -> Result<(), String> {
        let Document { id, content, .. } = &*self.document;
        let Some(text) = content.text() else {
            let kind = content.kind().word();
            return Err(format!("has text of document {id}, which is of kind {kind}"));
        };
        match text.get(self.bytes.clone()) {
            Some(_) => Ok(()),
            None => Err(format!(
                "has the bytes {:?} of document {id}, which has {} and no characters that begin and end there",
                self.bytes,
                text.len()
            )),
        }
    }

    fn text(&self) -> &str {
        let text = self.document.content.text();
        text.and_then(|text| text.get(self.bytes.clone())).unwrap_or_default()
    }

    fn view(&self) -> TextView<'_> {
        let Range { start, end } = self.bytes;
        let id = u128::from(self.document.id) << 64 | (start as u128) << 32 | (end - start) as u128;
        TextView { id, kind: self.document.content.kind(), text: self.text() }
    }
}

/// The entries `steps` of a document of trajectories; an error continues "item 2 ...".
fn trajectories<'d>(
    document: &'d Document,
    steps: &Range<usize>,
) -> Result<&'d [TrajectoryStep], String> {
    let Content::Trajectories(content) = &document.content else {
        let (id, kind) = (document.id, document.content.kind().word());
        return Err(format!("has steps of document {id}, which is of kind {kind}"));
    };
    content.get(steps.clone()).ok_or_else(|| {
        format!("has the steps {steps:?} of document {} with {}", document.id, content.len())
    })
}

/// Checks the number of an item's instructions; an error continues "item 2 ...".
fn check_count(instructions: &[Option<TextPart>], expected: usize) -> Result<(), String> {
    match instructions.len() {
        count if count == expected => Ok(()),
        count => Err(format!("has {count} instructions, expected {expected}")),
    }
}

/// The action of a step of a document; an error continues "item 2 ...".
fn action_of(
    step: &TrajectoryStep,
    world: &WorldDeclaration,
    document: DocumentId,
) -> Result<Option<ActionCode>, String> {
    let action = read_action(step.action).and_then(|action| world.read_action(action));
    action.map_err(|unknown| format!("has steps of document {document}: {unknown}"))
}

/// The lists that a [`Request`] and its items borrow.
struct StepViews<'a> {
    frame: FrameView<'a>,
    window: Vec<PastView<'a>>,
    steps: Vec<StepView<'a>>,
    plan_parts: Vec<PlannedActions<'a>>,
}
