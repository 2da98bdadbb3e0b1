//! What a memory supplies.

use std::sync::Arc;

use domain::ActionCode;

/// One item of what a memory supplies for a step.
#[derive(Debug, Clone, PartialEq)]
pub enum MemoryItem {
    /// A text.
    Text {
        /// The text. Equal texts are passed on once.
        text: Arc<str>,
        /// Where it comes from; none: from the memory as a whole.
        sources: Vec<Source>,
    },
    /// Consecutive steps of a demonstration.
    Steps {
        /// The steps.
        source: Source,
        /// The views to supply.
        views: Views,
        /// Whether to supply the expert's actions. The last step is supplied without one.
        actions: bool,
        /// Distance from the query, if there is one.
        distance: Option<f32>,
    },
    /// One view of a demonstration.
    Frame {
        /// Number of the demonstration.
        demonstration: u32,
        /// The step.
        step: u32,
        /// What to say about it; may be empty.
        caption: Arc<str>,
        /// Distance from the query, if there is one.
        distance: Option<f32>,
    },
    /// Actions to take one after the other, from the state of the query on.
    Plan {
        /// Where they come from, in order.
        parts: Vec<PlanPart>,
    },
}

/// A part of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlanPart {
    /// The expert's actions at these steps. A step without an action, such as the last of a demonstration, adds none.
    Steps(Source),
    /// An action that the memory chose itself.
    Own(ActionCode),
}

impl MemoryItem {
    /// A text that comes from the memory as a whole.
    pub fn text(text: impl Into<Arc<str>>) -> Self {
        Self::Text { text: text.into(), sources: Vec::new() }
    }
}

/// Consecutive steps of a demonstration in the bank.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Source {
    /// Number of the demonstration, from 0.
    pub demonstration: u32,
    /// The first step.
    pub first: u32,
    /// Number of steps, at least 1.
    pub count: u32,
}

/// Which views of an item's steps are supplied.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Views {
    /// None.
    None,
    /// All.
    All,
    /// Those of the steps with these numbers in the demonstration, ascending.
    Keyframes(Vec<u32>),
}
