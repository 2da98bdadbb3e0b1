//! An episode: its settings, its progress, and its pending observation.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use bytemuck::Zeroable;
use case_book::WorldDeclaration;
use domain::{
    ActionCode, Arm, Demonstrations, FeedbackCode, FeedbackLevel, Representation, SegmentContent,
    State,
};
use peer::memory::{Episode, MemoryItem, Query, Step};
use search::{ContentHash, Embedding};
use shm_types::message::{
    EXPERIENCE, EXTERNAL, EpisodeEnd, FrameId, MAX_ITEMS, MAX_SEGMENT, MemoryEpisodeConfig,
    NO_FRAME, Observation, Recall, RecallTrace, SnapshotId, StepReport, read_action, read_flag,
};

use crate::bank::MemoryBank;
use crate::demonstrations::{BankOrigin, DemonstrationLibrary, RememberedDemonstration, ViewId};
use crate::items::{AssembledRecall, Budgets, CheckedAnswer, PublishedTexts};
use crate::representation::MemorySettings;

/// Why something cannot go on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Reason {
    pub(crate) text: String,
    /// Whether an external memory has exceeded a time limit.
    pub(crate) is_overdue: bool,
}

impl Reason {
    pub(crate) const fn overdue(text: String) -> Self {
        Self { text, is_overdue: true }
    }
}

impl<T: Into<String>> From<T> for Reason {
    fn from(text: T) -> Self {
        Self { text: text.into(), is_overdue: false }
    }
}

/// Why an episode does not get what it needs now. What is [`Waiting`](Self::Waiting) is called again.
#[derive(Debug)]
pub(crate) enum Unready {
    /// Views, embeddings or an external memory are not ready.
    Waiting,
    /// The episode cannot go on.
    Refused(Reason),
    /// This process cannot go on.
    Broken(anyhow::Error),
}

impl From<Reason> for Unready {
    fn from(reason: Reason) -> Self {
        Self::Refused(reason)
    }
}

impl From<String> for Unready {
    fn from(text: String) -> Self {
        Self::Refused(text.into())
    }
}

impl From<&str> for Unready {
    fn from(text: &str) -> Self {
        Self::Refused(text.into())
    }
}

impl From<anyhow::Error> for Unready {
    fn from(error: anyhow::Error) -> Self {
        Self::Broken(error)
    }
}

/// Which memory an episode has.
pub(crate) enum MemoryKind {
    /// A built-in one.
    BuiltIn { representation: Representation, settings: MemorySettings, set: Demonstrations },
    /// The external memory with this index, built from this bank; `None`: from that of the episode's sequence.
    External { index: u8, bank: Option<u64> },
}

/// What an episode of a stream, or with a memory that others share, has beside what every episode has.
pub(crate) struct SequenceEpisode {
    pub(crate) sequence: u64,
    /// The snapshot that it begins with; zero: the memory as it was built.
    pub(crate) snapshot: SnapshotId,
    pub(crate) origin: BankOrigin,
    pub(crate) feedback: FeedbackLevel,
    /// What has happened so far, if the memory learns from it.
    pub(crate) recording: Option<Recording>,
}

/// An episode so far, as the demonstration that it becomes.
#[derive(Debug)]
pub(crate) struct Recording {
    pub(crate) lived: RememberedDemonstration,
    pub(crate) is_complete: bool,
}

/// An observation whose recall has not been sent.
pub(crate) struct PendingObservation {
    pub(crate) received_ns: u64,
    /// The current view; `None` if the memory does not use it.
    pub(crate) content: Option<ContentHash>,
    pub(crate) stage: PendingStage,
}

/// How far the answer to an observation has got.
pub(crate) enum PendingStage {
    /// The memory has not been asked.
    New,
    /// An external memory was asked at this time, about what it has built from this bank.
    Asked { bank: u64, since_ns: u64 },
    /// The memory has answered.
    Answered(Box<MemoryAnswer>),
    /// The episode is over, and the memory learns from it.
    Ended,
}

/// A memory's answer.
pub(crate) struct MemoryAnswer {
    pub(crate) checked: Arc<CheckedAnswer>,
    pub(crate) embedded_ns: u64,
    pub(crate) searched_ns: u64,
    pub(crate) method_ns: u64,
    pub(crate) store_bytes: u64,
    pub(crate) tokens: u32,
    /// Whether the views that it names have been pinned for it.
    pub(crate) pinned: bool,
}

pub(crate) struct MemoryEpisode {
    pub(crate) id: u64,
    pub(crate) lane: u32,
    pub(crate) kind: MemoryKind,
    /// Its part in a stream; `None` outside of streams.
    pub(crate) stream: Option<SequenceEpisode>,
    /// Whether its memory is built and has been told that the episode begins.
    pub(crate) begun: bool,
    /// What the memory can name: the demonstrations that it is built from. In a stream: from the first step on.
    pub(crate) bank: Arc<MemoryBank>,
    /// Whether all views of the bank are pinned while the episode runs.
    pub(crate) pins_bank: bool,
    /// Whether the memory uses embeddings.
    pub(crate) embeds: bool,
    /// Whether the views of the bank are pinned, if they have to be.
    pub(crate) admitted: bool,
    /// The first so many views of a pinned bank are ready.
    pub(crate) ready: usize,
    /// Views that are pinned for the last recall.
    pub(crate) recalled: Vec<ViewId>,
    pub(crate) budgets: Budgets,
    pub(crate) seed: u64,
    pub(crate) repeat: u32,
    pub(crate) instruction: String,
    /// The current step, from the first observation on.
    pub(crate) current: Option<CurrentStep>,
    pub(crate) pending: Option<PendingObservation>,
    /// The last answer and its recall: an equal answer has the same one.
    pub(crate) last: Option<(Arc<CheckedAnswer>, AssembledRecall)>,
    pub(crate) texts: PublishedTexts,
}

/// The agent's state.
pub(crate) struct CurrentStep {
    pub(crate) step: u32,
    pub(crate) state: State,
    pub(crate) feedback: FeedbackCode,
    pub(crate) action: Option<ActionCode>,
    pub(crate) frame: FrameId,
    /// Whether the episode is over.
    pub(crate) is_last: bool,
}

/// What is known about an episode's memory before its first step.
pub(crate) struct AnnouncedMemory {
    pub(crate) kind: MemoryKind,
    /// As [`MemoryEpisode::bank`].
    pub(crate) bank: Arc<MemoryBank>,
    /// As [`MemoryEpisode::pins_bank`].
    pub(crate) pins_bank: bool,
    /// As [`MemoryEpisode::embeds`].
    pub(crate) embeds: bool,
}

impl MemoryEpisode {
    /// The episode that a message announces. `external` finds the bank of an external memory for a set of demonstrations.
    pub(crate) fn announced(
        config: &MemoryEpisodeConfig,
        library: &DemonstrationLibrary,
        external: impl FnOnce(Demonstrations) -> Result<AnnouncedMemory, String>,
    ) -> Result<Self, String> {
        let MemoryEpisodeConfig { case, demonstrations, .. } = *config;
        let unknown = || {
            format!(
                "case {case} with demonstrations {demonstrations:#b}, but there are {} cases, and no such set for \
                 them; are both processes started with the same demonstrations?",
                library.case_count()
            )
        };
        let set = Demonstrations::from_bits(demonstrations).ok_or_else(unknown)?;
        let chosen = library.of_case(case, set).ok_or_else(unknown)?;
        let is_paraphrased =
            read_flag(config.paraphrased).map_err(|unknown| unknown.to_string())?;
        let instruction = library
            .instruction(case, is_paraphrased)
            .ok_or_else(|| format!("case {case} has no instruction, or no paraphrase of it"))?;
        // A memory of no demonstrations has nothing that could persist or be shared.
        let has_demonstrations = !chosen.is_empty();
        let is_in_sequence = has_demonstrations && config.sequence != 0;
        let has_large_bank = has_demonstrations && set.bank_size().is_some();
        let memory = match config.representation {
            EXTERNAL if !has_demonstrations => {
                return Err("external memory of no demonstrations".to_owned());
            }
            EXTERNAL => external(set)?,
            code => {
                let representation =
                    Representation::try_from(code).map_err(|error| error.to_string())?;
                if !has_demonstrations && representation.uses_demonstrations() {
                    return Err(format!("{representation} memory of no demonstrations"));
                }
                let settings = settings(library.world(), config, representation)?;
                let kind = MemoryKind::BuiltIn { representation, settings, set };
                let embeds = representation.matches_views();
                if is_in_sequence || has_large_bank {
                    AnnouncedMemory { kind, bank: Arc::default(), pins_bank: false, embeds }
                } else {
                    let bank = Arc::new(MemoryBank::new(chosen));
                    AnnouncedMemory { kind, bank, pins_bank: embeds, embeds }
                }
            }
        };
        let AnnouncedMemory { kind, bank, pins_bank, embeds } = memory;
        let stream = match &kind {
            _ if is_in_sequence => Some(stream_part(config, set, library, instruction)?),
            MemoryKind::BuiltIn { representation, settings, .. } if has_large_bank => {
                Some(bank_part(config, set, library, (*representation, settings)))
            }
            _ => None,
        };
        Ok(Self {
            id: config.episode,
            lane: config.lane,
            kind,
            stream,
            begun: false,
            bank,
            pins_bank,
            embeds,
            admitted: false,
            ready: 0,
            recalled: Vec::new(),
            budgets: Budgets { images: config.image_budget.into(), text: config.text_budget },
            seed: config.seed,
            repeat: config.repeat,
            instruction: instruction.to_owned(),
            current: None,
            pending: None,
            last: None,
            texts: PublishedTexts::default(),
        })
    }

    /// The views that have to be resident while the episode runs.
    pub(crate) fn view_ids(&self) -> &[ViewId] {
        if self.pins_bank { &self.bank.view_ids } else { &[] }
    }

    /// Checks and takes the next observation, with the report of its step.
    pub(crate) fn observe(
        &mut self,
        world: &WorldDeclaration,
        seen: &Observation,
        report: &StepReport,
    ) -> Result<(), String> {
        let Observation { episode, step, frame, .. } = *seen;
        let broken =
            |what: String| format!("observation of episode {episode}, step {step}: {what}");
        let state = world.read_state(&seen.state).map_err(|error| broken(error.to_string()))?;
        let feedback =
            world.read_feedback(seen.feedback).map_err(|error| broken(error.to_string()))?;
        let action = read_action(seen.action).and_then(|action| world.read_action(action));
        let action = action.map_err(|error| broken(error.to_string()))?;
        if frame == NO_FRAME && seen.last == 0 {
            return Err(broken("it names no frame".into()));
        }
        let expected = self.current.as_ref().map_or(0, |now| now.step + 1);
        if step != expected {
            return Err(broken(format!("expected step {expected}")));
        }
        let recording = self.stream.as_mut().and_then(|part| part.recording.as_mut());
        if let Some(Recording { lived, is_complete }) = recording {
            lived.states.push(state);
            lived.feedback.push(feedback);
            lived.stages.push(report.sub_goals.into());
            if step > 0 {
                lived.actions.push(action);
            }
            *is_complete = report.ended == EpisodeEnd::Complete as u8;
        }
        let is_last = seen.last == 1;
        self.current = Some(CurrentStep { step, state, feedback, action, frame, is_last });
        Ok(())
    }

    /// The index of its external memory.
    pub(crate) fn external(&self) -> Option<u8> {
        match self.kind {
            MemoryKind::External { index, .. } => Some(index),
            MemoryKind::BuiltIn { .. } => None,
        }
    }

    /// The bank of an external memory that it uses itself, and not through a sequence.
    pub(crate) fn own_bank(&self) -> Option<u64> {
        match self.kind {
            MemoryKind::External { bank, .. } => bank,
            MemoryKind::BuiltIn { .. } => None,
        }
    }

    /// Whether the memory learns from it.
    pub(crate) fn learns(&self) -> bool {
        self.stream.as_ref().is_some_and(|part| part.recording.is_some())
    }

    /// Its begin, as a built-in memory is told it.
    pub(crate) fn begin(&self) -> Episode<'_> {
        Episode {
            lane: self.lane,
            episode: self.id,
            instruction: &self.instruction,
            seed: self.seed,
            repeat: self.repeat,
            image_budget: self.budgets.images,
            text_budget: self.budgets.text,
            learns: self.learns(),
        }
    }

    /// The current step, as a built-in memory is asked about it. `embedding` is that of its view; the last step has none.
    pub(crate) fn query<'a>(&'a self, embedding: Option<&'a Embedding>) -> Option<Query<'a>> {
        let current = self.current.as_ref()?;
        let now = Step {
            lane: self.lane,
            episode: self.id,
            step: current.step,
            state: current.state,
            last_action: current.action,
            feedback: current.feedback,
            frame: None,
            embedding: embedding.map(Embedding::as_slice),
            pinned: None,
        };
        Some(Query {
            now,
            instruction: &self.instruction,
            window: &[],
            image_budget: self.budgets.images,
            text_budget: self.budgets.text,
        })
    }

    /// Checks the items of the memory's answer.
    ///
    /// # Errors
    /// When an item cannot be supplied.
    pub(crate) fn checked(
        &self,
        items: Vec<MemoryItem>,
        world: &WorldDeclaration,
    ) -> Result<Arc<CheckedAnswer>, String> {
        match &self.last {
            Some((last, _)) if last.is_of(&items) => Ok(last.clone()),
            _ => CheckedAnswer::new(items, &self.bank, world, self.budgets).map(Arc::new),
        }
    }

    /// The messages that answer the pending observation, once its recall is put together.
    pub(crate) fn take_messages(&mut self, assembled_ns: u64) -> Option<(Recall, RecallTrace)> {
        let PendingObservation { received_ns, stage, .. } = self.pending.take()?;
        let (PendingStage::Answered(answer), Some((_, assembled))) = (stage, &self.last) else {
            return None;
        };
        let (episode, lane) = (self.id, self.lane);
        let step = self.current.as_ref().map_or(0, |now| now.step);
        let MemoryAnswer {
            checked, embedded_ns, searched_ns, method_ns, store_bytes, tokens, ..
        } = *answer;
        let recall = Recall {
            episode,
            lane,
            step,
            items_len: assembled.items_len,
            steps_len: assembled.steps_len,
            instructions_len: assembled.instructions_len,
            reserved: 0,
            items: assembled.items,
            steps: assembled.steps,
            instructions: assembled.instructions,
        };
        let (asked, supplied) = (checked.asked, checked.supplied);
        let trace = RecallTrace {
            episode,
            received_ns,
            embedded_ns,
            searched_ns,
            assembled_ns,
            method_ns,
            store_bytes,
            lane,
            step,
            images_asked: asked.images,
            images: supplied.images,
            text_asked: asked.text,
            text: supplied.text,
            items_asked: asked.items,
            items: supplied.items,
            tokens,
            sources_len: assembled.sources_len,
            sources: assembled.sources,
            ..Zeroable::zeroed()
        };
        Some((recall, trace))
    }
}

/// The part of an episode in its stream.
fn stream_part(
    config: &MemoryEpisodeConfig,
    set: Demonstrations,
    library: &DemonstrationLibrary,
    instruction: &str,
) -> Result<SequenceEpisode, String> {
    let arm = Arm::try_from(config.arm).map_err(|error| error.to_string())?;
    let feedback = FeedbackLevel::try_from(config.feedback).map_err(|error| error.to_string())?;
    if !library.has_variant(config.variant) {
        return Err(format!(
            "there is no world variant {}: is memory-proc started with the run's --demonstrations?",
            config.variant
        ));
    }
    let learns = arm == Arm::Learning && config.learns == 1;
    Ok(SequenceEpisode {
        sequence: config.sequence,
        snapshot: config.snapshot,
        origin: BankOrigin::new(arm, config.stream, config.block, set),
        feedback,
        recording: learns.then(|| Recording {
            lived: RememberedDemonstration {
                case: config.position,
                number: EXPERIENCE,
                instruction: instruction.to_owned(),
                ..RememberedDemonstration::default()
            },
            is_complete: false,
        }),
    })
}

/// The part of an episode outside of streams with a memory that it shares: no episode changes it.
fn bank_part(
    config: &MemoryEpisodeConfig,
    set: Demonstrations,
    library: &DemonstrationLibrary,
    (representation, settings): (Representation, &MemorySettings),
) -> SequenceEpisode {
    let origin = library.bank_of_case(config.case, set);
    let MemorySettings { horizon, segment, hits, keyframes, .. } = settings;
    let mut hasher = DefaultHasher::new();
    (origin, representation as u8, horizon, *segment as u8, hits, keyframes).hash(&mut hasher);
    SequenceEpisode {
        // Outside of the numbers of sequences.
        sequence: hasher.finish() | 1 << 63,
        snapshot: Default::default(),
        origin,
        feedback: FeedbackLevel::None,
        recording: None,
    }
}

/// The settings of a built-in memory.
fn settings(
    world: &WorldDeclaration,
    config: &MemoryEpisodeConfig,
    representation: Representation,
) -> Result<MemorySettings, String> {
    let MemoryEpisodeConfig { horizon, hits, keyframes, .. } = *config;
    if usize::from(horizon) >= MAX_SEGMENT {
        let most = MAX_SEGMENT - 1;
        return Err(format!("a horizon of {horizon}, but at most {most} fit into a recall"));
    }
    if representation.matches_views() && !(1..=MAX_ITEMS).contains(&hits.into()) {
        return Err(format!("{hits} segments for a step, but must be 1 to {MAX_ITEMS}"));
    }
    let segment = SegmentContent::try_from(config.segment).map_err(|error| error.to_string())?;
    Ok(MemorySettings {
        horizon: horizon.into(),
        segment,
        hits: hits.into(),
        keyframes: keyframes.into(),
        turns: world.action_codes().filter(|code| world.is_turn(*code)).collect(),
        embeddings: Arc::default(),
        documents: Vec::new(),
    })
}
