//! Taking a role in a run from its first generation to its last.
//!
//! A process that the orchestrator started is killed with its generation. A process that the user started stays: it
//! joins each next generation, and ends when the run is over. So that it never outlives the run, it watches the
//! orchestrator's process and `attach.json`.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use shm_types::clock::{Instant, sleep};
use shm_types::message::Role;
use shm_types::process::{ProcessWatch, die_with_parent, is_parent};
use shm_types::{ATTACH_VARIABLE, Attach, AttachError, Bus, BusError, FactsTooLong};

use crate::connection::{Connection, End, Service};

/// How long to wait for the next generation, or the end of the run, after the transport has failed.
const NEXT_GENERATION_TIMEOUT: Duration = Duration::from_secs(10);

/// How long to try to join a generation. A process that was killed may hold its place for a moment after that, and the
/// services of a generation that ends may be gone before `attach.json` names the next one.
const JOIN_TIMEOUT: Duration = Duration::from_secs(2);

/// How often to look for the next generation, or to try to join one.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Why serving ended without a stop message.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The run cannot be joined, or its transport failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The environment does not name a run.
    #[error(
        "{ATTACH_VARIABLE} is not set: it names the folder of the run to join. `memtransfer run --{flag}-cmd \
         COMMAND` starts this program with it; `memtransfer run --{flag} external` waits for this program and \
         prints its value", flag = flag(*.0)
    )]
    NoRun(Role),
    /// The folder holds no run.
    #[error("{} is not the folder of a run, or that run is over", .0.display())]
    NotARun(PathBuf),
    /// The orchestrator's process does not exist.
    #[error(
        "process {pid}, the orchestrator of this run, does not exist: the run is over, or this program runs in a \
         container that cannot see the process (use --pid=host and --ipc=host)"
    )]
    NoOrchestrator {
        /// Its process id.
        pid: u32,
    },
    /// The folder is not that of an external memory.
    #[error("{} is not the folder of an external memory of a run: {ATTACH_VARIABLE} names one", .0.display())]
    NotAMemoryFolder(PathBuf),
    /// The run ended without a stop message.
    #[error("the run in {} ended without a stop message", .0.display())]
    Abandoned(PathBuf),
    /// The file for spans cannot be created.
    #[error("cannot write spans: {0}")]
    Spans(io::Error),
    /// The policy returned a wrong number of decisions.
    #[error("policy {policy} returned {answers} decisions for {requests} requests")]
    Answers {
        /// The policy.
        policy: String,
        /// Requests in the batch.
        requests: usize,
        /// Decisions it returned.
        answers: usize,
    },
    /// The policy failed.
    #[error(transparent)]
    Policy(Box<dyn std::error::Error + Send + Sync>),
    /// The program keeps frames that the simulator needs.
    #[error("{0}")]
    Frames(String),
    /// The facts of the handshake are too long.
    #[error(transparent)]
    Facts(#[from] FactsTooLong),
    /// The program's own file cannot be read, whose hash it has to tell.
    #[error("cannot read this program's own file: {0}")]
    OwnCode(io::Error),
    /// The prompt log cannot be created.
    #[error("{0}")]
    PromptLog(String),
    /// The orchestrator, which started this process, has ended.
    #[error(transparent)]
    Parent(#[from] io::Error),
}

/// The first part of the flags that start a program in `role`.
const fn flag(role: Role) -> &'static str {
    match role {
        Role::ExternalMemory => Role::Memory.word(),
        role => role.word(),
    }
}

/// The folder that the environment names for `role`.
///
/// # Errors
/// When `MEMTRANSFER_ATTACH` is not set.
pub fn folder_from_environment(role: Role) -> Result<PathBuf, ServeError> {
    let folder = std::env::var_os(ATTACH_VARIABLE).filter(|folder| !folder.is_empty());
    folder.map(PathBuf::from).ok_or(ServeError::NoRun(role))
}

/// Serves in the run whose folder is `folder` until the orchestrator sends a stop message, in every generation.
///
/// A process that the orchestrator started is killed with it, however it ends; any other process notices within a second.
///
/// # Errors
/// When there is no such run, it cannot be joined, its transport fails, it ends without a stop message, or the service
/// fails.
pub fn serve_role<S: Service>(service: &mut S, folder: &Path) -> Result<(), ServeError> {
    let mut attach = Attach::read(folder).map_err(|error| match error {
        AttachError::File { cause, .. } if cause.kind() == io::ErrorKind::NotFound => {
            ServeError::NotARun(folder.to_owned())
        }
        error => BusError::from(error).into(),
    })?;
    let run = WatchedRun::watch(&attach)?;
    loop {
        let bus = join(service, &mut attach, &run)?;
        let ended = Connection::new(bus).and_then(|mut connection| connection.serve(service, &run));
        attach = match ended {
            Ok(End::Stopped) => return Ok(()),
            Ok(End::NextGeneration(next)) => next,
            // The services of the generation are gone; wait for the next one or for the end of the run.
            Err(ServeError::Bus(error)) => run.after(&attach, error)?,
            Err(error) => return Err(error),
        }
    }
}

/// Joins the generation of `attach`, or the one that has replaced it meanwhile.
fn join<S: Service>(service: &S, attach: &mut Attach, run: &WatchedRun) -> Result<Bus, ServeError> {
    let deadline = Instant::now() + JOIN_TIMEOUT;
    loop {
        match service.join(attach.clone()) {
            Err(BusError::Taken { .. } | BusError::Open { .. }) if Instant::now() < deadline => {}
            joined => return Ok(joined?),
        }
        sleep(POLL_INTERVAL);
        if let Some(next) = run.next(attach)? {
            *attach = next;
        }
    }
}

/// A run, watched through the orchestrator's process and `attach.json`.
#[derive(Debug)]
pub(crate) struct WatchedRun {
    orchestrator: ProcessWatch,
    folder: PathBuf,
}

impl WatchedRun {
    fn watch(attach: &Attach) -> Result<Self, ServeError> {
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
    fn after(&self, attach: &Attach, error: BusError) -> Result<Attach, ServeError> {
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
