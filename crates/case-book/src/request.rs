//! What a run asks the world to write into its case book.

use std::path::PathBuf;

use domain::{Demonstrations, StreamRules};
use serde::{Deserialize, Serialize};

/// What the case book has to hold.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub struct BookRequest {
    /// The folder of the world's assets; `None`: the built-in ones.
    pub assets: Option<PathBuf>,
    /// The ids of the cases that take part, in any order; all cases are in the book.
    pub cases: Vec<String>,
    /// The sets of demonstrations that conditions name.
    pub demonstrations: Vec<Demonstrations>,
    /// Whether episodes take place on blocked routes.
    pub blocked: bool,
    /// The other world in which tasks are demonstrated, if there is one.
    pub elsewhere: Option<ElsewhereRequest>,
    /// The streams, if the run consists of some.
    pub streams: Option<StreamsRequest>,
}

/// Another world.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElsewhereRequest {
    /// The folder of its assets; `None`: it is drawn.
    pub assets: Option<PathBuf>,
    /// The seed for what is drawn.
    pub seed: u64,
}

/// Streams.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StreamsRequest {
    /// What is drawn.
    pub rules: StreamRules,
    /// The seed.
    pub seed: u64,
    /// Whether the book holds demonstrations by an expert who knows the world of each block.
    pub planned: bool,
}
