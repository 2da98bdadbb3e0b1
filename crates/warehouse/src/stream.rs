//! Streams: what happens in which order to a memory that persists (specification, section 9).
//!
//! A stream is a list of blocks. Between two blocks events change the world; within a block it stays as it is. This module
//! holds streams as values and in their file.

mod changes;
mod drawing;

use domain::{Cell, StreamOrder};
use serde::{Deserialize, Serialize};

use crate::asset::Problem;
use crate::case::CaseSet;
use crate::draw::Draw;
use crate::state::{WorldChange, WorldState};
use crate::world::Warehouse;

/// The streams of a run, and the world states in which they take place: the content of `streams.json`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamSet {
    /// The seed that the streams are drawn from.
    pub seed: u64,
    /// The world states of all streams, each once.
    pub worlds: Vec<WorldChange>,
    /// The streams.
    pub streams: Vec<Stream>,
}

/// A list of blocks.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stream {
    /// The blocks, in the order in which they are drawn. A sequence may visit them in another [`StreamOrder`].
    pub blocks: Vec<Block>,
}

/// Some cases in one world state.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// The index in [`StreamSet::worlds`] of the block's world state.
    pub world: u32,
    /// The indices of its cases in the set of cases.
    pub cases: Vec<u32>,
    /// What has changed since the block before.
    pub events: Vec<Event>,
}

/// A change of the world between two blocks.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Event {
    /// A passage closes.
    Close {
        /// The cells of the passage, sorted.
        cells: Vec<Cell>,
    },
    /// A closed passage opens again.
    Open {
        /// The cells of the passage, sorted.
        cells: Vec<Cell>,
    },
    /// An item moves to a bay that was empty.
    Move {
        /// The index of its type.
        item_type: usize,
        /// Its standpoint before.
        from: Cell,
        /// Its standpoint afterwards.
        to: Cell,
    },
    /// All items of two types swap places.
    Swap {
        /// The index of the one type.
        a: usize,
        /// The index of the other type.
        b: usize,
    },
    /// An item is added in a bay that was empty.
    Add {
        /// The index of its type.
        item_type: usize,
        /// Its standpoint.
        at: Cell,
    },
}

/// Why a set of streams cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct StreamError(pub(crate) Problem);

impl StreamSet {
    /// Reads the text of a `streams.json`.
    ///
    /// # Errors
    /// JSON that is not a set of streams, or one that does not fit `warehouse` and `cases`; see [`check`](Self::check).
    pub fn parse(text: &str, warehouse: &Warehouse, cases: &CaseSet) -> Result<Self, StreamError> {
        let set: Self =
            serde_json::from_str(text).map_err(|error| StreamError(error.to_string()))?;
        set.check(warehouse, cases)?;
        Ok(set)
    }

    /// The text of the `streams.json`: one line of JSON.
    pub fn to_text(&self) -> String {
        match serde_json::to_string(self) {
            Ok(text) => text + "\n",
            Err(error) => unreachable!("numbers, lists and words can always be written: {error}"),
        }
    }

    /// Checks that every block has a world and known cases, and that every world is a state of `warehouse`.
    ///
    /// # Errors
    /// The first that does not hold, with its stream and block.
    pub fn check(&self, warehouse: &Warehouse, cases: &CaseSet) -> Result<(), StreamError> {
        self.states(warehouse)?;
        for (stream, drawn) in self.streams.iter().enumerate() {
            if drawn.blocks.is_empty() {
                return Err(StreamError(format!("stream {stream} has no block")));
            }
            for (block, Block { world, cases: listed, .. }) in drawn.blocks.iter().enumerate() {
                let place = format!("stream {stream}, block {block}");
                if *world as usize >= self.worlds.len() {
                    let worlds = self.worlds.len();
                    return Err(StreamError(format!("{place}: world {world} of {worlds}")));
                }
                if listed.is_empty() {
                    return Err(StreamError(format!("{place} has no case")));
                }
                if let Some(case) = listed.iter().find(|&&case| case as usize >= cases.cases.len())
                {
                    let known = cases.cases.len();
                    return Err(StreamError(format!("{place}: case {case} of {known}")));
                }
            }
        }
        Ok(())
    }

    /// The world states, by their index in [`worlds`](Self::worlds).
    ///
    /// # Errors
    /// A change that does not fit `warehouse`, with its index.
    pub fn states(&self, warehouse: &Warehouse) -> Result<Vec<WorldState>, StreamError> {
        let state = |(index, change)| {
            WorldState::new(warehouse, change)
                .map_err(|error| StreamError(format!("world {index}: {error}")))
        };
        self.worlds.iter().enumerate().map(state).collect()
    }

    /// The world variant on the wire of world `world`, beside a set of `cases` cases: 0 if nothing has changed in it, otherwise
    /// a number after those of the cases' barricades.
    pub fn variant(&self, world: u32, cases: usize) -> u32 {
        match self.worlds.get(world as usize) {
            Some(change) if !change.is_empty() => 1 + cases as u32 + world,
            _ => 0,
        }
    }

    /// The indices of the blocks of stream `stream` in `order`.
    pub fn order(&self, stream: u32, order: StreamOrder) -> Vec<u32> {
        let blocks = self.streams.get(stream as usize).map_or(0, |stream| stream.blocks.len());
        let drawn: Vec<u32> = (0..blocks as u32).collect();
        let reversed: Vec<u32> = drawn.iter().rev().copied().collect();
        match order {
            StreamOrder::Drawn => drawn,
            StreamOrder::Reversed => reversed,
            StreamOrder::Shuffled => {
                let mut draw = Draw::new(self.seed, SHUFFLE | u64::from(stream));
                loop {
                    let shuffled = draw.shuffled(drawn.clone());
                    if blocks < 3 || (shuffled != drawn && shuffled != reversed) {
                        return shuffled;
                    }
                }
            }
        }
    }
}

/// Marks the draws of shuffled orders.
const SHUFFLE: u64 = 1 << 56;

impl Stream {
    /// The cases of all blocks, sorted, each once.
    pub fn cases(&self) -> Vec<u32> {
        let mut cases: Vec<u32> =
            self.blocks.iter().flat_map(|block| block.cases.iter().copied()).collect();
        cases.sort_unstable();
        cases.dedup();
        cases
    }
}

impl Event {
    /// What happens, in words: `close Corridor 2 at (14, 13)`, `swap red cone and blue tyre`.
    pub fn describe(&self, warehouse: &Warehouse) -> String {
        let name = |index: usize| {
            warehouse.catalogue.types.get(index).map_or("unknown type", |found| &found.name)
        };
        let passage = |cells: &[Cell]| {
            let first = cells.first().copied().unwrap_or(Cell::new(0, 0));
            let aisle = warehouse.layout.aisle_name(first).unwrap_or("passage");
            format!("{aisle} at {first}")
        };
        match self {
            Self::Close { cells } => format!("close {}", passage(cells)),
            Self::Open { cells } => format!("open {}", passage(cells)),
            Self::Move { item_type, from, to } => {
                format!("move {} from {from} to {to}", name(*item_type))
            }
            Self::Swap { a, b } => format!("swap {} and {}", name(*a), name(*b)),
            Self::Add { item_type, at } => format!("add {} at {at}", name(*item_type)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::Variant;

    fn set(blocks: u32) -> StreamSet {
        let block = |world| Block { world: world % 2, cases: vec![world], events: Vec::new() };
        let closed = WorldChange { closed: vec![Cell::new(2, 8)], stock: Vec::new() };
        StreamSet {
            seed: 1,
            worlds: vec![WorldChange::default(), closed],
            streams: vec![Stream { blocks: (0..blocks).map(block).collect() }],
        }
    }

    #[test]
    fn a_set_is_read_as_it_was_written() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let mut set = set(3);
        set.streams[0].blocks[1].events =
            vec![Event::Close { cells: vec![Cell::new(2, 8)] }, Event::Swap { a: 0, b: 1 }];
        assert_eq!(StreamSet::parse(&set.to_text(), &warehouse, &cases).unwrap(), set);
        for (from, to, expected) in [
            ("\"seed\"", "\"sead\"", "sead"),
            ("[2,8]", "[5,8]", "world 1: closed cell (5, 8) is not free floor"),
            ("\"world\":1", "\"world\":2", "stream 0, block 1: world 2 of 2"),
            ("\"cases\":[2]", "\"cases\":[100]", "stream 0, block 2: case 100 of 100"),
            ("\"cases\":[2]", "\"cases\":[]", "stream 0, block 2 has no case"),
        ] {
            let text = set.to_text().replace(from, to);
            let error = StreamSet::parse(&text, &warehouse, &cases).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn variants_follow_those_of_the_cases() {
        let set = set(2);
        assert_eq!([0, 1].map(|world| set.variant(world, 100)), [0, 102]);
        let states = set.states(&Warehouse::shipped()).unwrap();
        assert_eq!(states[0].variant, Variant::UNCHANGED);
        assert!(states[1].variant.is_closed(Cell::new(2, 8)));
    }

    #[test]
    fn orders_are_permutations_and_differ() {
        for blocks in 1..8 {
            let set = set(blocks);
            let orders = StreamOrder::ALL.map(|order| set.order(0, order));
            for order in &orders {
                let mut sorted = order.clone();
                sorted.sort_unstable();
                assert_eq!(sorted, orders[0]);
            }
            if blocks >= 3 {
                assert!(orders[2] != orders[0] && orders[2] != orders[1]);
            }
        }
        assert_eq!(set(4).order(0, StreamOrder::Reversed), [3, 2, 1, 0]);
        assert_eq!(set(2).order(7, StreamOrder::Shuffled), [0_u32; 0]);
    }
}
