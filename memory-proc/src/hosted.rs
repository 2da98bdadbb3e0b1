//! The memory of an episode, built-in or external, as the engine and sequences see it.
//!
//! It is built from a bank, continues from a snapshot if it has to, is told that an episode begins, is asked at each step, is
//! told that the episode ends, and saves what it has learned. A built-in memory does so at once; an external one is sent
//! messages, and its answers come later. Callers need not know which: they call again while they get
//! [`Unready::Waiting`].
//!
//! What is not here: who keeps the memory, which decides what it is built from and when. A built-in memory of few
//! demonstrations belongs to one episode, which pins their views ([`crate::engine`]); that of a sequence or a large bank to
//! all its episodes (`crate::sequences`); what an external memory has built from a bank to all episodes that remember the
//! bank ([`crate::external`]).

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use domain::Representation;
use peer::memory::{EpisodeEnd, Memory};
use shm_types::message::NOT_MEASURED;

use crate::bank::BankSteps;
use crate::demonstrations::DemonstrationLibrary;
use crate::embedded_views::EmbeddedViews;
use crate::episode::{MemoryAnswer, MemoryEpisode, MemoryKind, Unready};
use crate::external::ExternalMemories;
use crate::items::DocumentSupplier;
use crate::representation::{MemorySettings, built_in};

/// What memories are built from and asked with.
pub(crate) struct MemoryHost<'a, I> {
    pub(crate) library: &'a DemonstrationLibrary,
    pub(crate) views: &'a mut EmbeddedViews<I>,
    pub(crate) externals: &'a mut ExternalMemories,
    pub(crate) documents: &'a mut dyn DocumentSupplier,
    pub(crate) clock: &'a dyn Fn() -> u64,
}

/// A memory that answers for episodes.
pub(crate) enum HostedMemory {
    /// In this process.
    BuiltIn(Representation, Box<dyn Memory>),
    /// What an external memory builds, or has built, from the bank with this id.
    External {
        bank: u64,
        /// The folder that it has yet to load.
        to_load: Option<PathBuf>,
    },
}

impl HostedMemory {
    /// Builds the memory of an episode from the steps of a bank; an external one begins to.
    ///
    /// # Errors
    /// When a document is missing, or the memory cannot be built.
    pub(crate) fn build(
        kind: &MemoryKind,
        steps: BankSteps<'_>,
        externals: &mut ExternalMemories,
        documents: &mut dyn DocumentSupplier,
        now_ns: u64,
    ) -> anyhow::Result<Self> {
        let (representation, settings, set) = match kind {
            MemoryKind::BuiltIn { representation, settings, set } => {
                (*representation, settings, *set)
            }
            &MemoryKind::External { index, .. } => {
                let bank = externals.publish_for_sequence(index, steps, now_ns);
                return Ok(Self::External { bank, to_load: None });
            }
        };
        let failed = || format!("{representation} memory");
        let kinds = representation.describe().documents.iter();
        let texts: anyhow::Result<_> =
            kinds.map(|&kind| documents.consolidated(kind, set)).collect();
        let (documents, embeddings) = (texts.with_context(failed)?, steps.embeddings());
        let settings = MemorySettings { documents, embeddings, ..settings.clone() };
        let mut memory = built_in(representation, &settings);
        memory.build(&steps.demonstrations()).with_context(failed)?;
        Ok(Self::BuiltIn(representation, memory))
    }

    /// Has it continue from what it has saved in `folder`. An external memory does so once it is built.
    ///
    /// # Errors
    /// When it cannot: the reason.
    pub(crate) fn load(&mut self, folder: PathBuf) -> Result<(), String> {
        match self {
            Self::BuiltIn(_, memory) => memory.load(&folder).map_err(|error| error.to_string()),
            Self::External { to_load, .. } => {
                *to_load = Some(folder);
                Ok(())
            }
        }
    }

    /// Tells it that an episode begins, once it is built and loaded.
    pub(crate) fn begin(
        &mut self,
        episode: &MemoryEpisode,
        externals: &mut ExternalMemories,
        now_ns: u64,
    ) -> Result<(), Unready> {
        match self {
            Self::BuiltIn(_, memory) => {
                memory.begin_episode(&episode.begin()).map_err(anyhow::Error::from)?;
            }
            Self::External { bank, to_load } => {
                externals.check_built(*bank)?;
                if let Some(folder) = to_load {
                    externals.store(*bank, folder, true, now_ns)?;
                    *to_load = None;
                }
                externals.begin(episode, *bank);
            }
        }
        Ok(())
    }

    /// Asks it about the pending observation of an episode that has begun, once the current view is embedded. A built-in
    /// memory that learns from the episode observes the step first.
    pub(crate) fn ask<I: Clone>(
        &mut self,
        episode: &mut MemoryEpisode,
        host: &mut MemoryHost<'_, I>,
    ) -> Result<MemoryAnswer, Unready> {
        let MemoryHost { library, views, externals, clock, .. } = host;
        let content = episode.pending.as_ref().and_then(|pending| pending.content);
        let embedding = content.and_then(|content| views.embeddings.get(&content));
        if !episode.admitted || embedding.is_none() && content.is_some() {
            return Err(Unready::Waiting);
        }
        let (representation, memory) = match self {
            Self::BuiltIn(representation, memory) => (representation, memory),
            Self::External { bank, .. } => {
                return Err(externals.ask(episode, *bank, embedding, clock()));
            }
        };
        let failed = || format!("{representation} memory");
        let embedded_ns = clock();
        let query = episode.query(embedding).context("the episode has not begun")?;
        if episode.learns() {
            memory.observe(&query.now).with_context(failed)?;
        }
        let items = memory.recall(&query).with_context(failed)?;
        let store_bytes = memory.store_bytes().unwrap_or(0);
        let searched_ns = clock();
        let checked = episode.checked(items, library.world());
        let checked = checked.map_err(|what| anyhow!("{}: {what}", failed()))?;
        Ok(MemoryAnswer {
            checked,
            embedded_ns,
            searched_ns,
            method_ns: 0,
            store_bytes,
            tokens: NOT_MEASURED,
            pinned: false,
        })
    }

    /// Tells it that an episode that has begun is over, or was given up; with `learned` it learns from the episode. An
    /// external memory is told nothing of one that was given up: the next in the lane says it.
    ///
    /// # Errors
    /// When it cannot learn from the episode: the reason.
    pub(crate) fn end(
        &mut self,
        episode: &MemoryEpisode,
        learned: Option<&EpisodeEnd<'_>>,
        externals: &mut ExternalMemories,
    ) -> Result<(), String> {
        let unlearned = EpisodeEnd::unlearned(episode.lane, episode.id);
        let end = learned.unwrap_or(&unlearned);
        match self {
            Self::BuiltIn(_, memory) => {
                let last = episode.query(None).filter(|_| learned.is_some());
                let observed = last.map_or(Ok(()), |last| memory.observe(&last.now));
                observed.and_then(|()| memory.end_episode(end)).map_err(|error| error.to_string())
            }
            Self::External { .. } => {
                externals.end(episode, end);
                Ok(())
            }
        }
    }

    /// Has it save what it has learned in `folder`, and returns the bytes of its store.
    pub(crate) fn save(
        &mut self,
        folder: &Path,
        externals: &mut ExternalMemories,
        now_ns: u64,
    ) -> Result<u64, Unready> {
        match self {
            Self::BuiltIn(_, memory) => {
                memory.save(folder).map_err(|error| error.to_string())?;
                Ok(memory.store_bytes().unwrap_or(0))
            }
            Self::External { bank, .. } => externals.store(*bank, folder, false, now_ns),
        }
    }

    /// Bytes of its store in this process, as far as it tells them.
    pub(crate) fn store_bytes(&self) -> u64 {
        match self {
            Self::BuiltIn(_, memory) => memory.store_bytes().unwrap_or(0),
            Self::External { .. } => 0,
        }
    }

    /// Drops it; an external memory drops what it has built.
    pub(crate) fn discard(self, externals: &mut ExternalMemories) {
        if let Self::External { bank, .. } = self {
            externals.take_back(bank);
        }
    }
}
