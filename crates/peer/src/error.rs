//! Why a program in a role ends.

use std::io;
use std::path::PathBuf;

use case_book::BookError;
use shm_types::message::Role;
use shm_types::{ATTACH_VARIABLE, BusError, FactsTooLong, FrameError};

use crate::world::WorldFailure;

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
    /// The run's folder has no declaration of its world.
    #[error(transparent)]
    World(#[from] BookError),
    /// The world cannot go on.
    #[error(transparent)]
    WorldFailed(#[from] WorldFailure),
    /// A frame cannot be published.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The folder is not that of an external memory.
    #[error("{} is not the folder of an external memory of a run: {ATTACH_VARIABLE} names one", .0.display())]
    NotAMemoryFolder(PathBuf),
    /// The user has interrupted the program: it leaves, and the run waits for it.
    #[error("interrupted")]
    Interrupted,
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
        Role::Sim => "world",
        role => role.word(),
    }
}
