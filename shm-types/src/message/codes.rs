//! The closed sets that messages carry as `u8` codes.

use domain::{ActionCode, MAX_ACTIONS, UnknownCode, code_sets};

use super::NO_ACTION;

code_sets! {
    /// The kind of a [`StepCommand`](super::StepCommand).
    StepKind, "a step kind" {
        /// Take the action.
        Act = 0 "act",
        /// Do not move: the policy's answer could not be read.
        Stay = 1 "stay",
    }

    /// Whether and how an episode has ended, in a [`StepReport`](super::StepReport).
    EpisodeEnd, "an end of an episode" {
        /// It goes on.
        GoesOn = 0 "goes on",
        /// Its task is complete.
        Complete = 1 "complete",
        /// It has taken as many steps as it may.
        StepLimit = 2 "step limit",
        /// The world has ended it before: its task can no longer be completed. The facts of the episode say why.
        Failed = 3 "failed",
    }

    /// The kind of a [`ViewRequest`](super::ViewRequest).
    ViewRequestKind, "a view request kind" {
        /// Make the view resident and keep it.
        Pin = 0 "pin",
        /// The view may be evicted again.
        Release = 1 "release",
    }

    /// Whether a memory learns from an [episode](super::ExternalEpisode).
    Learning, "whether a memory learns" {
        /// The episode is not part of a stream.
        OutsideOfStreams = 0 "outside of streams",
        /// It observes the episode and is told of its end.
        Learns = 1 "learns",
        /// It answers, and the episode must not change what it answers in later ones.
        ReadsOnly = 2 "reads only",
    }

    /// What the last [query](super::ExternalQuery) of an episode tells about its task.
    EpisodeOutcome, "an outcome of an episode" {
        /// Nothing.
        NotTold = 0 "not told",
        /// It was not completed.
        Incomplete = 1 "not completed",
        /// It was completed.
        Complete = 2 "completed",
    }

    /// The kind of a [`RecalledItem`](super::RecalledItem).
    ItemKind, "an item kind" {
        /// Text.
        Text = 0 "text",
        /// Steps of a demonstration, in the message.
        Steps = 1 "steps",
        /// Steps of a demonstration, in a document.
        Trajectory = 2 "trajectory",
        /// One remembered view with a caption.
        Frame = 3 "frame",
        /// Actions to take from now on, in a document.
        Plan = 4 "plan",
    }

    /// What follows from an [`ErrorReport`](super::ErrorReport).
    ErrorReportKind, "an error report kind" {
        /// Nothing else: a message could not be used and was dropped.
        Message = 0 "message",
        /// The episode ends without a result: there is no decision, for a reason that is not the model's, such as a
        /// server that refuses the request.
        Episode = 1 "episode",
        /// The run stops: no episode can continue, for example because the server is down.
        Run = 2 "run",
        /// Not an error yet: decisions wait for something outside of the run, such as a model's server that does not
        /// answer. The text says for what; it is empty when the wait is over.
        Waiting = 3 "waiting",
        /// From the memory process: as `Episode`, because the episode's external memory has exceeded a time limit.
        Overdue = 4 "overdue",
        /// From the policy process, and not an error: facts that it has learned since its handshake, as the handshake has them,
        /// such as whether a model reasons although it was asked not to. The text is a JSON object of strings.
        Facts = 5 "facts",
    }

    /// The role of a process in a run.
    Role, "a role"
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "kebab-case")] {
        /// Schedules the steps; the program `memtransfer`.
        Orchestrator = 0 "orchestrator",
        /// Steps the world and renders. A run can have several, each with an index.
        Sim = 1 "sim",
        /// Embeds views and retrieves from memory.
        Memory = 2 "memory",
        /// Decides on actions.
        Policy = 3 "policy",
        /// A memory outside of the memory process, which asks it. A run can have several, each with an index.
        ExternalMemory = 4 "external-memory",
    }
}

impl EpisodeOutcome {
    /// What is told of a task that was completed or not; `None` tells nothing.
    pub const fn of(success: Option<bool>) -> Self {
        match success {
            None => Self::NotTold,
            Some(false) => Self::Incomplete,
            Some(true) => Self::Complete,
        }
    }

    /// Whether the task was completed, if that is told.
    pub const fn success(self) -> Option<bool> {
        match self {
            Self::NotTold => None,
            Self::Incomplete => Some(false),
            Self::Complete => Some(true),
        }
    }
}

/// Reads the code of an action; [`NO_ACTION`] is none.
///
/// # Errors
/// When no world can have such an action. Which the world of a run has is in its declaration.
pub fn read_action(code: u8) -> Result<Option<ActionCode>, UnknownCode> {
    match code {
        NO_ACTION => Ok(None),
        code if usize::from(code) < MAX_ACTIONS => Ok(Some(ActionCode(code))),
        code => Err(UnknownCode::new(code, "an action (0 to 63)")),
    }
}

/// The code of an action; [`NO_ACTION`] for none.
pub fn action_code(action: Option<ActionCode>) -> u8 {
    action.map_or(NO_ACTION, |ActionCode(code)| code)
}

/// Reads a field that is 0 or 1.
///
/// # Errors
/// When it is neither.
pub fn read_flag(code: impl Into<u32>) -> Result<bool, UnknownCode> {
    match code.into() {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(UnknownCode::new(other, "a flag (0 no, 1 yes)")),
    }
}

impl Role {
    /// The roles of the processes that every run with a policy has, apart from the orchestrator.
    pub const CHILDREN: [Self; 3] = [Self::Sim, Self::Memory, Self::Policy];

    /// Whether a run can have several processes in this role, each with an index.
    pub const fn has_index(self) -> bool {
        matches!(self, Self::Sim | Self::ExternalMemory)
    }
}
