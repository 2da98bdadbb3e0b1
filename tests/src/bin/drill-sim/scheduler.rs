//! Executes the processes of a run in this program, one at a time, in an order drawn from a seed and with a clock of its
//! own.
//!
//! Each process has a thread, of which exactly one runs: a process goes on until it is about to receive or send
//! something, or waits, and then the scheduler may pick another. Time passes only here: a little at every such point, and up
//! to the next time limit when all processes wait.

use std::any::Any;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use durable::{Fault as DiskFault, Faults, Operation};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use shm_types::clock::{Simulation, Waiter};

use crate::faults::{Damage, Fault, Preemption, Process, Trouble};

/// When the clock of a trial begins.
const START_NS: u64 = 1_000_000_000;

/// Longest time that passes between two points at which the scheduler may pick another process.
const STEP_NS: u64 = 2_000;

/// Ends the thread of a process that is killed.
struct Killed;

/// What a thread is to the scheduler, if anything.
type Place = Option<(Arc<Scheduler>, usize)>;

thread_local! {
    static PLACE: RefCell<Place> = const { RefCell::new(None) };
}

/// The calling thread's place.
fn place() -> Place {
    PLACE.with_borrow(Clone::clone)
}

/// Passes what the processes do to the scheduler that their thread belongs to.
pub(crate) struct Hooks;

impl Simulation for Hooks {
    fn now_ns(&self) -> Option<u64> {
        place().map(|(scheduler, _)| scheduler.state().now_ns)
    }

    fn pause(&self) {
        if let Some((scheduler, me)) = place() {
            scheduler.pause(me);
        }
    }

    fn is_queue_full(&self, service: &'static str) -> bool {
        place().is_some_and(|(scheduler, me)| scheduler.is_queue_full(me, service))
    }

    fn wait(&self, waiter: Option<Waiter>, time: Duration) -> bool {
        let Some((scheduler, me)) = place() else { return false };
        scheduler.wait(me, waiter, time);
        true
    }

    fn notify(&self, waiter: Waiter) {
        if let Some((scheduler, _)) = place() {
            scheduler.notify(waiter);
        }
    }
}

impl Faults for Hooks {
    fn fault(&self, operation: Operation, path: &Path) -> Option<DiskFault> {
        let (scheduler, me) = place()?;
        let fault = scheduler.disk(me, operation);
        if operation == Operation::Sync && fault.is_none() {
            let length = fs::metadata(path).map_or(0, |file| file.len());
            scheduler.state().flushed.insert(path.to_owned(), length);
        }
        fault
    }
}

/// A set of processes, a clock, and the faults that are to come.
pub(crate) struct Scheduler {
    state: Mutex<State>,
}

struct State {
    tasks: Vec<Task>,
    running: usize,
    now_ns: u64,
    draws: ChaCha8Rng,
    preemption: Preemption,
    /// Points passed so far, and operations on files.
    steps: u64,
    operations: u64,
    /// Points after which the run counts as hanging.
    most_steps: u64,
    is_hanging: bool,
    /// Faults to come, in their order.
    faults: Vec<Fault>,
    /// Faults that came, in words with the time.
    trace: Vec<String>,
    fired: BTreeMap<&'static str, u64>,
    /// Bytes of files that are on the disk.
    flushed: BTreeMap<PathBuf, u64>,
    /// Whether the power fails when the session dies.
    power_fails: bool,
    /// Hash of all decisions, to tell whether two executions were the same.
    digest: u64,
}

struct Task {
    process: Process,
    activity: Activity,
    /// It dies at the next point.
    is_doomed: bool,
    stalled_until_ns: u64,
    /// The task that waits for its end.
    ender: Option<usize>,
    wake: Arc<Condvar>,
    thread: Option<JoinHandle<()>>,
}

enum Activity {
    Ready,
    Waiting(Option<Waiter>, u64),
    Ended(ExitStatus),
}

/// How a process's function ended.
pub(crate) enum Ended<T> {
    Returned(T),
    Killed,
    /// It panicked: a bug.
    Panicked(String),
}

/// What a trial has done so far.
pub(crate) struct Account {
    pub(crate) steps: u64,
    pub(crate) operations: u64,
    pub(crate) virtual_ns: u64,
    pub(crate) digest: u64,
    pub(crate) is_hanging: bool,
    pub(crate) trace: Vec<String>,
    pub(crate) fired: BTreeMap<&'static str, u64>,
}

impl Scheduler {
    /// A scheduler that draws from `seed`.
    pub(crate) fn new(
        seed: u64,
        preemption: Preemption,
        faults: Vec<Fault>,
        most_steps: u64,
    ) -> Arc<Self> {
        let state = State {
            tasks: Vec::new(),
            running: 0,
            now_ns: START_NS,
            draws: ChaCha8Rng::seed_from_u64(seed),
            preemption,
            steps: 0,
            operations: 0,
            most_steps,
            is_hanging: false,
            faults,
            trace: Vec::new(),
            fired: BTreeMap::new(),
            flushed: BTreeMap::new(),
            power_fails: false,
            digest: 0,
        };
        Arc::new(Self { state: Mutex::new(state) })
    }

    /// Bytes of the file `path` that were on the disk when it was last flushed.
    pub(crate) fn flushed(&self, path: &Path) -> u64 {
        self.state().flushed.get(path).copied().unwrap_or(0)
    }

    /// Whether the power has failed since the last call.
    pub(crate) fn take_power_failure(&self) -> bool {
        std::mem::take(&mut self.state().power_fails)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What was done so far.
    pub(crate) fn account(&self) -> Account {
        let state = self.state();
        Account {
            steps: state.steps,
            operations: state.operations,
            virtual_ns: state.now_ns - START_NS,
            digest: state.digest,
            is_hanging: state.is_hanging,
            trace: state.trace.clone(),
            fired: state.fired.clone(),
        }
    }

    /// Executes the orchestrator on the calling thread. Returns how it ended, and the processes that outlive it.
    pub(crate) fn execute<T>(
        self: &Arc<Self>,
        orchestrator: impl FnOnce() -> T,
    ) -> (Ended<T>, usize) {
        {
            let mut state = self.state();
            state.tasks.clear();
            state.tasks.push(Task::new(Process::Orchestrator));
            state.running = 0;
        }
        PLACE.set(Some((self.clone(), 0)));
        let outcome = catch_unwind(AssertUnwindSafe(orchestrator));
        PLACE.set(None);
        let left = self.state().tasks[1..].iter().filter(|task| !task.has_ended()).count();
        (ended(outcome), left)
    }

    /// Starts a process. Called by a process.
    pub(crate) fn start(
        self: &Arc<Self>,
        process: Process,
        serve: impl FnOnce() -> ExitStatus + Send + 'static,
    ) -> io::Result<usize> {
        let me = {
            let mut state = self.state();
            state.tasks.push(Task::new(process));
            state.tasks.len() - 1
        };
        let scheduler = self.clone();
        let thread = thread::Builder::new().spawn(move || scheduler.serve(me, serve))?;
        self.state().tasks[me].thread = Some(thread);
        Ok(me)
    }

    fn serve(self: Arc<Self>, me: usize, serve: impl FnOnce() -> ExitStatus) {
        let state = self.await_turn(self.state(), me);
        let is_doomed = state.tasks[me].is_doomed;
        drop(state);
        PLACE.set(Some((self.clone(), me)));
        let outcome =
            if is_doomed { Ended::Killed } else { ended(catch_unwind(AssertUnwindSafe(serve))) };
        PLACE.set(None);
        let status = match outcome {
            Ended::Returned(status) => status,
            Ended::Killed => ExitStatus::from_raw(9),
            Ended::Panicked(why) => {
                self.state().trace.push(format!("PANIC: {why}"));
                ExitStatus::from_raw(6)
            }
        };
        let mut state = self.state();
        state.tasks[me].activity = Activity::Ended(status);
        let next = match state.tasks[me].ender.take() {
            Some(ender) => ender,
            None => state.choose(),
        };
        state.hand_over(next);
    }

    /// Waits until it is the turn of `me`.
    fn await_turn<'a>(&self, mut state: MutexGuard<'a, State>, me: usize) -> MutexGuard<'a, State> {
        let wake = state.tasks[me].wake.clone();
        while state.running != me {
            state = wake.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state
    }

    /// Lets the scheduler pick a process; returns when it is the turn of `me` again.
    fn yield_turn(&self, mut state: MutexGuard<'_, State>, me: usize) {
        let next = state.choose();
        if next != me {
            state.hand_over(next);
            state = self.await_turn(state, me);
        }
        if state.tasks[me].is_doomed {
            drop(state);
            resume_unwind(Box::new(Killed));
        }
    }

    fn pause(&self, me: usize) {
        // A process that dies is not interrupted.
        if thread::panicking() {
            return;
        }
        let mut state = self.state();
        state.pass(STEP_NS);
        state.fire();
        let task = &state.tasks[me];
        let must = task.is_doomed || task.stalled_until_ns > state.now_ns;
        let Preemption { of_1024, until } = state.preemption;
        if must || (state.draw(1024) < of_1024.into() && state.steps <= until) {
            self.yield_turn(state, me);
        }
    }

    fn wait(&self, me: usize, waiter: Option<Waiter>, time: Duration) {
        if thread::panicking() {
            return;
        }
        let mut state = self.state();
        state.pass(STEP_NS);
        let ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let until = state.now_ns.saturating_add(ns);
        state.tasks[me].activity = Activity::Waiting(waiter, until);
        state.fire();
        self.yield_turn(state, me);
    }

    fn notify(&self, notified: Waiter) {
        for task in &mut self.state().tasks {
            if matches!(task.activity, Activity::Waiting(Some(waiter), _) if waiter == notified) {
                task.activity = Activity::Ready;
            }
        }
    }

    fn is_queue_full(&self, me: usize, service: &str) -> bool {
        if thread::panicking() {
            return false;
        }
        let mut state = self.state();
        let steps = state.steps;
        let due = |fault: &Fault| fault.at <= steps && fault.trouble == Trouble::FullQueue;
        let Some(at) = state.faults.iter().position(due) else { return false };
        state.faults.remove(at);
        let process = state.tasks[me].process;
        state.note(Trouble::FullQueue.class(), format!("{service}, sent by {process:?}"));
        true
    }

    fn disk(&self, me: usize, operation: Operation) -> Option<DiskFault> {
        if thread::panicking() {
            return None;
        }
        let mut state = self.state();
        state.operations += 1;
        let due = |fault: &Fault| match fault.trouble {
            Trouble::Disk(damage) => fault.at <= state.operations && damage.concerns(operation),
            _ => false,
        };
        let at = state.faults.iter().position(due)?;
        let Trouble::Disk(damage) = state.faults.remove(at).trouble else { return None };
        let process = state.tasks[me].process;
        state.note(damage.class(), format!("{operation:?} by {process:?}"));
        let draw = state.draw(1 << 16) as usize;
        let written = match operation {
            Operation::Write(length) if length > 0 => draw % length,
            _ => 0,
        };
        let fails =
            |error: Box<dyn FnOnce() -> io::Error>| Some(DiskFault::Fails { written, error });
        match damage {
            Damage::ShortReads => Some(DiskFault::ShortReads),
            Damage::Full => fails(Box::new(|| io::ErrorKind::StorageFull.into())),
            Damage::Broken => {
                fails(Box::new(|| io::Error::other("Input/output error (os error 5)")))
            }
            Damage::TornByDeath => fails(Box::new(|| resume_unwind(Box::new(Killed)))),
        }
    }

    /// Whether a process runs.
    pub(crate) fn is_alive(&self, task: usize) -> bool {
        !self.state().tasks[task].has_ended()
    }

    /// Kills a process and waits for its end. Called by the orchestrator, which may be dying itself.
    pub(crate) fn end(&self, task: usize) -> io::Result<ExitStatus> {
        let mut state = self.state();
        if !state.tasks[task].has_ended() {
            let me = state.running;
            let dying = &mut state.tasks[task];
            (dying.is_doomed, dying.ender, dying.activity) = (true, Some(me), Activity::Ready);
            state.hand_over(task);
            state = self.await_turn(state, me);
        }
        let thread = state.tasks[task].thread.take();
        let status = match state.tasks[task].activity {
            Activity::Ended(status) => status,
            _ => return Err(io::Error::other("the process does not end")),
        };
        drop(state);
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            return Err(io::Error::other("the thread of a process panicked"));
        }
        Ok(status)
    }
}

impl Task {
    fn new(process: Process) -> Self {
        Self {
            process,
            activity: Activity::Ready,
            is_doomed: false,
            stalled_until_ns: 0,
            ender: None,
            wake: Arc::default(),
            thread: None,
        }
    }

    fn has_ended(&self) -> bool {
        matches!(self.activity, Activity::Ended(_))
    }
}

impl State {
    /// A number below `limit`.
    fn draw(&mut self, limit: u64) -> u64 {
        self.draws.next_u64() % limit
    }

    fn pass(&mut self, most_ns: u64) {
        self.steps += 1;
        self.now_ns += self.draw(most_ns);
        if self.steps > self.most_steps && !self.is_hanging {
            self.is_hanging = true;
            self.tasks[0].is_doomed = true;
            self.tasks[0].activity = Activity::Ready;
        }
    }

    fn note(&mut self, class: &'static str, what: String) {
        *self.fired.entry(class).or_default() += 1;
        let (steps, ms) = (self.steps, (self.now_ns - START_NS) / 1_000_000);
        self.trace.push(format!("step {steps}, {ms} ms: {class}: {what}"));
    }

    /// Lets the faults happen that are due.
    fn fire(&mut self) {
        while let Some(at) = self
            .faults
            .iter()
            .position(|fault| fault.at <= self.steps && !fault.trouble.is_of_an_operation())
        {
            let trouble = self.faults.remove(at).trouble;
            match trouble {
                Trouble::Jump(ms) => self.now_ns += ms * 1_000_000,
                Trouble::Stall(process, ms) => {
                    let until = self.now_ns + ms * 1_000_000;
                    if let Some(task) = self.living(process) {
                        task.stalled_until_ns = until;
                    }
                }
                Trouble::Death(process) => {
                    if let Some(task) = self.living(process) {
                        task.is_doomed = true;
                        task.activity = Activity::Ready;
                        task.stalled_until_ns = 0;
                    }
                }
                Trouble::PowerLoss => {
                    self.power_fails = true;
                    self.tasks[0].is_doomed = true;
                    self.tasks[0].activity = Activity::Ready;
                    self.tasks[0].stalled_until_ns = 0;
                }
                Trouble::Disk(_) | Trouble::FullQueue => {}
            }
            self.note(trouble.class(), format!("{trouble:?}"));
        }
    }

    /// The newest process of this kind, if it has not ended.
    fn living(&mut self, process: Process) -> Option<&mut Task> {
        self.tasks.iter_mut().rev().find(|task| task.process == process && !task.has_ended())
    }

    fn hand_over(&mut self, next: usize) {
        self.digest = (self.digest.rotate_left(5) ^ next as u64 ^ self.steps)
            .wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.running = next;
        self.tasks[next].wake.notify_one();
    }

    /// The process to go on: any that can. If all wait, time passes until one can.
    fn choose(&mut self) -> usize {
        loop {
            let now = self.now_ns;
            let mut able = Vec::new();
            let mut next_ns = u64::MAX;
            for (number, task) in self.tasks.iter_mut().enumerate() {
                if matches!(task.activity, Activity::Waiting(_, until) if until <= now) {
                    task.activity = Activity::Ready;
                }
                match task.activity {
                    Activity::Ready if task.stalled_until_ns <= now => able.push(number),
                    Activity::Ready => next_ns = next_ns.min(task.stalled_until_ns),
                    Activity::Waiting(_, until) => next_ns = next_ns.min(until),
                    Activity::Ended(_) => {}
                }
            }
            match able[..] {
                [] => self.now_ns = next_ns,
                [only] => return only,
                _ => return able[self.draw(able.len() as u64) as usize],
            }
        }
    }
}

fn ended<T>(outcome: Result<T, Box<dyn Any + Send>>) -> Ended<T> {
    match outcome {
        Ok(value) => Ended::Returned(value),
        Err(payload) if payload.is::<Killed>() => Ended::Killed,
        Err(payload) => Ended::Panicked(match payload.downcast::<String>() {
            Ok(why) => *why,
            Err(payload) => {
                payload.downcast::<&str>().map_or_else(|_| "?".to_owned(), |why| (*why).to_owned())
            }
        }),
    }
}
