//! The policy's side of a run without queues and frames, for the fuzz targets in `tests/fuzz`. Not part of the SDK.

use std::sync::Arc;

use case_book::WorldDeclaration;
use shm_types::documents::Document;
use shm_types::message::{Observation, PolicyEpisodeConfig, Recall};

use super::join::{Join, Recalled};
use super::pinned::PinnedStep;

/// A message to the policy.
#[derive(Debug)]
pub enum Incoming {
    /// The lane's next episode.
    Config(Box<PolicyEpisodeConfig>),
    /// What the agent sees.
    Observation(Box<Observation>),
    /// What memory supplies.
    Recall(Box<Recall>),
}

/// Takes messages in their order. Returns the complete requests, and how many messages and requests were refused.
pub fn requests(
    lanes: u32,
    world: Arc<WorldDeclaration>,
    documents: &[Arc<Document>],
    messages: impl IntoIterator<Item = Incoming>,
) -> (Vec<PinnedStep>, usize) {
    let mut join = Join::new(lanes, Arc::clone(&world));
    let (mut complete, mut refused) = (Vec::new(), 0);
    for message in messages {
        let taken = match message {
            Incoming::Config(config) => join.begin(&config),
            Incoming::Observation(observation) => join.observe(&observation),
            Incoming::Recall(recall) => {
                Recalled::read(&world, &recall).and_then(|read| join.recall(read))
            }
        };
        refused += usize::from(taken.is_err());
        for ready in join.take_ready() {
            match PinnedStep::new(ready, documents) {
                Ok(step) => complete.push(step),
                Err(_) => refused += 1,
            }
        }
    }
    (complete, refused)
}
