//! The closed sets that messages carry as `u8` codes.

use domain::code_sets;

code_sets! {
    /// The kind of a [`StepCommand`](super::StepCommand).
    StepKind, "a step kind (0 reset, 1 act, 2 stay)" {
        /// Put the agent at the start pose.
        Reset = 0,
        /// Take the action.
        Act = 1,
        /// Do not move: the policy's answer could not be read.
        Stay = 2,
    }

    /// The kind of a [`ViewRequest`](super::ViewRequest).
    ViewRequestKind, "a view request kind (0 pin, 1 release)" {
        /// Make the view resident and keep it.
        Pin = 0,
        /// The view may be evicted again.
        Release = 1,
    }

    /// Whether a memory learns from an [episode](super::ExternalEpisode).
    Learning, "whether a memory learns (0 outside of streams, 1 learns, 2 reads only)" {
        /// The episode is not part of a stream.
        OutsideOfStreams = 0,
        /// It observes the episode and is told of its end.
        Learns = 1,
        /// It answers, and the episode must not change what it answers in later ones.
        ReadsOnly = 2,
    }

    /// The kind of a [`RecalledItem`](super::RecalledItem).
    ItemKind, "an item kind (0 text, 1 steps, 2 trajectory, 3 frame)" {
        /// Text.
        Text = 0,
        /// Steps of a demonstration, in the message.
        Steps = 1,
        /// Steps of a demonstration, in a document.
        Trajectory = 2,
        /// One remembered view with a caption.
        Frame = 3,
    }

    /// What follows from an [`ErrorReport`](super::ErrorReport).
    ErrorReportKind, "an error report kind (0 message, 1 episode, 2 run, 3 waiting, 4 overdue)" {
        /// Nothing else: a message could not be used and was dropped.
        Message = 0,
        /// The episode ends without a result: there is no decision, for a reason that is not the model's, such as a
        /// server that refuses the request.
        Episode = 1,
        /// The run stops: no episode can continue, for example because the server is down.
        Run = 2,
        /// Not an error yet: decisions wait for something outside of the run, such as a model's server that does not
        /// answer. The text says for what; it is empty when the wait is over.
        Waiting = 3,
        /// From the memory process: as `Episode`, because the episode's external memory has exceeded a time limit.
        Overdue = 4,
    }

    /// The role of a process in a run.
    Role, "a role (0 orchestrator, 1 sim, 2 memory, 3 policy, 4 external memory)"
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "kebab-case")] {
        /// Schedules the steps; the program `memtransfer`.
        Orchestrator = 0,
        /// Steps the world and renders.
        Sim = 1,
        /// Embeds views and retrieves from memory.
        Memory = 2,
        /// Decides on actions.
        Policy = 3,
        /// A memory outside of the memory process, which asks it. A run can have several, each with an index.
        ExternalMemory = 4,
    }
}

impl Role {
    /// The roles of the processes that every run with a policy has, apart from the orchestrator.
    pub const CHILDREN: [Self; 3] = [Self::Sim, Self::Memory, Self::Policy];

    /// The word used in logs, service names and messages.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Orchestrator => "orchestrator",
            Self::Sim => "sim",
            Self::Memory => "memory",
            Self::Policy => "policy",
            Self::ExternalMemory => "external-memory",
        }
    }
}
