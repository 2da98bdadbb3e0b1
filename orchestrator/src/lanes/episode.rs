//! One episode in a lane, from its first command to its record.

use std::collections::BTreeMap;

use bytemuck::Zeroable;
use domain::{Action, Cell, Feedback, MemoryKind, Outcome, Pose, hex};
use results::conditions::Route;
use results::log::{
    BlockedRecord, Ending, EpisodeRecord, RecallTotals, Stages, StreamRecord, Unread,
};
use shm_types::message::{
    Decision, EXTERNAL, FrameId, MemoryEpisodeConfig, NO_ACTION, NO_FRAME, NOT_MEASURED,
    Observation, PolicyEpisodeConfig, RecallTrace, Role, SnapshotReport, StepCommand, StepKind,
    TASK_COMPLETE, WirePose, write_text,
};
use warehouse::{Progress, TrajectoryKind, Variant, step};

use super::retrieved::Retrieved;
use super::{
    AnswerError, AnsweredRequest, Context, EpisodeOpening, FinishedEpisode, PendingAnswer, Stamps,
};
use crate::event_recorder::EventRecorder;
use crate::plan::{PlannedEpisode, StreamPart};

/// An episode under way.
#[derive(Debug)]
pub(super) struct ActiveEpisode {
    variant_code: u32,
    variant: Variant,
    /// The reference's actions, for the expert.
    reference: Vec<Action>,
    progress: Progress,
    events: EventRecorder,
    /// Pose and feedback once the open command is done.
    pose: Pose,
    feedback: Feedback,
    last_action: u8,
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
    /// The simulator's; the episode goes on.
    Observation,
    /// The simulator's; the episode ends with it.
    LastObservation,
    /// The policy's.
    Decision,
    /// Memory's report that it has learned; the episode ends with it.
    Snapshot,
}

impl ActiveEpisode {
    /// `episode` before its first step.
    pub(super) fn new(context: &Context<'_>, id: u64, lane: u32, episode: PlannedEpisode) -> Self {
        let Context { cases, rules, now_ns, .. } = context;
        let state = context.state(&episode);
        let warehouse = state.map_or(context.warehouse, |state| &state.warehouse);
        let case = &cases.cases[episode.case_index];
        let condition = episode.key.condition;
        let from = TrajectoryKind::reference(condition.start, condition.route);
        let in_world = episode
            .part
            .zip(context.streams)
            .map(|(part, streams)| streams.case(part.world, episode.case_index));
        let trajectory = in_world.map_or(case.trajectory(from), |found| &found.reference);
        let start = trajectory.start;
        let progress = Progress::new(warehouse, &case.task, start.cell);
        let mut events = EventRecorder::new(warehouse, &case.task);
        events.stands(0, start);
        events.looks(warehouse, 0, start);
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
            arm: condition.arm,
            run: episode.key.run,
            case: episode.key.case.clone(),
            task: case.task.task_type().number(),
            seed: episode.seed,
            ending: Ending::OutOfSteps,
            steps: 0,
            reference: episode.expert(context.book).map_or(0, |expert| expert.length),
            actions: String::new(),
            sub_goals: vec![0; progress.stage() as usize],
            required: progress.total(),
            visits: Vec::new(),
            first_seen: BTreeMap::new(),
            blocked_moves: Vec::new(),
            tried_closed: is_blocked.then_some(false),
            tried_closed_at: None,
            start_pose: start,
            final_pose: start,
            requests: has_policy.then_some(0),
            images: has_policy.then_some(0),
            images_dropped: 0,
            prompt_tokens: has_policy.then_some(0),
            completion_tokens: has_policy.then_some(0),
            memory_tokens: has_policy.then_some(0),
            unread: Unread::default(),
            blocked: is_blocked.then(|| BlockedRecord {
                invalidated: case
                    .original
                    .replay(warehouse, &case.task, &case.variant(from))
                    .length
                    .is_none(),
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
                    reference_actions: trajectory.actions.iter().map(|a| a.letter()).collect(),
                    retrievals: 0,
                    stale: 0,
                    snapshot: None,
                    store_bytes: None,
                }
            }),
        };
        Self {
            variant_code: match episode.part.zip(context.streams) {
                Some((part, streams)) => streams.set.variant(part.world, cases.cases.len()),
                None if is_blocked => 1 + episode.case_index as u32,
                None => 0,
            },
            variant: state.map_or_else(|| case.variant(from), |state| state.variant.clone()),
            reference: if rules.expert { trajectory.actions.clone() } else { Vec::new() },
            progress,
            events,
            pose: start,
            feedback: Feedback::Start,
            last_action: NO_ACTION,
            awaited: Awaited::Observation,
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
                started_ns: *now_ns,
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
        let task = &context.cases.cases[episode.case_index].task;
        let instruction = task.instruction(&context.warehouse.catalogue);
        policy.instruction_len = write_text(&mut policy.instruction, &instruction);
        let rules = &context.rules;
        let external = condition.memory.external().and_then(|name| rules.external_index(name));
        let mut memory = MemoryEpisodeConfig {
            episode: id,
            seed: episode.seed,
            lane,
            case: episode.case_index as u32,
            demonstrations: condition.demonstrations.bits(),
            representation: condition.memory.built_in().map_or(EXTERNAL, |one| one as u8),
            horizon: rules.horizon,
            keyframes: rules.keyframes,
            segment: condition.variation.segment.code() as u8,
            text_budget: rules.memory_text_bytes,
            image_budget: rules.memory_images,
            hits: rules.hits,
            external: external.unwrap_or_default(),
            repeat: episode.key.run,
            variant: self.variant_code,
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
        let start = self.pose.into();
        let command = StepCommand { start, ..self.command(StepKind::Reset, context.now_ns) };
        EpisodeOpening { memory, policy, command }
    }

    /// Takes the simulator's answer. Returns whether the episode is over.
    pub(super) fn observed(
        &mut self,
        context: &Context<'_>,
        observation: &Observation,
    ) -> Result<bool, AnswerError> {
        let is_last = match self.awaited {
            Awaited::Observation => false,
            Awaited::LastObservation => true,
            Awaited::Decision | Awaited::Snapshot => {
                return Err(self.unexpected(Role::Sim, observation.step));
            }
        };
        self.compare(observation, is_last)?;
        self.stamps.observed(observation);
        self.since_ns = context.now_ns;
        let is_over = is_last && (!self.result.episode.learns() || self.snapshot.is_some());
        if !is_over {
            self.awaited = if is_last { Awaited::Snapshot } else { Awaited::Decision };
        }
        Ok(is_over)
    }

    /// Takes memory's report that it has learned. Returns whether the episode is over.
    pub(super) fn learned(&mut self, report: &SnapshotReport) -> Result<bool, AnswerError> {
        let is_last = matches!(self.awaited, Awaited::LastObservation | Awaited::Snapshot);
        if !self.result.episode.learns() || !is_last || self.snapshot.is_some() {
            return Err(self.unexpected(Role::Memory, self.result.record.steps));
        }
        self.snapshot = Some(*report);
        Ok(self.awaited == Awaited::Snapshot)
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
            let noted = self.retrieved.add(context, episode, record, &self.variant, sources);
            noted.map_err(invalid)?;
        }
        self.count_recall(trace);
        self.trace = Some(*trace);
        self.since_ns = context.now_ns;
        Ok(())
    }

    /// Takes the policy's answer.
    pub(super) fn decided(&mut self, decision: &Decision) -> Result<(), AnswerError> {
        if !self.awaits(decision.step) || self.early.is_some() {
            return Err(self.unexpected(Role::Policy, decision.step));
        }
        read_answer(decision).map(drop)?;
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
        let answer = read_answer(&decision)?;
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
        let action = self.reference.get(step as usize).copied().ok_or_else(|| {
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

    /// Predicts the next step: an action, or staying where an answer could not be read. Returns the command that
    /// makes the simulator take it, and the stamps of the step before.
    fn advance(
        &mut self,
        context: &Context<'_>,
        answer: Result<Action, Outcome>,
    ) -> (StepCommand, Stamps) {
        let layout = &context.warehouse.layout;
        let record = &mut self.result.record;
        record.steps += 1;
        let kind = match answer {
            Ok(action) => {
                let tried = entered(self.pose, action).is_some_and(|c| self.variant.is_closed(c));
                if tried && record.tried_closed == Some(false) {
                    record.tried_closed_at = Some(record.steps);
                }
                record.tried_closed = record.tried_closed.map(|before| before || tried);
                (self.pose, self.feedback) = step(layout, &self.variant, self.pose, action);
                self.last_action = action as u8;
                record.actions.push(action.letter());
                StepKind::Act
            }
            Err(outcome) => {
                record.unread.add(outcome);
                self.feedback = Feedback::NotUnderstood;
                self.last_action = NO_ACTION;
                record.actions.push('?');
                StepKind::Stay
            }
        };
        record.final_pose = self.pose;
        if self.feedback == Feedback::Blocked {
            record.blocked_moves.push(record.steps);
        }
        self.events.stands(record.steps, self.pose);
        let met = self.progress.visit(self.pose.cell);
        record.sub_goals.extend((0..met).map(|_| record.steps));
        if self.progress.is_complete() {
            record.ending = Ending::Complete;
        }
        let is_over = self.progress.is_complete() || record.steps >= context.rules.max_steps;
        self.awaited = if is_over {
            Awaited::LastObservation
        } else {
            let world = record.stream.as_ref().zip(context.streams);
            let warehouse = world
                .map_or(context.warehouse, |(part, streams)| &streams.state(part.world).warehouse);
            self.events.looks(warehouse, record.steps, self.pose);
            Awaited::Observation
        };
        self.stamps.logged_ns = context.now_ns;
        self.result.stages += self.stamps.stages();
        (self.command(kind, context.now_ns), self.stamps)
    }

    /// The finished episode.
    pub(super) fn finish(self, context: &Context<'_>) -> FinishedEpisode {
        let Self { mut result, events, snapshot, retrieved, .. } = self;
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
        result.record.visits = events.visits;
        result.record.first_seen = events.first_seen;
        retrieved.complete(&mut result.record);
        result
    }

    /// The answer that the episode waits for.
    pub(super) fn pending(&self, lane: u32, memory_busy_ns: u64) -> PendingAnswer {
        let role = match (self.awaited, self.trace) {
            (Awaited::Observation | Awaited::LastObservation, _) => Role::Sim,
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

    /// The command that makes the simulator do what was predicted.
    fn command(&mut self, kind: StepKind, now_ns: u64) -> StepCommand {
        self.since_ns = now_ns;
        StepCommand {
            episode: self.result.id,
            sent_ns: now_ns,
            lane: self.result.lane,
            step: self.result.record.steps,
            variant: self.variant_code,
            kind: kind as u8,
            action: self.last_action,
            last: u8::from(self.awaited == Awaited::LastObservation),
            progress: self.progress.stage() as u8
                | if self.progress.is_complete() { TASK_COMPLETE } else { 0 },
            ..Zeroable::zeroed()
        }
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
        !matches!(self.awaited, Awaited::LastObservation | Awaited::Snapshot)
            && step == self.result.record.steps
    }

    fn unexpected(&mut self, role: Role, step: u32) -> AnswerError {
        self.result.unusable += 1;
        AnswerError::Unexpected { role, lane: self.result.lane, step }
    }

    /// Compares an observation with the prediction.
    fn compare(&self, observation: &Observation, is_last: bool) -> Result<(), AnswerError> {
        let &Observation { lane, step, .. } = observation;
        let steps = self.result.record.steps;
        let frame_as_due = |frame: FrameId| (frame == NO_FRAME) == is_last;
        let (pose, feedback): (WirePose, u8) = (self.pose.into(), self.feedback as u8);
        if (step, observation.pose, observation.feedback) == (steps, pose, feedback)
            && frame_as_due(observation.frame)
        {
            return Ok(());
        }
        let found = format!(
            "step {step}, pose {:?}, feedback {}, frame {}",
            observation.pose.0, observation.feedback, observation.frame
        );
        let expected = format!(
            "step {steps}, pose {:?}, feedback {feedback}, {} frame",
            pose.0,
            if is_last { "no" } else { "a" }
        );
        Err(AnswerError::Disagrees { lane, step, found, expected })
    }
}

/// The action that was decided on, or why the answer has none.
fn read_answer(decision: &Decision) -> Result<Result<Action, Outcome>, AnswerError> {
    let &Decision { lane, step, outcome, action, .. } = decision;
    let invalid = |error: domain::pose::UnknownCode| {
        let problem = error.to_string();
        AnswerError::Invalid { role: Role::Policy, lane, step, problem }
    };
    Ok(match Outcome::try_from(outcome).map_err(invalid)? {
        Outcome::Acted => Ok(Action::try_from(action).map_err(invalid)?),
        unread => Err(unread),
    })
}

/// The cell that `action` tries to enter from `pose`, if it is a move.
fn entered(pose: Pose, action: Action) -> Option<Cell> {
    pose.cell.step(pose.heading.turned(action.move_direction()?))
}
