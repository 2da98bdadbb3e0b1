//! The closed sets that messages carry as `u8` codes.

use domain::code_sets;
pub use domain::{DocumentKind, Outcome, SegmentContent};

code_sets! {
    /// What a [`StepCommand`](super::StepCommand) asks for.
    StepKind, "a step kind (0 reset, 1 act, 2 stay)" {
        /// Put the agent at the start pose.
        Reset = 0,
        /// Take the action.
        Act = 1,
        /// Stay: the policy's answer could not be read.
        Stay = 2,
    }

    /// What a [`ViewRequest`](super::ViewRequest) asks for.
    ViewRequestKind, "a view request kind (0 hold, 1 release)" {
        /// Make the view resident and keep it.
        Hold = 0,
        /// It may be evicted again.
        Release = 1,
    }

    /// What follows from a [`Complaint`](super::Complaint).
    ComplaintKind, "a complaint kind (0 message, 1 episode, 2 run)" {
        /// A message could not be used; it was dropped, and nothing else follows.
        Message = 0,
        /// No decision will come for this episode's step: for a reason that is not the policy's, such as a
        /// server that refuses the request. The episode ends without a result.
        Episode = 1,
        /// There is no point in going on with the run now, whatever the episode: a server that is gone.
        Run = 2,
    }

    /// A process's part in a run.
    Role, "a role (0 orchestrator, 1 sim, 2 memory, 3 policy)"
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "lowercase")] {
        /// Sequences the steps; the program `memtransfer`.
        Orchestrator = 0,
        /// Steps the world and renders.
        Sim = 1,
        /// Embeds and retrieves.
        Memory = 2,
        /// Decides.
        Policy = 3,
    }
}

impl Role {
    /// Everybody but the orchestrator.
    pub const CREW: [Self; 3] = [Self::Sim, Self::Memory, Self::Policy];

    /// The word used in logs, service names and messages.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Orchestrator => "orchestrator",
            Self::Sim => "sim",
            Self::Memory => "memory",
            Self::Policy => "policy",
        }
    }
}
