//! Does a policy of somebody else's keep to the wire? Hard situations are played to it over the real bus, and what
//! it does wrong is said: what was expected, what happened, what to do.
//!
//! This process is everybody else meanwhile: orchestrator, simulator and memory, none of whom is what is tested.
//! What is not asked here: whether the policy's decisions are any good.

mod checks;
mod stage;

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::Result;
use serde::Serialize;
use shm_types::message::{MAX_WINDOW, Role};
use shm_types::{Attach, FrameSize, RunDir, registry};

use self::checks::CHECKS;
use self::stage::{Stage, Step, Terms, Trouble};
use supervise::Launch;

/// Episodes that a policy is asked about at once.
const LANES: u32 = 64;

/// Neither square nor of the usual size: a policy goes by what it is told.
const FRAME: FrameSize = FrameSize { width: 192, height: 128 };

/// Frames that may be resident: enough for the check that shows most of them.
const FRAMES: u32 = 128;

/// Longest that a process may take to end.
const END_PATIENCE: Duration = Duration::from_secs(10);

/// Checks without which nothing else can be said.
const FIRST: usize = 2;

/// What is tested, and how patiently.
#[derive(Debug, Clone)]
pub struct Conformance {
    /// The policy's command line.
    pub command: String,
    /// How long an answer may take.
    pub patience: Duration,
    /// How long the policy may take until it is ready.
    pub start_patience: Duration,
    /// Whether what need not be so counts as well.
    pub strict: bool,
}

/// How a check went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// As expected.
    Passed,
    /// Otherwise, and it may be so.
    Warning,
    /// Otherwise.
    Failed,
    /// Not played: an earlier one had to pass.
    Skipped,
}

/// What came of a check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// The check.
    pub name: &'static str,
    /// How it went.
    pub verdict: Verdict,
    /// What was expected.
    pub expected: &'static str,
    /// What happened.
    pub happened: String,
    /// What to do where it is not as expected.
    pub advice: &'static str,
}

impl Conformance {
    /// Plays everything, and tells `observer` of each check as soon as it is done.
    ///
    /// # Errors
    /// When the command cannot be started, the machine does not have what is needed, or `stop` is set.
    pub fn check(
        &self,
        stop: &AtomicBool,
        observer: &mut dyn FnMut(&Finding),
    ) -> Result<Vec<Finding>> {
        let launch = Launch::command(Role::Policy, &self.command)?;
        let terms = Terms {
            launch: &launch,
            patience: self.patience,
            end_patience: self.patience.min(END_PATIENCE),
            start_patience: self.start_patience,
            stop,
        };
        let mut kit = Kit::new(&terms)?;
        let mut findings: Vec<Finding> = Vec::with_capacity(CHECKS.len());
        for check in CHECKS {
            let first = findings.iter().take(FIRST).find(|f| f.verdict == Verdict::Failed);
            let (verdict, happened) = match first {
                Some(first) => (Verdict::Skipped, format!("it needs \"{}\"", first.name)),
                None => match (check.play)(&mut kit) {
                    Ok(note) => (Verdict::Passed, note),
                    Err(Trouble::Broken(error)) => return Err(error),
                    Err(Trouble::Wrong(what)) => {
                        // Whatever it is up to: the next check is not to suffer from it.
                        kit.kill_stage();
                        (Verdict::Failed, what)
                    }
                    Err(Trouble::Doubtful(what)) if self.strict => (Verdict::Failed, what),
                    Err(Trouble::Doubtful(what)) => (Verdict::Warning, what),
                },
            };
            let (name, expected, advice) = (check.name, check.expected, check.advice);
            let finding = Finding { name, verdict, expected, happened, advice };
            observer(&finding);
            findings.push(finding);
        }
        Ok(findings)
    }
}

/// A policy under test: started when a check needs it, and again where an earlier one has ended it.
struct Kit<'a> {
    terms: &'a Terms<'a>,
    stage: Option<Stage<'a>>,
    /// What the next generation is told.
    attach: Attach,
    run: RunDir,
}

impl<'a> Kit<'a> {
    fn new(terms: &'a Terms<'a>) -> Result<Self> {
        let run = RunDir::create(&registry::default_base())?;
        let attach = described(&run);
        shm_types::process::check_shared_memory(attach.shared_memory_bytes())?;
        Ok(Self { terms, stage: None, attach, run })
    }

    /// The policy, ready for questions.
    fn stage(&mut self) -> Step<&mut Stage<'a>> {
        if self.stage.as_mut().is_some_and(|stage| stage.death().is_some()) {
            self.kill_stage();
        }
        let stage = match self.stage.take() {
            Some(stage) => stage,
            None => {
                let stage = Stage::set(&self.attach, self.terms);
                self.attach.generation += 1;
                stage?
            }
        };
        Ok(self.stage.insert(stage))
    }

    /// The same, for good.
    fn take_stage(&mut self) -> Step<Stage<'a>> {
        self.stage()?;
        self.stage.take().ok_or_else(|| anyhow::anyhow!("the policy is not there").into())
    }

    /// Ends the policy as `kill -9` does, and everything that it had started.
    fn kill_stage(&mut self) {
        self.stage = None;
    }

    /// A run beside this one.
    fn another_run(&self) -> Step<(RunDir, Attach)> {
        let base = self.run.path().parent().unwrap_or(self.run.path());
        let run = RunDir::create(base).map_err(anyhow::Error::from)?;
        let attach = described(&run);
        Ok((run, attach))
    }
}

/// What a policy is told of `run`. Nobody but the policy has to be waited for: the others are here.
fn described(run: &RunDir) -> Attach {
    Attach {
        participants: vec![Role::Policy],
        lanes: LANES,
        window: MAX_WINDOW as u32,
        frame: FRAME,
        frame_capacity: FRAMES,
        ..run.attach()
    }
}
