//! Many questions in flight together: what one learns about the server, all of them heed.
//!
//! - the bound on requests in flight adapts to what the server takes ([`limit`]);
//! - a `Retry-After` holds back every request, and one that waits for its next try holds no connection;
//! - a request that hangs keeps its own connection until the deadline of its attempt, and nothing else;
//! - a server that is gone ends all of it at once, with a reason ([`breaker`]).
//!
//! What is decided is in [`queue`], without threads; what is here are the workers that do it.

mod breaker;
mod limit;
mod queue;

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Instant;

use shm_types::process::monotonic_ns;

use super::cache::{Key, ResponseCache};
use super::client::{Client, jitter};
use super::error::{ChatError, Failure, Passing};
use super::message::Question;
use super::reply::Reply;
use queue::{Entry, Queue, Task, Verdict, Words};

/// How a pool asks, beside what its client says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PoolSettings {
    /// Most requests in flight, at least 1. There are fewer while the server says that it is too many.
    pub max_connections: u32,
    /// The server is gone when so many requests in a row have failed every time; or one, when there never was
    /// a connection.
    pub most_given_up: u32,
}

impl Default for PoolSettings {
    fn default() -> Self {
        Self { max_connections: 32, most_given_up: 3 }
    }
}

/// A question to ask.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Job {
    /// It.
    pub question: Question,
    /// Which repetition of the same question this is, from 0: each has a reply of its own.
    pub repeat: u32,
}

/// A reply, and how it was had.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Asked {
    /// It.
    pub reply: Reply,
    /// Times that the question was sent; 0 when the reply was known.
    pub attempts: u32,
    /// Whether the reply was known: what it cost was counted when it was new.
    pub from_cache: bool,
    /// When the attempt began that got the reply, in nanoseconds of CLOCK_MONOTONIC.
    pub sent_ns: u64,
    /// When the reply was there, on the same scale.
    pub answered_ns: u64,
}

/// Why a question has no reply.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PoolError {
    /// This request failed, for good. Others may do better.
    #[error(transparent)]
    Failed(ChatError),
    /// The server is gone, or refuses everybody: asking on makes no sense. What happened, and what to do.
    #[error("{0}")]
    Gone(String),
}

/// Asks one model of one endpoint many questions together.
///
/// Dropping it waits for nobody: questions that were not sent yet are answered with [`PoolError::Gone`], those
/// in flight when their attempt ends, by threads that outlive the pool until then.
pub struct Pool {
    shared: Arc<Shared>,
}

struct Shared {
    client: Client,
    cache: Option<ResponseCache>,
    /// A reply could not be stored, and that was said.
    unwritable: AtomicBool,
    /// One more than there can be connections, so that somebody is left who looks after the rest.
    most_workers: usize,
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    queue: Queue<Load>,
    workers: usize,
    /// Those that wait for something to do.
    idle: usize,
    closed: bool,
}

struct Load {
    job: Job,
    /// Where its reply is kept.
    key: Option<Key>,
    done: Box<dyn FnOnce(Result<Asked, PoolError>) + Send>,
}

impl fmt::Debug for Pool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pool").field("client", &self.shared.client).finish_non_exhaustive()
    }
}

impl Pool {
    /// A pool without connections yet, which looks for replies in `cache` before it asks and keeps them there.
    pub fn new(client: Client, settings: PoolSettings, cache: Option<ResponseCache>) -> Self {
        let PoolSettings { max_connections, most_given_up } = settings;
        let max_retries = client.settings().max_retries;
        let queue = Queue::new(max_connections, most_given_up, max_retries);
        let state = Mutex::new(State { queue, workers: 0, idle: 0, closed: false });
        let most_workers = max_connections.max(1) as usize + 1;
        let shared = Shared {
            client,
            cache,
            unwritable: AtomicBool::new(false),
            most_workers,
            state,
            changed: Condvar::new(),
        };
        Self { shared: Arc::new(shared) }
    }

    /// Asks a question. Never blocks; `done` is called exactly once, on another thread, where it should not
    /// stay long. Replies come in the order in which the server gives them.
    ///
    /// Only when the system has no thread left for the pool is `done` called on this one.
    pub fn submit(&self, job: Job, done: impl FnOnce(Result<Asked, PoolError>) + Send + 'static) {
        let mut state = self.shared.lock();
        let load = Load { job, key: None, done: Box::new(done) };
        state.queue.submit(load, self.shared.cache.is_some());
        self.shared.staff(&mut state);
        if state.workers == 0 {
            state
                .queue
                .stop("the system gives no thread to ask with; close other programs".to_owned());
            let refused = state.queue.take(Instant::now());
            drop(state);
            if let Some(task) = refused {
                self.shared.do_task(task);
            }
        }
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        let mut state = self.shared.lock();
        state.closed = true;
        state
            .queue
            .stop("the question was not sent any more, because the asking was ended".to_owned());
        drop(state);
        self.shared.changed.notify_all();
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing that runs under the lock leaves the state half changed.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sees to it that somebody who is free looks after the requests that wait.
    fn staff(self: &Arc<Self>, state: &mut State) {
        if state.queue.is_empty() {
            return;
        }
        if state.idle > 0 {
            self.changed.notify_one();
        } else if state.workers < self.most_workers {
            let shared = Arc::clone(self);
            let worker = thread::Builder::new().name("chat".to_owned());
            match worker.spawn(move || shared.work()) {
                Ok(_) => state.workers += 1,
                Err(error) => tracing::warn!("cannot start a thread to ask with: {error}"),
            }
        }
    }

    fn work(self: &Arc<Self>) {
        let _leaving = Leaving(self);
        while let Some(task) = self.next_task() {
            self.do_task(task);
        }
    }

    /// Waits for something to do; `None` when there will be nothing.
    fn next_task(self: &Arc<Self>) -> Option<Task<Load>> {
        let mut state = self.lock();
        loop {
            let now = Instant::now();
            if let Some(task) = state.queue.take(now) {
                self.staff(&mut state);
                return Some(task);
            }
            if state.closed {
                return None;
            }
            let pause = state.queue.wakes_at().map(|then| then.saturating_duration_since(now));
            state.idle += 1;
            state = match pause {
                None => self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
                Some(pause) => {
                    let waited = self.changed.wait_timeout(state, pause);
                    waited.unwrap_or_else(PoisonError::into_inner).0
                }
            };
            state.idle -= 1;
        }
    }

    fn do_task(&self, task: Task<Load>) {
        match task {
            Task::LookUp(entry) => self.look_up(entry),
            Task::Send(entry) => self.send(entry),
            Task::Refuse(entry, why) => (entry.load.done)(Err(PoolError::Gone(why))),
        }
    }

    fn look_up(&self, mut entry: Entry<Load>) {
        let sent_ns = monotonic_ns();
        let Job { question, repeat } = &entry.load.job;
        let model = &self.client.settings().model;
        entry.load.key = self.cache.as_ref().and_then(|_| Key::of(model, question, *repeat));
        let known = self.cache.as_ref().zip(entry.load.key.as_ref());
        match known.and_then(|(cache, key)| cache.get(key)) {
            None => self.lock().queue.missed(entry),
            Some(reply) => {
                let answered_ns = monotonic_ns();
                let asked = Asked { reply, attempts: 0, from_cache: true, sent_ns, answered_ns };
                (entry.load.done)(Ok(asked));
            }
        }
    }

    fn send(&self, entry: Entry<Load>) {
        let (sent, sent_ns) = (Instant::now(), monotonic_ns());
        let reply = match self.client.attempt(&entry.load.job.question) {
            Ok(reply) => reply,
            Err(failure) => return self.failed(entry, failure, sent),
        };
        let answered_ns = monotonic_ns();
        self.lock().queue.answered();
        // What follows may take its time, and the connection is free.
        self.changed.notify_one();
        self.keep(entry.load.key.as_ref(), &reply);
        let attempts = entry.attempts;
        let asked = Asked { reply, attempts, from_cache: false, sent_ns, answered_ns };
        (entry.load.done)(Ok(asked));
    }

    /// Keeps a reply. That it cannot be kept costs nothing but asking again some day, so it is said once.
    fn keep(&self, key: Option<&Key>, reply: &Reply) {
        let Some((cache, key)) = self.cache.as_ref().zip(key) else { return };
        let Err(error) = cache.put(key, &self.client.settings().model, reply) else { return };
        if !self.unwritable.swap(true, Ordering::Relaxed) {
            let folder = cache.folder().display();
            tracing::warn!("replies cannot be kept in {folder}: {error}; they count all the same");
        }
    }

    fn failed(&self, entry: Entry<Load>, failure: Failure, sent: Instant) {
        let attempt = entry.attempts;
        let reason = match &failure {
            Failure::Passing(reason, _) => reason.to_string(),
            Failure::Final(error) => error.to_string(),
        };
        let times = (sent, Instant::now());
        let verdict = self.lock().queue.failed(entry, failure, self, times, jitter(attempt));
        // Whoever waits for a moment may have to wait for another one now.
        self.changed.notify_all();
        match verdict {
            Verdict::Again(pause) => {
                let seconds = pause.as_secs_f64();
                tracing::warn!("attempt {attempt}: {reason}; again in {seconds:.1} s");
            }
            Verdict::Failed(entry, error) => (entry.load.done)(Err(PoolError::Failed(error))),
            Verdict::Gone(entry, why) => (entry.load.done)(Err(PoolError::Gone(why))),
        }
    }
}

impl Words for Shared {
    fn gave_up(&self, attempts: u32, last: Passing) -> ChatError {
        self.client.gave_up(attempts, last)
    }

    fn gone(&self, failures: u32, last: &ChatError) -> String {
        format!(
            "the server is gone (attempts in a row without an answer: {failures}): {last}; see what `memtransfer \
             doctor --policy openai` says, and start the same again when the server is back"
        )
    }

    fn refuses(&self, error: &ChatError) -> String {
        format!("the server refuses every request: {error}")
    }
}

/// Counts a worker out, however it ends.
struct Leaving<'a>(&'a Arc<Shared>);

impl Drop for Leaving<'_> {
    fn drop(&mut self) {
        let Self(shared) = self;
        shared.lock().workers -= 1;
    }
}

#[cfg(test)]
mod tests;
