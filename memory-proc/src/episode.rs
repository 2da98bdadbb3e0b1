//! A running episode as memory knows it: what was seen and done, how far the task is, what is open.

use anyhow::Context;
use domain::{Action, Feedback, Pose, Representation, SegmentContent};
use shm_types::message::{
    FrameId, MAX_WINDOW, MemoryEpisodeConfig, NO_ACTION, NOT_MEASURED, Observation, PastStep,
    Recall, RecallTrace, SegmentStep,
};
use shm_types::message::{MAX_DOCUMENTS, MAX_SEGMENT, NO_DOCUMENT, NO_FRAME};
use warehouse::{CaseSet, Demonstrations, Progress, Warehouse};

use crate::demonstrations;
use crate::embedding::{ContentHash, Embedding};
use crate::representation::working::Window;
use crate::representation::{
    Blueprint, Documents, Ingredients, Memory, Retrieved, Situation, Supply, View, Views, blueprint,
};

/// A message that cannot be used: what, which value, what was expected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Unusable(pub(crate) String);

/// Makes an [`Unusable`] from a format string.
macro_rules! unusable {
    ($($text:tt)*) => { $crate::episode::Unusable(format!($($text)*)) };
}
pub(crate) use unusable;

/// An observation that waits for its recall.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Question {
    pub(crate) received_ns: u64,
    /// The current view; `None` when the memory does not look at it.
    pub(crate) content: Option<ContentHash>,
}

pub(crate) struct Episode {
    pub(crate) ticket: u64,
    pub(crate) lane: u32,
    pub(crate) representation: Representation,
    pub(crate) blueprint: Box<dyn Blueprint>,
    /// Whether its views are held.
    pub(crate) admitted: bool,
    /// Views of the blueprint, from the first, that are there; none any more once the memory is built.
    views: Views,
    memory: Option<Box<dyn Memory>>,
    case: u32,
    window: Window,
    /// From the first observation on.
    now: Option<Now>,
    pub(crate) question: Option<Question>,
}

struct Now {
    step: u32,
    frame: FrameId,
    progress: Progress,
}

impl Episode {
    /// The episode that a brief announces.
    pub(crate) fn announced(
        config: &MemoryEpisodeConfig,
        warehouse: &Warehouse,
        cases: &CaseSet,
    ) -> Result<Self, Unusable> {
        let MemoryEpisodeConfig { case, demonstrations, window, horizon, .. } = *config;
        let representation = Representation::try_from(config.representation)
            .map_err(|error| unusable!("brief of episode {}: {error}", config.episode))?;
        if usize::from(window) > MAX_WINDOW || usize::from(horizon) >= MAX_SEGMENT {
            let most = MAX_SEGMENT - 1;
            return Err(unusable!(
                "brief of episode {}: a window of {window} and a horizon of {horizon}, but at most \
                 {MAX_WINDOW} and {most} fit into a recall",
                config.episode
            ));
        }
        let segment = SegmentContent::try_from(config.segment)
            .map_err(|error| unusable!("brief of episode {}: {error}", config.episode))?;
        let chosen = demonstrations::selected(warehouse, cases, case, demonstrations)
            .zip(Demonstrations::from_bits(demonstrations));
        let (chosen, set) = chosen.ok_or_else(|| {
            unusable!(
                "brief of episode {}: case {case} with demonstrations {demonstrations:#b}, but there \
                 are {} cases, and no such set for them (are both sides given the same assets?)",
                config.episode,
                cases.cases.len()
            )
        })?;
        if chosen.is_empty() && representation.uses_demonstrations() {
            let episode = config.episode;
            return Err(unusable!(
                "brief of episode {episode}: {representation} memory of no demonstrations"
            ));
        }
        let ingredients = Ingredients {
            episode: (config.lane, config.episode),
            set,
            demonstrations: chosen,
            horizon: horizon.into(),
            segment,
            keyframes: config.keyframes.into(),
        };
        Ok(Self {
            ticket: config.episode,
            lane: config.lane,
            representation,
            blueprint: blueprint(representation, ingredients),
            admitted: false,
            views: Views::default(),
            memory: None,
            case,
            window: Window::new(window.into()),
            now: None,
            question: None,
        })
    }

    /// Takes up the next observation.
    pub(crate) fn observe(
        &mut self,
        seen: &Observation,
        warehouse: &Warehouse,
        cases: &CaseSet,
    ) -> Result<(), Unusable> {
        let Observation { episode, step, frame, .. } = *seen;
        let broken =
            |what: String| unusable!("observation of episode {episode}, step {step}: {what}");
        let pose = Pose::try_from(seen.pose).map_err(|error| broken(error.to_string()))?;
        Feedback::try_from(seen.feedback).map_err(|error| broken(error.to_string()))?;
        if seen.action != NO_ACTION {
            Action::try_from(seen.action).map_err(|error| broken(error.to_string()))?;
        }
        if frame == NO_FRAME {
            return Err(broken("it names no frame".into()));
        }
        let expected = self.now.as_ref().map_or(0, |now| now.step + 1);
        if step != expected {
            return Err(broken(format!("step {expected} was to come")));
        }
        let task = &cases.cases[self.case as usize].task;
        let now = self.now.get_or_insert_with(|| Now {
            step,
            frame,
            progress: Progress::new(warehouse, task, pose.cell),
        });
        if step > 0 {
            let Observation { action, feedback, .. } = *seen;
            self.window.push(PastStep { frame: now.frame, action, feedback, reserved: [0; 6] });
            now.progress.visit(pose.cell);
            (now.step, now.frame) = (step, frame);
        }
        Ok(())
    }

    /// Builds the memory if it is not built yet and all its views are there; says whether it is built.
    ///
    /// # Errors
    /// When a document that the memory supplies cannot be had.
    pub(crate) fn is_built(
        &mut self,
        view: impl Fn(Pose) -> Option<View>,
        documents: &mut dyn Documents,
    ) -> anyhow::Result<bool> {
        if self.memory.is_none() {
            let poses = self.blueprint.poses();
            for &pose in &poses[self.views.len()..] {
                let Some(view) = view(pose) else { return Ok(false) };
                self.views.insert(pose, view);
            }
            let views = std::mem::take(&mut self.views);
            let memory = self.blueprint.build(&views, documents);
            let memory = memory.with_context(|| format!("{} memory", self.representation));
            self.memory = Some(memory?);
        }
        Ok(true)
    }

    /// Answers the open question. The memory is built, and `embedding` is that of the question's content.
    pub(crate) fn answer(
        &mut self,
        embedding: Option<&Embedding>,
        clock: impl Fn() -> u64,
    ) -> Option<(Recall, RecallTrace)> {
        let (memory, now) = (self.memory.as_ref()?, self.now.as_ref()?);
        let Question { received_ns, .. } = self.question.take()?;
        let embedded_ns = clock();
        let situation = Situation { embedding, stage: now.progress.stage(), elapsed: now.step };
        let Supply { segment: retrieved, documents: named } = memory.access(&situation);
        let searched_ns = clock();

        let mut window = [bytemuck::Zeroable::zeroed(); MAX_WINDOW];
        let steps = self.window.steps();
        let window_len = steps.len() as u32;
        window.iter_mut().zip(steps).for_each(|(slot, step): (&mut PastStep, _)| *slot = step);
        let mut segment: [SegmentStep; MAX_SEGMENT] = [bytemuck::Zeroable::zeroed(); MAX_SEGMENT];
        let found = retrieved.as_ref().map_or(&[][..], |retrieved| &retrieved.segment);
        segment[..found.len()].copy_from_slice(found);
        let mut documents = [NO_DOCUMENT; MAX_DOCUMENTS];
        documents[..named.len()].copy_from_slice(&named);
        let distance = retrieved.as_ref().map_or(f32::NAN, |retrieved| retrieved.distance);

        let (episode, lane, step) = (self.ticket, self.lane, now.step);
        let assembled_ns = clock();
        let recall = Recall {
            episode,
            received_ns,
            sent_ns: 0,
            lane,
            step,
            distance,
            window_len,
            segment_len: found.len() as u32,
            documents_len: named.len() as u32,
            documents,
            window,
            segment,
        };
        let (case, demonstration, index) = match retrieved {
            Some(Retrieved { case, demonstration, step, .. }) => (case, demonstration, step),
            None => (NOT_MEASURED, u16::MAX, u16::MAX),
        };
        let trace = RecallTrace {
            episode,
            received_ns,
            embedded_ns,
            searched_ns,
            assembled_ns,
            sent_ns: 0,
            lane,
            step,
            case,
            demonstration,
            index,
            distance,
            reserved: 0,
        };
        Some((recall, trace))
    }
}
