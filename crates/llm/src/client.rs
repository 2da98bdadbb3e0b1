//! The client: many requests to one model of one or several endpoints, each on a thread that waits for its own reply.

use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};

use crate::cache::{CacheKey, ReplyCache};
use crate::endpoint::Endpoint;
use crate::error::{AskError, AttemptError};
use crate::http::{HttpClient, jitter};
use crate::pool::{RequestTurn, ServerPool};
use crate::reply::ChatReply;
use crate::request::{ChatRequest, Dialect};
use crate::server::{Attempts, Next, ServerState};
use crate::settings::ChatSettings;
use crate::slots::Slots;

/// A reply, and how it was obtained.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChatAnswer {
    /// The reply.
    pub reply: ChatReply,
    /// Attempts made; 0 when the reply came from the cache.
    pub attempts: u32,
    /// Whether the reply came from the cache: its tokens were counted when it was new.
    pub from_cache: bool,
    /// When the successful attempt began, in nanoseconds of CLOCK_MONOTONIC.
    pub sent_ns: u64,
    /// When the reply was complete, on the same clock.
    pub answered_ns: u64,
}

/// Receives a text for the user while the client waits for its server, and `None` when the server answers again.
type WaitingListener = Box<dyn Fn(Option<&str>) + Send + Sync>;

/// Asks one model of one or several endpoints. Clones share connections, cache and what is known about the servers.
#[derive(Clone)]
pub struct ChatClient {
    shared: Arc<Shared>,
}

struct Shared {
    /// The endpoints, in the order of the pool.
    http: Vec<HttpClient>,
    settings: ChatSettings,
    cache: Option<ReplyCache>,
    /// A reply could not be stored, and a warning was logged.
    unwritable: AtomicBool,
    requests: AtomicU64,
    pool: Mutex<ServerPool>,
    changed: Condvar,
    listener: OnceLock<WaitingListener>,
    /// Whether the listener knows that the server is waited for.
    told: AtomicBool,
    /// The model that each endpoint names in its replies, in the order of the pool.
    models: Vec<OnceLock<String>>,
}

impl fmt::Debug for ChatClient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ChatClient").field("http", &self.shared.http).finish_non_exhaustive()
    }
}

impl ChatClient {
    /// A client without connections yet, which looks up replies in `cache` and stores them there.
    pub fn new(endpoint: Endpoint, settings: ChatSettings, cache: Option<ReplyCache>) -> Self {
        Self::balanced(endpoint, Vec::new(), settings, cache)
    }

    /// A client of several endpoints of one model, which share the requests.
    pub fn balanced(
        first: Endpoint,
        others: Vec<Endpoint>,
        settings: ChatSettings,
        cache: Option<ReplyCache>,
    ) -> Self {
        let endpoints: Vec<Endpoint> = std::iter::once(first).chain(others).collect();
        let pool = ServerPool::new(endpoints.iter().map(|endpoint| {
            let address = endpoint.to_string();
            let slots = settings.endpoint_limit.as_ref().map(|limit| Slots::of(limit, &address));
            (ServerState::new(address, &settings), slots)
        }));
        let client = |endpoint| HttpClient::new(endpoint, settings.clone());
        let models = endpoints.iter().map(|_| OnceLock::new()).collect();
        let shared = Shared {
            http: endpoints.into_iter().map(client).collect(),
            settings,
            cache,
            unwritable: AtomicBool::new(false),
            requests: AtomicU64::new(0),
            pool: Mutex::new(pool),
            changed: Condvar::new(),
            listener: OnceLock::new(),
            told: AtomicBool::new(false),
            models,
        };
        Self { shared: Arc::new(shared) }
    }

    /// Calls `listener` while the client waits for a server that is gone, every few seconds with a text for the user,
    /// and once with `None` when the server answers again. Only the first listener is called.
    pub fn on_waiting(&self, listener: impl Fn(Option<&str>) + Send + Sync + 'static) {
        // A second listener is documented to be ignored.
        drop(self.shared.listener.set(Box::new(listener)));
    }

    /// The settings.
    pub fn settings(&self) -> &ChatSettings {
        &self.shared.settings
    }

    /// The addresses of the servers, at least one.
    pub fn endpoints(&self) -> impl Iterator<Item = &Endpoint> {
        self.shared.http.iter().map(HttpClient::endpoint)
    }

    /// The optional fields of requests that a server has refused so far, which it is not sent again: ways to turn reasoning off,
    /// and [`CONSTRAINTS`](crate::CONSTRAINTS) of answers.
    pub fn refused_fields(&self) -> Vec<&'static str> {
        let dialects = self.shared.http.iter().map(|http| http.dialect().0);
        Dialect(dialects.fold(0, |all, one| all | one)).refused()
    }

    /// Single attempts on the first server, without retries.
    pub(crate) fn http(&self) -> &HttpClient {
        &self.shared.http[0]
    }

    /// The reply to a request, from the cache or from the server. Blocks until there is one. `repeat` tells repetitions
    /// of the same request apart: each has a reply of its own.
    ///
    /// # Errors
    /// When the server refuses the request, every attempt fails, or no request can succeed.
    pub fn ask(&self, request: &ChatRequest, repeat: u32) -> Result<ChatAnswer, AskError> {
        self.shared.ask(request, repeat)
    }

    /// [`ask`](Self::ask) on a thread of its own, which calls `done` exactly once.
    pub fn submit(
        &self,
        request: ChatRequest,
        repeat: u32,
        done: impl FnOnce(Result<ChatAnswer, AskError>) + Send + 'static,
    ) {
        // The thread gets its work through a channel, so that `done` is still here when it cannot be started.
        let (give, take) = mpsc::sync_channel::<Box<dyn FnOnce() + Send>>(1);
        let thread = thread::Builder::new().name("chat".to_owned());
        let started = thread.spawn(move || {
            if let Ok(work) = take.recv() {
                work();
            }
        });
        match started {
            Ok(_) => {
                let client = self.clone();
                // The thread has not ended: it waits for this.
                drop(give.send(Box::new(move || done(client.ask(&request, repeat)))));
            }
            Err(error) => done(Err(AskError::Stopped(format!(
                "cannot start a thread for a request: {error}; lower --lanes"
            )))),
        }
    }

    /// Ends every request that waits, and those in flight when their attempt ends.
    pub fn stop(&self, why: &str) {
        self.shared.lock().stop(why);
        self.shared.changed.notify_all();
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, ServerPool> {
        // Nothing that runs under the lock leaves the pool half changed.
        self.pool.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn ask(&self, request: &ChatRequest, repeat: u32) -> Result<ChatAnswer, AskError> {
        let key = self.cache.as_ref().and_then(|_| CacheKey::of(&self.settings, request, repeat));
        let stored = self.cache.as_ref().zip(key.as_ref());
        if let Some(reply) = stored.and_then(|(cache, key)| cache.get(key)) {
            let now = monotonic_ns();
            return Ok(ChatAnswer {
                reply,
                attempts: 0,
                from_cache: true,
                sent_ns: now,
                answered_ns: now,
            });
        }
        let number = self.requests.fetch_add(1, Ordering::Relaxed);
        let mut attempts = Attempts::new(number, Instant::now());
        loop {
            let RequestTurn { server, deadline, slot } = self.wait_for_turn(&mut attempts)?;
            let (sent, sent_ns) = (Instant::now(), monotonic_ns());
            let outcome = self.http[server].attempt(request, deadline);
            drop(slot);
            match outcome {
                Ok(reply) => {
                    self.compare_models(server, &reply)?;
                    let answered_ns = monotonic_ns();
                    self.lock().replied(server, sent.elapsed(), Instant::now());
                    self.changed.notify_all();
                    self.report(None);
                    self.store(key.as_ref(), &reply);
                    let attempts = attempts.made;
                    return Ok(ChatAnswer {
                        reply,
                        attempts,
                        from_cache: false,
                        sent_ns,
                        answered_ns,
                    });
                }
                Err(failure) => self.failed(server, &mut attempts, failure, sent)?,
            }
        }
    }

    /// Stops the client where two servers name different models: their answers would be mixed at random.
    fn compare_models(&self, server: usize, reply: &ChatReply) -> Result<(), AskError> {
        let Some(named) = reply.model.as_deref() else { return Ok(()) };
        let Some(model) = self.models.get(server) else { return Ok(()) };
        let named = model.get_or_init(|| model_name(named));
        let others = self.http.iter().zip(&self.models).filter_map(|(http, name)| {
            Some((http.endpoint(), name.get().filter(|name| *name != named)?))
        });
        let Some((other, name)) = others.take(1).next() else { return Ok(()) };
        let endpoint = self.http[server].endpoint();
        let why = format!(
            "{endpoint} answers as {named} and {other} as {name}: the servers of a run serve one model; name one of them with \
             --base-url, or serve both models under one name if they are the same"
        );
        self.lock().stop(&why);
        self.changed.notify_all();
        Err(AskError::Stopped(why))
    }

    /// Waits until the request may be sent.
    fn wait_for_turn(&self, attempts: &mut Attempts) -> Result<RequestTurn, AskError> {
        let mut pool = self.lock();
        pool.enqueue(attempts);
        loop {
            let now = Instant::now();
            match pool.start(attempts, now)? {
                Ok(turn) => {
                    drop(pool);
                    // There may be room for another one.
                    self.changed.notify_all();
                    return Ok(turn);
                }
                Err(until) => pool = self.wait(pool, until.map(|until| until - now)),
            }
        }
    }

    fn wait<'a>(
        &self,
        pool: MutexGuard<'a, ServerPool>,
        timeout: Option<Duration>,
    ) -> MutexGuard<'a, ServerPool> {
        match timeout {
            None => self.changed.wait(pool).unwrap_or_else(PoisonError::into_inner),
            Some(timeout) => {
                let waited = self.changed.wait_timeout(pool, timeout);
                waited.unwrap_or_else(PoisonError::into_inner).0
            }
        }
    }

    /// Records a failed attempt; returns an error when there is no further attempt.
    fn failed(
        &self,
        server: usize,
        attempts: &mut Attempts,
        failure: AttemptError,
        sent: Instant,
    ) -> Result<(), AskError> {
        let (made, now) = (attempts.made, Instant::now());
        let (next, waiting) =
            self.lock().failed(server, attempts, failure.clone(), (sent, now), jitter(made));
        // The pause and the limit may have changed for all of them.
        self.changed.notify_all();
        self.report(waiting.as_deref());
        match next {
            Next::End(error) => Err(error),
            Next::Retry(pause) => {
                if let AttemptError::Transient(reason, _) = failure {
                    let seconds = pause.as_secs_f64();
                    tracing::warn!("attempt {made}: {reason}; again in {seconds:.1} s");
                }
                Ok(())
            }
        }
    }

    /// Calls the listener with the reason for waiting, or, once, with `None` when the server answers again.
    fn report(&self, waiting: Option<&str>) {
        let before = self.told.swap(waiting.is_some(), Ordering::Relaxed);
        if let Some(listener) = self.listener.get()
            && (before || waiting.is_some())
        {
            listener(waiting);
        }
    }

    /// Stores a reply. A failure costs at most another request later, so it is logged once.
    fn store(&self, key: Option<&CacheKey>, reply: &ChatReply) {
        let Some((cache, key)) = self.cache.as_ref().zip(key) else { return };
        let Err(error) = cache.put(key, &self.settings.model, reply) else { return };
        if !self.unwritable.swap(true, Ordering::Relaxed) {
            let folder = cache.folder().display();
            tracing::warn!(
                "replies cannot be stored in {folder}: {error}; the run continues without them"
            );
        }
    }
}

/// A model's name without the folder of its file, which may differ from machine to machine.
fn model_name(named: &str) -> String {
    let file = named.strip_prefix('/').and_then(|path| path.rsplit('/').next());
    file.unwrap_or(named).to_owned()
}

/// Nanoseconds of CLOCK_MONOTONIC, which all processes of a run share.
fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    let seconds = u64::try_from(now.tv_sec).unwrap_or_default();
    seconds * 1_000_000_000 + u64::try_from(now.tv_nsec).unwrap_or_default()
}

#[cfg(test)]
mod tests;
