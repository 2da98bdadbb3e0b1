//! Lanes: N episodes walked at once, each a small state machine. Pure: messages in, messages out.
//!
//! A lane has at most one question open. A [`StepCommand`] opens it, the [`Observation`] answers the
//! simulator's half, the [`Decision`] the policy's half; then the next command goes out or the episode
//! is finished. Where a step ends the episode is known before it is taken, because the dynamics are one
//! pure function: the simulator is told (`last`), need not render, and nobody has to decide in vain. What
//! it then reports is compared with the prediction, so a simulator that disagrees is found at once.
//!
//! Every answer names its episode by a ticket that is never handed out twice. What belongs to an earlier
//! episode of the lane is late, and dropped without harm.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use bytemuck::Zeroable;
use domain::{Action, Cell, Feedback, Outcome, Pose};
use shm_types::message::{
    Decision, FrameId, MemoryEpisodeConfig, NO_ACTION, NO_FRAME, NOT_MEASURED, Observation,
    PolicyEpisodeConfig, RecallTrace, Role, StepCommand, StepKind, WirePose, write_text,
};
use warehouse::{Case, CaseSet, Progress, Start, Variant, Warehouse, step};

use crate::event_recorder::EventRecorder;
use crate::plan::Episode;
use results::conditions::Route;
use results::log::{Ending, EpisodeRecord, Stages, Unread};

mod fault;

pub use fault::Fault;
mod stamps;

pub use stamps::Stamps;

/// What all episodes of a run have in common.
#[derive(Debug, Clone, Copy)]
pub struct Rules {
    /// Expert actions that a retrieved segment follows, H_epi.
    pub horizon: u8,
    /// Keyframes of full-context memory.
    pub keyframes: u8,
    /// T_max.
    pub max_steps: u32,
    /// Whether the orchestrator decides itself, by replaying the reference.
    pub expert: bool,
}

/// A finished episode: what goes into the log, and what it cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Walked {
    /// Which episode.
    pub episode: Episode,
    /// What follows from settings, seed and frames alone.
    pub record: EpisodeRecord,
    /// Where the time went.
    pub stages: Stages,
    /// The lane it was walked in.
    pub lane: u32,
    /// Its ticket.
    pub ticket: u64,
    /// When it began, CLOCK_MONOTONIC.
    pub started_ns: u64,
    /// When it was over.
    pub ended_ns: u64,
    /// Messages about it that could not be used.
    pub rubbish: u32,
}

/// A question to a model that was answered, and what it took.
#[derive(Debug, Clone, PartialEq)]
pub struct Spent {
    /// Key of the episode.
    pub key: String,
    /// The answer.
    pub decision: Decision,
}

/// The messages that open an episode, in the order in which they must be sent.
#[derive(Debug)]
pub struct Opening {
    /// For the memory.
    pub memory: MemoryEpisodeConfig,
    /// For the policy.
    pub policy: PolicyEpisodeConfig,
    /// For the simulator.
    pub command: StepCommand,
}

/// What follows from a message.
#[derive(Debug)]
pub enum Turn {
    /// Nothing to do.
    Wait,
    /// Send this.
    Command(StepCommand),
    /// The lane is free; its episode is done.
    Finished(Box<Walked>),
}

/// An answer that a lane waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Owed {
    /// Who owes it.
    pub role: Role,
    /// Which lane waits.
    pub lane: u32,
    /// Since when, CLOCK_MONOTONIC.
    pub since_ns: u64,
    /// Messages about the lane's episode that could not be used: there may have been an answer among them.
    pub rubbish: u32,
}

/// The lanes of a run and the episodes in them.
#[derive(Debug)]
pub struct Lanes<'w> {
    warehouse: &'w Warehouse,
    cases: &'w CaseSet,
    rules: Rules,
    lanes: Vec<Option<Walk>>,
    tickets: u64,
    now_ns: u64,
    /// Since [`Lanes::take_spent`] was last called.
    spent: Vec<Spent>,
    /// Since [`Lanes::take_stepped`] was last called.
    stepped: Vec<Stamps>,
}

/// One episode under way.
#[derive(Debug)]
struct Walk {
    ticket: u64,
    variant_code: u32,
    variant: Variant,
    /// The reference's actions, for the expert.
    reference: Vec<Action>,
    progress: Progress,
    events: EventRecorder,
    /// Where the agent will be, and be told, when the open command is done.
    pose: Pose,
    feedback: Feedback,
    last_action: u8,
    asked: Asked,
    /// When the open question was asked.
    since_ns: u64,
    /// Of the current step.
    stamps: Stamps,
    /// What the memory said of the current step, once it has.
    trace: Option<RecallTrace>,
    /// The decision on the current step, while what it follows from has not arrived here.
    early: Option<Decision>,
    /// As [`EpisodeRecord::retrieved`].
    retrieved: String,
    distances: Vec<f64>,
    walked: Walked,
}

/// Whose answer a lane waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Asked {
    /// The simulator's; the episode goes on.
    Observation,
    /// The simulator's; the episode is over with it.
    LastObservation,
    /// The policy's.
    Decision,
}

impl<'w> Lanes<'w> {
    /// `count` empty lanes.
    pub fn new(warehouse: &'w Warehouse, cases: &'w CaseSet, rules: Rules, count: usize) -> Self {
        let lanes = std::iter::repeat_with(|| None).take(count).collect();
        let (spent, stepped) = (Vec::new(), Vec::new());
        Self { warehouse, cases, rules, lanes, tickets: 0, now_ns: 0, spent, stepped }
    }

    /// What time it is, CLOCK_MONOTONIC: until the next call, everything happens now. To read the clock costs as
    /// much as much of what is done here.
    pub fn set_time(&mut self, now_ns: u64) {
        self.now_ns = now_ns;
    }

    /// The time that was set last.
    pub fn time(&self) -> u64 {
        self.now_ns
    }

    /// A lane that is free.
    pub fn free(&self) -> Option<usize> {
        self.lanes.iter().position(Option::is_none)
    }

    /// Episodes under way.
    pub fn busy(&self) -> usize {
        self.lanes.iter().flatten().count()
    }

    /// Begins `episode` in the free lane `lane`.
    pub fn begin(&mut self, lane: usize, episode: Episode) -> Opening {
        self.tickets += 1;
        let mut walk = self.set_out(lane, episode);
        let episode = &walk.walked.episode;
        let condition = episode.key.condition;
        let mut policy = PolicyEpisodeConfig {
            episode: walk.ticket,
            seed: episode.seed,
            lane: lane as u32,
            repeat: episode.key.run,
            starts_as_demonstrated: condition.is_hinted().into(),
            // At most `MAX_WINDOW`, which the settings check.
            window: condition.variation.window as u8,
            ..Zeroable::zeroed()
        };
        let task = &self.cases.cases[episode.case_index].task;
        let instruction = task.instruction(&self.warehouse.catalogue);
        policy.instruction_len = write_text(&mut policy.instruction, &instruction);
        let opening = Opening {
            memory: MemoryEpisodeConfig {
                episode: walk.ticket,
                lane: lane as u32,
                case: episode.case_index as u32,
                demonstrations: condition.demonstrations.bits(),
                representation: condition.memory as u8,
                horizon: self.rules.horizon,
                keyframes: self.rules.keyframes,
                segment: condition.variation.segment.code() as u8,
                ..Zeroable::zeroed()
            },
            policy,
            command: StepCommand {
                start: walk.pose.into(),
                ..walk.command(lane, StepKind::Reset, self.now_ns)
            },
        };
        self.lanes[lane] = Some(walk);
        opening
    }

    /// The walk of `episode` before its first step.
    fn set_out(&self, lane: usize, episode: Episode) -> Walk {
        let case = &self.cases.cases[episode.case_index];
        let condition = episode.key.condition;
        let from = condition.start.reference(condition.route);
        let trajectory = case.trajectory(from);
        let start = trajectory.start;
        let progress = Progress::new(self.warehouse, &case.task, start.cell);
        let mut events = EventRecorder::new(self.warehouse, &case.task);
        events.stands(0, start);
        events.looks(&self.warehouse.layout, 0, start);
        let blocked = condition.route == Route::Blocked;
        let asks = !self.rules.expert;
        let record = EpisodeRecord {
            key: episode.key.to_string(),
            memory: condition.memory,
            start: condition.start,
            route: condition.route,
            demonstrations: condition.demonstrations,
            window: condition.variation.window,
            segment: condition.variation.segment,
            hint: condition.variation.hint,
            run: episode.key.run,
            case: episode.key.case.clone(),
            task: case.task.number(),
            seed: episode.seed,
            ending: Ending::OutOfSteps,
            steps: 0,
            reference: case.replay(self.warehouse, from).length.unwrap_or(0),
            actions: String::new(),
            sub_goals: vec![0; progress.stage() as usize],
            required: progress.total(),
            visits: Vec::new(),
            first_seen: BTreeMap::new(),
            blocked_moves: Vec::new(),
            tried_closed: blocked.then_some(false),
            tried_closed_at: None,
            start_pose: start,
            final_pose: start,
            requests: asks.then_some(0),
            images: asks.then_some(0),
            images_dropped: 0,
            prompt_tokens: asks.then_some(0),
            completion_tokens: asks.then_some(0),
            memory_tokens: asks.then_some(0),
            unread: Unread::default(),
            retrieved: None,
            distance: None,
        };
        Walk {
            ticket: self.tickets,
            variant_code: if blocked { 1 + episode.case_index as u32 } else { 0 },
            variant: case.variant(from),
            reference: trajectory.actions.clone(),
            progress,
            events,
            pose: start,
            feedback: Feedback::Start,
            last_action: NO_ACTION,
            asked: Asked::Observation,
            since_ns: 0,
            stamps: Stamps::none(self.tickets, lane as u32, condition.memory),
            trace: None,
            early: None,
            retrieved: String::new(),
            distances: Vec::new(),
            walked: Walked {
                episode,
                record,
                stages: Stages::default(),
                lane: lane as u32,
                ticket: self.tickets,
                started_ns: self.now_ns,
                ended_ns: 0,
                rubbish: 0,
            },
        }
    }

    /// Takes the simulator's answer.
    ///
    /// # Errors
    /// When it cannot be used; [`Fault::Disagrees`] means that the simulator is broken.
    pub fn observed(&mut self, observation: &Observation) -> Result<Turn, Fault> {
        let &Observation { lane, step, episode, .. } = observation;
        let (expert, now_ns) = (self.rules.expert, self.now_ns);
        let Some(walk) = self.walk(Role::Sim, lane, episode)? else { return Ok(Turn::Wait) };
        let last = match walk.asked {
            Asked::Observation => false,
            Asked::LastObservation => true,
            Asked::Decision => return Err(walk.not_asked(Role::Sim, step)),
        };
        walk.agrees(observation, last)?;
        walk.stamps.observed(observation);
        walk.since_ns = now_ns;
        if last {
            return Ok(self.close(lane as usize));
        }
        walk.asked = Asked::Decision;
        if !expert {
            return self.settle(lane);
        }
        let next = walk.reference.get(walk.walked.record.steps as usize).copied();
        let action = next.ok_or_else(|| {
            let what = "the case's reference ends before its task is complete".to_owned();
            Fault::Garbage { role: Role::Orchestrator, lane, step, what }
        })?;
        Ok(self.advance(lane as usize, Ok(action)))
    }

    /// Takes the memory's account of a recall.
    ///
    /// # Errors
    /// When it cannot be used. After [`Fault::Garbage`] the episode cannot go on: [`Lanes::give_up`].
    pub fn recalled(&mut self, trace: &RecallTrace) -> Result<Turn, Fault> {
        let &RecallTrace { lane, step, episode, demonstration, .. } = trace;
        let (cases, now_ns) = (&self.cases.cases, self.now_ns);
        let Some(walk) = self.walk(Role::Memory, lane, episode)? else { return Ok(Turn::Wait) };
        if !walk.is_awaited(step) || walk.trace.is_some() {
            return Err(walk.not_asked(Role::Memory, step));
        }
        let source = match trace.case {
            NOT_MEASURED => None,
            case => {
                let which = Start::DEMONSTRATIONS.get(usize::from(demonstration));
                let Some(source) = cases.get(case as usize).zip(which) else {
                    let what = format!("case {case}, demonstration {demonstration}");
                    return Err(Fault::Garbage { role: Role::Memory, lane, step, what });
                };
                Some(source)
            }
        };
        walk.retrieved_from(source, trace);
        walk.trace = Some(*trace);
        walk.since_ns = now_ns;
        self.settle(lane)
    }

    /// Takes the policy's answer.
    ///
    /// # Errors
    /// When it cannot be used. After [`Fault::Garbage`] the episode cannot go on: [`Lanes::give_up`].
    pub fn decided(&mut self, decision: &Decision) -> Result<Turn, Fault> {
        let &Decision { lane, step, episode, .. } = decision;
        let Some(walk) = self.walk(Role::Policy, lane, episode)? else { return Ok(Turn::Wait) };
        if !walk.is_awaited(step) || walk.early.is_some() {
            return Err(walk.not_asked(Role::Policy, step));
        }
        read_answer(decision).map(drop)?;
        walk.early = Some(*decision);
        self.settle(lane)
    }

    /// Draws the consequence of a decision once all that it follows from is here: a message is delivered to one
    /// receiver after the other, so one that answers it may arrive first.
    fn settle(&mut self, lane: u32) -> Result<Turn, Fault> {
        let Some(walk) = self.lanes.get_mut(lane as usize).and_then(Option::as_mut) else {
            return Ok(Turn::Wait);
        };
        let (Asked::Decision, Some(trace), Some(decision)) = (walk.asked, walk.trace, walk.early)
        else {
            return Ok(Turn::Wait);
        };
        (walk.trace, walk.early) = (None, None);
        let answer = read_answer(&decision)?;
        walk.stamps.recalled(&trace);
        walk.stamps.decided(&decision);
        let record = &mut walk.walked.record;
        let counts = decision.counts();
        let sum = |sum: Option<u64>, more: Option<u64>| sum.zip(more).map(|(a, b)| a + b);
        record.requests = record.requests.map(|requests| requests + 1);
        record.images = sum(record.images, counts.images.map(u64::from));
        record.images_dropped += counts
            .images_asked
            .zip(counts.images)
            .map_or(0, |(asked, images)| u64::from(asked - images));
        record.prompt_tokens = sum(record.prompt_tokens, counts.prompt_tokens.map(u64::from));
        record.completion_tokens =
            sum(record.completion_tokens, counts.completion_tokens.map(u64::from));
        record.memory_tokens = sum(record.memory_tokens, counts.memory_tokens.map(u64::from));
        let asked_a_model = counts.attempts.is_some_and(|attempts| attempts > 0)
            || decision.replayed != 0
            || counts.prompt_tokens.is_some();
        if asked_a_model {
            let key = record.key.clone();
            self.spent.push(Spent { key, decision });
        }
        Ok(self.advance(lane as usize, answer))
    }

    /// Whether a decision is here without what it follows from, which is on its way.
    pub fn is_half_told(&self) -> bool {
        self.lanes.iter().flatten().any(|walk| walk.early.is_some())
    }

    /// What was spent on answers since the last call.
    pub fn take_spent(&mut self) -> Vec<Spent> {
        std::mem::take(&mut self.spent)
    }

    /// The steps that were taken since the last call.
    pub fn take_stepped(&mut self) -> std::vec::Drain<'_, Stamps> {
        self.stepped.drain(..)
    }

    /// Empties the lane if `ticket` is walked in it, and hands the episode back.
    pub fn give_up_ticket(&mut self, lane: u32, ticket: u64) -> Option<Episode> {
        let walk = self.lanes.get_mut(lane as usize)?.take_if(|walk| walk.ticket == ticket)?;
        Some(walk.walked.episode)
    }

    /// Empties the lane and hands its episode back, to be walked again.
    pub fn give_up(&mut self, lane: u32) -> Option<Episode> {
        self.lanes.get_mut(lane as usize)?.take().map(|walk| walk.walked.episode)
    }

    /// Empties all lanes and hands their episodes back, to be walked again.
    pub fn abandon(&mut self) -> Vec<Episode> {
        self.lanes.iter_mut().filter_map(Option::take).map(|walk| walk.walked.episode).collect()
    }

    /// The answers that are owed, by lane. Memory owes nothing from before `memory_busy_ns`, when it was last known
    /// to be at work.
    pub fn owed(&self, memory_busy_ns: u64) -> Vec<Owed> {
        let owed = (0..).zip(&self.lanes).filter_map(|(lane, walk)| {
            let walk = walk.as_ref()?;
            let role = match (walk.asked, walk.trace) {
                (Asked::Observation | Asked::LastObservation, _) => Role::Sim,
                (Asked::Decision, None) => Role::Memory,
                (Asked::Decision, Some(_)) => Role::Policy,
            };
            let since_ns = match role {
                Role::Memory => walk.since_ns.max(memory_busy_ns),
                _ => walk.since_ns,
            };
            Some(Owed { role, lane, since_ns, rubbish: walk.walked.rubbish })
        });
        owed.collect()
    }

    /// The walk that a message is about; `None` when the message is late.
    fn walk(&mut self, role: Role, lane: u32, ticket: u64) -> Result<Option<&mut Walk>, Fault> {
        let lanes = self.lanes.len();
        let walk =
            self.lanes.get_mut(lane as usize).ok_or(Fault::NoSuchLane { role, lane, lanes })?;
        Ok(walk.as_mut().filter(|walk| walk.ticket == ticket))
    }

    /// Takes the next step of the lane's walk: an action, or staying where an answer could not be read.
    fn advance(&mut self, lane: usize, answer: Result<Action, Outcome>) -> Turn {
        let (layout, max_steps) = (&self.warehouse.layout, self.rules.max_steps);
        let Some(walk) = &mut self.lanes[lane] else { return Turn::Wait };
        let record = &mut walk.walked.record;
        let kind = match answer {
            Ok(action) => {
                let tried = entered(walk.pose, action).is_some_and(|c| walk.variant.is_closed(c));
                if tried && record.tried_closed_at.is_none() {
                    record.tried_closed_at = Some(record.steps + 1);
                }
                record.tried_closed = record.tried_closed.map(|before| before || tried);
                (walk.pose, walk.feedback) = step(layout, &walk.variant, walk.pose, action);
                walk.last_action = action as u8;
                record.actions.push(action.letter());
                StepKind::Act
            }
            Err(outcome) => {
                match outcome {
                    Outcome::Acted | Outcome::Unreadable => record.unread.unreadable += 1,
                    Outcome::Empty => record.unread.empty += 1,
                    Outcome::Refused => record.unread.refused += 1,
                }
                walk.feedback = Feedback::NotUnderstood;
                walk.last_action = NO_ACTION;
                record.actions.push('?');
                StepKind::Stay
            }
        };
        record.steps += 1;
        record.final_pose = walk.pose;
        if walk.feedback == Feedback::Blocked {
            record.blocked_moves.push(record.steps);
        }
        walk.events.stands(record.steps, walk.pose);
        let met = walk.progress.visit(walk.pose.cell);
        record.sub_goals.extend((0..met).map(|_| record.steps));
        if walk.progress.is_complete() {
            record.ending = Ending::Complete;
        }
        let over = walk.progress.is_complete() || record.steps >= max_steps;
        walk.asked = if over {
            Asked::LastObservation
        } else {
            walk.events.looks(layout, record.steps, walk.pose);
            Asked::Observation
        };
        let command = walk.command(lane, kind, self.now_ns);
        walk.stamps.logged_ns = command.sent_ns;
        walk.walked.stages += walk.stamps.stages();
        self.stepped.push(walk.stamps);
        Turn::Command(command)
    }

    /// Takes the finished walk out of its lane.
    fn close(&mut self, lane: usize) -> Turn {
        let Some(walk) = self.lanes[lane].take() else { return Turn::Wait };
        let Walk { mut walked, events, retrieved, distances, .. } = walk;
        walked.ended_ns = self.now_ns;
        walked.record.visits = events.visits;
        walked.record.first_seen = events.first_seen;
        if !distances.is_empty() {
            let mean = distances.iter().sum::<f64>() / distances.len() as f64;
            walked.record.distance = Some((mean * 1e6).round() / 1e6);
            walked.record.retrieved = Some(retrieved);
        }
        Turn::Finished(Box::new(walked))
    }
}

impl Walk {
    /// The command that makes the simulator do what was predicted.
    fn command(&mut self, lane: usize, kind: StepKind, now_ns: u64) -> StepCommand {
        self.since_ns = now_ns;
        StepCommand {
            episode: self.ticket,
            sent_ns: self.since_ns,
            lane: lane as u32,
            step: self.walked.record.steps,
            variant: self.variant_code,
            kind: kind as u8,
            action: self.last_action,
            last: u8::from(self.asked == Asked::LastObservation),
            ..Zeroable::zeroed()
        }
    }

    /// Adds a word about where the current step's segment is from, if one was retrieved.
    fn retrieved_from(&mut self, source: Option<(&Case, &Start)>, trace: &RecallTrace) {
        if !self.retrieved.is_empty() {
            self.retrieved.push(' ');
        }
        let Some((case, start)) = source else { return self.retrieved.push('-') };
        self.distances.push(f64::from(trace.distance));
        if trace.case as usize != self.walked.episode.case_index {
            self.retrieved.push_str(&case.id);
            self.retrieved.push(':');
        }
        self.retrieved.push(start.letter());
        // Writing to a string cannot fail.
        let _ = write!(self.retrieved, "{}", trace.index);
    }

    /// Whether an answer about `step` is, or will be, owed.
    fn is_awaited(&self, step: u32) -> bool {
        self.asked != Asked::LastObservation && step == self.walked.record.steps
    }

    fn not_asked(&mut self, role: Role, step: u32) -> Fault {
        self.walked.rubbish += 1;
        Fault::NotAsked { role, lane: self.walked.lane, step }
    }

    /// Whether the simulator saw what the dynamics say.
    fn agrees(&self, observation: &Observation, last: bool) -> Result<(), Fault> {
        let &Observation { lane, step, .. } = observation;
        let frame_as_due = |frame: FrameId| (frame == NO_FRAME) == last;
        let (pose, feedback): (WirePose, u8) = (self.pose.into(), self.feedback as u8);
        if (step, observation.pose, observation.feedback)
            == (self.walked.record.steps, pose, feedback)
            && frame_as_due(observation.frame)
        {
            return Ok(());
        }
        let found = format!(
            "step {step}, pose {:?}, feedback {}, frame {}",
            observation.pose.0, observation.feedback, observation.frame
        );
        let expected = format!(
            "step {}, pose {:?}, feedback {feedback}, {} frame",
            self.walked.record.steps,
            pose.0,
            if last { "no" } else { "a" }
        );
        Err(Fault::Disagrees { lane, step, found, expected })
    }
}

/// What was decided: an action, or that an answer could not be read.
fn read_answer(decision: &Decision) -> Result<Result<Action, Outcome>, Fault> {
    let &Decision { lane, step, outcome, action, .. } = decision;
    let garbage = |error: domain::pose::UnknownCode| {
        let what = error.to_string();
        Fault::Garbage { role: Role::Policy, lane, step, what }
    };
    Ok(match Outcome::try_from(outcome).map_err(garbage)? {
        Outcome::Acted => Ok(Action::try_from(action).map_err(garbage)?),
        unread => Err(unread),
    })
}

/// The cell that `action` tries to enter from `pose`, if it is a move.
fn entered(pose: Pose, action: Action) -> Option<Cell> {
    pose.cell.step(pose.heading.turned(action.move_direction()?))
}
