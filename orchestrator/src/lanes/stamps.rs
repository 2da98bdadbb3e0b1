//! Time stamps of one step, taken from its messages.

use domain::MemoryKind;
use run_log::Stages;
use shm_types::message::{Decision, RecallTrace, StepReport};

/// When one step passed from stage to stage: CLOCK_MONOTONIC nanoseconds, the same clock in every process. A stage
/// that the step skips has 0; with the expert so has every stage after the observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamps {
    /// The episode's id.
    pub episode: u64,
    /// The lane.
    pub lane: u32,
    /// Steps taken before.
    pub step: u32,
    /// The episode's memory.
    pub memory: MemoryKind,
    /// The orchestrator sent the command.
    pub commanded_ns: u64,
    /// The simulator received it.
    pub woken_ns: u64,
    /// The dynamics were applied.
    pub stepped_ns: u64,
    /// The view was rendered, or found.
    pub rendered_ns: u64,
    /// The observation was published.
    pub published_ns: u64,
    /// Memory received it.
    pub received_ns: u64,
    /// The embeddings were computed.
    pub embedded_ns: u64,
    /// The memory had answered the query.
    pub searched_ns: u64,
    /// Nanoseconds before that in which an external memory computed, by its own clock; 0 for a built-in one.
    pub method_ns: u64,
    /// The recall was assembled.
    pub assembled_ns: u64,
    /// The recall was sent.
    pub recalled_ns: u64,
    /// The policy had observation and recall.
    pub joined_ns: u64,
    /// It began to decide.
    pub started_ns: u64,
    /// The prompt was built; 0 without one.
    pub prompted_ns: u64,
    /// The request was sent to a model's server; 0 without one.
    pub requested_ns: u64,
    /// It had decided.
    pub decided_ns: u64,
    /// The orchestrator had recorded the step.
    pub logged_ns: u64,
}

impl Stamps {
    /// The stamps of a step before it begins.
    pub const fn new(episode: u64, lane: u32, memory: MemoryKind) -> Self {
        Self {
            episode,
            lane,
            step: 0,
            memory,
            commanded_ns: 0,
            woken_ns: 0,
            stepped_ns: 0,
            rendered_ns: 0,
            published_ns: 0,
            received_ns: 0,
            embedded_ns: 0,
            searched_ns: 0,
            method_ns: 0,
            assembled_ns: 0,
            recalled_ns: 0,
            joined_ns: 0,
            started_ns: 0,
            prompted_ns: 0,
            requested_ns: 0,
            decided_ns: 0,
            logged_ns: 0,
        }
    }

    /// Begins a step with the simulator's stamps.
    pub(super) const fn reported(&mut self, report: &StepReport) {
        let StepReport { step, commanded_ns, woken_ns, stepped_ns, rendered_ns, sent_ns, .. } =
            *report;
        *self = Self {
            step,
            commanded_ns,
            woken_ns,
            stepped_ns,
            rendered_ns,
            published_ns: sent_ns,
            ..Self::new(self.episode, self.lane, self.memory)
        };
    }

    /// Adds memory's stamps.
    pub(super) const fn recalled(&mut self, trace: &RecallTrace) {
        self.received_ns = trace.received_ns;
        self.embedded_ns = trace.embedded_ns;
        self.searched_ns = trace.searched_ns;
        // By a clock that is not ours.
        let most_ns = trace.searched_ns.saturating_sub(trace.embedded_ns);
        self.method_ns = if trace.method_ns < most_ns { trace.method_ns } else { most_ns };
        self.assembled_ns = trace.assembled_ns;
        self.recalled_ns = trace.sent_ns;
    }

    /// Adds the policy's stamps.
    pub(super) const fn decided(&mut self, decision: &Decision) {
        self.joined_ns = decision.received_ns;
        self.started_ns = decision.started_ns;
        self.prompted_ns = decision.prompted_ns;
        self.requested_ns = decision.sent_ns;
        self.decided_ns = decision.decided_ns;
    }

    /// When an external memory began to compute, if the messages to it and back took equally long; 0 for a built-in one.
    pub const fn method_began_ns(&self) -> u64 {
        if self.method_ns == 0 {
            return 0;
        }
        let wire_ns =
            self.searched_ns.saturating_sub(self.embedded_ns).saturating_sub(self.method_ns);
        self.searched_ns.saturating_sub(wire_ns / 2 + self.method_ns)
    }

    /// Nanoseconds in each stage; 0 for one that the step skips.
    pub fn stages(&self) -> Stages {
        // A policy may send any stamps.
        let from = |from: u64, until: u64| if from == 0 { 0 } else { until.saturating_sub(from) };
        Stages {
            command: from(self.commanded_ns, self.woken_ns),
            dynamics: from(self.woken_ns, self.stepped_ns),
            render: from(self.stepped_ns, self.rendered_ns),
            publish: from(self.rendered_ns, self.published_ns),
            observation: from(self.published_ns, self.received_ns),
            embed: from(self.received_ns, self.embedded_ns),
            search: from(self.embedded_ns, self.searched_ns),
            assemble: from(self.searched_ns, self.assembled_ns),
            recall: from(self.assembled_ns, self.joined_ns),
            queue: from(self.joined_ns, self.started_ns),
            decide: from(self.started_ns, self.decided_ns),
            decision: from(self.decided_ns, self.logged_ns),
        }
    }
}
