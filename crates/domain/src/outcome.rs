//! Enums whose codes the wire, the log and the report share.

use crate::code_sets;

code_sets! {
    /// The outcome of a decision. Failures of the infrastructure are not outcomes: the policy retries, or reports an error.
    Outcome, "an outcome" {
        /// An action was chosen.
        Acted = 0 "acted",
        /// No action could be read from the answer.
        Unreadable = 1 "unreadable",
        /// The answer was empty.
        Empty = 2 "empty",
        /// The model refused.
        Refused = 3 "refused",
        /// The answer was cut off at the bound on its tokens, before it named an action.
        CutOff = 4 "cut-off",
    }

    /// Whether a model reasoned before it answered.
    Reasoning, "whether a model reasoned" {
        /// Not known.
        Unknown = 0 "unknown",
        /// Its reply shows no reasoning.
        Off = 1 "off",
        /// Its reply shows reasoning, or counts its tokens.
        On = 2 "on",
    }

    /// The content of a retrieved segment (paper, Design Choices).
    SegmentContent, "a segment content" {
        /// The expert's actions and the views they led to.
        Actions = 0 "actions",
        /// The views alone.
        Images = 1 "images",
    }

    /// What the memory of an episode is built from, and whether it changes.
    Arm, "an arm"
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "lowercase")] {
        /// Built once, never changed: the paper's setting.
        Frozen = 0 "frozen",
        /// Built once, and changed by the episodes of its stream.
        Learning = 1 "learning",
        /// Built from the right content, a control: in a stream anew for every block, from demonstrations in the world as it is.
        Oracle = 2 "oracle",
        /// Built once from demonstrations of other tasks: a control.
        Wrong = 3 "wrong",
    }

    /// What a memory is told at the end of an episode that it learns from.
    FeedbackLevel, "a feedback level"
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "kebab-case")] {
        /// Nothing but the steps.
        None = 0 "none",
        /// Whether the task was completed.
        Success = 1 "success",
        /// Also the steps at which sub-goals were completed.
        SubGoals = 2 "sub-goals",
    }

    /// The kind of a document.
    DocumentKind, "a document kind"
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(rename_all = "lowercase")] {
        /// Object locations, landmarks and routes: UTF-8 text.
        Summary = 0 "summary",
        /// General spatial and navigation knowledge: UTF-8 text.
        Semantic = 1 "semantic",
        /// Demonstrations with their keyframes: `TrajectoryStep`s.
        Trajectories = 2 "trajectories",
        /// Text of an external memory: UTF-8 text.
        Note = 3 "note",
    }
}

impl Default for Arm {
    /// The paper's setting.
    fn default() -> Self {
        Self::Frozen
    }
}

impl DocumentKind {
    /// Those that are text, in the order in which they are supplied.
    pub const TEXTS: [Self; 2] = [Self::Summary, Self::Semantic];
}

/// What the reason says of an episode whose memory's snapshot is damaged; what to delete follows it. The same command gives the
/// episode up again.
pub const SEQUENCE_ENDED: &str =
    "Its sequence cannot go on, however often the run is continued. To run the sequence again";
