//! The role of a memory: what it is given, what it answers, and how an external one is served.
//!
//! A memory is built from a bank of [`Demonstration`]s. At each step of an episode it is given a [`Query`] and returns
//! [`MemoryItem`]s: texts, steps of demonstrations, captioned frames, plans. It names what it was given by number, so it cannot
//! supply any other view; the host looks up views and actions, applies the budgets, and passes the items on to the policy.
//!
//! In a stream one memory serves many episodes. It learns from some of them ([`Episode::learns`]): it observes their steps,
//! is told of their end ([`EpisodeEnd`]), can name their steps from then on, and is saved. The others only read it.
//!
//! The memories that MemTransfer is built with implement [`Memory`] in the host's process; [`serve`] runs any other in a
//! process of its own.

mod answer;
mod items;
mod method;
mod serving;
mod session;
mod views;

use std::path::Path;

pub use shm_types::MemoryDescription;
pub use shm_types::description::Scope;
use shm_types::message::shortened_reason;

pub use self::items::{MemoryItem, PlanPart, Source, Views};
pub use self::method::{MemoryMethod, Method};
pub use self::serving::{serve, serve_from_environment, serve_until};
pub use self::views::{
    Demonstration, DemonstrationStep, Episode, EpisodeEnd, PastStep, Query, Step,
};

/// A memory of one bank of demonstrations.
///
/// Episodes of several lanes can run at the same time; each call names its episode.
pub trait Memory {
    /// Builds the memory from the demonstrations, once, before anything else.
    ///
    /// # Errors
    /// When it cannot be built: all its episodes end without a result.
    fn build(&mut self, demonstrations: &[Demonstration<'_>]) -> Result<(), MemoryError> {
        let _ = demonstrations;
        Ok(())
    }

    /// An episode begins.
    ///
    /// # Errors
    /// When the episode cannot be served: it ends without a result.
    fn begin_episode(&mut self, episode: &Episode<'_>) -> Result<(), MemoryError> {
        let _ = episode;
        Ok(())
    }

    /// The agent has taken a step: called before the [`Self::recall`] for the step, and for the last step of an episode,
    /// which has no view and no recall. Not called in an episode of a stream that the memory does not learn from.
    ///
    /// # Errors
    /// As [`Self::begin_episode`].
    fn observe(&mut self, step: &Step<'_>) -> Result<(), MemoryError> {
        let _ = step;
        Ok(())
    }

    /// What the memory supplies for a step, the most important first: at most
    /// [`MAX_ITEMS`](shm_types::message::MAX_ITEMS) items. An item that does not fit into a budget is dropped.
    ///
    /// # Errors
    /// As [`Self::begin_episode`].
    fn recall(&mut self, query: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError>;

    /// An episode is over, or was given up.
    ///
    /// # Errors
    /// When the memory cannot learn from the episode: it ends without a result.
    fn end_episode(&mut self, end: &EpisodeEnd<'_>) -> Result<(), MemoryError> {
        let _ = end;
        Ok(())
    }

    /// Writes what it has learned into `folder`, which is empty: all that [`Self::load`] needs beside the demonstrations.
    /// Called after each episode that it learns from.
    ///
    /// # Errors
    /// When it cannot be written: the episode ends without a result.
    fn save(&mut self, folder: &Path) -> Result<(), MemoryError> {
        let _ = folder;
        Ok(())
    }

    /// Restores what [`Self::save`] has written into `folder`. Called after [`Self::build`] with the same demonstrations,
    /// before anything else. From then on the memory has to answer as the one that was saved.
    ///
    /// # Errors
    /// When it cannot be read: all episodes that continue from it end without a result.
    fn load(&mut self, folder: &Path) -> Result<(), MemoryError> {
        let _ = folder;
        Ok(())
    }

    /// Size of what it stores, if it is known.
    fn store_bytes(&self) -> Option<u64> {
        None
    }

    /// Tokens of its own requests to a model for the last [`Self::recall`], if it counts them.
    fn tokens(&self) -> Option<u32> {
        None
    }
}

/// Why a memory cannot be built or cannot answer. A long reason is cut: see [`MAX_REASON_BYTES`](shm_types::message::MAX_REASON_BYTES).
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct MemoryError(String);

impl MemoryError {
    /// An error with this text.
    pub fn new(what: impl std::fmt::Display) -> Self {
        Self(shortened_reason(what.to_string()))
    }
}

impl From<String> for MemoryError {
    fn from(what: String) -> Self {
        Self(shortened_reason(what))
    }
}
