//! The vocabulary of the benchmark: poses, actions and feedback, memory representations, outcomes of decisions, and the
//! formats of the prompt log and of measured searches.
//!
//! Does not link iceoryx2. Knows neither the map nor what a task asks for nor messages.

mod appearance;
mod cache;
pub mod camera;
mod chat;
pub mod codes;
mod demonstrations;
pub mod events;
mod hex;
mod labels;
pub mod limits;
pub mod memory_kind;
mod mismatch;
pub mod names;
pub mod outcome;
pub mod pose;
pub mod prompt_log;
pub mod reasoning;
pub mod representation;
pub mod search_profile;
mod shell;
mod state;
mod stream;
pub mod tokens;

pub use appearance::Appearance;
pub use cache::{
    NoCacheFolder, RUNTIME_FILE, RUNTIME_SHA256, RUNTIME_VARIABLE, cache_folder,
    create_private_folder,
};
pub use chat::{
    HEADER_VARIABLE, ImageFormat, KEY_VARIABLES, NoHeader, REQUEST_FIELDS, ReasoningRequest,
    SecretHeader, SystemRole,
};
pub use demonstrations::{DemonstrationKind, Demonstrations, Mixture, UnknownDemonstrations};
pub use hex::hex;
pub use labels::{Route, Start};
pub use memory_kind::{ExternalName, MemoryKind};
pub use mismatch::Mismatch;
pub use outcome::{
    Arm, DocumentKind, FeedbackLevel, Outcome, Reasoning, SEQUENCE_ENDED, SegmentContent,
};
pub use pose::{Action, Cell, Feedback, Heading, Pose, UnknownCode};
pub use representation::Representation;
pub use shell::shell_word;
pub use state::{ActionCode, FeedbackCode, InvalidState, MAX_ACTIONS, MAX_STATE, State};
pub use stream::{EventKind, StreamOrder, StreamRules};

/// The step limit of an episode, T_max in the paper.
pub const MAX_STEPS: u32 = 200;
