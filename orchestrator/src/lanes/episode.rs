//! One episode in a lane, from its first command to its record.

use bytemuck::Zeroable;
use case_book::{CaseVariant, NO_LETTER};
use conditions::{Mismatch, Route};
use domain::{ActionCode, MemoryKind, Outcome, Start, UnknownCode, hex};
use run_log::{BlockedRecord, Ending, EpisodeRecord, RecallTotals, Stages, StreamRecord, Unread};
use serde_json::Map;
use shm_types::message::{
    Decision, EXTERNAL, EpisodeEnd, MemoryEpisodeConfig, NO_ACTION, NO_FRAME, NOT_MEASURED,
    PolicyEpisodeConfig, RecallTrace, Role, SnapshotReport, StepCommand, StepKind, StepReport,
    WorldEpisodeConfig, read_flag, write_text,
};
use shm_types::notes::Note;

use super::retrieved::Retrieved;
use super::{
    AnswerError, AnsweredRequest, Context, EpisodeOpening, FinishedEpisode, PendingAnswer, Stamps,
};
use crate::plan::{PlannedEpisode, StreamPart};

/// An episode under way.
#[derive(Debug, Clone)]
pub(super) struct ActiveEpisode {
    /// The number of the variant that it takes place in.
    variant: u32,
    /// The hash of the state of the world at its begin.
    begin_hash: u64,
    awaited: Awaited,
    /// When the awaited answer was asked for.
    since_ns: u64,
    /// Of the current step.
    stamps: Stamps,
    /// Memory's trace of the current step, once it has arrived.
    trace: Option<RecallTrace>,
    /// The decision on the current step, until what it is based on has arrived, too.
    early: Option<Decision>,
    retrieved: Retrieved,
    /// Memory's report that it has learned from the episode.
    snapshot: Option<SnapshotReport>,
    result: FinishedEpisode,
}

/// The answer that the episode waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Awaited {
    /// The simulator's.
    Report,
    /// The policy's.
    Decision,
    /// Memory's report that it has learned; the episode ends with it.
    Snapshot,
}

impl ActiveEpisode {
    /// `episode` before its first step.
    pub(super) fn new(context: &Context<'_>, id: u64, lane: u32, episode: PlannedEpisode) -> Self {
        let (rules, book) = (&context.rules, context.book());
        let case = &book.cases[episode.case_index];
        let condition = episode.key.condition;
        let expert = episode.expert(book);
        let in_world = episode.part.zip(book.streams.as_ref());
        let in_world = in_world
            .and_then(|(part, streams)| streams.case(part.world, episode.case_index as u32));
        let is_blocked = condition.route == Route::Blocked;
        let has_policy = !rules.expert;
        let record = EpisodeRecord {
            key: episode.key.to_string(),
            memory: condition.memory,
            start: condition.start,
            route: condition.route,
            demonstrations: condition.demonstrations,
            window: condition.variation.window,
            segment: condition.variation.segment,
            hint: condition.variation.hint,
            mismatch: condition.mismatch,
            arm: condition.arm,
            run: episode.key.run,
            case: episode.key.case.clone(),
            task: case.task,
            seed: episode.seed,
            ending: Ending::OutOfSteps,
            steps: 0,
            reference: expert.map_or(0, |expert| expert.length),
            actions: String::new(),
            state_hashes: None,
            sub_goals: Vec::new(),
            required: 0,
            conflict_at: None,
            requests: has_policy.then_some(0),
            images: has_policy.then_some(0),
            images_dropped: 0,
            prompt_tokens: has_policy.then_some(0),
            completion_tokens: has_policy.then_some(0),
            memory_tokens: has_policy.then_some(0),
            unread: Unread::default(),
            blocked: is_blocked.then(|| BlockedRecord {
                invalidated: case.invalidated_when_blocked,
                ..BlockedRecord::default()
            }),
            retrieved: None,
            distances: None,
            distance: None,
            memory_items_dropped: 0,
            memory_images_dropped: 0,
            memory_text_dropped: 0,
            stream: episode.part.zip(episode.key.place).map(|(part, place)| {
                let StreamPart { block, place: at, after, round, feedback, world, .. } = part;
                StreamRecord {
                    stream: place.stream,
                    order: place.order,
                    position: place.position,
                    block,
                    place: at,
                    after,
                    round,
                    feedback,
                    world,
                    invalidated: in_world.is_some_and(|found| found.invalidated),
                    reference_actions: in_world.map_or_else(String::new, |found| {
                        book.world.declaration.letters(found.actions.iter().copied().map(Some))
                    }),
                    retrievals: 0,
                    stale: 0,
                    snapshot: None,
                    store_bytes: None,
                }
            }),
            world: Map::new(),
        };
        Self {
            variant: episode.variant(book),
            begin_hash: 0,
            awaited: Awaited::Report,
            since_ns: 0,
            stamps: Stamps::new(id, lane, condition.memory),
            trace: None,
            early: None,
            retrieved: Retrieved::default(),
            snapshot: None,
            result: FinishedEpisode {
                episode,
                record,
                stages: Stages::default(),
                recalls: RecallTotals::default(),
                lane,
                id,
                started_ns: context.now_ns,
                ended_ns: 0,
                unusable: 0,
            },
        }
    }

    pub(super) const fn id(&self) -> u64 {
        self.result.id
    }

    pub(super) const fn memory(&self) -> MemoryKind {
        self.stamps.memory
    }

    pub(super) fn into_episode(self) -> PlannedEpisode {
        self.result.episode
    }

    pub(super) const fn has_early_decision(&self) -> bool {
        self.early.is_some()
    }

    /// The messages that begin the episode.
    pub(super) fn opening(&mut self, context: &Context<'_>) -> EpisodeOpening {
        let FinishedEpisode { episode, id, lane, .. } = &self.result;
        let (episode, id, lane) = (episode.clone(), *id, *lane);
        let condition = episode.key.condition;
        let mut policy = PolicyEpisodeConfig {
            episode: id,
            seed: episode.seed,
            lane,
            repeat: episode.key.run,
            starts_as_demonstrated: condition.is_hinted().into(),
            demonstrated_elsewhere: condition.demonstrations.take_place_elsewhere().into(),
            // At most `MAX_WINDOW`, which the settings check.
            window: condition.variation.window as u8,
            ..Zeroable::zeroed()
        };
        let case = &context.book().cases[episode.case_index];
        let instruction = case.instruction_with(condition.mismatch);
        policy.instruction_len = write_text(&mut policy.instruction, instruction);
        let rules = &context.rules;
        let external = condition.memory.external().and_then(|name| rules.external_index(name));
        let mut memory = MemoryEpisodeConfig {
            episode: id,
            seed: episode.seed,
            lane,
            case: episode.case_index as u32,
            demonstrations: episode.demonstrations().bits(),
            representation: condition.memory.built_in().map_or(EXTERNAL, |one| one as u8),
            horizon: rules.horizon,
            keyframes: rules.keyframes,
            segment: condition.variation.segment.code() as u8,
            text_budget: rules.memory_text_bytes,
            image_budget: rules.memory_images,
            hits: rules.hits,
            external: external.unwrap_or_default(),
            repeat: episode.key.run,
            variant: CaseVariant::without_mismatch(self.variant),
            paraphrased: (condition.mismatch == Mismatch::Wording).into(),
            ..Zeroable::zeroed()
        };
        // Working memory has nothing that could persist.
        let persists = condition.memory.uses_demonstrations();
        if let Some((part, place)) = episode.part.zip(episode.key.place).filter(|_| persists) {
            memory.sequence = part.sequence;
            memory.snapshot = part.snapshot;
            memory.stream = place.stream;
            memory.block = part.block;
            memory.position = place.position;
            memory.arm = condition.arm as u8;
            memory.learns = episode.learns().into();
            memory.feedback = part.feedback as u8;
        }
        // An episode of a stream begins at the case's new start, whatever its condition says.
        let start = if episode.part.is_some() { Start::New } else { condition.start };
        let mut world = WorldEpisodeConfig {
            episode: id,
            seed: episode.seed,
            sent_ns: context.now_ns,
            lane,
            case: episode.case_index as u32,
            variant: self.variant,
            max_steps: rules.max_steps,
            start: start as u8,
            learns: episode.learns().into(),
            ..Zeroable::zeroed()
        };
        if let Some((part, place)) = episode.part.zip(episode.key.place) {
            (world.sequence, world.position) = (part.sequence, place.position);
        }
        self.since_ns = context.now_ns;
        EpisodeOpening { memory, policy, world }
    }

    /// Takes the simulator's answer. Returns whether the episode has ended; then its facts are among `notes`.
    pub(super) fn reported(
        &mut self,
        context: &Context<'_>,
        report: &StepReport,
        notes: &[Note],
    ) -> Result<bool, AnswerError> {
        let &StepReport { lane, step, .. } = report;
        if self.awaited != Awaited::Report || step != self.result.record.steps {
            return Err(self.unexpected(Role::Sim, step));
        }
        let ended = self
            .take_report(context, report, notes)
            .map_err(|problem| AnswerError::Invalid { role: Role::Sim, lane, step, problem })?;
        self.stamps.reported(report);
        self.since_ns = context.now_ns;
        self.awaited = if ended { Awaited::Snapshot } else { Awaited::Decision };
        Ok(ended)
    }

    /// Records what the simulator tells of a step. Returns whether the episode has ended.
    ///
    /// # Errors
    /// What is wrong with it.
    fn take_report(
        &mut self,
        context: &Context<'_>,
        report: &StepReport,
        notes: &[Note],
    ) -> Result<bool, String> {
        let ended = EpisodeEnd::try_from(report.ended).map_err(|unknown| unknown.to_string())?;
        let conflict = read_flag(report.conflict).map_err(|unknown| unknown.to_string())?;
        let has_ended = ended != EpisodeEnd::GoesOn;
        if (report.frame == NO_FRAME) != has_ended {
            return Err(format!("frame {} of an episode that {}", report.frame, ended.word()));
        }
        if report.step == 0 {
            self.begin_hash = report.state_hash;
        }
        let record = &mut self.result.record;
        let (sub_goals, required) = (report.sub_goals.into(), report.required.into());
        if sub_goals < record.sub_goals.len() || report.sub_goals > report.required {
            return Err(format!("{sub_goals} of {required} sub-goals"));
        }
        record.sub_goals.resize(sub_goals, record.steps);
        record.required = required;
        if conflict && record.route == Route::Blocked {
            record.conflict_at.get_or_insert(record.steps);
        }
        if !has_ended {
            return Ok(false);
        }
        record.ending = match ended {
            EpisodeEnd::Complete => Ending::Complete,
            EpisodeEnd::Failed => Ending::Failed,
            EpisodeEnd::StepLimit | EpisodeEnd::GoesOn => Ending::OutOfSteps,
        };
        let begin = self.begin_hash;
        record.state_hashes = Some([begin, report.state_hash].map(|hash| format!("{hash:016x}")));
        let note = notes.iter().find(|note| note.header.id == report.facts);
        let note = note.ok_or_else(|| "its facts are missing".to_owned())?;
        let bytes = note.bytes.as_ref().map_err(ToString::to_string)?;
        record.world =
            serde_json::from_slice(bytes).map_err(|error| format!("its facts: {error}"))?;
        record.check_world()?;
        let failure = record.shared_facts().failure;
        let is_unknown = |kind: &str| context.book().world.failure_index(kind).is_none();
        match failure.filter(|failure| is_unknown(&failure.kind)) {
            Some(failure) => Err(format!("it has no kind of failure {}", failure.kind)),
            None => Ok(true),
        }
    }

    /// Whether a memory learns from it.
    pub(super) fn learns(&self) -> bool {
        self.result.episode.learns()
    }

    /// Takes memory's report that it has learned, with which the episode is over.
    pub(super) fn learned(&mut self, report: &SnapshotReport) -> Result<(), AnswerError> {
        if !self.result.episode.learns() || self.awaited != Awaited::Snapshot {
            return Err(self.unexpected(Role::Memory, self.result.record.steps));
        }
        self.snapshot = Some(*report);
        Ok(())
    }

    /// Takes memory's trace of a recall.
    pub(super) fn recalled(
        &mut self,
        context: &Context<'_>,
        trace: &RecallTrace,
    ) -> Result<(), AnswerError> {
        let &RecallTrace { lane, step, .. } = trace;
        if !self.awaits(step) || self.trace.is_some() {
            return Err(self.unexpected(Role::Memory, step));
        }
        let invalid = |problem| AnswerError::Invalid { role: Role::Memory, lane, step, problem };
        let sources = trace.sources.get(..trace.sources_len as usize);
        let sources = sources.ok_or_else(|| invalid(format!("{} sources", trace.sources_len)))?;
        if self.stamps.memory.retrieves() {
            let FinishedEpisode { episode, record, .. } = &mut self.result;
            // What differs beside the route makes no demonstration stale.
            let variant = CaseVariant::without_mismatch(self.variant);
            let noted = self.retrieved.add(context, episode, record, variant, sources);
            noted.map_err(invalid)?;
        }
        self.count_recall(trace);
        self.trace = Some(*trace);
        self.since_ns = context.now_ns;
        Ok(())
    }

    /// Takes the policy's answer.
    pub(super) fn decided(
        &mut self,
        context: &Context<'_>,
        decision: &Decision,
    ) -> Result<(), AnswerError> {
        if !self.awaits(decision.step) || self.early.is_some() {
            return Err(self.unexpected(Role::Policy, decision.step));
        }
        read_answer(context, decision).map(drop)?;
        self.early = Some(*decision);
        Ok(())
    }

    /// Takes the step that a decision leads to, once everything that it is based on has arrived: messages are delivered
    /// to one receiver after the other, so an answer may arrive before what it answers.
    pub(super) fn settle(
        &mut self,
        context: &Context<'_>,
        answered: &mut Vec<AnsweredRequest>,
    ) -> Result<Option<(StepCommand, Stamps)>, AnswerError> {
        let (Awaited::Decision, Some(trace), Some(decision)) =
            (self.awaited, self.trace, self.early)
        else {
            return Ok(None);
        };
        (self.trace, self.early) = (None, None);
        let answer = read_answer(context, &decision)?;
        self.stamps.recalled(&trace);
        self.stamps.decided(&decision);
        self.count(&decision, answered);
        Ok(Some(self.advance(context, answer)))
    }

    /// Takes the next step of the reference.
    pub(super) fn expert_step(
        &mut self,
        context: &Context<'_>,
    ) -> Result<(StepCommand, Stamps), AnswerError> {
        let step = self.result.record.steps;
        let expert = self.result.episode.expert(context.book());
        let action = expert.and_then(|expert| expert.actions.get(step as usize).copied());
        let action = action.ok_or_else(|| {
            let problem = "the case's reference ends before its task is complete".to_owned();
            let lane = self.result.lane;
            AnswerError::Invalid { role: Role::Orchestrator, lane, step, problem }
        })?;
        Ok(self.advance(context, Ok(action)))
    }

    /// Adds what a decision cost.
    fn count(&mut self, decision: &Decision, answered: &mut Vec<AnsweredRequest>) {
        let counts = decision.counts();
        let sum = |sum: Option<u64>, more: Option<u32>| {
            sum.zip(more).map(|(sum, more)| sum + u64::from(more))
        };
        let record = &mut self.result.record;
        let dropped = counts.images_asked.zip(counts.images);
        record.requests = record.requests.map(|requests| requests + 1);
        record.images = sum(record.images, counts.images);
        record.images_dropped +=
            dropped.map_or(0, |(asked, images)| u64::from(asked.saturating_sub(images)));
        record.prompt_tokens = sum(record.prompt_tokens, counts.prompt_tokens);
        record.completion_tokens = sum(record.completion_tokens, counts.completion_tokens);
        record.memory_tokens = sum(record.memory_tokens, counts.memory_tokens);
        let asked_a_model = counts.attempts.is_some_and(|attempts| attempts > 0)
            || decision.replayed != 0
            || counts.prompt_tokens.is_some();
        if asked_a_model {
            answered.push(AnsweredRequest { key: record.key.clone(), decision: *decision });
        }
    }

    /// Takes the next step: an action, or staying where an answer could not be read. Returns the command for it, and the
    /// stamps of the step before.
    fn advance(
        &mut self,
        context: &Context<'_>,
        answer: Result<ActionCode, Outcome>,
    ) -> (StepCommand, Stamps) {
        let record = &mut self.result.record;
        record.steps += 1;
        let (kind, action) = match answer {
            Ok(action) => {
                record.actions.push(context.declaration().letter(Some(action)));
                (StepKind::Act, action.0)
            }
            Err(outcome) => {
                record.unread.add(outcome);
                record.actions.push(NO_LETTER);
                (StepKind::Stay, NO_ACTION)
            }
        };
        self.awaited = Awaited::Report;
        self.stamps.logged_ns = context.now_ns;
        self.result.stages += self.stamps.stages();
        self.since_ns = context.now_ns;
        let command = StepCommand {
            episode: self.result.id,
            sent_ns: context.now_ns,
            lane: self.result.lane,
            step: self.result.record.steps,
            kind: kind as u8,
            action,
            ..Zeroable::zeroed()
        };
        (command, self.stamps)
    }

    /// The finished episode.
    pub(super) fn finish(self, context: &Context<'_>) -> FinishedEpisode {
        let Self { mut result, snapshot, retrieved, .. } = self;
        result.ended_ns = context.now_ns;
        if let Some((SnapshotReport { snapshot, store_bytes, .. }, stream)) =
            snapshot.zip(result.record.stream.as_mut())
        {
            stream.snapshot = Some(hex(&snapshot));
            stream.store_bytes =
                Some(store_bytes).filter(|bytes| *bytes > 0).or(stream.store_bytes);
            if let Some(part) = &mut result.episode.part {
                part.snapshot = snapshot;
            }
        }
        retrieved.complete(&mut result.record);
        result
    }

    /// The answer that the episode waits for.
    pub(super) fn pending(&self, lane: u32, memory_busy_ns: u64) -> PendingAnswer {
        let role = match (self.awaited, self.trace) {
            (Awaited::Report, _) => Role::Sim,
            (Awaited::Decision, None) | (Awaited::Snapshot, _) => Role::Memory,
            (Awaited::Decision, Some(_)) => Role::Policy,
        };
        let since_ns = match role {
            Role::Memory => self.since_ns.max(memory_busy_ns),
            _ => self.since_ns,
        };
        let memory = self.stamps.memory;
        PendingAnswer { role, lane, memory, since_ns, unusable: self.result.unusable }
    }

    /// Adds what memory supplied.
    fn count_recall(&mut self, trace: &RecallTrace) {
        let record = &mut self.result.record;
        let dropped = |asked: u32, supplied: u32| u64::from(asked.saturating_sub(supplied));
        record.memory_items_dropped += dropped(trace.items_asked.into(), trace.items.into());
        record.memory_images_dropped += dropped(trace.images_asked, trace.images);
        record.memory_text_dropped += dropped(trace.text_asked, trace.text);
        let recalls = &mut self.result.recalls;
        recalls.requests += 1;
        recalls.items += u64::from(trace.items);
        recalls.images += u64::from(trace.images);
        recalls.text += u64::from(trace.text);
        if let Some(stream) = record.stream.as_mut().filter(|_| trace.store_bytes > 0) {
            stream.store_bytes = Some(trace.store_bytes);
        }
        if trace.store_bytes > 0 {
            recalls.store_bytes = recalls.store_bytes.max(Some(trace.store_bytes));
        }
        if trace.tokens != NOT_MEASURED {
            *recalls.tokens.get_or_insert(0) += u64::from(trace.tokens);
        }
        if self.stamps.memory.external().is_some() {
            let answer_ns = trace.searched_ns.saturating_sub(trace.embedded_ns);
            *recalls.answer_ns.get_or_insert(0) += answer_ns;
            *recalls.method_ns.get_or_insert(0) += trace.method_ns.min(answer_ns);
        }
    }

    /// Whether an answer about `step` is, or will be, awaited.
    fn awaits(&self, step: u32) -> bool {
        self.awaited != Awaited::Snapshot && step == self.result.record.steps
    }

    fn unexpected(&mut self, role: Role, step: u32) -> AnswerError {
        self.result.unusable += 1;
        AnswerError::Unexpected { role, lane: self.result.lane, step }
    }
}

/// The action that was decided on, or why the answer has none.
fn read_answer(
    context: &Context<'_>,
    decision: &Decision,
) -> Result<Result<ActionCode, Outcome>, AnswerError> {
    let &Decision { lane, step, outcome, action, .. } = decision;
    let invalid = |error: UnknownCode| {
        let problem = error.to_string();
        AnswerError::Invalid { role: Role::Policy, lane, step, problem }
    };
    Ok(match Outcome::try_from(outcome).map_err(invalid)? {
        Outcome::Acted => Ok(context
            .declaration()
            .action(action)
            .ok_or_else(|| invalid(UnknownCode::new(action, "an action of this world")))?),
        unread => Err(unread),
    })
}
