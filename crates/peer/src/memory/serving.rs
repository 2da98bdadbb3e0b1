//! Serving an external memory: its description, the wait for the run, and its [`Service`].

use std::io;
use std::path::Path;
use std::time::Duration;

use shm_types::clock::sleep;
use shm_types::description::run_of_memory_folder;
use shm_types::message::Role;
use shm_types::{Attach, AttachError, Bus, BusError, MemoryDescription, registry};

use super::{MemoryMethod, session};
use crate::connection::{Connection, Service};
use crate::error::ServeError;
use crate::program_code::own_code;
use crate::run::{Until, folder_from_environment, serve_role};

/// How often to look for `attach.json`.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Serves `method` in the run whose folder `MEMTRANSFER_ATTACH` names, as [`serve`] does.
///
/// # Errors
/// As [`serve`], and when the variable is not set.
pub fn serve_from_environment(method: &dyn MemoryMethod) -> Result<(), ServeError> {
    serve(method, &folder_from_environment(Role::ExternalMemory)?)
}

/// Serves `method` in a run until the orchestrator sends a stop message. `folder` is the folder of this external memory
/// in the run's folder. Messages that cannot be used are reported and dropped.
///
/// # Errors
/// When there is no such run, the description cannot be written, the run cannot be joined, its transport fails, or it
/// ends without a stop message.
pub fn serve(method: &dyn MemoryMethod, folder: &Path) -> Result<(), ServeError> {
    serve_until(method, folder, Until::RunEnds)
}

/// As [`serve`], but `until` can end it with the generation.
///
/// # Errors
/// As [`serve`].
pub fn serve_until(
    method: &dyn MemoryMethod,
    folder: &Path,
    until: Until,
) -> Result<(), ServeError> {
    let not_found = |_: io::Error| ServeError::NotARun(folder.to_owned());
    let folder = folder.canonicalize().map_err(not_found)?;
    let not_a_memory = || ServeError::NotAMemoryFolder(folder.clone());
    let (run, index) = run_of_memory_folder(&folder).ok_or_else(not_a_memory)?;
    let mut description = method.describe();
    if description.sdk.is_empty() {
        description.sdk = concat!("peer ", env!("CARGO_PKG_VERSION")).to_owned();
    }
    if description.code.is_empty() {
        description.code = own_code().map_err(ServeError::OwnCode)?;
    }
    description.write(&folder).map_err(BusError::from)?;
    wait_for_run(run, method)?;
    serve_role(&mut MemoryService { method, description, index }, run, until)
}

/// Waits until the run in `folder` can be joined.
fn wait_for_run(folder: &Path, method: &dyn MemoryMethod) -> Result<(), ServeError> {
    loop {
        method.check()?;
        match Attach::read(folder) {
            Ok(_) => return Ok(()),
            Err(AttachError::File { .. }) if registry::is_alive(folder) => {
                sleep(POLL_INTERVAL);
            }
            Err(AttachError::File { .. }) => return Err(ServeError::NotARun(folder.to_owned())),
            Err(error) => return Err(BusError::from(error).into()),
        }
    }
}

/// A method of remembering as a [`Service`].
struct MemoryService<'m> {
    method: &'m dyn MemoryMethod,
    description: MemoryDescription,
    index: u8,
}

impl Service for MemoryService<'_> {
    const ROLE: Role = Role::ExternalMemory;

    type Session<'s>
        = session::MemorySession<'s>
    where
        Self: 's;

    fn join(&self, attach: Attach) -> Result<Bus, BusError> {
        Bus::join_as(attach, Role::ExternalMemory, self.index)
    }

    fn facts(&self) -> Vec<(&str, String)> {
        let MemoryDescription { name, version, sdk, .. } = &self.description;
        vec![("memory", name.clone()), ("version", version.clone()), ("sdk", sdk.clone())]
    }

    fn start<'s>(&'s mut self, connection: &Connection) -> Result<Self::Session<'s>, ServeError> {
        session::MemorySession::new(self.method, self.description.frames, connection)
    }
}
