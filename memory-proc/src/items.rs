//! From a memory's items to a recall: references are checked, budgets applied, views and actions looked up, texts
//! published.
//!
//! This is the only place that knows what a memory may supply: steps of the demonstrations in its bank, and texts and actions
//! of its own. Every memory passes through it, the built-in ones too.

use std::collections::HashMap;
use std::sync::Arc;

use bytemuck::Zeroable;
use domain::ActionCode;
use peer::WorldDeclaration;
use peer::memory::{MemoryItem, PlanPart, Source, Views};
use shm_types::documents::Content;
use shm_types::message::{
    DocumentId, FrameId, ItemKind, MAX_ITEMS, MAX_PLAN, MAX_SEGMENT, MAX_SOURCES, MAX_STEPS,
    NO_DOCUMENT, NO_FRAME, RecalledInstruction, RecalledItem, RecalledSource, SegmentStep,
    TrajectoryStep, action_code,
};

use crate::bank::MemoryBank;
use crate::demonstrations::{RememberedDemonstration, ViewId};

/// Publishes the documents that recalls name.
pub trait DocumentSupplier {
    /// Publishes a document for one episode (lane and number).
    ///
    /// # Errors
    /// When it cannot be published.
    fn publish(&mut self, episode: (u32, u64), content: &Content) -> anyhow::Result<DocumentId>;

    /// The text of a document over the demonstrations of all cases, which is published for the whole run.
    ///
    /// # Errors
    /// When it is missing, not usable, or cannot be published.
    fn consolidated(
        &mut self,
        kind: domain::DocumentKind,
        set: domain::Demonstrations,
    ) -> anyhow::Result<Arc<str>>;

    /// The document that [`Self::consolidated`] published for this text; `None` for any other text.
    fn published(&self, text: &Arc<str>) -> Option<DocumentId>;
}

/// Most of what one recall may contain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budgets {
    /// Images.
    pub images: u32,
    /// Bytes of text.
    pub text: u32,
}

/// How much a memory asked to supply, and how much is supplied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Amount {
    /// Items.
    pub items: u16,
    /// Images.
    pub images: u32,
    /// Bytes of text.
    pub text: u32,
}

/// An answer whose references exist, cut to the budgets.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckedAnswer {
    /// The answer as it was given.
    given: Vec<MemoryItem>,
    /// What the recall will consist of.
    parts: Vec<Part>,
    /// What was asked for.
    pub asked: Amount,
    /// What is supplied.
    pub supplied: Amount,
    /// The views that are supplied, each once.
    pub view_ids: Vec<ViewId>,
}

/// One item of a recall: the memory's items with these numbers. Several only if they are whole demonstrations that the
/// message has no room for: they are one document.
#[derive(Debug, Clone, PartialEq)]
struct Part {
    kind: ItemKind,
    whole: bool,
    items: Vec<usize>,
}

impl CheckedAnswer {
    /// Checks the items of a memory that was built from `bank` in the world `world`.
    ///
    /// # Errors
    /// When an item names something that is not in the bank or an action that the world does not have, or there are too many
    /// items, sources or actions.
    pub fn new(
        given: Vec<MemoryItem>,
        bank: &MemoryBank,
        world: &WorldDeclaration,
        budgets: Budgets,
    ) -> Result<Self, String> {
        let mut sources = 0;
        for (number, item) in given.iter().enumerate() {
            sources += check(item, bank, world).map_err(|what| format!("item {number} {what}"))?;
        }
        if sources > MAX_SOURCES {
            return Err(format!("it has {sources} sources, and at most {MAX_SOURCES} are allowed"));
        }
        let (mut asked, mut supplied) = (Amount::default(), Amount::default());
        let (mut kept, mut view_ids) = (Vec::new(), Vec::new());
        for (number, item) in given.iter().enumerate() {
            let Amount { images, text, .. } = amount(item);
            asked.items += 1;
            asked.images = asked.images.saturating_add(images);
            asked.text = asked.text.saturating_add(text);
            let fits =
                images <= budgets.images - supplied.images && text <= budgets.text - supplied.text;
            if fits {
                supplied.items += 1;
                supplied.images += images;
                supplied.text += text;
                kept.push(number);
                view_ids.extend(views(item, bank));
            }
        }
        view_ids.sort_unstable();
        view_ids.dedup();
        let parts = parts(&given, &kept, bank);
        if parts.len() > MAX_ITEMS {
            let count = parts.len();
            return Err(format!("it has {count} items, and at most {MAX_ITEMS} are allowed"));
        }
        Ok(Self { given, parts, asked, supplied, view_ids })
    }

    /// Whether a memory gave just these items.
    pub fn is_of(&self, items: &[MemoryItem]) -> bool {
        self.given == items
    }
}

/// The items of the recall for the kept ones of `given`.
fn parts(given: &[MemoryItem], kept: &[usize], bank: &MemoryBank) -> Vec<Part> {
    let is_frame = |&&number: &&usize| matches!(given[number], MemoryItem::Frame { .. });
    let mut room = MAX_STEPS.saturating_sub(kept.iter().filter(is_frame).count());
    let mut parts: Vec<Part> = Vec::new();
    for &number in kept {
        let (mut kind, mut whole, mut joins) = (ItemKind::Text, false, false);
        match &given[number] {
            MemoryItem::Text { .. } => {}
            MemoryItem::Frame { .. } => kind = ItemKind::Frame,
            MemoryItem::Plan { .. } => kind = ItemKind::Plan,
            MemoryItem::Steps { source, views, distance, .. } => {
                let count = source.count as usize;
                let length = bank.demonstrations[source.demonstration as usize].states.len();
                whole = count == length;
                if count > MAX_SEGMENT.min(room) || matches!(views, Views::Keyframes(_)) {
                    kind = ItemKind::Trajectory;
                    joins = whole && distance.is_none();
                } else {
                    kind = ItemKind::Steps;
                    room -= count;
                }
            }
        }
        match parts.last_mut() {
            Some(last) if joins && last.joins(given) => last.items.push(number),
            _ => parts.push(Part { kind, whole, items: vec![number] }),
        }
    }
    parts
}

impl Part {
    /// Whether further whole demonstrations can become part of this item.
    fn joins(&self, given: &[MemoryItem]) -> bool {
        let is_close =
            |&number: &usize| matches!(given[number], MemoryItem::Steps { distance: None, .. });
        self.kind == ItemKind::Trajectory && self.whole && self.items.iter().all(is_close)
    }
}

/// Checks the references of an item; returns the number of its sources.
fn check(item: &MemoryItem, bank: &MemoryBank, world: &WorldDeclaration) -> Result<usize, String> {
    match item {
        MemoryItem::Text { sources, .. } => {
            sources.iter().try_for_each(|source| demonstration(source, bank).map(drop))?;
            Ok(sources.len())
        }
        MemoryItem::Steps { source, views, actions, distance } => {
            demonstration(source, bank)?;
            let steps = source.first..source.first + source.count;
            match views {
                Views::None if !actions => {
                    return Err("supplies neither views nor actions".to_owned());
                }
                Views::None | Views::All => {}
                Views::Keyframes(shown) => {
                    if let Some(step) = shown.iter().find(|step| !steps.contains(step)) {
                        return Err(format!(
                            "shows step {step}, which is not one of its steps {} to {}",
                            steps.start,
                            steps.end.saturating_sub(1)
                        ));
                    }
                    if !shown.is_sorted_by(|a, b| a < b) {
                        return Err("names its keyframes in no ascending order".to_owned());
                    }
                }
            }
            finite(*distance)
        }
        MemoryItem::Frame { demonstration: number, step, distance, .. } => {
            let source = Source { demonstration: *number, first: *step, count: 1 };
            demonstration(&source, bank)?;
            finite(*distance)
        }
        MemoryItem::Plan { parts } => check_plan(parts, bank, world),
    }
}

/// Checks the parts of a plan; returns the number of its sources.
fn check_plan(
    parts: &[PlanPart],
    bank: &MemoryBank,
    world: &WorldDeclaration,
) -> Result<usize, String> {
    let (mut sources, mut planned) = (0, 0);
    for part in parts {
        match part {
            PlanPart::Steps(source) => {
                demonstration(source, bank)?;
                sources += 1;
                planned += u64::from(source.count);
            }
            &PlanPart::Own(ActionCode(code)) => {
                let count = world.actions.len();
                if world.action(code).is_none() {
                    return Err(format!(
                        "plans action {code}, but the world has {count} actions (from 0)"
                    ));
                }
                planned += 1;
            }
        }
    }
    if planned > MAX_PLAN as u64 {
        return Err(format!("plans {planned} actions, and at most {MAX_PLAN} are allowed"));
    }
    if planned_actions(parts, bank).is_empty() {
        return Err("is a plan without actions".to_owned());
    }
    Ok(sources)
}

/// The actions of a checked plan from one place: from a demonstration, or of the memory's own.
struct PlannedActions {
    /// Number of the demonstration.
    demonstration: Option<u32>,
    actions: Vec<ActionCode>,
}

/// The actions of the parts of a plan. Consecutive actions of the memory's own are one part, and a part without actions is none.
fn planned_actions(parts: &[PlanPart], bank: &MemoryBank) -> Vec<PlannedActions> {
    let mut planned: Vec<PlannedActions> = Vec::new();
    for part in parts {
        match (*part, planned.last_mut()) {
            (PlanPart::Own(action), Some(PlannedActions { demonstration: None, actions })) => {
                actions.push(action);
            }
            (PlanPart::Own(action), _) => {
                planned.push(PlannedActions { demonstration: None, actions: vec![action] });
            }
            (PlanPart::Steps(Source { demonstration, first, count }), _) => {
                let all = &bank.demonstrations[demonstration as usize].actions;
                let actions = all.iter().skip(first as usize).take(count as usize);
                let actions: Vec<ActionCode> = actions.copied().flatten().collect();
                if !actions.is_empty() {
                    planned.push(PlannedActions { demonstration: Some(demonstration), actions });
                }
            }
        }
    }
    planned
}

fn finite(distance: Option<f32>) -> Result<usize, String> {
    match distance {
        Some(distance) if !distance.is_finite() => {
            Err(format!("has the distance {distance}, expected a finite number"))
        }
        _ => Ok(1),
    }
}

/// The demonstration of a source, if it has these steps.
fn demonstration<'b>(
    source: &Source,
    bank: &'b MemoryBank,
) -> Result<&'b RememberedDemonstration, String> {
    let &Source { demonstration: number, first, count } = source;
    let all = &bank.demonstrations;
    let demonstration = all.get(number as usize).ok_or_else(|| {
        format!("names demonstration {number}, but the bank has {} (from 0)", all.len())
    })?;
    let length = demonstration.states.len();
    let end = u64::from(first) + u64::from(count);
    if count == 0 || end > length as u64 {
        return Err(format!(
            "names {count} steps from step {first} of demonstration {number}, which has {length} steps (from 0)"
        ));
    }
    Ok(demonstration)
}

fn amount(item: &MemoryItem) -> Amount {
    let (images, text) = match item {
        MemoryItem::Text { text, .. } => (0, text.len()),
        MemoryItem::Steps { source, views, .. } => match views {
            Views::None => (0, 0),
            Views::All => (source.count as usize, 0),
            Views::Keyframes(shown) => (shown.len(), 0),
        },
        MemoryItem::Frame { caption, .. } => (1, caption.len()),
        MemoryItem::Plan { .. } => (0, 0),
    };
    let short = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    Amount { items: 1, images: short(images), text: short(text) }
}

/// The views that a checked item shows.
fn views(item: &MemoryItem, bank: &MemoryBank) -> Vec<ViewId> {
    let at = |of: u32, step: u32| bank.demonstrations[of as usize].views[step as usize];
    match item {
        MemoryItem::Text { .. }
        | MemoryItem::Plan { .. }
        | MemoryItem::Steps { views: Views::None, .. } => Vec::new(),
        MemoryItem::Steps { source, views: Views::All, .. } => {
            let steps = source.first..source.first + source.count;
            steps.map(|step| at(source.demonstration, step)).collect()
        }
        MemoryItem::Steps { source, views: Views::Keyframes(shown), .. } => {
            shown.iter().map(|&step| at(source.demonstration, step)).collect()
        }
        MemoryItem::Frame { demonstration, step, .. } => vec![at(*demonstration, *step)],
    }
}

/// The part of a recall and its trace that follows from an answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AssembledRecall {
    /// Items in use.
    pub items_len: u32,
    /// The items.
    pub items: [RecalledItem; MAX_ITEMS],
    /// Steps in use.
    pub steps_len: u32,
    /// The steps.
    pub steps: [SegmentStep; MAX_STEPS],
    /// Instructions in use.
    pub instructions_len: u32,
    /// The instructions of the demonstrations that items come from.
    pub instructions: [RecalledInstruction; MAX_SOURCES],
    /// Sources in use.
    pub sources_len: u32,
    /// The sources.
    pub sources: [RecalledSource; MAX_SOURCES],
}

/// The texts that were published for an episode, also instructions: document and first byte of each.
pub type PublishedTexts = HashMap<Arc<str>, (DocumentId, u32)>;

/// Puts recalls together.
pub struct Assembler<'a> {
    /// The demonstrations that the memory was built from.
    pub bank: &'a MemoryBank,
    /// Lane and number of the episode.
    pub episode: (u32, u64),
    /// The texts that were published for the episode.
    pub texts: &'a mut PublishedTexts,
    /// Publishes further ones.
    pub documents: &'a mut dyn DocumentSupplier,
}

impl Assembler<'_> {
    /// Puts together what an answer supplies. `frame` returns the frame of a view; all those of the answer are resident.
    ///
    /// # Errors
    /// When a document cannot be published.
    pub fn assemble(
        &mut self,
        answer: &CheckedAnswer,
        frame: impl Fn(ViewId) -> Option<FrameId>,
    ) -> anyhow::Result<AssembledRecall> {
        self.publish_texts(answer)?;
        let trajectories = self.publish_trajectories(answer, &frame)?;
        let mut next_step = 0;
        let mut recall = AssembledRecall::empty();
        for Part { kind, whole, items } in &answer.parts {
            let mut item = RecalledItem { kind: *kind as u8, ..NOTHING };
            item.whole = (*whole).into();
            match &answer.given[items[0]] {
                MemoryItem::Text { text, .. } => {
                    (item.document, item.first_byte, item.bytes) = self.place(text);
                }
                MemoryItem::Frame { caption, distance, .. } => {
                    (item.document, item.first_byte, item.bytes) = self.place(caption);
                    item.distance = distance.unwrap_or(f32::NAN);
                }
                MemoryItem::Steps { distance, .. } => item.distance = distance.unwrap_or(f32::NAN),
                MemoryItem::Plan { .. } => {}
            }
            match kind {
                ItemKind::Text => {}
                ItemKind::Steps | ItemKind::Frame => {
                    let steps = self.steps(&answer.given[items[0]], &frame);
                    (item.first_step, item.steps) = recall.add_steps(&steps);
                }
                ItemKind::Trajectory | ItemKind::Plan => {
                    let counts = items.iter().map(|&of| self.steps_of(&answer.given[of]));
                    (item.first_step, item.steps) = (next_step, counts.sum());
                    item.document = trajectories;
                    next_step += item.steps;
                }
            }
            let number = recall.items_len as u8;
            item.first_instruction = recall.instructions_len as u8;
            for &of in items {
                for instruction in instructions_of(&answer.given[of], self.bank) {
                    let (document, first_byte, bytes) = self.place(instruction);
                    recall.add_instruction(RecalledInstruction { document, first_byte, bytes });
                    item.instructions += 1;
                }
                recall.add_sources(&answer.given[of], self.bank, number, *kind);
            }
            recall.items[usize::from(number)] = item;
            recall.items_len += 1;
        }
        Ok(recall)
    }

    /// Publishes the texts and instructions that have not been published for the episode, as one document.
    fn publish_texts(&mut self, answer: &CheckedAnswer) -> anyhow::Result<()> {
        let mut note = String::new();
        let mut new: Vec<(Arc<str>, u32)> = Vec::new();
        for &number in answer.parts.iter().flat_map(|part| &part.items) {
            let item = &answer.given[number];
            let text = match item {
                MemoryItem::Text { text, .. } => Some(text.clone()),
                MemoryItem::Frame { caption, .. } => {
                    Some(caption.clone()).filter(|of| !of.is_empty())
                }
                MemoryItem::Steps { .. } | MemoryItem::Plan { .. } => None,
            };
            let instructions = instructions_of(item, self.bank).into_iter();
            let instructions = instructions.filter(|of| !of.is_empty()).map(Arc::from);
            for text in text.into_iter().chain(instructions) {
                if self.texts.contains_key(&text) || new.iter().any(|(known, _)| *known == text) {
                    continue;
                }
                if let Some(document) = self.documents.published(&text) {
                    self.texts.insert(text, (document, 0));
                } else {
                    new.push((text.clone(), note.len() as u32));
                    note.push_str(&text);
                }
            }
        }
        if !new.is_empty() {
            let document = self.documents.publish(self.episode, &Content::Note(note))?;
            let new = new.into_iter().map(|(text, first_byte)| (text, (document, first_byte)));
            self.texts.extend(new);
        }
        Ok(())
    }

    /// Where a published text is: document, first byte and bytes.
    fn place(&self, text: &str) -> (DocumentId, u32, u32) {
        let (document, first_byte) = self.texts.get(text).copied().unwrap_or((NO_DOCUMENT, 0));
        (document, first_byte, text.len() as u32)
    }

    /// Publishes the steps of all trajectories and plans of an answer as one document.
    fn publish_trajectories(
        &mut self,
        answer: &CheckedAnswer,
        frame: &impl Fn(ViewId) -> Option<FrameId>,
    ) -> anyhow::Result<DocumentId> {
        let is_long = |part: &&Part| matches!(part.kind, ItemKind::Trajectory | ItemKind::Plan);
        let long = answer.parts.iter().filter(is_long);
        let mut steps = Vec::new();
        // Every part has a source or comes after one: there are fewer than 256.
        let mut trajectory = 0;
        for &number in long.flat_map(|part| &part.items) {
            let step = |frame, action, trajectory, own| TrajectoryStep {
                frame,
                action,
                trajectory,
                own,
                reserved: [0; 5],
            };
            if let MemoryItem::Plan { parts } = &answer.given[number] {
                for PlannedActions { demonstration, actions } in planned_actions(parts, self.bank) {
                    let own = demonstration.is_none().into();
                    let actions = actions.into_iter();
                    steps.extend(actions.map(|action| step(NO_FRAME, action.0, trajectory, own)));
                    trajectory += 1;
                }
            } else {
                let supplied = self.steps(&answer.given[number], frame).into_iter();
                steps.extend(supplied.map(|of| step(of.frame, of.action, trajectory, 0)));
                trajectory += 1;
            }
        }
        if steps.is_empty() {
            return Ok(NO_DOCUMENT);
        }
        self.documents.publish(self.episode, &Content::Trajectories(steps))
    }

    /// The views and actions of an item.
    fn steps(
        &self,
        item: &MemoryItem,
        frame: &impl Fn(ViewId) -> Option<FrameId>,
    ) -> Vec<SegmentStep> {
        let (source, views, actions) = match item {
            MemoryItem::Text { .. } | MemoryItem::Plan { .. } => return Vec::new(),
            MemoryItem::Steps { source, views, actions, .. } => (*source, views, *actions),
            &MemoryItem::Frame { demonstration, step, .. } => {
                (Source { demonstration, first: step, count: 1 }, &Views::All, false)
            }
        };
        let demonstration = &self.bank.demonstrations[source.demonstration as usize];
        let steps = source.first..source.first + source.count;
        let last = steps.end - 1;
        let step = |at: u32| {
            let is_shown = match views {
                Views::None => false,
                Views::All => true,
                Views::Keyframes(shown) => shown.binary_search(&at).is_ok(),
            };
            let view = is_shown.then(|| frame(demonstration.views[at as usize])).flatten();
            let action = demonstration.actions.get(at as usize).copied().flatten();
            let action = action.filter(|_| actions && at < last);
            SegmentStep {
                frame: view.unwrap_or(NO_FRAME),
                action: action_code(action),
                reserved: [0; 7],
            }
        };
        steps.map(step).collect()
    }

    /// Number of steps of an item; of a plan, that of its actions.
    fn steps_of(&self, item: &MemoryItem) -> u32 {
        match item {
            MemoryItem::Text { .. } => 0,
            MemoryItem::Steps { source, .. } => source.count,
            MemoryItem::Frame { .. } => 1,
            MemoryItem::Plan { parts } => {
                let planned = planned_actions(parts, self.bank);
                planned.iter().map(|part| part.actions.len() as u32).sum()
            }
        }
    }
}

/// An item without text, steps and distance.
const NOTHING: RecalledItem = RecalledItem {
    document: NO_DOCUMENT,
    distance: f32::NAN,
    first_step: 0,
    steps: 0,
    first_byte: 0,
    bytes: 0,
    kind: 0,
    whole: 0,
    first_instruction: 0,
    instructions: 0,
};

/// The instructions of the demonstrations that an item shows steps or actions of; none for a text.
fn instructions_of<'b>(item: &MemoryItem, bank: &'b MemoryBank) -> Vec<&'b str> {
    let numbers = match item {
        MemoryItem::Text { .. } => Vec::new(),
        MemoryItem::Steps { source, .. } => vec![source.demonstration],
        MemoryItem::Frame { demonstration, .. } => vec![*demonstration],
        MemoryItem::Plan { parts } => {
            let planned = planned_actions(parts, bank).into_iter();
            planned.filter_map(|part| part.demonstration).collect()
        }
    };
    let instruction = |number: u32| &*bank.demonstrations[number as usize].instruction;
    numbers.into_iter().map(instruction).collect()
}

impl AssembledRecall {
    fn empty() -> Self {
        Self {
            items_len: 0,
            items: [NOTHING; MAX_ITEMS],
            steps_len: 0,
            steps: [Zeroable::zeroed(); MAX_STEPS],
            instructions_len: 0,
            instructions: [Zeroable::zeroed(); MAX_SOURCES],
            sources_len: 0,
            sources: [Zeroable::zeroed(); MAX_SOURCES],
        }
    }

    /// Adds steps, for which there is room; returns the first and their number.
    fn add_steps(&mut self, steps: &[SegmentStep]) -> (u32, u32) {
        let (first, count) = (self.steps_len, steps.len() as u32);
        self.steps[first as usize..][..steps.len()].copy_from_slice(steps);
        self.steps_len += count;
        (first, count)
    }

    /// Adds an instruction. There is room, because every item that has one also has a source.
    fn add_instruction(&mut self, instruction: RecalledInstruction) {
        self.instructions[self.instructions_len as usize] = instruction;
        self.instructions_len += 1;
    }

    fn add_sources(&mut self, item: &MemoryItem, bank: &MemoryBank, number: u8, kind: ItemKind) {
        let (sources, distance) = match item {
            MemoryItem::Text { sources, .. } => (sources.clone(), None),
            MemoryItem::Steps { source, distance, .. } => (vec![*source], *distance),
            &MemoryItem::Frame { demonstration, step, distance, .. } => {
                (vec![Source { demonstration, first: step, count: 1 }], distance)
            }
            MemoryItem::Plan { parts } => {
                let source = |part: &PlanPart| match part {
                    PlanPart::Steps(source) => Some(*source),
                    PlanPart::Own(_) => None,
                };
                (parts.iter().filter_map(source).collect(), None)
            }
        };
        for Source { demonstration, first, count } in sources {
            let &RememberedDemonstration { case, number: of, .. } =
                &*bank.demonstrations[demonstration as usize];
            self.sources[self.sources_len as usize] = RecalledSource {
                case,
                distance: distance.unwrap_or(f32::NAN),
                demonstration: of,
                first: first as u16,
                steps: count as u16,
                item: number,
                kind: kind as u8,
            };
            self.sources_len += 1;
        }
    }
}

#[cfg(test)]
mod tests;
