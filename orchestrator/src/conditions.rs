//! What an episode is run under: which memory, from where, on which route, with which demonstrations.
//!
//! Only the words and their combinations; which episodes follow from them is [`plan`](crate::plan)'s.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use shm_types::FrameControl;
use shm_types::Representation;

use crate::names::{UnknownName, named};

named! {
    /// A memory representation (SPEC section 5).
    Memory, "memory" {
        /// The window alone: no memory of demonstrations.
        Working = "working",
        /// The stored view nearest to the current one, and the expert's continuation.
        Episodic = "episodic",
    }

    /// Where the episode starts.
    Start, "start" {
        /// Where the case's original demonstration starts.
        Original = "original",
        /// The case's test pose, which no demonstration starts from.
        New = "new",
    }

    /// Whether the warehouse is the one that was demonstrated.
    Route, "route" {
        /// As demonstrated.
        Unchanged = "unchanged",
        /// A passage that a demonstration used is closed by a barricade.
        Blocked = "blocked",
    }

    /// Who decides.
    PolicyKind, "policy" {
        /// A scripted stand-in that looks at the pixels and at the recall it is given.
        Grounded = "grounded",
        /// Draws every action, seeded.
        Random = "random",
        /// Replays the reference trajectory: privileged, the upper bound of the scale.
        Expert = "expert",
    }

    /// What the simulator shows where the agent looks: the controls that prove results come from pixels.
    Frames, "kind of frames" {
        /// What is there.
        Rendered = "rendered",
        /// Uniform grey.
        Blank = "blank",
        /// The view of another pose.
        Swapped = "swapped",
    }

    /// One of a case's four demonstrations; the position is its bit on the wire.
    Demonstration, "demonstration" {
        /// From the case's own start.
        Original = "original",
        /// From the same cell, facing the other way.
        Opposite = "opposite",
        /// From a few cells away in the same aisle.
        Nearby = "nearby",
        /// From another aisle.
        Distant = "distant",
    }
}

impl Memory {
    /// The word for it on the wire.
    pub const fn representation(self) -> Representation {
        match self {
            Self::Working => Representation::Working,
            Self::Episodic => Representation::Episodic,
        }
    }

    /// Whether demonstrations make a difference to it.
    pub const fn uses_demonstrations(self) -> bool {
        match self {
            Self::Working => false,
            Self::Episodic => true,
        }
    }
}

impl PolicyKind {
    /// Whether it decides in a process of its own, from observations and memory. The expert does not.
    pub const fn has_process(self) -> bool {
        match self {
            Self::Grounded | Self::Random => true,
            Self::Expert => false,
        }
    }
}

impl Frames {
    /// The word for it on the wire.
    pub const fn control(self) -> FrameControl {
        match self {
            Self::Rendered => FrameControl::Rendered,
            Self::Blank => FrameControl::Blank,
            Self::Swapped => FrameControl::Swapped,
        }
    }
}

impl Start {
    /// The case's trajectory whose length is the reference l_i for an episode from here on `route`.
    ///
    /// A blocked route is defined from the new start only (SPEC section 4).
    pub const fn reference(self, route: Route) -> warehouse::Start {
        match (self, route) {
            (_, Route::Blocked) => warehouse::Start::Blocked,
            (Self::Original, Route::Unchanged) => warehouse::Start::Original,
            (Self::New, Route::Unchanged) => warehouse::Start::Test,
        }
    }
}

impl Demonstration {
    /// The letter used in the log's provenance column.
    pub const fn letter(self) -> char {
        match self {
            Self::Original => 'o',
            Self::Opposite => 'p',
            Self::Nearby => 'n',
            Self::Distant => 'd',
        }
    }
}

/// A set of a case's demonstrations. Written `original`, `original+nearby`, `4` for all, `none`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Demonstrations(u8);

impl Demonstrations {
    /// No demonstration: what working memory has.
    pub const NONE: Self = Self(0);
    /// The original demonstration alone.
    pub const ORIGINAL: Self = Self(1);
    /// All four.
    pub const ALL: Self = Self(0b1111);

    /// Bit i set: demonstration i is in the set.
    pub const fn bits(self) -> u32 {
        self.0 as u32
    }
}

impl fmt::Display for Demonstrations {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = match *self {
            Self::NONE => "none".to_owned(),
            Self::ALL => "4".to_owned(),
            Self(bits) => {
                let members = Demonstration::ALL.iter().filter(|d| bits & (1 << **d as u8) != 0);
                members.map(|d| d.name()).collect::<Vec<_>>().join("+")
            }
        };
        f.pad(&words)
    }
}

impl FromStr for Demonstrations {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        match text {
            "none" => return Ok(Self::NONE),
            "1" => return Ok(Self::ORIGINAL),
            "4" => return Ok(Self::ALL),
            _ => {}
        }
        let mut bits = 0;
        for word in text.split('+') {
            let demonstration: Demonstration = word.parse().map_err(|error: UnknownName| {
                let counts = ["1", "4"].map(str::to_owned);
                UnknownName { known: error.known.into_iter().chain(counts).collect(), ..error }
            })?;
            bits |= 1 << demonstration as u8;
        }
        Ok(Self(bits))
    }
}

impl TryFrom<String> for Demonstrations {
    type Error = UnknownName;

    fn try_from(text: String) -> Result<Self, UnknownName> {
        text.parse()
    }
}

impl From<Demonstrations> for String {
    fn from(demonstrations: Demonstrations) -> Self {
        demonstrations.to_string()
    }
}

/// One cell of the table of results. Written `memory/start/route/demonstrations`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Condition {
    /// Which memory.
    pub memory: Memory,
    /// From where.
    pub start: Start,
    /// On which route.
    pub route: Route,
    /// With which demonstrations.
    pub demonstrations: Demonstrations,
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { memory, start, route, demonstrations } = self;
        write!(f, "{memory}/{start}/{route}/{demonstrations}")
    }
}

impl Condition {
    /// The product of the parts, without what makes no difference and what does not exist.
    ///
    /// Working memory has no demonstrations, so it appears once for all sets of them. A blocked route
    /// is defined for the new start only (SPEC section 4), so it is left out elsewhere.
    pub fn product(
        memory: &[Memory],
        starts: &[Start],
        routes: &[Route],
        demonstrations: &[Demonstrations],
    ) -> Vec<Self> {
        let mut conditions = Vec::new();
        for &memory in memory {
            for &start in starts {
                for &route in routes {
                    for &demonstrations in demonstrations {
                        let demonstrations = if memory.uses_demonstrations() {
                            demonstrations
                        } else {
                            Demonstrations::NONE
                        };
                        let condition = Self { memory, start, route, demonstrations };
                        let exists = (start, route) != (Start::Original, Route::Blocked);
                        if exists && !conditions.contains(&condition) {
                            conditions.push(condition);
                        }
                    }
                }
            }
        }
        conditions
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_of_demonstrations_are_written_as_they_are_read() {
        for (text, bits, shown) in [
            ("original", 0b0001, "original"),
            ("1", 0b0001, "original"),
            ("4", 0b1111, "4"),
            ("distant+opposite", 0b1010, "opposite+distant"),
            ("original+opposite+nearby+distant", 0b1111, "4"),
            ("none", 0, "none"),
        ] {
            let set: Demonstrations = text.parse().unwrap();
            assert_eq!((set.bits(), set.to_string().as_str()), (bits, shown));
            assert_eq!(set.to_string().parse(), Ok(set));
        }
        let error = "origin".parse::<Demonstrations>().unwrap_err().to_string();
        assert!(error.contains("did you mean `original`?") && error.contains("4)"), "{error}");
    }

    #[test]
    fn the_product_leaves_out_what_does_not_exist() {
        let shown = |demonstrations: &[Demonstrations]| {
            let conditions =
                Condition::product(Memory::ALL, Start::ALL, Route::ALL, demonstrations);
            conditions.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        assert_eq!(
            shown(&[Demonstrations::ORIGINAL, Demonstrations::ALL]),
            [
                "working/original/unchanged/none",
                "working/new/unchanged/none",
                "working/new/blocked/none",
                "episodic/original/unchanged/original",
                "episodic/original/unchanged/4",
                "episodic/new/unchanged/original",
                "episodic/new/unchanged/4",
                "episodic/new/blocked/original",
                "episodic/new/blocked/4",
            ]
        );
    }
}
