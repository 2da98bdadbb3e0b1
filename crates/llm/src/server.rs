//! What the requests of a client learn about their server, and what follows for each of them. Pure: the clock and the
//! jitter are arguments.
//!
//! - **Load**: how many requests may be in flight, and how long an attempt may take. Status 429 and time-outs halve the
//!   first, replies add to it; time-outs double the second, and it follows the latency of replies ([`Load`]).
//! - **Outage**: a server that has answered before and is gone is waited for, as long as the settings say.
//! - **Refusals**: a server that refuses every request stops the client.

use std::collections::BTreeMap;
use std::time::{Duration, Instant, SystemTime};

use crate::error::{AskError, AttemptError, RequestError, Transient};
use crate::settings::ChatSettings;

/// The pause before the first retry; each further one is twice as long.
const FIRST_PAUSE: Duration = Duration::from_millis(500);

/// The longest pause between attempts.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);

/// The longest pause between attempts while a server is waited for.
const LONGEST_OUTAGE_PAUSE: Duration = Duration::from_secs(5);

/// The longest pause that a server may ask for. A longer one stops the client.
pub(crate) const LONGEST_RETRY_AFTER: Duration = Duration::from_secs(600);

/// Requests in a row that may fail in every attempt before the client stops.
const MOST_GIVEN_UP: u32 = 3;

/// Requests that may be refused for their content before the first reply.
const MOST_REFUSED: u32 = 5;

/// The deadline of an attempt is at most this many times that of the settings.
const MOST_PATIENCE: u32 = 8;

/// An attempt may take this many times the recent latency.
const LATENCY_FACTOR: u32 = 3;

pub(crate) const TOO_MANY_REQUESTS: u16 = 429;

/// Statuses of servers and proxies that gave up on a request which they do not refuse.
const PASSING: [u16; 6] = [408, 409, 421, 424, 425, 499];

/// Whether another attempt may meet another answer than this status.
pub(crate) fn is_transient(status: u16) -> bool {
    status == TOO_MANY_REQUESTS || PASSING.contains(&status) || (500..=599).contains(&status)
}

/// The pause that a `Retry-After` header asks for: seconds, or a date, which is compared with the server's own `Date`
/// where there is one, since clocks differ. `None` when it is neither.
pub(crate) fn retry_after(value: &str, date: Option<&str>, now: SystemTime) -> Option<Duration> {
    let value = value.trim();
    if let Ok(seconds) = value.parse::<f64>() {
        return Duration::try_from_secs_f64(seconds).ok();
    }
    let then = httpdate::parse_http_date(value).ok()?;
    let now = date.and_then(|date| httpdate::parse_http_date(date).ok()).unwrap_or(now);
    Some(then.duration_since(now).unwrap_or_default())
}

/// The pause after failure `failure` (from 0): what the server asks for, else twice the previous pause. `jitter`, from
/// 0 to 1, keeps requests from returning at the same moment.
fn pause(failure: u32, longest: Duration, asked: Option<Duration>, jitter: f64) -> Duration {
    match asked {
        Some(asked) => asked + FIRST_PAUSE.mul_f64(jitter),
        None => {
            let doubled = FIRST_PAUSE.saturating_mul(2_u32.saturating_pow(failure)).min(longest);
            doubled.mul_f64(1.0 - jitter / 2.0)
        }
    }
}

/// How many requests a server may be sent at once, and how long an attempt may take.
///
/// Additive increase, multiplicative decrease: one more request for every round of replies, half of them for a round of
/// status 429 or of time-outs. Other errors say nothing about the load.
#[derive(Debug, Clone)]
struct Load {
    most: u32,
    limit: f64,
    timeout: Duration,
    /// The slowest reply, forgotten by a tenth with every further one.
    latency: Duration,
    /// Doubled by every round of time-outs, reset by a reply.
    patience: u32,
    /// When the limit was halved: requests sent before then say nothing about the new one.
    halved: Option<Instant>,
}

impl Load {
    fn new(most: u32, timeout: Duration) -> Self {
        let most = most.max(1);
        Self {
            most,
            limit: most.into(),
            timeout,
            latency: Duration::ZERO,
            patience: 1,
            halved: None,
        }
    }

    fn limit(&self) -> usize {
        self.limit as usize
    }

    /// The deadline of an attempt: the settings', or longer where the server has been slower.
    fn deadline(&self) -> Duration {
        let usual = self.timeout.max(self.latency * LATENCY_FACTOR);
        (usual * self.patience).min(self.timeout * MOST_PATIENCE)
    }

    /// A reply came after `latency`, with `in_flight` requests under way, itself included. With fewer than half of the
    /// limit in flight it says nothing about a higher one.
    fn replied(&mut self, in_flight: usize, latency: Duration) {
        if in_flight * 2 >= self.limit() {
            self.limit = (self.limit + 1.0 / self.limit).min(self.most.into());
        }
        self.latency = latency.max(self.latency.mul_f64(0.9));
        self.patience = 1;
    }

    /// The request sent at `sent` was too much for the server. Returns whether that is news.
    fn exceeded(&mut self, sent: Instant, now: Instant) -> bool {
        let news = self.halved.is_none_or(|halved| sent >= halved);
        if news {
            self.limit = (self.limit / 2.0).floor().max(1.0);
            self.halved = Some(now);
        }
        news
    }

    /// The request sent at `sent` had no answer before its deadline.
    fn timed_out(&mut self, sent: Instant, now: Instant) {
        if self.exceeded(sent, now) {
            self.patience = (self.patience * 2).min(MOST_PATIENCE);
            tracing::warn!(
                "the server is slow: at most {} requests at once from now on, and {:.0} s for each",
                self.limit(),
                self.deadline().as_secs_f64()
            );
        }
    }
}

/// The attempts of one request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Attempts {
    /// The request's number: earlier requests go first.
    pub(crate) number: u64,
    /// Attempts made.
    pub(crate) made: u32,
    /// Attempts that count as retries.
    counted: u32,
    /// Replies that the client had when this request last failed.
    replies: Option<u64>,
    due: Instant,
}

impl Attempts {
    pub(crate) const fn new(number: u64, now: Instant) -> Self {
        Self { number, made: 0, counted: 0, replies: None, due: now }
    }

    /// The next attempt goes to another server, and may go there at once.
    pub(crate) fn move_on(&mut self, now: Instant) {
        *self = Self { made: self.made, ..Self::new(self.number, now) };
    }
}

/// A time without an answer from the server.
#[derive(Debug, Clone, Copy)]
struct Outage {
    since: Instant,
    failures: u32,
}

/// What happens to a request whose attempt failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Next {
    /// Another attempt after this pause.
    Retry(Duration),
    /// No further attempt.
    End(AskError),
}

/// What is known about a server, and the requests that wait for their turn.
#[derive(Debug)]
pub(crate) struct ServerState {
    endpoint: String,
    max_retries: u32,
    patience: Duration,
    load: Load,
    in_flight: usize,
    /// By number: the requests that wait, and until when at least.
    waiting: BTreeMap<u64, Instant>,
    /// Until when no request is sent: the server asked for a pause, or others are asked while it is gone.
    quiet_until: Option<Instant>,
    replies: u64,
    /// Requests refused for their content.
    refused: u32,
    /// Whether the server has ever answered, be it with an error.
    answered: bool,
    /// Attempts that failed since the last sign of life.
    failures: u32,
    /// Whether no connection was opened in any of them.
    unreachable: bool,
    /// Requests given up since the last sign of life.
    given_up: u32,
    outage: Option<Outage>,
    /// Whether another server of the same model answers, so that nothing has to wait for this one.
    pub(crate) replaceable: bool,
    stopped: Option<String>,
}

impl ServerState {
    pub(crate) fn new(endpoint: String, settings: &ChatSettings) -> Self {
        Self {
            endpoint,
            max_retries: settings.max_retries,
            patience: settings.server_patience,
            load: Load::new(settings.max_connections, settings.request_timeout),
            in_flight: 0,
            waiting: BTreeMap::new(),
            quiet_until: None,
            replies: 0,
            refused: 0,
            answered: false,
            failures: 0,
            unreachable: true,
            given_up: 0,
            outage: None,
            replaceable: false,
            stopped: None,
        }
    }

    pub(crate) fn endpoint(&self) -> &str {
        &self.endpoint
    }

    pub(crate) fn in_flight(&self) -> usize {
        self.in_flight
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.stopped.is_some()
    }

    /// Whether the server has answered and not been gone since, or has not been asked yet.
    pub(crate) fn is_up(&self) -> bool {
        !self.is_stopped() && self.outage.is_none()
    }

    /// Whether a request may be sent now, as far as the server is concerned.
    pub(crate) fn is_ready(&self, now: Instant) -> bool {
        self.is_up() && self.quiet_until.is_none_or(|until| until <= now)
    }

    /// While the server is gone, sends it no request until `until`.
    pub(crate) fn rest(&mut self, until: Instant) {
        if self.outage.is_some() {
            self.quiet_until = self.quiet_until.max(Some(until));
        }
    }

    /// Another server has answered, so an outage of all of them begins now at the earliest.
    pub(crate) fn another_replied(&mut self, now: Instant) {
        if let Some(outage) = &mut self.outage {
            outage.since = now;
        }
    }

    /// Ends every request that waits or fails from now on. The first reason is kept.
    pub(crate) fn stop(&mut self, why: String) -> AskError {
        AskError::Stopped(self.stopped.get_or_insert(why).clone())
    }

    /// How many requests may be in flight.
    fn allowed(&self) -> usize {
        // While the server is gone, one request tries whether it is back.
        if self.outage.is_some() { 1 } else { self.load.limit() }
    }

    /// Adds a request to those that wait.
    pub(crate) fn enqueue(&mut self, attempts: &Attempts) {
        self.waiting.insert(attempts.number, attempts.due);
    }

    /// Whether it is the turn of a request that waits; if not, until when to wait at least.
    ///
    /// # Errors
    /// When the client has stopped.
    pub(crate) fn turn(
        &self,
        attempts: &Attempts,
        now: Instant,
    ) -> Result<Result<(), Option<Instant>>, AskError> {
        if let Some(why) = &self.stopped {
            return Err(AskError::Stopped(why.clone()));
        }
        let from = self.quiet_until.max(Some(attempts.due)).filter(|from| *from > now);
        let earlier = self.waiting.range(..attempts.number).any(|(_, due)| *due <= now);
        let full = self.in_flight >= self.allowed();
        Ok(if from.is_some() || earlier || full { Err(from) } else { Ok(()) })
    }

    /// Starts the next attempt of a request whose turn it is; returns the attempt's deadline.
    pub(crate) fn start(&mut self, attempts: &mut Attempts) -> Duration {
        self.forget(attempts);
        self.in_flight += 1;
        attempts.made += 1;
        self.load.deadline()
    }

    /// Removes a request from those that wait.
    pub(crate) fn forget(&mut self, attempts: &Attempts) {
        self.waiting.remove(&attempts.number);
    }

    /// The server has given a sign of life.
    fn alive(&mut self) {
        self.answered = true;
        self.failures = 0;
        self.unreachable = true;
        self.given_up = 0;
        self.outage = None;
    }

    /// An attempt got its reply after `latency`.
    pub(crate) fn replied(&mut self, latency: Duration) {
        self.load.replied(self.in_flight, latency);
        self.alive();
        self.in_flight -= 1;
        self.replies += 1;
    }

    /// What to tell the user while the server is waited for.
    pub(crate) fn waiting_for_server(&self, now: Instant, reason: &AttemptError) -> Option<String> {
        let AttemptError::Transient(reason, _) = reason else { return None };
        if self.replaceable {
            return None;
        }
        let since = now.duration_since(self.outage?.since).as_secs();
        let most = self.patience.as_secs();
        Some(format!(
            "no answer from {} for {since} s ({reason}); waiting up to {most} s",
            self.endpoint
        ))
    }

    /// The attempt sent at `sent` failed. `jitter` is from 0 to 1.
    pub(crate) fn failed(
        &mut self,
        attempts: &mut Attempts,
        failure: AttemptError,
        (sent, now): (Instant, Instant),
        jitter: f64,
    ) -> Next {
        self.in_flight -= 1;
        let (reason, asked) = match failure {
            AttemptError::Final(error) => return Next::End(self.refused(error)),
            AttemptError::Transient(reason, asked) => (reason, asked),
        };
        if let Transient::Busy { .. } = reason {
            let error = self.exhausted(attempts, reason);
            return Next::End(self.stop(format!("the server refuses every request: {error}")));
        }
        self.note(&reason, asked, (sent, now));
        let before = attempts.replies.replace(self.replies);
        if self.is_outage(&reason) {
            let Outage { since, failures } =
                self.outage.unwrap_or(Outage { since: now, failures: 0 });
            self.outage = Some(Outage { since, failures: failures + 1 });
            let waited = now.duration_since(since);
            if waited >= self.patience && !self.replaceable {
                let answers = is_answer(&reason);
                let error = self.exhausted(attempts, reason);
                let how_long = format!("for {} s", waited.as_secs());
                return Next::End(self.gone(&error, answers, &how_long));
            }
            // A request that fails whenever the server is back may be what brings it down.
            attempts.counted += u32::from(before.is_some_and(|before| self.replies > before));
            if attempts.counted <= self.max_retries {
                let pause = pause(failures, LONGEST_OUTAGE_PAUSE, asked, jitter);
                return self.retry(attempts, now, pause);
            }
        } else {
            self.outage = None;
            // Waiting while others are served is no failure of this request.
            let others_are_served = is_throttled(&reason) && self.replies > before.unwrap_or(0);
            attempts.counted += u32::from(!others_are_served);
            if attempts.counted <= self.max_retries {
                let pause = pause(attempts.made.saturating_sub(1), LONGEST_PAUSE, asked, jitter);
                return self.retry(attempts, now, pause);
            }
        }
        Next::End(self.give_up(attempts, reason))
    }

    /// The end of a request whose attempts have all failed, and of the client where too many requests have.
    fn give_up(&mut self, attempts: &Attempts, reason: Transient) -> AskError {
        let throttled = is_throttled(&reason);
        let slow = matches!(reason, Transient::Timeout(_));
        let answers = is_answer(&reason);
        let error = self.exhausted(attempts, reason);
        self.given_up += u32::from(!throttled);
        let unreachable = self.unreachable && self.failures > self.max_retries;
        if throttled || (self.given_up < MOST_GIVEN_UP && !unreachable) {
            return self.end(error);
        }
        let failures = format!("in {} attempts", self.failures);
        if slow {
            return self.stop(format!(
                "the server is too slow ({failures}, no answer in time): {error}; start the same command again with a \
                 longer --request-timeout, fewer --max-connections or a smaller --image-budget"
            ));
        }
        self.gone(&error, answers, &failures)
    }

    /// Records what a transient failure says about the server.
    fn note(
        &mut self,
        reason: &Transient,
        asked: Option<Duration>,
        (sent, now): (Instant, Instant),
    ) {
        if is_throttled(reason) {
            self.load.exceeded(sent, now);
            self.alive();
        } else {
            self.failures += 1;
            self.unreachable &= matches!(reason, Transient::Unreachable(_));
            self.answered |= is_answer(reason);
        }
        if matches!(reason, Transient::Timeout(_)) && self.outage.is_none() {
            self.load.timed_out(sent, now);
        }
        if let Some(asked) = asked {
            self.quiet_until = self.quiet_until.max(Some(now + asked));
        }
    }

    /// Whether the server, or the way to it, is down and to be waited for. A server that starts again may accept
    /// connections before it answers.
    fn is_outage(&self, reason: &Transient) -> bool {
        let down = match reason {
            Transient::Unreachable(_) | Transient::Connection(_) => true,
            Transient::Status { status, .. } => (502..=504).contains(status),
            Transient::Timeout(_) => self.outage.is_some(),
            Transient::Busy { .. } | Transient::Unreadable(_) => false,
        };
        down && (self.replaceable || (self.answered && !self.patience.is_zero()))
    }

    fn retry(&self, attempts: &mut Attempts, now: Instant, pause: Duration) -> Next {
        if let Some(why) = &self.stopped {
            return Next::End(AskError::Stopped(why.clone()));
        }
        attempts.due = now + pause;
        Next::Retry(pause)
    }

    fn refused(&mut self, error: RequestError) -> AskError {
        self.alive();
        if let RequestError::OutOfReach { .. } = error {
            return self.stop(error.to_string());
        }
        if concerns_all(&error, self.replies > 0) {
            return self.stop(format!("the server refuses every request: {error}"));
        }
        if self.replies == 0 && matches!(error, RequestError::Refused { .. }) {
            self.refused += 1;
            if self.refused >= MOST_REFUSED {
                return self.stop(format!("the server has refused every request so far: {error}"));
            }
        }
        self.end(error)
    }

    /// The end of a request that failed, or that of the client if it has stopped meanwhile.
    fn end(&self, error: RequestError) -> AskError {
        self.stopped.clone().map_or(AskError::Failed(error), AskError::Stopped)
    }

    fn exhausted(&self, attempts: &Attempts, last: Transient) -> RequestError {
        RequestError::GaveUp { endpoint: self.endpoint.clone(), attempts: attempts.made, last }
    }

    fn gone(&mut self, error: &RequestError, answers: bool, how_long: &str) -> AskError {
        let (problem, recovery) = match answers {
            true => (format!("fails every request ({how_long})"), "it works"),
            false => (format!("is gone (no answer {how_long})"), "it is back"),
        };
        self.stop(format!(
            "the server {problem}: {error}; check it with `memtransfer doctor --policy openai`, and start the same command \
             again when {recovery}"
        ))
    }
}

/// Whether a failure is an answer of the server, so that it is not gone.
const fn is_answer(reason: &Transient) -> bool {
    matches!(reason, Transient::Status { .. } | Transient::Unreadable(_))
}

const fn is_throttled(reason: &Transient) -> bool {
    matches!(reason, Transient::Status { status: TOO_MANY_REQUESTS, .. })
}

/// Whether every other request would meet the same error. A server that has replied knows the model.
const fn concerns_all(error: &RequestError, replied: bool) -> bool {
    match error {
        RequestError::Refused { permanent: true, .. } | RequestError::NotChat { .. } => true,
        RequestError::Refused { status: 404, .. } => !replied,
        RequestError::Refused { .. }
        | RequestError::OutOfReach { .. }
        | RequestError::Unserializable(_)
        | RequestError::GaveUp { .. } => false,
    }
}

#[cfg(test)]
mod tests;
