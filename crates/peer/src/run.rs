//! Taking a role in a run from its first generation to its last.
//!
//! A process that the orchestrator started is killed with its generation. A process that the user started stays: it
//! joins each next generation, and ends when the run is over. So that it never outlives the run, it watches the
//! orchestrator's process and `attach.json`.

use std::cell::RefCell;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use shm_types::clock::{Instant, sleep};
use shm_types::message::Role;
use shm_types::{ATTACH_VARIABLE, Attach, AttachError, Bus, BusError, FrameError};

use crate::connection::{Connection, End, Service};
use crate::error::ServeError;
use crate::watched_run::WatchedRun;

/// How long to try to join a generation. A process that was killed may hold its place for a moment after that, and the
/// services of a generation that ends may be gone before `attach.json` names the next one.
const JOIN_TIMEOUT: Duration = Duration::from_secs(2);

/// How often to try to join a generation.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// The folder that the environment names for `role`.
///
/// # Errors
/// When `MEMTRANSFER_ATTACH` is not set.
pub fn folder_from_environment(role: Role) -> Result<PathBuf, ServeError> {
    let folder = std::env::var_os(ATTACH_VARIABLE).filter(|folder| !folder.is_empty());
    folder.map(PathBuf::from).ok_or(ServeError::NoRun(role))
}

/// How long a role is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Until {
    /// Until the run is over, in every generation.
    RunEnds,
    /// Until the generation is over: what takes the role in the next one is another service.
    GenerationEnds,
}

/// Serves in the run whose folder is `folder` until the orchestrator sends a stop message, in every generation or, if `until` says
/// so, in one.
///
/// A process that the orchestrator started is killed with it, however it ends; any other process notices within a second.
///
/// # Errors
/// When there is no such run, it cannot be joined, its transport fails, it ends without a stop message, or the service
/// fails.
pub fn serve_role<S: Service>(
    service: &mut S,
    folder: &Path,
    until: Until,
) -> Result<(), ServeError> {
    // Both closures need the service, one after the other.
    let service = RefCell::new(service);
    serve_generations(
        folder,
        until,
        |attach| service.borrow().join(attach),
        |bus, run| Connection::new(bus)?.serve(&mut **service.borrow_mut(), run),
    )
}

/// Joins each generation of the run whose folder is `folder`, or the first one if `until` says so, and serves in it, until the
/// orchestrator sends a stop message.
///
/// # Errors
/// As [`serve_role`].
pub(crate) fn serve_generations(
    folder: &Path,
    until: Until,
    join: impl Fn(Attach) -> Result<Bus, BusError>,
    mut serve: impl FnMut(Bus, &WatchedRun) -> Result<End, ServeError>,
) -> Result<(), ServeError> {
    let mut attach = Attach::read(folder).map_err(|error| match error {
        AttachError::File { cause, .. } if cause.kind() == io::ErrorKind::NotFound => {
            ServeError::NotARun(folder.to_owned())
        }
        error => BusError::from(error).into(),
    })?;
    let run = WatchedRun::watch(&attach)?;
    loop {
        let bus = join_generation(&join, &mut attach, &run)?;
        attach = match serve(bus, &run) {
            Ok(End::Stopped) => return Ok(()),
            Ok(End::NextGeneration(next)) => next,
            // The services of the generation are gone; wait for the next one or for the end of the run.
            Err(ServeError::Bus(error) | ServeError::Frame(FrameError::Bus(error))) => {
                run.after(&attach, error)?
            }
            Err(error) => return Err(error),
        };
        if until == Until::GenerationEnds {
            return Ok(());
        }
    }
}

/// Joins the generation of `attach`, or the one that has replaced it meanwhile.
fn join_generation(
    join: impl Fn(Attach) -> Result<Bus, BusError>,
    attach: &mut Attach,
    run: &WatchedRun,
) -> Result<Bus, ServeError> {
    let deadline = Instant::now() + JOIN_TIMEOUT;
    loop {
        match join(attach.clone()) {
            Err(BusError::Taken { .. } | BusError::Open { .. }) if Instant::now() < deadline => {}
            joined => return Ok(joined?),
        }
        sleep(POLL_INTERVAL);
        if let Some(next) = run.next(attach)? {
            *attach = next;
        }
    }
}
