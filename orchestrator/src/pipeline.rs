//! Runs episodes through the child processes, generation after generation.
//!
//! A *generation* is one set of processes and services. When a process dies, hangs or disagrees, the whole
//! generation ends; its services have names that no later one uses, so no stale message arrives. The next generation
//! starts after a pause and repeats the episodes that were under way; finished ones are in the log. A policy may be
//! any program: an episode that it leaves unanswered, or answers with something invalid, is repeated by itself. An episode
//! that makes a policy, an external memory or an external world crash is searched for (`queue`). An external memory that
//! fails on everything is excluded: the run goes on without it. A process that the user interrupts leaves, and the run
//! waits for it: that counts as no failure.
//!
//! Results leave through [`Observer`]; nothing here writes or prints.

mod generation;
mod queue;
mod startup;
mod supervision;
mod vital_signs;

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Result, bail};
use domain::{ExternalName, MemoryKind};
use shm_types::message::{Heartbeat, Role, ShutdownReport};
use shm_types::{Attach, clock};
use supervise::{ChildExit, Children, Launch, Launcher};

use crate::external_memory::ExternalMemory;
use crate::lanes::{AnsweredRequest, FinishedEpisode, Lanes, Stamps};
use crate::plan::PlannedEpisode;
use generation::Generation;
use queue::{Culpable, EpisodeQueue, MOST_FAILED_ALONE};

/// Failures of an external memory, one after the other and none because of an episode, after which it is excluded.
const IDLE_FAILURES: u32 = 3;

/// Time that an external memory has to build itself from demonstrations; the memory process keeps it.
const MEMORY_BUILD_TIMEOUT: Duration = Duration::from_secs(600);

/// Generations that may fail one after the other without an episode being finished in between.
const FAILURES_IN_A_ROW: u32 = 4;

/// The advice when a run gives up.
const RESUME: &str = "Finished episodes are kept; the same command resumes the run";

/// How the processes are started, and their time limits.
#[derive(Debug, Clone)]
pub struct PipelineOptions {
    /// Starts them.
    pub launcher: Arc<dyn Launcher>,
    /// The processes, without the run that they are to attach to.
    pub launches: Vec<Launch>,
    /// Whether the policy is started by someone else, at any time.
    pub external_policy: bool,
    /// For worlds that are started by someone else, at any time: the file of the demonstrations that they need.
    pub external_world: Option<PathBuf>,
    /// Folder of the processes' logs.
    pub logs: PathBuf,
    /// Time limit for a process to get ready.
    pub start_timeout: Duration,
    /// Time limit of an answer.
    pub answer_timeout: Duration,
    /// Time limit of a decision; `None` where the policy limits it itself.
    pub decision_timeout: Option<Duration>,
    /// The external memories, by index.
    pub memories: Vec<ExternalMemory>,
    /// Time limit of an answer of an external memory. The memory process keeps it, and gives up the episode.
    pub memory_timeout: Duration,
    /// Time that processes have to end once they are asked to.
    pub shutdown_timeout: Duration,
}

impl PipelineOptions {
    /// The external memory with this index.
    fn memory(&self, index: u32) -> Option<&ExternalMemory> {
        self.memories.iter().find(|memory| u32::from(memory.index) == index)
    }

    /// Whether the world is the user's own.
    fn has_external_world(&self) -> bool {
        let is_own = |launch: &Launch| launch.role == Role::Sim && launch.command.is_some();
        self.external_world.is_some() || self.launches.iter().any(is_own)
    }

    /// The process with this role and, for a world or an external memory, this index.
    fn participant(&self, role: Role, index: u32) -> Option<Participant> {
        match role {
            Role::ExternalMemory => self.memory(index).map(|memory| memory.name.into()),
            Role::Sim => u8::try_from(index).ok().map(Participant::world),
            role => Some(role.into()),
        }
    }
}

/// A process of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Participant {
    /// Its role.
    pub role: Role,
    /// The name of an external memory.
    pub memory: Option<ExternalName>,
    /// The index of a world; otherwise 0.
    pub world: u8,
}

impl From<Role> for Participant {
    fn from(role: Role) -> Self {
        Self { role, memory: None, world: 0 }
    }
}

impl From<ExternalName> for Participant {
    fn from(name: ExternalName) -> Self {
        Self { role: Role::ExternalMemory, memory: Some(name), world: 0 }
    }
}

impl fmt::Display for Participant {
    /// The role; after it the name of an external memory, or the index of a world after the first.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.memory, self.world) {
            (None, 0) => f.pad(self.role.word()),
            (None, index) => f.pad(&format!("{} {index}", self.role.word())),
            (Some(name), _) => f.pad(&format!("{} {name}", self.role.word())),
        }
    }
}

impl Participant {
    /// The world with this index.
    pub const fn world(index: u8) -> Self {
        Self { role: Role::Sim, memory: None, world: index }
    }

    /// As it is called in a sentence: `the policy process`, `the sim process 2`, `the external memory top-3`.
    fn in_words(&self) -> String {
        match (self.memory, self.world) {
            (None, 0) => format!("the {} process", self.role.word()),
            (None, index) => format!("the {} process {index}", self.role.word()),
            (Some(name), _) => format!("the external memory {name}"),
        }
    }
}

/// What becomes of an external memory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MemoryState {
    /// It takes part.
    Ready,
    /// It failed so many times since one of its episodes was finished, and is started again.
    Failed(u32),
    /// It takes part no longer, for this reason.
    Excluded(String),
}

/// The facts that a process reports when it is ready: adapter, encoder, policy, ...
pub type Facts = BTreeMap<String, String>;

/// Receives what happens, as it happens.
pub trait Observer {
    /// Processes are being started.
    fn starting(&mut self, _generation: u32) {}
    /// All are ready but those that are started by someone else. One of them is `process`, and `command` is how.
    fn awaiting(&mut self, _process: Participant, _command: &str) {}
    /// Something happened to an external memory.
    fn memory_state(&mut self, _name: ExternalName, _state: &MemoryState) -> Result<()> {
        Ok(())
    }
    /// All are ready.
    fn ready(&mut self, _facts: &BTreeMap<Participant, Facts>) -> Result<()> {
        Ok(())
    }
    /// A process has learned facts about itself since it was ready.
    fn learned(&mut self, _sender: Participant, _facts: &Facts) -> Result<()> {
        Ok(())
    }
    /// A model answered a request. Returns why the run has to stop, if it has: its budget is used up, or no answer has an action.
    fn answered(&mut self, _request: &AnsweredRequest) -> Result<Option<String>> {
        Ok(None)
    }
    /// An episode is finished, at the `attempt`th attempt.
    fn finished(&mut self, finished: &FinishedEpisode, attempt: u32) -> Result<()>;
    /// A step was taken.
    fn stepped(&mut self, _stamps: &Stamps) -> Result<()> {
        Ok(())
    }
    /// A process reported its load, as each does about once a second.
    fn heartbeat(&mut self, _sender: Participant, _heartbeat: &Heartbeat) {}
    /// The policy waits for its model's server, for the reason given, or no longer.
    fn waiting_for_server(&mut self, _reason: Option<&str>) {}
    /// The processes that answers are awaited from, one for each lane that waits. Called several times a second.
    fn pending(&mut self, _awaited: &[Participant]) {}
    /// `steps` steps were taken since the last call. Called several times a second.
    fn progress(&mut self, _steps: u64) {}
    /// A problem occurred and was dealt with.
    fn problem(&mut self, what: &str);
}

/// How a session of a run ended.
#[derive(Debug, Default)]
pub struct Ending {
    /// Whether it was asked to stop early.
    pub interrupted: bool,
    /// Why it stopped early, if a process or the observer asked for it.
    pub halted: Option<String>,
    /// Episodes that could not be finished, and why.
    pub unfinished: Vec<(PlannedEpisode, String)>,
    /// The shutdown reports of the last generation.
    pub shutdown_reports: BTreeMap<Participant, ShutdownReport>,
}

/// Why a generation ended before its work was done.
#[derive(Debug)]
enum Failure {
    /// The next generation may do better.
    Retry(String),
    /// As [`Failure::Retry`], and this is the cause. One of its episodes may be the reason.
    Of(Culpable, String),
    /// A process that the user started was interrupted, and has left.
    Left(String),
    /// No other generation would do better.
    Fatal(anyhow::Error),
}

impl Failure {
    /// That of `sender`.
    fn of(sender: Participant, options: &PipelineOptions, why: String) -> Self {
        match (sender.role, sender.memory) {
            (_, Some(name)) => Self::Of(Culpable::Memory(name), why),
            (Role::Policy, None) => Self::Of(Culpable::Policy, why),
            (Role::Sim, None) if options.has_external_world() => Self::Of(Culpable::World, why),
            (_, None) => Self::Retry(why),
        }
    }

    /// That of a child which has exited.
    fn of_exit(exit: &ChildExit, options: &PipelineOptions) -> Self {
        let sender = options.participant(exit.role, exit.index.into());
        Self::of(sender.unwrap_or(exit.role.into()), options, exit.to_string())
    }
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Fatal(error.into())
    }
}

/// Runs `episodes`, in their order as lanes become free. The external memories that are `started` already take part in
/// the first generation.
///
/// # Errors
/// When the processes cannot be started, fail repeatedly, or `observer` returns an error.
pub fn run_episodes(
    lanes: &mut Lanes<'_>,
    episodes: impl IntoIterator<Item = PlannedEpisode>,
    attach: &Attach,
    options: &PipelineOptions,
    started: Children,
    stop: &AtomicBool,
    observer: &mut dyn Observer,
) -> Result<Ending> {
    let mut run = PipelineRun {
        lanes,
        queue: EpisodeQueue::new(episodes),
        options,
        started,
        memory_failures: BTreeMap::new(),
        stop,
        observer,
    };
    let ending = run.execute_to_end(attach.clone());
    // A process that was not started here and missed the stop message learns from this that the run is over.
    if let Err(error) = Attach::withdraw(&attach.root) {
        tracing::warn!(%error, "attach.json could not be removed from the run's folder");
    }
    let (halted, shutdown_reports) = ending?;
    Ok(Ending {
        interrupted: stop.load(Ordering::Relaxed) && !run.queue.is_empty(),
        halted,
        unfinished: run.queue.into_unfinished(),
        shutdown_reports,
    })
}

/// What a generation works on and with.
struct PipelineRun<'a, 'w> {
    lanes: &'a mut Lanes<'w>,
    queue: EpisodeQueue,
    options: &'a PipelineOptions,
    /// External memories that the next generation finds started; none after the first.
    started: Children,
    memory_failures: BTreeMap<ExternalName, MemoryFailures>,
    stop: &'a AtomicBool,
    observer: &'a mut dyn Observer,
}

/// Failures of an external memory since one of its episodes was finished.
#[derive(Debug, Default)]
struct MemoryFailures {
    all: u32,
    /// The last of them that came one after the other while it worked on no episode.
    idle: u32,
}

/// Why a run stopped early, if it did, and the reports of its last generation.
type GenerationOutcome = (Option<String>, BTreeMap<Participant, ShutdownReport>);

impl PipelineRun<'_, '_> {
    fn execute_to_end(&mut self, mut attach: Attach) -> Result<GenerationOutcome> {
        let mut failures = 0;
        let (mut halted, mut reports) = (None, BTreeMap::new());
        while !self.queue.is_empty() && halted.is_none() && !self.stop.load(Ordering::Relaxed) {
            self.observer.starting(attach.generation);
            let finished_before = self.queue.count_finished();
            let outcome = self.generation(&attach);
            let under_way = self.lanes.give_up_all();
            let why = match outcome {
                Ok(outcome) => {
                    (halted, reports) = outcome;
                    self.queue.failed(under_way);
                    continue;
                }
                Err(Failure::Fatal(error)) => return Err(error),
                Err(Failure::Left(why)) => {
                    self.queue.interrupted(under_way);
                    failures = 0;
                    why
                }
                Err(Failure::Of(Culpable::Memory(name), why)) => {
                    self.memory_failed(name, under_way, &why, &mut attach)?;
                    failures = 0;
                    why
                }
                Err(Failure::Of(process, why)) if !under_way.is_empty() => {
                    // Any number of times: each time fewer episodes can be the cause.
                    self.failed_by(process, under_way, &why);
                    if self.queue.is_hopeless() {
                        bail!("{why}\n{}. {RESUME}", on_everything(process));
                    }
                    failures = 0;
                    why
                }
                Err(Failure::Retry(why) | Failure::Of(_, why)) => {
                    self.queue.failed(under_way);
                    let has_finished = self.queue.count_finished() > finished_before;
                    failures = if has_finished { 1 } else { failures + 1 };
                    if failures >= FAILURES_IN_A_ROW {
                        bail!(
                            "{why}\nThe processes failed {failures} times in a row without finishing an episode. \
                             {RESUME}"
                        );
                    }
                    why
                }
            };
            if self.queue.is_empty() {
                self.observer.problem(&why);
                break;
            }
            let width = self.queue.width().map(|width| match width {
                1 => " with one episode at a time".to_owned(),
                width => format!(" with {width} episodes at a time"),
            });
            self.observer.problem(&format!("{why}; starting again{}", width.unwrap_or_default()));
            attach.generation += 1;
            clock::sleep(Duration::from_millis(100 << failures));
        }
        Ok((halted, reports))
    }

    /// Starts a generation, runs episodes in it until none is left or it is asked to stop, and ends it.
    fn generation(&mut self, attach: &Attach) -> Result<GenerationOutcome, Failure> {
        let Some(mut generation) = Generation::start(attach, self)? else {
            return Ok(GenerationOutcome::default());
        };
        match generation.run_queue(self) {
            Ok(halted) => Ok((halted, generation.finish(self)?)),
            Err(failure) => Err(generation.root_cause(self.options, failure)),
        }
    }

    /// Searches for the episode of `under_way` because of which `process` has failed.
    fn failed_by(&mut self, process: Culpable, under_way: Vec<PlannedEpisode>, why: &str) {
        if let Some(culprit) = self.queue.failed_by(process, under_way, why) {
            let problem = format!("{culprit}: given up, {process} fails on this episode alone");
            self.observer.problem(&problem);
        }
    }

    /// Counts a failure of an external memory. One that fails on everything takes part no longer: its episodes end without a
    /// result.
    fn memory_failed(
        &mut self,
        name: ExternalName,
        under_way: Vec<PlannedEpisode>,
        why: &str,
        attach: &mut Attach,
    ) -> Result<()> {
        let memory = Culpable::Memory(name);
        let (own, others): (Vec<_>, Vec<_>) =
            under_way.into_iter().partition(|episode| memory.serves(episode));
        self.queue.interrupted(others);
        let failures = self.memory_failures.entry(name).or_default();
        failures.all += 1;
        failures.idle = if own.is_empty() { failures.idle + 1 } else { 0 };
        let MemoryFailures { all, idle } = *failures;
        self.failed_by(memory, own, why);
        let is_hopeless = idle >= IDLE_FAILURES || self.queue.is_hopeless();
        if !is_hopeless {
            return self.observer.memory_state(name, &MemoryState::Failed(all));
        }
        let index = self.options.memories.iter().find(|known| known.name == name);
        attach.external_memories.retain(|&taken| Some(taken) != index.map(|memory| memory.index));
        let why = format!(
            "the external memory {name} failed {all} times without finishing an episode, and is left out; the last \
             time: {why}"
        );
        let excluded = self.queue.exclude(MemoryKind::External(name), &why);
        self.observer.problem(&format!("{excluded} episodes end without a result: {why}"));
        self.observer.memory_state(name, &MemoryState::Excluded(why))
    }
}

/// What is said of a process that fails on everything.
fn on_everything(process: Culpable) -> String {
    format!(
        "{process} failed on {MOST_FAILED_ALONE} different episodes, each of which ran alone, and finished none in between"
    )
}
