//! The closed sets that messages carry as `u8` codes.

use crate::layout::{CodeSet, Codes, coded_enum};
use crate::pose::UnknownCode;

/// Declares closed sets with `u8` codes that are positions in `ALL`.
macro_rules! codes {
    ($($(#[doc = $doc:literal])* $name:ident, $what:literal $(#[$attribute:meta])* {
        $($(#[doc = $variant_doc:literal])* $variant:ident = $code:literal,)*
    })*) => {
        $(
            coded_enum! {
                $(#[doc = $doc])*
                $name $(#[$attribute])* { $($(#[doc = $variant_doc])* $variant = $code,)* }
            }

            impl $name {
                /// Every member, in code order.
                pub const ALL: &'static [Self] = &[$(Self::$variant),*];
            }

            impl TryFrom<u8> for $name {
                type Error = UnknownCode;

                fn try_from(code: u8) -> Result<Self, UnknownCode> {
                    match code {
                        $($code => Ok(Self::$variant),)*
                        _ => Err(UnknownCode::new(code, $what)),
                    }
                }
            }
        )*

        /// All sets of codes that are declared here, described.
        pub const CODE_SETS: &[CodeSet] = &[$($name::CODES),*];
    };
}

codes! {
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

    /// How a decision came out (DESIGN section 5). Infrastructure failures are retried by the policy
    /// and reported as [`Complaint`](super::Complaint)s: they are never an outcome of the model.
    Outcome, "an outcome (0 acted, 1 unreadable, 2 empty, 3 refused)" {
        /// An action was chosen.
        Acted = 0,
        /// There was an answer, and no action could be read from it.
        Unreadable = 1,
        /// The answer was empty.
        Empty = 2,
        /// The model refused.
        Refused = 3,
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

    /// What a retrieved segment holds (paper, Design Choices).
    SegmentContent, "a segment content (0 actions, 1 images)" {
        /// The expert's actions and the views they led to.
        Actions = 0,
        /// The views alone.
        Images = 1,
    }

    /// What a [`Document`](crate::documents::Document) is.
    DocumentKind, "a document kind (0 summary, 1 semantic, 2 trajectories)"
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "lowercase")] {
        /// Object locations, landmarks and routes: UTF-8 text.
        Summary = 0,
        /// General spatial and navigation knowledge: UTF-8 text.
        Semantic = 1,
        /// Demonstrations with their keyframes: [`TrajectoryStep`](super::TrajectoryStep)s.
        Trajectories = 2,
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

impl Outcome {
    /// The word used in logs and messages.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Acted => "acted",
            Self::Unreadable => "unreadable",
            Self::Empty => "empty",
            Self::Refused => "refused",
        }
    }
}

impl DocumentKind {
    /// Those that are text, in the order in which they are supplied.
    pub const TEXTS: [Self; 2] = [Self::Summary, Self::Semantic];

    /// The word used in files, on the command line and in messages.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Summary => "summary",
            Self::Semantic => "semantic",
            Self::Trajectories => "trajectories",
        }
    }
}
