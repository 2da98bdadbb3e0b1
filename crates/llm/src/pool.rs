//! The servers of one model, and which of them gets a request.
//!
//! A request goes to the server with the fewest requests in flight that may have one more. A server that is gone is tried
//! with one request every few seconds, and its other requests go to those that answer; only when none does is it waited
//! for. A server that stops for good, for example because it does not accept the key, is left out.

use std::time::{Duration, Instant};

use crate::error::{AskError, AttemptError};
use crate::server::{Attempts, Next, ServerState};
use crate::slots::{Slot, Slots};

/// How long to wait for a free slot before looking again: other processes do not tell when they free one.
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// The servers of one model.
#[derive(Debug)]
pub(crate) struct ServerPool {
    servers: Vec<PooledServer>,
}

#[derive(Debug)]
struct PooledServer {
    state: ServerState,
    /// Where a limit holds for all processes.
    slots: Option<Slots>,
}

/// The right to send a request once.
#[derive(Debug)]
pub(crate) struct RequestTurn {
    /// The server's place in the pool.
    pub(crate) server: usize,
    /// The attempt's deadline.
    pub(crate) deadline: Duration,
    /// Held until the attempt ends.
    pub(crate) slot: Option<Slot>,
}

impl ServerPool {
    pub(crate) fn new(servers: impl IntoIterator<Item = (ServerState, Option<Slots>)>) -> Self {
        let pooled = |(state, slots)| PooledServer { state, slots };
        Self { servers: servers.into_iter().map(pooled).collect() }
    }

    /// Ends every request that waits or fails from now on.
    pub(crate) fn stop(&mut self, why: &str) {
        for server in &mut self.servers {
            server.state.stop(why.to_owned());
        }
    }

    /// Adds a request to those that wait.
    pub(crate) fn enqueue(&mut self, attempts: &Attempts) {
        for server in &mut self.servers {
            server.state.enqueue(attempts);
        }
    }

    /// Starts the next attempt of a request that waits, if it is its turn on a server; else returns until when to wait at
    /// least.
    ///
    /// # Errors
    /// When all servers have stopped.
    pub(crate) fn start(
        &mut self,
        attempts: &mut Attempts,
        now: Instant,
    ) -> Result<Result<RequestTurn, Option<Instant>>, AskError> {
        let mut order: Vec<usize> = (0..self.servers.len()).collect();
        order.sort_by_key(|server| self.servers[*server].state.in_flight());
        let mut stopped = None;
        let mut until: Option<Instant> = None;
        for index in order {
            let server = &mut self.servers[index];
            let slot = match server.state.turn(attempts, now) {
                Err(error) => {
                    stopped = Some(error);
                    continue;
                }
                Ok(Err(at)) => {
                    until = until.into_iter().chain(at).min();
                    continue;
                }
                Ok(Ok(())) => match server.slots.as_ref().map(|slots| (slots, slots.take())) {
                    None => None,
                    Some((_, Ok(Some(slot)))) => Some(slot),
                    Some((_, Ok(None))) => {
                        until = until.into_iter().chain([now + LOOK_AGAIN]).min();
                        continue;
                    }
                    Some((slots, Err(error))) => {
                        let why = slots.failed(&error);
                        self.stop(&why);
                        return Err(AskError::Stopped(why));
                    }
                },
            };
            let deadline = server.state.start(attempts);
            self.servers.iter_mut().for_each(|server| server.state.forget(attempts));
            return Ok(Ok(RequestTurn { server: index, deadline, slot }));
        }
        match stopped {
            Some(error) if self.servers.iter().all(|server| server.state.is_stopped()) => {
                Err(error)
            }
            _ => Ok(Err(until)),
        }
    }

    /// An attempt got its reply from `server` after `latency`.
    pub(crate) fn replied(&mut self, server: usize, latency: Duration, now: Instant) {
        for (index, PooledServer { state, .. }) in self.servers.iter_mut().enumerate() {
            if index == server { state.replied(latency) } else { state.another_replied(now) }
        }
    }

    /// An attempt failed; the other arguments are those of [`ServerState::failed`]. Also returns what to tell the user while
    /// every server is waited for.
    pub(crate) fn failed(
        &mut self,
        server: usize,
        attempts: &mut Attempts,
        failure: AttemptError,
        (sent, now): (Instant, Instant),
        jitter: f64,
    ) -> (Next, Option<String>) {
        let others = |is: fn(&ServerState, Instant) -> bool, pool: &Self| {
            let mut others = pool.servers.iter().enumerate().filter(|(index, _)| *index != server);
            others.any(|(_, other)| is(&other.state, now))
        };
        let replaceable = others(|state, _| state.is_up(), self);
        let another_is_ready = others(ServerState::is_ready, self);
        let another_goes_on = others(|state, _| !state.is_stopped(), self);
        let state = &mut self.servers[server].state;
        state.replaceable = replaceable;
        let next = state.failed(attempts, failure.clone(), (sent, now), jitter);
        let waiting = state.waiting_for_server(now, &failure);
        let next = match next {
            Next::Retry(pause) => {
                if replaceable {
                    state.rest(now + pause);
                }
                if another_is_ready && !state.is_ready(now) {
                    attempts.move_on(now);
                    Next::Retry(Duration::ZERO)
                } else {
                    Next::Retry(pause)
                }
            }
            Next::End(AskError::Stopped(why)) if another_goes_on => {
                tracing::warn!("{} is left out: {why}", state.endpoint());
                attempts.move_on(now);
                Next::Retry(Duration::ZERO)
            }
            end @ Next::End(_) => end,
        };
        (next, waiting)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ChatSettings;
    use crate::error::{RequestError, Transient};
    use crate::slots::EndpointLimit;

    fn pool(servers: usize) -> ServerPool {
        let settings =
            ChatSettings { max_connections: 4, max_retries: 1, ..ChatSettings::new("m") };
        ServerPool::new((0..servers).map(|n| (ServerState::new(format!("E{n}"), &settings), None)))
    }

    fn seconds(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    fn unreachable() -> AttemptError {
        AttemptError::Transient(Transient::Unreachable("refused".into()), None)
    }

    /// A pool, a clock, and the number of requests so far.
    struct Story {
        pool: ServerPool,
        now: Instant,
        requests: u64,
    }

    impl Story {
        fn new(pool: ServerPool) -> Self {
            Self { pool, now: Instant::now(), requests: 0 }
        }

        /// Starts a new request, which has to be possible; returns its server.
        fn start(&mut self) -> (Attempts, usize) {
            let mut attempts = Attempts::new(self.requests, self.now);
            self.requests += 1;
            self.pool.enqueue(&attempts);
            let turn = self.pool.start(&mut attempts, self.now).unwrap().unwrap();
            (attempts, turn.server)
        }

        fn fail(&mut self, attempts: &mut Attempts, server: usize, failure: AttemptError) -> Next {
            let (next, _) = self.pool.failed(server, attempts, failure, (self.now, self.now), 0.0);
            if let Next::Retry(_) = next {
                self.pool.enqueue(attempts);
            }
            next
        }
    }

    #[test]
    fn requests_are_spread_by_those_in_flight() {
        let mut story = Story::new(pool(3));
        let servers: Vec<usize> = (0..6).map(|_| story.start().1).collect();
        assert_eq!(servers, [0, 1, 2, 0, 1, 2]);
        story.pool.replied(1, seconds(1), story.now);
        assert_eq!(story.start().1, 1, "it has one request less than the others");
    }

    #[test]
    fn a_lost_server_drains_to_the_others_and_returns() {
        let mut story = Story::new(pool(2));
        let [(mut first, on_first), (_, on_second)] = [(); 2].map(|()| story.start());
        assert_eq!((on_first, on_second), (0, 1));
        assert_eq!(story.fail(&mut first, 0, unreachable()), Next::Retry(Duration::ZERO));
        let turn = story.pool.start(&mut first, story.now).unwrap().unwrap();
        assert_eq!(turn.server, 1, "it goes to the other server at once");
        assert_eq!(story.start().1, 1);

        // Far longer than a run waits for a server: nothing waits for this one.
        for round in 0..600 {
            story.now += seconds(6);
            let (mut probe, server) = story.start();
            assert_eq!(server, 0, "one request looks whether it is back ({round})");
            assert_eq!(story.fail(&mut probe, 0, unreachable()), Next::Retry(Duration::ZERO));
            let turn = story.pool.start(&mut probe, story.now).unwrap().unwrap();
            assert_eq!(turn.server, 1);
            story.pool.replied(1, seconds(1), story.now);
        }
        story.now += seconds(6);
        assert_eq!(story.start().1, 0);
        story.pool.replied(0, seconds(1), story.now);
        assert_eq!([story.start().1, story.start().1], [0, 0], "it has fewer in flight");
    }

    #[test]
    fn only_when_all_are_gone_they_are_waited_for() {
        let mut story = Story::new(pool(2));
        assert_eq!([story.start().1, story.start().1], [0, 1]);
        for server in [0, 1] {
            story.pool.replied(server, seconds(1), story.now);
        }
        let (mut attempts, _) = story.start();
        assert_eq!(story.fail(&mut attempts, 0, unreachable()), Next::Retry(Duration::ZERO));
        let turn = story.pool.start(&mut attempts, story.now).unwrap().unwrap();
        let (next, told) = story.pool.failed(
            turn.server,
            &mut attempts,
            unreachable(),
            (story.now, story.now),
            0.0,
        );
        assert!(matches!(next, Next::Retry(pause) if pause > Duration::ZERO), "{next:?}");
        assert!(told.unwrap().contains("no answer from E1"));
        // Both stop after as long as a run waits for a server, and with them the client.
        let ended = (0..1000).find_map(|_| {
            story.now += seconds(6);
            story.pool.enqueue(&attempts);
            let turn = match story.pool.start(&mut attempts, story.now) {
                Err(error) => return Some(error),
                Ok(turn) => turn.unwrap(),
            };
            match story.fail(&mut attempts, turn.server, unreachable()) {
                Next::End(error) => Some(error),
                Next::Retry(_) => None,
            }
        });
        assert!(matches!(ended, Some(AskError::Stopped(_))), "{ended:?}");
    }

    #[test]
    fn a_server_that_refuses_the_key_is_left_out() {
        let mut story = Story::new(pool(2));
        let refused = AttemptError::Final(RequestError::Refused {
            endpoint: "E0".into(),
            status: 401,
            message: "no".into(),
            advice: "check OPENAI_API_KEY".into(),
            permanent: true,
        });
        let (mut first, _) = story.start();
        assert_eq!(story.fail(&mut first, 0, refused.clone()), Next::Retry(Duration::ZERO));
        assert_eq!(story.pool.start(&mut first, story.now).unwrap().unwrap().server, 1);
        assert_eq!(story.start().1, 1);
        assert!(matches!(story.fail(&mut first, 1, refused), Next::End(AskError::Stopped(_))));
    }

    #[test]
    fn a_request_waits_for_a_slot_that_another_process_has() {
        let folder = tempfile::tempdir().unwrap();
        let limit = EndpointLimit { most: 1, folder: folder.path().to_owned() };
        let settings = ChatSettings::new("m");
        let state = ServerState::new("E".into(), &settings);
        let slots = Slots::of(&limit, "E");
        let elsewhere = slots.take().unwrap();
        let mut pool = ServerPool::new([(state, Some(slots))]);
        let now = Instant::now();
        let mut attempts = Attempts::new(0, now);
        pool.enqueue(&attempts);
        assert_eq!(pool.start(&mut attempts, now).unwrap().unwrap_err(), Some(now + LOOK_AGAIN));
        drop(elsewhere);
        assert!(pool.start(&mut attempts, now).unwrap().unwrap().slot.is_some());
    }
}
