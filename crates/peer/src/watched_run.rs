//! Whether a run goes on, and in which generation.

use std::path::PathBuf;
use std::time::Duration;

use shm_types::clock::{Instant, sleep};
use shm_types::process::{ProcessWatch, die_with_parent, is_parent};
use shm_types::{Attach, AttachError, BusError};

use crate::error::ServeError;

/// How long to wait for the next generation, or the end of the run, after the transport has failed.
const NEXT_GENERATION_TIMEOUT: Duration = Duration::from_secs(10);

/// How often to look for the next generation.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// A run, watched through the orchestrator's process and `attach.json`.
#[derive(Debug)]
pub(crate) struct WatchedRun {
    orchestrator: ProcessWatch,
    folder: PathBuf,
}

impl WatchedRun {
    pub(crate) fn watch(attach: &Attach) -> Result<Self, ServeError> {
        let pid = attach.orchestrator_pid;
        if is_parent(pid) {
            die_with_parent(pid)?;
        }
        let orchestrator =
            ProcessWatch::new(pid).map_err(|_| ServeError::NoOrchestrator { pid })?;
        Ok(Self { orchestrator, folder: attach.root.clone() })
    }

    /// The generation that has replaced that of `attach`, if any.
    ///
    /// # Errors
    /// When the run is over.
    pub(crate) fn next(&self, attach: &Attach) -> Result<Option<Attach>, ServeError> {
        let abandoned = || ServeError::Abandoned(self.folder.clone());
        if self.orchestrator.has_ended() {
            return Err(abandoned());
        }
        match Attach::read(&self.folder) {
            Ok(now) if now.generation != attach.generation => Ok(Some(now)),
            Ok(_) => Ok(None),
            Err(AttachError::File { .. }) => Err(abandoned()),
            Err(error) => Err(BusError::from(error).into()),
        }
    }

    /// Waits for the generation after that of `attach`, which failed with `error`.
    pub(crate) fn after(&self, attach: &Attach, error: BusError) -> Result<Attach, ServeError> {
        let deadline = Instant::now() + NEXT_GENERATION_TIMEOUT;
        loop {
            if let Some(next) = self.next(attach)? {
                return Ok(next);
            }
            if Instant::now() > deadline {
                return Err(error.into());
            }
            sleep(POLL_INTERVAL);
        }
    }
}
