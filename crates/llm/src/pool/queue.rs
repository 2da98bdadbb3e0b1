//! What to do next about the requests of a pool, and what an attempt's outcome means for all of them. Pure:
//! no threads, no sockets; the clock and the jitter are arguments.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::time::{Duration, Instant};

use super::super::error::{ChatError, Failure, Passing};
use super::super::retry;
use super::breaker::{Breaker, Fault};
use super::limit::Limit;

/// The status that says: too many requests.
const TOO_MANY: u16 = 429;

/// A request on its way through the pool; `T` is what it asks and whom to tell.
#[derive(Debug)]
pub(super) struct Entry<T> {
    pub(super) load: T,
    /// Times it was sent.
    pub(super) attempts: u32,
    /// Those that count against its retries.
    tries: u32,
    /// How many replies the pool had seen when this one was told to wait.
    replies: u64,
}

/// What a worker does next.
#[derive(Debug)]
pub(super) enum Task<T> {
    /// See whether the reply is known already.
    LookUp(Entry<T>),
    /// Send it; one more is in flight.
    Send(Entry<T>),
    /// Tell it that there will be no reply.
    Refuse(Entry<T>, String),
}

/// What an attempt means for its request.
#[derive(Debug)]
pub(super) enum Verdict<T> {
    /// It is asked again; the queue has it. The pause.
    Again(Duration),
    /// It failed for good.
    Failed(Entry<T>, ChatError),
    /// The server is gone, or the pool is.
    Gone(Entry<T>, String),
}

/// The words in which the queue reports, which know the server.
pub(super) trait Words {
    /// A request was given up after so many attempts.
    fn gave_up(&self, attempts: u32, last: Passing) -> ChatError;
    /// The server is gone: so many attempts in a row failed, the last one for this reason.
    fn gone(&self, failures: u32, last: &ChatError) -> String;
    /// The server refuses everybody.
    fn refuses(&self, error: &ChatError) -> String;
}

/// The requests of a pool that are not in flight, and what is known about the server.
#[derive(Debug)]
pub(super) struct Queue<T> {
    /// Not looked up yet.
    fresh: VecDeque<Entry<T>>,
    /// To be sent as soon as a connection is free.
    ready: VecDeque<Entry<T>>,
    /// To be sent again, later.
    later: BinaryHeap<Reverse<Later<T>>>,
    in_flight: usize,
    limit: Limit,
    breaker: Breaker,
    max_retries: u32,
    /// Until when the server wants to be left alone.
    quiet_until: Option<Instant>,
    /// Replies so far.
    replies: u64,
    /// Why nothing is sent any more.
    over: Option<String>,
}

#[derive(Debug)]
struct Later<T> {
    due: Instant,
    entry: Entry<T>,
}

impl<T> Queue<T> {
    pub(super) fn new(max_connections: u32, most_given_up: u32, max_retries: u32) -> Self {
        Self {
            fresh: VecDeque::new(),
            ready: VecDeque::new(),
            later: BinaryHeap::new(),
            in_flight: 0,
            limit: Limit::new(max_connections),
            breaker: Breaker::new(most_given_up),
            max_retries,
            quiet_until: None,
            replies: 0,
            over: None,
        }
    }

    /// A new request. Whether its reply may be known.
    pub(super) fn submit(&mut self, load: T, maybe_known: bool) {
        let entry = Entry { load, attempts: 0, tries: 0, replies: 0 };
        if maybe_known { self.fresh.push_back(entry) } else { self.ready.push_back(entry) }
    }

    /// A request whose reply is not known yet.
    pub(super) fn missed(&mut self, entry: Entry<T>) {
        self.ready.push_back(entry);
    }

    /// Sends nothing any more. The first reason stays.
    pub(super) fn stop(&mut self, why: String) {
        self.over.get_or_insert(why);
    }

    /// Whether no request waits for anything.
    pub(super) fn is_empty(&self) -> bool {
        self.fresh.is_empty() && self.ready.is_empty() && self.later.is_empty()
    }

    /// How many may be in flight.
    #[cfg(test)]
    pub(super) fn allowed(&self) -> usize {
        self.limit.allowed()
    }

    /// What to do now, if anything.
    pub(super) fn take(&mut self, now: Instant) -> Option<Task<T>> {
        if let Some(why) = &self.over {
            let entry = self.fresh.pop_front().or_else(|| self.ready.pop_front());
            let entry = entry.or_else(|| self.later.pop().map(|Reverse(later)| later.entry))?;
            return Some(Task::Refuse(entry, why.clone()));
        }
        if let Some(entry) = self.fresh.pop_front() {
            return Some(Task::LookUp(entry));
        }
        if self.in_flight >= self.limit.allowed() || self.quiet_until.is_some_and(|end| end > now) {
            return None;
        }
        // Those that have waited before go first.
        let is_due = self.later.peek().is_some_and(|Reverse(later)| later.due <= now);
        let entry = if is_due { self.later.pop().map(|Reverse(later)| later.entry) } else { None };
        let mut entry = entry.or_else(|| self.ready.pop_front())?;
        entry.attempts += 1;
        self.in_flight += 1;
        Some(Task::Send(entry))
    }

    /// When there is something to do again, if nothing happens before; `None`: only then.
    pub(super) fn wakes_at(&self) -> Option<Instant> {
        if self.in_flight >= self.limit.allowed() {
            return None;
        }
        let due = match self.later.peek() {
            _ if !self.ready.is_empty() => None,
            Some(Reverse(later)) => Some(later.due),
            None => return None,
        };
        due.max(self.quiet_until)
    }

    /// The request that was sent got its reply.
    pub(super) fn answered(&mut self) {
        self.limit.answered(self.in_flight);
        self.breaker.alive();
        self.in_flight -= 1;
        self.replies += 1;
    }

    /// The request that was sent at `sent` got none. `jitter` is from 0 to 1.
    pub(super) fn failed(
        &mut self,
        mut entry: Entry<T>,
        failure: Failure,
        words: &impl Words,
        (sent, now): (Instant, Instant),
        jitter: f64,
    ) -> Verdict<T> {
        self.in_flight -= 1;
        let (last, wish) = match failure {
            Failure::Passing(last, wish) => (last, wish),
            Failure::Final(error) => {
                self.breaker.alive();
                if refuses_everybody(&error, self.replies > 0) {
                    self.stop(words.refuses(&error));
                }
                return self.done(entry, error);
            }
        };
        if let Passing::Busy { .. } = last {
            let error = words.gave_up(entry.attempts, last);
            self.stop(words.refuses(&error));
            return self.done(entry, error);
        }
        let throttled = matches!(last, Passing::Status { status: TOO_MANY, .. });
        if throttled {
            self.limit.throttled(sent, now);
            self.breaker.alive();
        } else {
            let nobody_there = matches!(last, Passing::Unreachable(_));
            self.breaker.failed(if nobody_there { Fault::Unreachable } else { Fault::Failing });
        }
        if let Some(wish) = wish {
            self.quiet_until = self.quiet_until.max(Some(now + wish));
        }
        // To wait while others are served is no failure of this request.
        let others_were_served = throttled && self.replies > entry.replies;
        entry.replies = self.replies;
        entry.tries += u32::from(!others_were_served);
        if entry.tries > self.max_retries {
            let error = words.gave_up(entry.attempts, last);
            if !throttled && self.breaker.gave_up() {
                self.stop(words.gone(self.breaker.failures(), &error));
            }
            return self.done(entry, error);
        }
        if let Some(why) = &self.over {
            return Verdict::Gone(entry, why.clone());
        }
        let pause = retry::pause(entry.attempts.saturating_sub(1), wish, jitter);
        self.later.push(Reverse(Later { due: now + pause, entry }));
        Verdict::Again(pause)
    }

    fn done(&self, entry: Entry<T>, error: ChatError) -> Verdict<T> {
        match &self.over {
            Some(why) => Verdict::Gone(entry, why.clone()),
            None => Verdict::Failed(entry, error),
        }
    }
}

/// Whether an error that is final for one request is so for all of them. A server that has `answered` knows the
/// model and speaks chat, so what it refuses then is that one request.
const fn refuses_everybody(error: &ChatError, answered: bool) -> bool {
    match error {
        ChatError::Refused { status: 401 | 402, .. } => true,
        ChatError::Refused { status: 403 | 404, .. } | ChatError::NotChat { .. } => !answered,
        ChatError::Refused { .. } | ChatError::Unsaid(_) | ChatError::GaveUp { .. } => false,
    }
}

impl<T> PartialEq for Later<T> {
    fn eq(&self, other: &Self) -> bool {
        self.due == other.due
    }
}

impl<T> Eq for Later<T> {}

impl<T> PartialOrd for Later<T> {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> Ord for Later<T> {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.due.cmp(&other.due)
    }
}

#[cfg(test)]
mod tests;
