//! The `[stream]` table of a suite.

use std::collections::BTreeSet;

use domain::{EventKind, FeedbackLevel, StreamOrder, StreamRules};
use serde::{Deserialize, Serialize};

/// What streams a run consists of (specification, section 9).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct StreamSettings {
    /// Number of streams.
    pub streams: u32,
    /// Blocks of each stream, the first in the unchanged world.
    pub blocks: u32,
    /// Cases of each block.
    pub cases_per_block: u32,
    /// How often the cases of a block are learned from.
    pub rounds: u32,
    /// The kinds of events before the second block, the third, and so on; after the last it begins again.
    #[serde(default)]
    pub events: Vec<EventKind>,
    /// The orders in which sequences visit the blocks.
    pub orders: Vec<StreamOrder>,
    /// What a memory that learns is told at the end of an episode.
    pub feedback: FeedbackLevel,
    /// Whether the cases of every block are evaluated before the first block and after each.
    #[serde(default = "yes")]
    pub evaluate: bool,
}

fn yes() -> bool {
    true
}

impl StreamSettings {
    /// What streams are drawn.
    pub fn rules(&self) -> StreamRules {
        StreamRules {
            streams: self.streams,
            blocks: self.blocks,
            cases_per_block: self.cases_per_block,
            events: self.events.clone(),
        }
    }

    /// The episodes of one condition in one repetition: all streams in all orders.
    pub fn all_episodes(&self) -> usize {
        self.sequence_episodes() * self.sequences()
    }

    /// The episodes of one sequence.
    pub fn sequence_episodes(&self) -> usize {
        let [blocks, cases_per_block, rounds] =
            [self.blocks, self.cases_per_block, self.rounds].map(|count| count as usize);
        let evaluations = if self.evaluate { blocks + 1 } else { 0 };
        blocks * cases_per_block * (rounds + evaluations)
    }

    /// The sequences of one condition in one repetition.
    pub fn sequences(&self) -> usize {
        let orders: BTreeSet<StreamOrder> = self.orders.iter().copied().collect();
        self.streams as usize * orders.len()
    }
}
