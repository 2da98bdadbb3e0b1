//! Why an answer of another process cannot be used.

use shm_types::message::Role;

/// Why a message cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// It names no lane.
    #[error("the {} answered for lane {lane}, but there are {lanes}", role.word())]
    NoSuchLane {
        /// Who sent it.
        role: Role,
        /// The lane.
        lane: u32,
        /// How many there are.
        lanes: usize,
    },
    /// It answers a question that was not asked.
    #[error(
        "the {} answered step {step} of lane {lane}, which is not the step it was asked for",
        role.word()
    )]
    NotAsked {
        /// Who sent it.
        role: Role,
        /// The lane.
        lane: u32,
        /// The step.
        step: u32,
    },
    /// The simulator's world is not the orchestrator's.
    #[error("the simulator reports {found} for step {step} of lane {lane}, expected {expected}")]
    Disagrees {
        /// The lane.
        lane: u32,
        /// The step.
        step: u32,
        /// What it said.
        found: String,
        /// What the dynamics say.
        expected: String,
    },
    /// The answer itself is no answer. The episode is given up.
    #[error("the {} sent no usable answer for step {step} of lane {lane}: {what}", role.word())]
    Garbage {
        /// Who sent it.
        role: Role,
        /// The lane.
        lane: u32,
        /// The step.
        step: u32,
        /// What is wrong with it.
        what: String,
    },
}
