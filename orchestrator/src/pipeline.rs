//! Walking episodes through the four processes: generations, their messages, and what is done when one
//! fails.
//!
//! A *generation* is one set of processes and services. When any of them dies, hangs or disagrees, the
//! whole generation goes: its services have names that no later one shares, so nothing stale can arrive.
//! The next generation starts after a pause, and the episodes that were under way are walked again from
//! their beginning; finished ones are in the log already. A policy may be anybody's program: an episode that it
//! leaves unanswered, or answers with what cannot be used, is walked again by itself, and one that it crashes on
//! is looked for (`work.rs`).
//!
//! Results leave through [`Observer`]; nothing here writes or prints.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::{Result, bail};
use shm_types::Attach;
use shm_types::message::{Heartbeat, Role, ShutdownReport};

use crate::lanes::{Lanes, Owed, Spent, Stamps, Walked};
use crate::plan::Episode;
use supervise::Launch;

mod generation;
mod work;

use generation::Generation;
use work::{CULPRITS_IN_A_ROW, Work};

/// Generations that may fail one after the other without an episode being finished in between.
const FAILURES_IN_A_ROW: u32 = 4;

/// How the processes are started and how long they may take.
#[derive(Debug, Clone)]
pub struct Crewing {
    /// The processes; none is told yet which run to attach to.
    pub launches: Vec<Launch>,
    /// Whether somebody else starts the policy, and may take any time for it.
    pub guest: bool,
    /// Folder of the processes' logs.
    pub logs: PathBuf,
    /// How long a process may take until it is ready.
    pub start_deadline: Duration,
    /// How long a process may owe an answer.
    pub answer_deadline: Duration,
    /// How long the policy may owe a decision; as long as it likes where it sees to that itself.
    pub decision_deadline: Option<Duration>,
}

/// What a process told about itself: adapter, encoder, policy, ...
pub type Facts = BTreeMap<String, String>;

/// Told what happens, as it happens.
pub trait Observer {
    /// Processes are being started.
    fn starting(&mut self, generation: u32);
    /// All are ready but the policy, which somebody else starts: it is to attach to the run in `folder`.
    fn awaiting(&mut self, folder: &Path);
    /// All are ready; what each said about itself.
    fn ready(&mut self, facts: &BTreeMap<Role, Facts>) -> Result<()>;
    /// A model answered. Says why there is no point in going on, if there is none: the run has spent all that it
    /// may. An error ends the run.
    fn spent(&mut self, spent: &Spent) -> Result<Option<String>>;
    /// An episode is finished, at the `attempt`th time of walking it. An error ends the run.
    fn finished(&mut self, walked: &Walked, attempt: u32) -> Result<()>;
    /// A step was taken. An error ends the run.
    fn stepped(&mut self, _stamps: &Stamps) -> Result<()> {
        Ok(())
    }
    /// A process told what it is at, as it does about once a second.
    fn heartbeat(&mut self, _role: Role, _heartbeat: &Heartbeat) {}
    /// The answers that are owed now. Called some times a second.
    fn waiting(&mut self, _owed: &[Owed]) {}
    /// `steps` steps were taken since the last call. Called at least a few times a second.
    fn progress(&mut self, steps: u64);
    /// Something went wrong and was dealt with.
    fn trouble(&mut self, what: &str);
}

/// How walking ended.
#[derive(Debug)]
pub struct Ending {
    /// Whether it was asked to stop early.
    pub interrupted: bool,
    /// Why there was no point in going on, if somebody said so: a process, or the observer.
    pub halted: Option<String>,
    /// Episodes that could not be finished, and why.
    pub unfinished: Vec<(Episode, String)>,
    /// What the last generation did with frames, by process.
    pub shutdown_reports: BTreeMap<Role, ShutdownReport>,
}

/// Why a generation ended before its work was done.
enum Failure {
    /// The next generation may do better.
    Again(String),
    /// The same, and the policy is to blame.
    Policy(String),
    /// It would not.
    Final(anyhow::Error),
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Final(error.into())
    }
}

/// Walks `episodes`, in their order as lanes become free, and tells `observer`.
///
/// # Errors
/// When the processes cannot be started, fail again and again, or the observer does not want to go on.
pub fn walk(
    lanes: &mut Lanes<'_>,
    episodes: impl IntoIterator<Item = Episode>,
    attach: &Attach,
    crewing: &Crewing,
    stop: &AtomicBool,
    observer: &mut dyn Observer,
) -> Result<Ending> {
    let ending = walk_generations(lanes, episodes, attach, crewing, stop, observer);
    // Whoever attached without being started here, and was not told, sees by this that the run is over.
    if let Err(error) = Attach::withdraw(&attach.root) {
        tracing::warn!(%error, "the run's folder still looks like that of a run");
    }
    ending
}

fn walk_generations(
    lanes: &mut Lanes<'_>,
    episodes: impl IntoIterator<Item = Episode>,
    attach: &Attach,
    crewing: &Crewing,
    stop: &AtomicBool,
    observer: &mut dyn Observer,
) -> Result<Ending> {
    let mut work = Work::new(episodes);
    let mut halted = None;
    let mut shutdown_reports = BTreeMap::new();
    let mut failures = 0;
    let mut attach = attach.clone();
    while !work.is_done() && halted.is_none() && !stop.load(Ordering::Relaxed) {
        observer.starting(attach.generation);
        let finished_before = work.count_finished();
        let outcome = Generation::start(&attach, crewing, stop, observer).and_then(|generation| {
            let Some(mut generation) = generation else { return Ok(BTreeMap::new()) };
            match generation.work_off(lanes, &mut work, crewing, stop, observer) {
                Ok(why) => {
                    halted = why;
                    Ok(generation.finish())
                }
                Err(failure) => Err(generation.explain(failure)),
            }
        });
        let under_way = lanes.abandon();
        let why = match outcome {
            Ok(said) => {
                shutdown_reports = said;
                // Whoever asked to stop knows what is left.
                work.failed(under_way);
                continue;
            }
            Err(Failure::Final(error)) => return Err(error),
            Err(Failure::Policy(why)) if !under_way.is_empty() => {
                // However often: each time fewer episodes can be to blame.
                if let Some(culprit) = work.failed_by_policy(under_way, &why) {
                    observer.trouble(&format!("{culprit}: given up, the policy fails on it alone"));
                }
                if work.culprits_in_a_row() >= CULPRITS_IN_A_ROW {
                    bail!(
                        "{why}\nthe policy has failed on {CULPRITS_IN_A_ROW} different episodes, each \
                         walked alone, and on others together: giving up. Finished episodes are kept; \
                         the same command goes on from here"
                    );
                }
                failures = 0;
                why
            }
            Err(Failure::Again(why) | Failure::Policy(why)) => {
                work.failed(under_way);
                failures = if work.count_finished() > finished_before { 1 } else { failures + 1 };
                if failures >= FAILURES_IN_A_ROW {
                    bail!(
                        "{why}\nthis was failure {failures} in a row without an episode finished: \
                         giving up. Finished episodes are kept; the same command goes on from here"
                    );
                }
                why
            }
        };
        if work.is_done() {
            observer.trouble(&why);
            break;
        }
        let how = work.width().map(|width| format!(" with {width} at a time"));
        observer.trouble(&format!("{why}; starting again{}", how.unwrap_or_default()));
        attach.generation += 1;
        thread::sleep(Duration::from_millis(100 << failures));
    }
    Ok(Ending {
        interrupted: stop.load(Ordering::Relaxed) && !work.is_done(),
        halted,
        unfinished: work.into_unfinished(),
        shutdown_reports,
    })
}
