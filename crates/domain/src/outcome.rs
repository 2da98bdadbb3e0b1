//! Enums whose codes the wire, the log and the report share.

use crate::code_sets;

code_sets! {
    /// The outcome of a decision. Failures of the infrastructure are not outcomes: the policy retries, or reports an error.
    Outcome, "an outcome (0 acted, 1 unreadable, 2 empty, 3 refused)" {
        /// An action was chosen.
        Acted = 0,
        /// No action could be read from the answer.
        Unreadable = 1,
        /// The answer was empty.
        Empty = 2,
        /// The model refused.
        Refused = 3,
    }

    /// The content of a retrieved segment (paper, Design Choices).
    SegmentContent, "a segment content (0 actions, 1 images)" {
        /// The expert's actions and the views they led to.
        Actions = 0,
        /// The views alone.
        Images = 1,
    }

    /// What the memory of an episode is built from, and whether it changes.
    Arm, "an arm (0 frozen, 1 learning, 2 oracle, 3 wrong)"
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "lowercase")] {
        /// Built once, never changed: the paper's setting.
        Frozen = 0,
        /// Built once, and changed by the episodes of its stream.
        Learning = 1,
        /// Built anew for every block, from demonstrations in the world as it is: a control.
        Oracle = 2,
        /// Built once from demonstrations of other tasks: a control.
        Wrong = 3,
    }

    /// What a memory is told at the end of an episode that it learns from.
    FeedbackLevel, "a feedback level (0 none, 1 success, 2 sub-goals)"
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "kebab-case")] {
        /// Nothing but the steps.
        None = 0,
        /// Whether the task was completed.
        Success = 1,
        /// Also the steps at which sub-goals were completed.
        SubGoals = 2,
    }

    /// The kind of a document.
    DocumentKind, "a document kind (0 summary, 1 semantic, 2 trajectories, 3 note)"
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "lowercase")] {
        /// Object locations, landmarks and routes: UTF-8 text.
        Summary = 0,
        /// General spatial and navigation knowledge: UTF-8 text.
        Semantic = 1,
        /// Demonstrations with their keyframes: `TrajectoryStep`s.
        Trajectories = 2,
        /// Text of an external memory: UTF-8 text.
        Note = 3,
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

impl Arm {
    /// The word used in files, on the command line and in tables.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Frozen => "frozen",
            Self::Learning => "learning",
            Self::Oracle => "oracle",
            Self::Wrong => "wrong",
        }
    }
}

impl Default for Arm {
    /// The paper's setting.
    fn default() -> Self {
        Self::Frozen
    }
}

impl FeedbackLevel {
    /// The word used in files, on the command line and in tables.
    pub const fn word(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Success => "success",
            Self::SubGoals => "sub-goals",
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
            Self::Note => "note",
        }
    }
}
