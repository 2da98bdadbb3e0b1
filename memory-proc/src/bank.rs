//! A bank: the demonstrations that a memory is built from, in the form in which it is given them.

use std::ops::Range;

use domain::Pose;
use peer::memory::{self, DemonstrationStep};
use search::{ContentHash, Embedding};
use shm_types::BankContent;
use shm_types::banks::{BankDemonstration, BankStep};
use shm_types::message::{FrameId, NO_ACTION, NO_FRAME};

use crate::demonstrations::Demonstration;

/// Demonstrations, and the poses of their views.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Bank {
    /// The demonstrations, numbered from 0.
    pub demonstrations: Vec<Demonstration>,
    /// Their poses, each once, sorted.
    pub poses: Vec<Pose>,
}

/// What is known about a remembered view.
#[derive(Debug, Clone, Default)]
pub struct KnownView {
    /// Its frame, if it is in the frame store.
    pub frame: FrameId,
    /// Its content.
    pub content: ContentHash,
    /// Its embedding, if the memory asked for embeddings.
    pub embedding: Option<Embedding>,
}

impl Bank {
    /// A bank of these demonstrations.
    pub fn new(demonstrations: Vec<Demonstration>) -> Self {
        let poses = demonstrations.iter().flat_map(|demonstration| &demonstration.poses);
        let mut poses: Vec<Pose> = poses.copied().collect();
        poses.sort_unstable();
        poses.dedup();
        Self { demonstrations, poses }
    }

    /// The steps of all demonstrations with what is known about their views. `None` while a view is not known.
    pub fn with_views(&self, view: impl Fn(Pose) -> Option<KnownView>) -> Option<BankSteps<'_>> {
        let mut found = BankSteps::without_views(self);
        for (at, pose) in self.demonstrations.iter().flat_map(|of| &of.poses).enumerate() {
            let KnownView { frame, content, embedding } = view(*pose)?;
            found.frames.push(frame);
            found.steps[at].content_hash = content;
            if let Some(embedding) = embedding {
                found.embeddings.extend_from_slice(embedding.as_slice());
            }
        }
        Some(found)
    }
}

/// The steps of a bank's demonstrations, one demonstration after the other, with their views.
#[derive(Debug)]
pub struct BankSteps<'a> {
    bank: &'a Bank,
    steps: Vec<DemonstrationStep>,
    embeddings: Vec<f32>,
    frames: Vec<FrameId>,
}

impl<'a> BankSteps<'a> {
    /// The steps without views.
    pub fn without_views(bank: &'a Bank) -> Self {
        let steps = bank.demonstrations.iter().flat_map(|demonstration| {
            let states = demonstration.poses.iter().zip(&demonstration.feedback).enumerate();
            states.map(|(at, (&pose, &feedback))| DemonstrationStep {
                pose,
                action: demonstration.actions.get(at).copied(),
                feedback,
                content_hash: [0; 16],
            })
        });
        Self { bank, steps: steps.collect(), embeddings: Vec::new(), frames: Vec::new() }
    }

    /// Each demonstration with its place in the lists.
    fn places(&self) -> impl Iterator<Item = (&'a Demonstration, Range<usize>)> {
        let mut first = 0;
        self.bank.demonstrations.iter().map(move |demonstration| {
            let place = first..first + demonstration.poses.len();
            first = place.end;
            (demonstration, place)
        })
    }

    /// As a built-in memory is given them.
    pub fn demonstrations(&self) -> Vec<memory::Demonstration<'_>> {
        let dimension = self.embeddings.len().checked_div(self.steps.len()).unwrap_or(0);
        let given = self.places().map(|(demonstration, place)| memory::Demonstration {
            instruction: &demonstration.instruction,
            embeddings: &self.embeddings[place.start * dimension..place.end * dimension],
            steps: &self.steps[place],
            frames: &[],
            stages: &demonstration.stages,
            bank: None,
        });
        given.collect()
    }

    /// As an external memory is given them, with or without frames.
    pub fn content(self, with_frames: bool) -> BankContent {
        let mut content = BankContent::default();
        for (demonstration, place) in self.places() {
            content.demonstrations.push(BankDemonstration {
                first_step: place.start as u32,
                steps: place.len() as u32,
                first_byte: content.text.len() as u32,
                bytes: demonstration.instruction.len() as u32,
            });
            content.text.push_str(&demonstration.instruction);
        }
        let frame = |at: usize| self.frames.get(at).copied().filter(|_| with_frames);
        let steps = self.steps.iter().enumerate().map(|(at, step)| BankStep {
            frame: frame(at).unwrap_or(NO_FRAME),
            content_hash: step.content_hash,
            pose: step.pose.into(),
            action: step.action.map_or(NO_ACTION, |action| action as u8),
            feedback: step.feedback as u8,
            reserved: [0; 2],
        });
        content.steps = steps.collect();
        content.embeddings = self.embeddings;
        content
    }
}
