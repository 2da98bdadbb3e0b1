//! A running episode: its memory, its progress and its pending observation.

use anyhow::Context;
use domain::SegmentContent;
use domain::{Action, Feedback, Pose, Representation};
use shm_types::message::{MAX_DOCUMENTS, MAX_SEGMENT, NO_DOCUMENT, NO_FRAME};
use shm_types::message::{
    MemoryEpisodeConfig, NO_ACTION, NOT_MEASURED, Observation, Recall, RecallTrace, SegmentStep,
};
use warehouse::{CaseSet, Demonstrations, Progress, Warehouse};

use crate::demonstrations;
use crate::representation::{
    DocumentSupplier, Memory, MemoryBuilder, MemorySpec, RecallQuery, RecalledItems,
    RetrievedSegment, StoredView, StoredViews, memory_builder,
};
use search::{ContentHash, Embedding};

/// A message that cannot be used. The text names the value and what was expected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Unusable(pub(crate) String);

/// Makes an [`Unusable`] from a format string.
macro_rules! unusable {
    ($($text:tt)*) => { $crate::episode::Unusable(format!($($text)*)) };
}
pub(crate) use unusable;

/// An observation whose recall has not been sent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PendingObservation {
    pub(crate) received_ns: u64,
    /// The current view; `None` if the memory does not use it.
    pub(crate) content: Option<ContentHash>,
}

pub(crate) struct MemoryEpisode {
    pub(crate) id: u64,
    pub(crate) lane: u32,
    pub(crate) representation: Representation,
    pub(crate) builder: Box<dyn MemoryBuilder>,
    /// Whether its views are pinned.
    pub(crate) admitted: bool,
    /// The leading views of the builder that are ready; empty once the memory is built.
    views: StoredViews,
    memory: Option<Box<dyn Memory>>,
    case: u32,
    /// The current step, from the first observation on.
    current: Option<CurrentStep>,
    pub(crate) pending: Option<PendingObservation>,
}

struct CurrentStep {
    step: u32,
    progress: Progress,
}

impl MemoryEpisode {
    /// The episode that a message announces.
    pub(crate) fn announced(
        config: &MemoryEpisodeConfig,
        warehouse: &Warehouse,
        cases: &CaseSet,
    ) -> Result<Self, Unusable> {
        let MemoryEpisodeConfig { case, demonstrations, horizon, .. } = *config;
        let representation = Representation::try_from(config.representation)
            .map_err(|error| unusable!("config of episode {}: {error}", config.episode))?;
        if usize::from(horizon) >= MAX_SEGMENT {
            let most = MAX_SEGMENT - 1;
            return Err(unusable!(
                "config of episode {}: a horizon of {horizon}, but at most {most} fit into a recall",
                config.episode
            ));
        }
        let segment = SegmentContent::try_from(config.segment)
            .map_err(|error| unusable!("config of episode {}: {error}", config.episode))?;
        let chosen = demonstrations::selected(warehouse, cases, case, demonstrations)
            .zip(Demonstrations::from_bits(demonstrations));
        let (chosen, set) = chosen.ok_or_else(|| {
            unusable!(
                "config of episode {}: case {case} with demonstrations {demonstrations:#b}, but there \
                 are {} cases, and no such set for them; are both processes started with the same assets?",
                config.episode,
                cases.cases.len()
            )
        })?;
        if chosen.is_empty() && representation.uses_demonstrations() {
            let episode = config.episode;
            return Err(unusable!(
                "config of episode {episode}: {representation} memory of no demonstrations"
            ));
        }
        let spec = MemorySpec {
            episode: (config.lane, config.episode),
            set,
            demonstrations: chosen,
            horizon: horizon.into(),
            segment,
            keyframes: config.keyframes.into(),
        };
        Ok(Self {
            id: config.episode,
            lane: config.lane,
            representation,
            builder: memory_builder(representation, spec),
            admitted: false,
            views: StoredViews::default(),
            memory: None,
            case,
            current: None,
            pending: None,
        })
    }

    /// Checks and takes the next observation.
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
        let expected = self.current.as_ref().map_or(0, |now| now.step + 1);
        if step != expected {
            return Err(broken(format!("expected step {expected}")));
        }
        let task = &cases.cases[self.case as usize].task;
        let now = self.current.get_or_insert_with(|| CurrentStep {
            step,
            progress: Progress::new(warehouse, task, pose.cell),
        });
        if step > 0 {
            now.progress.visit(pose.cell);
            now.step = step;
        }
        Ok(())
    }

    /// Builds the memory if all its views are ready. Returns whether it is built.
    ///
    /// # Errors
    /// When a document is missing or cannot be published.
    pub(crate) fn is_built(
        &mut self,
        view: impl Fn(Pose) -> Option<StoredView>,
        documents: &mut dyn DocumentSupplier,
    ) -> anyhow::Result<bool> {
        if self.memory.is_none() {
            let poses = self.builder.poses();
            for &pose in &poses[self.views.len()..] {
                let Some(view) = view(pose) else { return Ok(false) };
                self.views.insert(pose, view);
            }
            let views = std::mem::take(&mut self.views);
            let memory = self.builder.build(&views, documents);
            let memory = memory.with_context(|| format!("{} memory", self.representation));
            self.memory = Some(memory?);
        }
        Ok(true)
    }

    /// Answers the pending observation. The memory must be built; `embedding` is that of the current view.
    pub(crate) fn answer(
        &mut self,
        embedding: Option<&Embedding>,
        clock: impl Fn() -> u64,
    ) -> Option<(Recall, RecallTrace)> {
        let (memory, now) = (self.memory.as_ref()?, self.current.as_ref()?);
        let PendingObservation { received_ns, .. } = self.pending.take()?;
        let embedded_ns = clock();
        let query = RecallQuery { embedding, stage: now.progress.stage(), elapsed: now.step };
        let RecalledItems { segment: retrieved, documents: named } = memory.recall(&query);
        let searched_ns = clock();

        let mut segment: [SegmentStep; MAX_SEGMENT] = [bytemuck::Zeroable::zeroed(); MAX_SEGMENT];
        let found = retrieved.as_ref().map_or(&[][..], |retrieved| &retrieved.segment);
        segment[..found.len()].copy_from_slice(found);
        let mut documents = [NO_DOCUMENT; MAX_DOCUMENTS];
        documents[..named.len()].copy_from_slice(&named);
        let distance = retrieved.as_ref().map_or(f32::NAN, |retrieved| retrieved.distance);

        let (episode, lane, step) = (self.id, self.lane, now.step);
        let assembled_ns = clock();
        let recall = Recall {
            episode,
            received_ns,
            sent_ns: 0,
            lane,
            step,
            distance,
            segment_len: found.len() as u32,
            documents_len: named.len() as u32,
            reserved: 0,
            documents,
            segment,
        };
        let (case, demonstration, index) = match retrieved {
            Some(RetrievedSegment { case, demonstration, step, .. }) => (case, demonstration, step),
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
