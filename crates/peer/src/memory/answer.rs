//! The answer of an external memory as a message and a note.

use bytemuck::Zeroable;
use domain::ActionCode;
use shm_types::NoteTooLong;
use shm_types::documents::MAX_DOCUMENT_BYTES;
use shm_types::message::{
    AnswerItem, AnswerSource, ExternalAnswer, ItemKind, MAX_ACTIONS, MAX_ITEMS, MAX_PLAN,
    MAX_SOURCES, NO_ACTION, NOT_MEASURED,
};

use super::{MemoryError, MemoryItem, PlanPart, Source, Views};

/// An answer that has not been sent.
pub(super) struct UnsentAnswer {
    /// The message, without what identifies it.
    pub(super) message: ExternalAnswer,
    /// The texts and planned actions of its items.
    pub(super) note: Vec<u8>,
}

impl UnsentAnswer {
    /// No items.
    pub(super) fn empty() -> Self {
        let message = ExternalAnswer { tokens: NOT_MEASURED, ..Zeroable::zeroed() };
        Self { message, note: Vec::new() }
    }

    /// The memory cannot answer.
    pub(super) fn failed(error: MemoryError) -> Self {
        let mut answer = Self::empty();
        answer.message.failed = 1;
        answer.note = error.to_string().into_bytes();
        answer
    }

    /// These items.
    ///
    /// # Errors
    /// When there are too many, or their texts are too long.
    pub(super) fn of(items: &[MemoryItem]) -> Result<Self, MemoryError> {
        if items.len() > MAX_ITEMS {
            let count = items.len();
            return Err(MemoryError::new(format_args!(
                "{count} items, and at most {MAX_ITEMS} fit"
            )));
        }
        let mut answer = Self::empty();
        for (number, item) in (0..).zip(items) {
            let wire = answer.item(number, item)?;
            answer.message.items[number as usize] = wire;
        }
        answer.message.items_len = items.len() as u32;
        match answer.note.len() {
            bytes if bytes > MAX_DOCUMENT_BYTES => Err(MemoryError::new(NoteTooLong { bytes })),
            _ => Ok(answer),
        }
    }

    fn item(&mut self, number: u32, item: &MemoryItem) -> Result<AnswerItem, MemoryError> {
        let nothing = AnswerItem { distance: f32::NAN, ..Zeroable::zeroed() };
        Ok(match item {
            MemoryItem::Text { text, sources } => {
                sources.iter().try_for_each(|source| self.add_source(number, source))?;
                let (first_byte, bytes) = self.write(text.as_bytes());
                AnswerItem { kind: ItemKind::Text as u8, first_byte, bytes, ..nothing }
            }
            MemoryItem::Steps { source, views, actions, distance } => {
                let Source { demonstration, first, count } = *source;
                let (code, (first_byte, bytes)) = match views {
                    Views::None => (0, (0, 0)),
                    Views::All => (1, (0, 0)),
                    Views::Keyframes(steps) => {
                        let numbers: Vec<u8> = steps.iter().flat_map(|n| n.to_le_bytes()).collect();
                        (2, self.write(&numbers))
                    }
                };
                AnswerItem {
                    kind: ItemKind::Steps as u8,
                    demonstration,
                    first_step: first,
                    steps: count,
                    distance: distance.unwrap_or(f32::NAN),
                    views: code,
                    actions: (*actions).into(),
                    first_byte,
                    bytes,
                    reserved: 0,
                }
            }
            MemoryItem::Frame { demonstration, step, caption, distance } => {
                let (first_byte, bytes) = self.write(caption.as_bytes());
                AnswerItem {
                    kind: ItemKind::Frame as u8,
                    demonstration: *demonstration,
                    first_step: *step,
                    steps: 1,
                    distance: distance.unwrap_or(f32::NAN),
                    first_byte,
                    bytes,
                    ..nothing
                }
            }
            MemoryItem::Plan { parts } => {
                let count = |part: &PlanPart| match part {
                    PlanPart::Steps(source) => u64::from(source.count),
                    PlanPart::Own(_) => 1,
                };
                let planned: u64 = parts.iter().map(count).sum();
                if planned > MAX_PLAN as u64 {
                    return Err(MemoryError::new(format_args!(
                        "a plan has {planned} actions, and at most {MAX_PLAN} are allowed"
                    )));
                }
                let mut actions = Vec::with_capacity(planned as usize);
                for part in parts {
                    match part {
                        PlanPart::Steps(source) => {
                            self.add_source(number, source)?;
                            actions.resize(actions.len() + source.count as usize, NO_ACTION);
                        }
                        PlanPart::Own(ActionCode(code)) if usize::from(*code) < MAX_ACTIONS => {
                            actions.push(*code);
                        }
                        PlanPart::Own(ActionCode(code)) => {
                            return Err(MemoryError::new(format_args!(
                                "a plan has the action {code}, and the codes of actions are 0 to {}",
                                MAX_ACTIONS - 1
                            )));
                        }
                    }
                }
                let (first_byte, bytes) = self.write(&actions);
                AnswerItem { kind: ItemKind::Plan as u8, first_byte, bytes, ..nothing }
            }
        })
    }

    fn add_source(&mut self, item: u32, source: &Source) -> Result<(), MemoryError> {
        let used = self.message.sources_len as usize;
        let place = self.message.sources.get_mut(used).ok_or_else(|| {
            MemoryError::new(format_args!("texts and plans have more than {MAX_SOURCES} sources"))
        })?;
        let Source { demonstration, first, count } = *source;
        *place = AnswerSource { item, demonstration, first_step: first, steps: count };
        self.message.sources_len += 1;
        Ok(())
    }

    /// Appends to the note; returns first byte and number of bytes.
    fn write(&mut self, bytes: &[u8]) -> (u32, u32) {
        let first = self.note.len() as u32;
        self.note.extend_from_slice(bytes);
        (first, bytes.len() as u32)
    }
}
