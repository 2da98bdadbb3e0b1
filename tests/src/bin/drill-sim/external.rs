//! The external memory of the simulated runs: what it supplies depends on everything that it was given, so that a wrong
//! bank, query or snapshot changes the episode.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use domain::Action;
use orchestrator::external_memory::ExternalMemory;
use peer::memory::{
    Demonstration, EpisodeEnd, Memory, MemoryDescription, MemoryError, MemoryItem, Method,
    PlanPart, Query, Source, Step, Views,
};

use crate::roles::pixels;

/// Its name, and its command.
pub(crate) const NAME: &str = "digest";

/// What it has learned, in the folder of a snapshot.
const FILE: &str = "digest";

/// Bytes of a digest.
const DIGEST: usize = 32;

pub(crate) fn method() -> Method<fn() -> DigestMemory> {
    let description = MemoryDescription {
        name: NAME.to_owned(),
        version: "1".to_owned(),
        embeddings: true,
        frames: true,
        deterministic: true,
        learns: true,
        sdk: "drill".to_owned(),
        code: "drill=0".to_owned(),
        ..MemoryDescription::default()
    };
    Method::new(description, DigestMemory::default)
}

/// As the orchestrator knows it.
pub(crate) fn memory() -> Result<ExternalMemory> {
    use peer::memory::MemoryMethod;
    let description = method().describe();
    Ok(ExternalMemory { index: 0, name: NAME.parse()?, description, command: Some(NAME.into()) })
}

/// A digest of all that was learned, and the steps of each demonstration and learned episode that have views.
#[derive(Default)]
pub(crate) struct DigestMemory {
    known: [u8; DIGEST],
    lengths: Vec<u32>,
    /// By lane: what was observed of the episode.
    observed: BTreeMap<u32, (blake3::Hasher, u32)>,
}

impl DigestMemory {
    /// Changes what is known.
    fn learn(&mut self, what: &blake3::Hasher, length: u32) {
        let mut hasher = blake3::Hasher::new_keyed(&self.known);
        hasher.update(what.finalize().as_bytes());
        self.known = *hasher.finalize().as_bytes();
        self.lengths.push(length);
    }
}

fn add_numbers(hasher: &mut blake3::Hasher, numbers: &[f32]) {
    for number in numbers {
        hasher.update(&number.to_le_bytes());
    }
}

fn add_step(hasher: &mut blake3::Hasher, step: &Step<'_>) {
    let Step { step: number, state, last_action, feedback, .. } = step;
    hasher.update(format!("{number} {state} {last_action:?} {feedback:?}").as_bytes());
    if let Some(frame) = &step.frame {
        hasher.update(&pixels(frame));
    }
    add_numbers(hasher, step.embedding.unwrap_or_default());
}

impl Memory for DigestMemory {
    fn build(&mut self, demonstrations: &[Demonstration<'_>]) -> Result<(), MemoryError> {
        for demonstration in demonstrations {
            let mut hasher = blake3::Hasher::new();
            hasher.update(demonstration.instruction.as_bytes());
            hasher.update(format!("{:?}", demonstration.steps).as_bytes());
            add_numbers(&mut hasher, demonstration.embeddings);
            for step in 0..demonstration.steps.len() {
                if let Some(frame) = demonstration.frame(step) {
                    hasher.update(&pixels(&frame));
                }
            }
            self.learn(&hasher, demonstration.steps.len() as u32);
        }
        Ok(())
    }

    fn observe(&mut self, step: &Step<'_>) -> Result<(), MemoryError> {
        if step.step == 0 {
            self.observed.remove(&step.lane);
        }
        let (hasher, length) = self.observed.entry(step.lane).or_default();
        add_step(hasher, step);
        *length = step.step;
        Ok(())
    }

    fn recall(&mut self, query: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError> {
        let mut hasher = blake3::Hasher::new_keyed(&self.known);
        hasher.update(query.instruction.as_bytes());
        add_step(&mut hasher, &query.now);
        for past in query.window {
            hasher
                .update(format!("{} {:?} {:?}", past.state, past.action, past.feedback).as_bytes());
            hasher.update(&past.frame.content_hash());
        }
        let digest = hasher.finalize();
        let draw = |place: usize, limit: u32| u32::from(digest.as_bytes()[place]) % limit.max(1);
        let text = format!(
            "{} {}",
            Action::ALL[draw(0, Action::ALL.len() as u32) as usize].words(),
            digest
        );
        let mut items = vec![MemoryItem::text(text)];
        if let Some(&length) = self.lengths.get(draw(1, self.lengths.len() as u32) as usize)
            && length > 0
        {
            let demonstration = draw(1, self.lengths.len() as u32);
            let first = draw(2, length);
            let count = 1 + draw(3, 3.min(length - first));
            let source = Source { demonstration, first, count };
            items.push(MemoryItem::Steps {
                source,
                views: Views::All,
                actions: true,
                distance: None,
            });
            let caption = format!("step {first}").into();
            items.push(MemoryItem::Frame {
                demonstration,
                step: first,
                caption,
                distance: Some(0.5),
            });
            let own = Action::ALL[draw(4, Action::ALL.len() as u32) as usize];
            let parts = vec![PlanPart::Steps(source), PlanPart::Own(own.into())];
            items.push(MemoryItem::Plan { parts });
        }
        Ok(items)
    }

    fn end_episode(&mut self, end: &EpisodeEnd<'_>) -> Result<(), MemoryError> {
        let observed = self.observed.remove(&end.lane);
        if end.demonstration.is_some() {
            let (mut hasher, length) = observed.unwrap_or_default();
            hasher.update(format!("{:?} {:?}", end.success, end.sub_goals).as_bytes());
            self.learn(&hasher, length);
        }
        Ok(())
    }

    fn save(&mut self, folder: &Path) -> Result<(), MemoryError> {
        let lengths = self.lengths.iter().flat_map(|length| length.to_le_bytes());
        let bytes: Vec<u8> = self.known.into_iter().chain(lengths).collect();
        durable::write_file(&folder.join(FILE), &bytes).map_err(MemoryError::new)
    }

    fn load(&mut self, folder: &Path) -> Result<(), MemoryError> {
        let bytes = durable::read(&folder.join(FILE)).map_err(MemoryError::new)?;
        let (known, lengths) = bytes.split_first_chunk().ok_or(MemoryError::new("too short"))?;
        self.known = *known;
        let lengths = lengths.chunks_exact(4);
        self.lengths =
            lengths.map(|four| four.iter().rev().fold(0, |n, &b| n << 8 | u32::from(b))).collect();
        Ok(())
    }
}
