//! An episode: its memory, its progress, and its pending observation.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use bytemuck::Zeroable;
use domain::{
    Action, Arm, Demonstrations, Feedback, FeedbackLevel, Pose, Representation, SegmentContent,
};
use peer::memory::{Memory, MemoryItem, Query, Step};
use search::{ContentHash, Embedding};
use shm_types::message::{
    EXPERIENCE, EXTERNAL, EpisodeEnd, FrameId, MAX_ITEMS, MAX_SEGMENT, MemoryEpisodeConfig,
    NO_ACTION, NO_FRAME, NOT_MEASURED, Observation, Recall, RecallTrace, StepReport,
};

use crate::bank::{BankSteps, KnownView, MemoryBank, ViewId};
use crate::demonstrations::{BankOrigin, DemonstrationLibrary, RememberedDemonstration};
use crate::items::{AssembledRecall, Budgets, CheckedAnswer, DocumentSupplier, PublishedTexts};
use crate::representation::{MemorySettings, built_in};
use crate::sequences::{KeptMemory, Recording, SequenceEpisode, SequenceMemory};

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

/// The memory that answers an episode's queries.
pub(crate) enum EpisodeMemory {
    /// A built-in one.
    BuiltIn {
        representation: Representation,
        settings: MemorySettings,
        set: Demonstrations,
        /// Once it is built. `None` for one that the episode shares with others of its sequence.
        own: Option<Box<dyn Memory>>,
    },
    /// The external memory with this index, with the bank that the episode remembers.
    External {
        index: u8,
        bank: u64,
        /// Whether it has been told that the episode begins.
        begun: bool,
    },
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
    /// An external memory was asked at this time.
    Asked { since_ns: u64 },
    /// The memory has answered.
    Answered(Box<MemoryAnswer>),
    /// The episode is over, and the memory is to learn from it.
    Ended,
    /// The episode is over, and its external memory saves what it has learned.
    Saving,
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
    pub(crate) memory: EpisodeMemory,
    /// Its part in a stream; `None` outside of streams.
    pub(crate) stream: Option<SequenceEpisode>,
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
    pub(crate) pose: Pose,
    pub(crate) feedback: Feedback,
    pub(crate) action: Option<Action>,
    pub(crate) frame: FrameId,
    /// Sub-goals completed so far.
    stage: u32,
}

/// What an external memory needs of an episode's bank.
pub(crate) struct ExternalBank {
    pub(crate) id: u64,
    pub(crate) bank: Arc<MemoryBank>,
    pub(crate) pins_bank: bool,
    pub(crate) embeds: bool,
}

impl MemoryEpisode {
    /// The episode that a message announces. `external` finds the bank of an external memory.
    pub(crate) fn announced(
        config: &MemoryEpisodeConfig,
        library: &DemonstrationLibrary,
        external: impl FnOnce(Demonstrations) -> Result<ExternalBank, String>,
    ) -> Result<Self, String> {
        let MemoryEpisodeConfig { case, demonstrations, lane, .. } = *config;
        let refused = |what: String| format!("config of episode {}: {what}", config.episode);
        let unknown = || {
            refused(format!(
                "case {case} with demonstrations {demonstrations:#b}, but there are {} cases, and no such set for \
                 them; are both processes started with the same demonstrations?",
                library.case_count()
            ))
        };
        let set = Demonstrations::from_bits(demonstrations).ok_or_else(unknown)?;
        let chosen = library.of_case(case, set).ok_or_else(unknown)?;
        let instruction = library.instruction(case).ok_or_else(unknown)?;
        let none = chosen.is_empty();
        // Memories of large banks are shared, as those of sequences are.
        let is_shared = config.sequence != 0 || set.bank_size().is_some();
        let (memory, bank, pins_bank, embeds) = if config.representation == EXTERNAL {
            if none {
                return Err(refused("external memory of no demonstrations".to_owned()));
            }
            let ExternalBank { id, bank, pins_bank, embeds } = external(set).map_err(refused)?;
            let memory = EpisodeMemory::External { index: config.external, bank: id, begun: false };
            (memory, bank, pins_bank, embeds)
        } else {
            let representation = Representation::try_from(config.representation)
                .map_err(|error| refused(error.to_string()))?;
            if none && representation.uses_demonstrations() {
                return Err(refused(format!("{representation} memory of no demonstrations")));
            }
            let settings = settings(config, representation).map_err(refused)?;
            let embeds = representation.matches_views();
            let memory = EpisodeMemory::BuiltIn { representation, settings, set, own: None };
            if is_shared && !none {
                (memory, Arc::default(), false, embeds)
            } else {
                (memory, Arc::new(MemoryBank::new(chosen)), embeds, embeds)
            }
        };
        let stream = match &memory {
            // A memory of no demonstrations has nothing that could persist.
            _ if none => None,
            _ if config.sequence != 0 => {
                Some(stream_part(config, set, library, instruction).map_err(refused)?)
            }
            EpisodeMemory::BuiltIn { representation, settings, .. } if is_shared => {
                Some(bank_part(config, set, library, (*representation, settings)))
            }
            _ => None,
        };
        Ok(Self {
            id: config.episode,
            lane,
            memory,
            stream,
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
        seen: &Observation,
        report: &StepReport,
    ) -> Result<(), String> {
        let Observation { episode, step, frame, .. } = *seen;
        let broken =
            |what: String| format!("observation of episode {episode}, step {step}: {what}");
        let pose = Pose::try_from(seen.pose).map_err(|error| broken(error.to_string()))?;
        let feedback =
            Feedback::try_from(seen.feedback).map_err(|error| broken(error.to_string()))?;
        let action = match seen.action {
            NO_ACTION => None,
            code => Some(Action::try_from(code).map_err(|error| broken(error.to_string()))?),
        };
        if frame == NO_FRAME && seen.last == 0 {
            return Err(broken("it names no frame".into()));
        }
        let expected = self.current.as_ref().map_or(0, |now| now.step + 1);
        if step != expected {
            return Err(broken(format!("expected step {expected}")));
        }
        let stage = u32::from(report.sub_goals);
        let recording = self.stream.as_mut().and_then(|part| part.recording.as_mut());
        if let Some(Recording { lived, is_complete }) = recording {
            lived.poses.push(pose);
            lived.feedback.push(feedback);
            lived.stages.push(stage);
            if step > 0 {
                lived.actions.push(action);
            }
            *is_complete = report.ended == EpisodeEnd::Complete as u8;
        }
        self.current = Some(CurrentStep { step, pose, feedback, action, frame, stage });
        Ok(())
    }

    /// Asks a built-in memory: `shared`, that of the episode's sequence, or its own, which is built first if it has not been.
    /// The views of a pinned bank are ready; `embedding` is that of the current view. A memory that learns from the episode
    /// observes the step first.
    ///
    /// # Errors
    /// When a document is missing, or the memory cannot be built or fails.
    pub(crate) fn ask_built_in(
        &mut self,
        shared: Option<&mut SequenceMemory>,
        embedding: Option<&Embedding>,
        view: impl Fn(ViewId) -> Option<KnownView>,
        documents: &mut dyn DocumentSupplier,
        clock: impl Fn() -> u64,
    ) -> anyhow::Result<MemoryAnswer> {
        let learns = self.learns();
        let (EpisodeMemory::BuiltIn { representation, settings, set, own }, Some(now)) =
            (&mut self.memory, &self.current)
        else {
            bail!("episode {} has no built-in memory, or has not begun", self.id);
        };
        let failed = format!("{representation} memory");
        let memory = match (shared, own) {
            (Some(SequenceMemory { memory: KeptMemory::BuiltIn(memory), .. }), _) => memory,
            (Some(_), _) => bail!("{failed} is not that of the sequence"),
            (None, Some(memory)) => memory,
            (None, own @ None) => {
                let steps = match self.pins_bank {
                    true => self.bank.with_views(view).context("a view of the bank is missing")?,
                    false => BankSteps::without_views(&self.bank),
                };
                own.insert(build_built_in(*representation, settings, *set, &steps, documents)?)
            }
        };
        let embedded_ns = clock();
        let step = now.step(self.lane, self.id, embedding);
        let query = now.query(step, &self.instruction, self.budgets);
        if learns {
            memory.observe(&query.now).context(failed.clone())?;
        }
        let items = memory.recall(&query).context(failed.clone())?;
        let store_bytes = memory.store_bytes().unwrap_or(0);
        let searched_ns = clock();
        Ok(MemoryAnswer {
            checked: self.checked(items).map_err(|what| anyhow!("{failed}: {what}"))?,
            embedded_ns,
            searched_ns,
            method_ns: 0,
            store_bytes,
            tokens: NOT_MEASURED,
            pinned: false,
        })
    }

    /// The index of its external memory, and the bank that it remembers.
    pub(crate) fn external(&self) -> Option<(u8, u64)> {
        match self.memory {
            EpisodeMemory::External { index, bank, .. } => Some((index, bank)),
            EpisodeMemory::BuiltIn { .. } => None,
        }
    }

    /// The bank of an external memory that it uses itself, and not through a sequence.
    pub(crate) fn own_bank(&self) -> Option<u64> {
        self.external().filter(|_| self.stream.is_none()).map(|(_, bank)| bank)
    }

    /// Whether the memory learns from it.
    pub(crate) fn learns(&self) -> bool {
        self.stream.as_ref().is_some_and(|part| part.recording.is_some())
    }

    /// The last step, which has no view.
    pub(crate) fn last_step(&self) -> Option<Step<'_>> {
        self.current.as_ref().map(|now| now.step(self.lane, self.id, None))
    }

    /// Checks the items of the memory's answer.
    ///
    /// # Errors
    /// When an item cannot be supplied.
    pub(crate) fn checked(&self, items: Vec<MemoryItem>) -> Result<Arc<CheckedAnswer>, String> {
        match &self.last {
            Some((last, _)) if last.is_of(&items) => Ok(last.clone()),
            _ => CheckedAnswer::new(items, &self.bank, self.budgets).map(Arc::new),
        }
    }

    /// The messages that answer the pending observation.
    pub(crate) fn messages(
        &self,
        received_ns: u64,
        answer: &MemoryAnswer,
        assembled: &AssembledRecall,
        assembled_ns: u64,
    ) -> (Recall, RecallTrace) {
        let (episode, lane) = (self.id, self.lane);
        let step = self.current.as_ref().map_or(0, |now| now.step);
        let &MemoryAnswer {
            embedded_ns,
            searched_ns,
            method_ns,
            store_bytes,
            tokens,
            ref checked,
            ..
        } = answer;
        let recall = Recall {
            episode,
            received_ns,
            lane,
            step,
            items_len: assembled.items_len,
            steps_len: assembled.steps_len,
            items: assembled.items,
            steps: assembled.steps,
            ..Zeroable::zeroed()
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
        (recall, trace)
    }
}

impl CurrentStep {
    /// As a built-in memory is given it.
    fn step<'a>(&self, lane: u32, episode: u64, embedding: Option<&'a Embedding>) -> Step<'a> {
        Step {
            lane,
            episode,
            step: self.step,
            pose: self.pose,
            last_action: self.action,
            feedback: self.feedback,
            frame: None,
            embedding: embedding.map(Embedding::as_slice),
            pinned: None,
        }
    }

    /// A query of a built-in memory, at the step `now`.
    fn query<'a>(&self, now: Step<'a>, instruction: &'a str, budgets: Budgets) -> Query<'a> {
        Query {
            now,
            instruction,
            window: &[],
            image_budget: budgets.images,
            text_budget: budgets.text,
            stage: Some(self.stage),
        }
    }
}

/// Builds a built-in memory.
///
/// # Errors
/// When a document is missing, or the memory cannot be built.
pub(crate) fn build_built_in(
    representation: Representation,
    settings: &MemorySettings,
    set: Demonstrations,
    steps: &BankSteps<'_>,
    documents: &mut dyn DocumentSupplier,
) -> anyhow::Result<Box<dyn Memory>> {
    let failed = || format!("{representation} memory");
    let kinds = representation.describe().documents.iter();
    let texts: anyhow::Result<_> = kinds.map(|&kind| documents.consolidated(kind, set)).collect();
    let (documents, embeddings) = (texts.with_context(failed)?, steps.embeddings());
    let settings = MemorySettings { documents, embeddings, ..settings.clone() };
    let mut built = built_in(representation, &settings);
    built.build(&steps.demonstrations()).with_context(failed)?;
    Ok(built)
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
        begun: false,
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
        begun: false,
    }
}

/// The settings of a built-in memory.
fn settings(
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
        embeddings: Arc::default(),
        documents: Vec::new(),
    })
}
