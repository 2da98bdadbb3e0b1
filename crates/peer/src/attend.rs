//! Taking part in a run from its first generation to its last, whoever started this process.
//!
//! A process that the orchestrator started is killed with its generation. One that somebody else started lives
//! on: it joins the next generation by itself, and ends when the run is over. So that it never outlives a run,
//! it watches the orchestrator's process and the file `attach.json`.

use std::ffi::OsStr;
use std::io;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use shm_types::message::Role;
use shm_types::process::{ProcessWatch, die_with_parent, is_parent};
use shm_types::{ATTACH_VARIABLE, Attach, AttachError, Bus, BusError, FactsTooLong};

use super::Decider;
use super::serve::{End, serve_generation};

/// How long a generation that has come apart may take to be followed by another one, or by the run's end.
const NEXT_PATIENCE: Duration = Duration::from_secs(10);

/// How often it is looked for.
const LOOK: Duration = Duration::from_millis(50);

/// Why serving ended before it was told to.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The run cannot be joined, or its transport failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Nobody said which run.
    #[error(
        "{ATTACH_VARIABLE} is not set: it names the folder of the run to decide in. `memtransfer run \
         --policy-cmd COMMAND` starts this program with it; `memtransfer run --policy external` waits for \
         this program, and says what to set it to"
    )]
    NoRun,
    /// The folder has no run in it.
    #[error("{} is not the folder of a run, or that run is over", .0.display())]
    NotARun(PathBuf),
    /// The orchestrator's process is not there.
    #[error(
        "process {pid}, the orchestrator of this run, is not there: the run is over, or this program runs \
         where it cannot see that process (a container needs --pid=host and --ipc=host)"
    )]
    NoOrchestrator {
        /// Its process id.
        pid: u32,
    },
    /// The run ended, and nobody said that it would.
    #[error("the run in {} ended without saying so", .0.display())]
    Abandoned(PathBuf),
    /// Spans cannot be kept.
    #[error("cannot keep spans of the work: {0}")]
    Spans(std::io::Error),
    /// The policy broke its contract.
    #[error("policy {policy} answered {answers} of {requests} requests: it must answer each once")]
    Answers {
        /// The policy.
        policy: String,
        /// Requests it was given.
        requests: usize,
        /// Decisions it returned.
        answers: usize,
    },
    /// What the policy says about itself does not fit into a message.
    #[error(transparent)]
    Facts(#[from] FactsTooLong),
    /// The prompt log cannot be begun.
    #[error("{0}")]
    PromptLog(String),
    /// The orchestrator, which started this process, is gone.
    #[error(transparent)]
    Parent(#[from] io::Error),
}

/// Lets `policy` decide in the run that `MEMTRANSFER_ATTACH` names, as [`serve`] does. All that the `main` of a
/// policy needs.
///
/// # Errors
/// As [`serve`], and when the variable is not set.
pub fn serve_from_environment(policy: &mut (impl Decider + ?Sized)) -> Result<(), ServeError> {
    serve_named(policy, std::env::var_os(ATTACH_VARIABLE).as_deref())
}

fn serve_named(
    policy: &mut (impl Decider + ?Sized),
    folder: Option<&OsStr>,
) -> Result<(), ServeError> {
    let folder = folder.filter(|folder| !folder.is_empty()).ok_or(ServeError::NoRun)?;
    serve(policy, folder.as_ref())
}

/// Lets `policy` decide in the run whose folder is `attach_dir`, until the orchestrator says stop. When the
/// run's processes are started anew meanwhile, this one takes part again: [`Decider::reset`] is called for each
/// lane that begins an episode, as ever.
///
/// A process that the orchestrator started ends with it, whatever ends it; any other one finds out within a
/// second.
///
/// Messages that cannot be used are complained about and dropped.
///
/// # Errors
/// When there is no such run, it cannot be joined, its transport fails, it ends without saying stop, or the
/// policy breaks its contract.
pub fn serve(policy: &mut (impl Decider + ?Sized), attach_dir: &Path) -> Result<(), ServeError> {
    let mut attach = Attach::read(attach_dir).map_err(|error| match error {
        AttachError::File { cause, .. } if cause.kind() == io::ErrorKind::NotFound => {
            ServeError::NotARun(attach_dir.to_owned())
        }
        error => BusError::from(error).into(),
    })?;
    let run = Run::new(&attach)?;
    loop {
        let bus = Bus::join(attach.clone(), Role::Policy)?;
        match serve_generation(policy, &bus, &run) {
            Ok(End::Stopped) => return Ok(()),
            Ok(End::Over(next)) => attach = next,
            // The generation has come apart: its services are gone. What follows is the run's to say.
            Err(ServeError::Bus(error)) => attach = run.after(&attach, error)?,
            Err(error) => return Err(error),
        }
    }
}

/// The run, looked at from outside its messages.
pub(super) struct Run {
    orchestrator: ProcessWatch,
    folder: PathBuf,
}

impl Run {
    fn new(attach: &Attach) -> Result<Self, ServeError> {
        let pid = attach.orchestrator_pid;
        if is_parent(pid) {
            die_with_parent(pid)?;
        }
        let orchestrator =
            ProcessWatch::new(pid).map_err(|_| ServeError::NoOrchestrator { pid })?;
        Ok(Self { orchestrator, folder: attach.root.clone() })
    }

    /// The generation that has followed on `attach`, if one has.
    ///
    /// # Errors
    /// When the run is over.
    pub(super) fn next(&self, attach: &Attach) -> Result<Option<Attach>, ServeError> {
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

    /// The generation after `attach`, which came apart with `error`.
    fn after(&self, attach: &Attach, error: BusError) -> Result<Attach, ServeError> {
        let deadline = Instant::now() + NEXT_PATIENCE;
        loop {
            if let Some(next) = self.next(attach)? {
                return Ok(next);
            }
            if Instant::now() > deadline {
                return Err(error.into());
            }
            thread::sleep(LOOK);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Stay;

    impl crate::Policy for Stay {
        fn name(&self) -> &str {
            "stay"
        }

        fn act(&mut self, _: &[crate::Request<'_>]) -> Vec<crate::Decision> {
            Vec::new()
        }
    }

    #[test]
    fn without_a_run_it_says_what_to_do() {
        let said = serve_named(&mut Stay, None).unwrap_err().to_string();
        assert!(said.starts_with("MEMTRANSFER_ATTACH is not set"), "{said}");
        assert_eq!(serve_named(&mut Stay, Some("".as_ref())).unwrap_err().to_string(), said);
        let said = serve_named(&mut Stay, Some("/nowhere".as_ref())).unwrap_err().to_string();
        assert_eq!(said, "/nowhere is not the folder of a run, or that run is over");
    }
}
