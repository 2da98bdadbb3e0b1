//! What a condition changes about the prompt (paper, Design Choices).
//!
//! Only names and standard values: [`Condition::new`](super::Condition::new) decides where a variation has an effect.

use std::fmt;

use serde::{Deserialize, Serialize};

use domain::names::named;

named! {
    /// The content of a retrieved segment.
    #[derive(Default)]
    SegmentContent, "segment content" {
        /// The expert's actions and the views they led to.
        #[default]
        Actions = "actions",
        /// The views alone.
        Images = "images",
    }

    /// Whether the prompt states that the demonstration starts at the agent's starting pose, where it does.
    #[derive(Default)]
    Hint, "hint" {
        /// It does.
        #[default]
        On = "on",
        /// It does not.
        Off = "off",
    }
}

/// Variations of the prompt; the default is the paper's standard (paper, Experimental Setup).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(default)]
pub struct Variation {
    /// Past steps that the policy is shown, h.
    #[serde(skip_serializing_if = "is_standard_window")]
    pub window: u32,
    /// The content of a retrieved segment.
    #[serde(skip_serializing_if = "is_default")]
    pub segment: SegmentContent,
    /// Whether the original-start hint is given.
    #[serde(skip_serializing_if = "is_default")]
    pub hint: Hint,
}

/// The longest window that a condition may have.
pub const MAX_WINDOW: u32 = 32;

impl Variation {
    /// The paper's standard: h = 6, actions with their views, the hint where it is true.
    pub const STANDARD: Self = Self { window: 6, segment: SegmentContent::Actions, hint: Hint::On };
}

impl Default for Variation {
    fn default() -> Self {
        Self::STANDARD
    }
}

impl SegmentContent {
    /// The code for it on the wire.
    pub const fn code(self) -> domain::SegmentContent {
        match self {
            Self::Actions => domain::SegmentContent::Actions,
            Self::Images => domain::SegmentContent::Images,
        }
    }
}

/// The window of the standard variation, which records leave out.
pub fn standard_window() -> u32 {
    Variation::STANDARD.window
}

/// Whether `window` is that of the standard variation.
pub fn is_standard_window(window: &u32) -> bool {
    *window == standard_window()
}

/// Whether `value` is the default of its type.
pub fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl fmt::Display for Variation {
    /// Writes the deviations from the standard, each after a slash: `/h20`, `/images`, `/no-hint`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { window, segment, hint } = self;
        if !is_standard_window(window) {
            write!(f, "/h{window}")?;
        }
        if !is_default(segment) {
            write!(f, "/{segment}")?;
        }
        match hint {
            Hint::On => Ok(()),
            Hint::Off => f.write_str("/no-hint"),
        }
    }
}

impl Variation {
    /// Reads one of the parts that [`Display`](fmt::Display) writes, without its slash. Returns `false` for any other
    /// text.
    pub(super) fn read(&mut self, part: &str) -> bool {
        let window = part.strip_prefix('h').and_then(|digits| digits.parse().ok());
        match (window, part) {
            (Some(window), _) if window <= MAX_WINDOW => self.window = window,
            (_, "images") => self.segment = SegmentContent::Images,
            (_, "no-hint") => self.hint = Hint::Off,
            _ => return false,
        }
        true
    }
}
