//! The memory representations (specification, section 5): names, codes, and what each supplies.
//!
//! To add one: a variant with its row in [`Representation::describe`] here, and a file in memory-proc. Flags, suites and
//! tables follow from these.

use serde::{Deserialize, Serialize};

use crate::outcome::DocumentKind;
use crate::{coded_enum, serde_as_text};

coded_enum! {
    /// A memory representation.
    Representation, "a representation (0 to 6)";
    #[derive(Serialize, Deserialize)]
    #[serde(try_from = "String", into = "String")] {
        /// The window alone: no memory of demonstrations.
        Working = 0,
        /// Every action of the case's demonstrations, and keyframes.
        FullContext = 1,
        /// One document of object locations, landmarks and routes.
        Summary = 2,
        /// One document of general spatial and navigation knowledge.
        Semantic = 3,
        /// The summary and the semantic document.
        Hybrid = 4,
        /// The stored view nearest to the current one, and the expert's continuation.
        Episodic = 5,
        /// Episodic memory that verifies, updates and forgets while it is used.
        Adaptive = 6,
    }
}

/// The properties of a representation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RepresentationInfo {
    /// The word on the command line, in files and in tables.
    pub name: &'static str,
    /// What is stored.
    pub stores: &'static str,
    /// What is supplied at each step, in addition to the window.
    pub supplies: &'static str,
    /// The demonstrations it is built from.
    pub built_from: BuiltFrom,
    /// The text documents it supplies, in order.
    pub documents: &'static [DocumentKind],
    /// The parts of demonstrations that it supplies.
    pub trajectories: Trajectories,
}

/// The demonstrations that a representation is built from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BuiltFrom {
    /// None.
    Nothing,
    /// The selected ones of the episode's own case.
    Case,
    /// The selected ones of all cases, consolidated.
    AllCases,
}

/// The parts of demonstrations, actions and views, that a representation supplies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trajectories {
    /// None.
    Nothing,
    /// All actions, and as many keyframes as the budget allows.
    Whole,
    /// A retrieved view, and the steps after it up to the horizon.
    Segment,
}

impl Representation {
    /// Its properties.
    pub const fn describe(self) -> RepresentationInfo {
        const NOTHING: RepresentationInfo = RepresentationInfo {
            name: "working",
            stores: "the last h steps",
            supplies: "the window",
            built_from: BuiltFrom::Nothing,
            documents: &[],
            trajectories: Trajectories::Nothing,
        };
        match self {
            Self::Working => NOTHING,
            Self::FullContext => RepresentationInfo {
                name: "full-context",
                stores: "all actions and the keyframes of the case's demonstrations",
                supplies: "all of it",
                built_from: BuiltFrom::Case,
                trajectories: Trajectories::Whole,
                ..NOTHING
            },
            Self::Summary => RepresentationInfo {
                name: "summary",
                stores: "one document of object locations, landmarks and routes",
                supplies: "the whole document",
                built_from: BuiltFrom::AllCases,
                documents: &[DocumentKind::Summary],
                ..NOTHING
            },
            Self::Semantic => RepresentationInfo {
                name: "semantic",
                stores: "one document of general spatial and navigation knowledge",
                supplies: "the whole document",
                built_from: BuiltFrom::AllCases,
                documents: &[DocumentKind::Semantic],
                ..NOTHING
            },
            Self::Hybrid => RepresentationInfo {
                name: "hybrid",
                stores: "the summary and the semantic document",
                supplies: "both documents",
                built_from: BuiltFrom::AllCases,
                documents: &[DocumentKind::Summary, DocumentKind::Semantic],
                ..NOTHING
            },
            Self::Episodic => RepresentationInfo {
                name: "episodic",
                stores: "every demonstration frame's embedding, with its trajectory",
                supplies: "the stored view nearest to the current one, and the expert's continuation",
                built_from: BuiltFrom::Case,
                trajectories: Trajectories::Segment,
                ..NOTHING
            },
            Self::Adaptive => RepresentationInfo {
                name: "adaptive",
                stores: "the same of the task's demonstrations and, in a stream, of its own successful episodes",
                supplies: "as episodic; in a stream what it has confirmed, and nothing that it has seen contradicted",
                built_from: BuiltFrom::Case,
                trajectories: Trajectories::Segment,
                ..NOTHING
            },
        }
    }

    /// The word on the command line, in files and in tables.
    pub const fn name(self) -> &'static str {
        self.describe().name
    }

    /// Whether it is built from demonstrations.
    pub const fn uses_demonstrations(self) -> bool {
        !matches!(self.describe().built_from, BuiltFrom::Nothing)
    }

    /// Whether it is searched with the current view, so that views have to be embedded.
    pub const fn matches_views(self) -> bool {
        matches!(self.describe().trajectories, Trajectories::Segment)
    }

    /// Most images that memory adds to a request: `hits` segments of `horizon` actions, or `keyframes`.
    pub const fn images(self, horizon: u32, hits: u32, keyframes: u32) -> u32 {
        match self.describe().trajectories {
            Trajectories::Nothing => 0,
            Trajectories::Whole => keyframes,
            Trajectories::Segment => hits * (1 + horizon),
        }
    }
}

impl std::fmt::Display for Representation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// An unknown name of a representation.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no representation is called {0:?}")]
pub struct UnknownRepresentation(pub String);

impl std::str::FromStr for Representation {
    type Err = UnknownRepresentation;

    fn from_str(text: &str) -> Result<Self, UnknownRepresentation> {
        let found = Self::ALL.iter().find(|representation| representation.name() == text);
        found.copied().ok_or_else(|| UnknownRepresentation(text.to_owned()))
    }
}

serde_as_text!(Representation);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_codes_are_each_other_s_inverse() {
        for (code, &representation) in Representation::ALL.iter().enumerate() {
            assert_eq!(Representation::try_from(code as u8), Ok(representation));
            assert_eq!(representation.name().parse(), Ok(representation));
        }
        assert!(
            Representation::try_from(7).is_err() && "eidetic".parse::<Representation>().is_err()
        );
    }

    #[test]
    fn images_of_a_request_are_those_of_the_paper() {
        let images = |hits| Representation::ALL.iter().map(|r| 7 + r.images(6, hits, 40)).collect();
        let (one, three): (Vec<u32>, Vec<u32>) = (images(1), images(3));
        assert_eq!(one, [7, 47, 7, 7, 7, 14, 14]);
        assert_eq!(three, [7, 47, 7, 7, 7, 28, 28]);
    }
}
