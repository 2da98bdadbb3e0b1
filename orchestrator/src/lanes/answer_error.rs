//! Why the answer of another process cannot be used.

use shm_types::message::Role;

/// Why a message cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AnswerError {
    /// It names a lane that does not exist.
    #[error("the {} process answered for lane {lane}, and there are {lanes} lanes", role.word())]
    NoSuchLane {
        /// The sender.
        role: Role,
        /// The lane.
        lane: u32,
        /// Number of lanes.
        lanes: usize,
    },
    /// It answers a step that no answer is awaited for.
    #[error(
        "the {} process answered step {step} of lane {lane}, for which no answer is awaited",
        role.word()
    )]
    Unexpected {
        /// The sender.
        role: Role,
        /// The lane.
        lane: u32,
        /// The step.
        step: u32,
    },
    /// Its content is invalid, and the episode cannot go on.
    #[error("the {} process sent an invalid answer to step {step} of lane {lane}: {problem}", role.word())]
    Invalid {
        /// The sender.
        role: Role,
        /// The lane.
        lane: u32,
        /// The step.
        step: u32,
        /// What is invalid.
        problem: String,
    },
}
