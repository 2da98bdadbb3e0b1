//! Checks whether an external policy, memory or world follows the protocol of the wire, in difficult situations over the real
//! bus.
//!
//! This process plays the other roles ([`neighbours`]). The quality of decisions, of what a memory supplies and of a world's
//! tasks is not checked.

mod checks;
mod memory;
pub mod messages;
pub mod neighbours;
mod policy;
mod subject;
mod world;

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::Result;
use serde::Serialize;
use shm_types::message::MAX_WINDOW;
use shm_types::{Attach, FrameSize, RunDir, registry};
use supervise::last_lines;

use self::checks::Check;
use self::memory::MemoryRole;
use self::policy::PolicyRole;
use self::subject::{CheckResult, Subject, Terms, TestedRole, Trouble};
use self::world::WorldRole;

/// Lanes of the run.
const LANES: u32 = 64;

/// Neither square nor the default: a process has to read the size from `attach.json`.
const FRAME: FrameSize = FrameSize { width: 192, height: 128 };

/// Frames that may be resident: enough for the check with most views.
const FRAMES: u32 = 128;

/// Longest time for a process to end.
const MAX_END_TIMEOUT: Duration = Duration::from_secs(10);

/// What is checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CheckedRole {
    /// A policy.
    Policy,
    /// An external memory.
    Memory,
    /// A world.
    World,
}

/// A policy, a memory or a world to check.
#[derive(Debug, Clone)]
pub struct Conformance {
    /// Which of them.
    pub role: CheckedRole,
    /// Its command line.
    pub command: String,
    /// How long an answer may take.
    pub answer_timeout: Duration,
    /// How long it may take to get ready, a memory to build itself from a bank, and a world to write its case book.
    pub start_timeout: Duration,
    /// Whether warnings count as failures.
    pub strict: bool,
}

/// The outcome of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CheckVerdict {
    /// The process does what is expected.
    Passed,
    /// The process does something that may be intended.
    Warning,
    /// The process violates the protocol.
    Failed,
    /// The check did not run, because an earlier one failed, or does not apply.
    Skipped,
}

/// The result of a check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CheckFinding {
    /// The check.
    pub name: &'static str,
    /// Its outcome.
    pub verdict: CheckVerdict,
    /// What is expected.
    pub expected: &'static str,
    /// What happened.
    pub happened: String,
    /// What to do if the check fails.
    pub advice: &'static str,
    /// If it fails: the last lines that the process printed meanwhile, such as the traceback of an exception.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub printed: String,
}

impl Conformance {
    /// Runs all checks, and passes each result to `observer` at once.
    ///
    /// # Errors
    /// When the command cannot be started, the run cannot be set up, or `stop` is set.
    pub fn check(
        &self,
        stop: &AtomicBool,
        observer: &mut dyn FnMut(&CheckFinding),
    ) -> Result<Vec<CheckFinding>> {
        match self.role {
            CheckedRole::Policy => {
                use policy::checks::{CHECKS, REQUIRED_CHECKS};
                self.play::<PolicyRole>(CHECKS, REQUIRED_CHECKS, stop, observer)
            }
            CheckedRole::Memory => {
                use memory::checks::{CHECKS, REQUIRED_CHECKS};
                self.play::<MemoryRole>(CHECKS, REQUIRED_CHECKS, stop, observer)
            }
            CheckedRole::World => {
                use world::checks::{CHECKS, REQUIRED_CHECKS};
                self.play::<WorldRole>(CHECKS, REQUIRED_CHECKS, stop, observer)
            }
        }
    }

    /// As [`Self::check`]. If one of the first `required` checks fails, all others are skipped.
    fn play<R: TestedRole>(
        &self,
        checks: &[Check<R>],
        required: usize,
        stop: &AtomicBool,
        observer: &mut dyn FnMut(&CheckFinding),
    ) -> Result<Vec<CheckFinding>> {
        let run = RunDir::create(&registry::default_base())?;
        let terms = Terms {
            launch: &R::launch(&self.command, run.path())?,
            command: &self.command,
            answer_timeout: self.answer_timeout,
            end_timeout: self.answer_timeout.min(MAX_END_TIMEOUT),
            start_timeout: self.start_timeout,
            stop,
        };
        let mut kit: Kit<'_, R> = Kit::new(&terms, run)?;
        let mut findings: Vec<CheckFinding> = Vec::with_capacity(checks.len());
        for check in checks {
            let mut first = findings.iter().take(required);
            let failed = first.find(|f| f.verdict == CheckVerdict::Failed);
            let printed_before = kit.printed_bytes();
            let (verdict, happened) = match failed {
                Some(failed) => (CheckVerdict::Skipped, format!("it needs \"{}\"", failed.name)),
                None => match (check.run)(&mut kit) {
                    Ok(remark) => (CheckVerdict::Passed, remark),
                    Err(Trouble::NotApplicable(why)) => (CheckVerdict::Skipped, why),
                    Err(Trouble::Broken(error)) => return Err(error),
                    Err(Trouble::Wrong(what)) => {
                        // The next check starts a new process.
                        kit.kill_subject();
                        (CheckVerdict::Failed, what)
                    }
                    Err(Trouble::Doubtful(what)) if self.strict => (CheckVerdict::Failed, what),
                    Err(Trouble::Doubtful(what)) => (CheckVerdict::Warning, what),
                },
            };
            let (name, expected, advice) = (check.name, check.expected, check.advice);
            let printed = match verdict {
                CheckVerdict::Failed => kit.printed_since(printed_before),
                CheckVerdict::Passed | CheckVerdict::Warning | CheckVerdict::Skipped => {
                    String::new()
                }
            };
            let finding = CheckFinding { name, verdict, expected, happened, advice, printed };
            observer(&finding);
            findings.push(finding);
        }
        Ok(findings)
    }
}

/// The process under test: started when a check needs it, and again after a check that has ended it.
struct Kit<'a, R: TestedRole> {
    terms: &'a Terms<'a>,
    subject: Option<Subject<'a, R>>,
    /// The settings of the next generation.
    attach: Attach,
    run: RunDir,
}

impl<'a, R: TestedRole> Kit<'a, R> {
    fn new(terms: &'a Terms<'a>, run: RunDir) -> Result<Self> {
        let attach = settings::<R>(&run);
        shm_types::process::check_shared_memory(attach.shared_memory_bytes())?;
        Ok(Self { terms, subject: None, attach, run })
    }

    /// The process, ready for requests.
    fn subject(&mut self) -> CheckResult<&mut Subject<'a, R>> {
        if self.subject.as_mut().is_some_and(|subject| subject.exited().is_some()) {
            self.kill_subject();
        }
        let subject = match self.subject.take() {
            Some(subject) => subject,
            None => {
                let subject = Subject::start(&self.attach, self.terms);
                self.attach.generation += 1;
                subject?
            }
        };
        Ok(self.subject.insert(subject))
    }

    /// As [`Self::subject`], for a check that ends the process.
    fn take_subject(&mut self) -> CheckResult<Subject<'a, R>> {
        self.subject()?;
        self.subject.take().ok_or_else(|| anyhow::anyhow!("the process was not started").into())
    }

    /// The file that the process prints to, once it has been started.
    fn log(&self) -> Option<PathBuf> {
        let mut logs = fs::read_dir(self.run.path().join("logs")).ok()?;
        Some(logs.next()?.ok()?.path())
    }

    /// How many bytes the process has printed.
    fn printed_bytes(&self) -> u64 {
        self.log().and_then(|log| fs::metadata(log).ok()).map_or(0, |facts| facts.len())
    }

    /// The last lines that the process has printed after its first `bytes` bytes.
    fn printed_since(&self, bytes: u64) -> String {
        self.log().and_then(|log| last_lines(&log, bytes).ok()).unwrap_or_default()
    }

    /// Kills the process and all processes that it started.
    fn kill_subject(&mut self) {
        self.subject = None;
    }

    /// Creates a second run, for a check that needs one of its own.
    fn another_run(&self) -> CheckResult<(RunDir, Attach)> {
        let base = self.run.path().parent().unwrap_or(self.run.path());
        let run = RunDir::create(base).map_err(anyhow::Error::from)?;
        let attach = settings::<R>(&run);
        Ok((run, attach))
    }
}

/// The settings of `run`. Only the process under test takes part: its neighbours are in this process.
fn settings<R: TestedRole>(run: &RunDir) -> Attach {
    R::settings(Attach {
        participants: Vec::new(),
        lanes: LANES,
        window: MAX_WINDOW as u32,
        frame: FRAME,
        frame_capacity: FRAMES,
        ..run.attach()
    })
}
