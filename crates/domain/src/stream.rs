//! How streams are drawn, and in which order a sequence visits their blocks (specification, section 9).

use serde::{Deserialize, Serialize};

/// What streams are drawn.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamRules {
    /// Number of streams.
    pub streams: u32,
    /// Blocks of each, the unchanged one included.
    pub blocks: u32,
    /// Cases of each block.
    pub cases_per_block: u32,
    /// The kind of events before the second block, the third, and so on; after the last it begins again.
    pub events: Vec<EventKind>,
}

/// The kind of a change of the world between two blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// A passage closes.
    Close,
    /// A closed passage opens again.
    Open,
    /// An item moves.
    Move,
    /// Two types of items swap places.
    Swap,
    /// An item is added.
    Add,
}

/// The order in which a sequence visits the blocks of its stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StreamOrder {
    /// As drawn.
    Drawn,
    /// From the last block to the first.
    Reversed,
    /// In random order, different from both others if there are three blocks or more.
    Shuffled,
}

impl EventKind {
    /// All kinds.
    pub const ALL: [Self; 5] = [Self::Close, Self::Open, Self::Move, Self::Swap, Self::Add];

    /// The word in files and tables.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Close => "close",
            Self::Open => "open",
            Self::Move => "move",
            Self::Swap => "swap",
            Self::Add => "add",
        }
    }
}

impl StreamOrder {
    /// All orders.
    pub const ALL: [Self; 3] = [Self::Drawn, Self::Reversed, Self::Shuffled];

    /// The word in files, on the command line and in tables.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Drawn => "drawn",
            Self::Reversed => "reversed",
            Self::Shuffled => "shuffled",
        }
    }
}
