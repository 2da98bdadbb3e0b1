//! The state of a server, in scenarios with a simulated clock.

use proptest::prelude::*;

use super::*;
use crate::ChatSettings;

const TIMEOUT: Duration = Duration::from_secs(30);

fn seconds(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

fn status(status: u16) -> AttemptError {
    AttemptError::Transient(Transient::Status { status, message: "no".into() }, None)
}

fn unreachable() -> AttemptError {
    AttemptError::Transient(Transient::Unreachable("refused".into()), None)
}

fn timeout() -> AttemptError {
    AttemptError::Transient(Transient::Timeout(TIMEOUT), None)
}

fn refused(status: u16) -> AttemptError {
    AttemptError::Final(RequestError::Refused {
        endpoint: "E".into(),
        status,
        message: "no".into(),
        advice: "lower --image-budget".into(),
        permanent: matches!(status, 401..=403),
    })
}

/// A state and a clock, both controlled by the test.
struct Story {
    state: ServerState,
    start: Instant,
    now: Instant,
    requests: u64,
}

impl Story {
    fn new(max_connections: u32, max_retries: u32, patience: u64) -> Self {
        let settings = ChatSettings {
            max_connections,
            max_retries,
            request_timeout: TIMEOUT,
            server_patience: seconds(patience),
            ..ChatSettings::new("m")
        };
        let now = Instant::now();
        Self { state: ServerState::new("E".into(), &settings), start: now, now, requests: 0 }
    }

    /// A new request that waits.
    fn request(&mut self) -> Attempts {
        let attempts = Attempts::new(self.requests, self.now);
        self.requests += 1;
        self.state.enqueue(&attempts);
        attempts
    }

    /// Starts the next attempt, which has to be possible now; returns its deadline.
    fn start(&mut self, attempts: &mut Attempts) -> Duration {
        self.state.turn(attempts, self.now).unwrap().unwrap();
        self.state.start(attempts)
    }

    fn is_held_back(&mut self, attempts: &mut Attempts) -> bool {
        self.state.turn(attempts, self.now).unwrap().is_err()
    }

    fn fail(&mut self, attempts: &mut Attempts, failure: AttemptError, sent: Instant) -> Next {
        let next = self.state.failed(attempts, failure, (sent, self.now), 0.0);
        if let Next::Retry(_) = next {
            self.state.enqueue(attempts);
        }
        next
    }

    /// Sends a request until it ends, each attempt failing with `failure`.
    fn until_end(&mut self, failure: &AttemptError) -> AskError {
        let mut attempts = self.request();
        loop {
            self.start(&mut attempts);
            let sent = self.now;
            match self.fail(&mut attempts, failure.clone(), sent) {
                Next::Retry(pause) => self.now += pause,
                Next::End(error) => return error,
            }
        }
    }

    fn reply(&mut self, latency: Duration) {
        let mut attempts = self.request();
        self.start(&mut attempts);
        self.now += latency;
        self.state.replied(latency);
    }

    fn elapsed(&self) -> u64 {
        self.now.duration_since(self.start).as_secs()
    }
}

#[test]
fn which_statuses_are_transient() {
    let transient: Vec<u16> = (100..600).filter(|&status| is_transient(status)).collect();
    assert_eq!(transient.len(), 107);
    assert_eq!(transient[..7], [408, 409, 421, 424, 425, 429, 499]);
    assert!(transient.contains(&500) && transient.contains(&599));
}

#[test]
fn pauses_double_up_to_a_bound_and_retry_after_goes_first() {
    let ms = Duration::from_millis;
    for (failure, asked, jitter, expected) in [
        (0, None, 0.0, ms(500)),
        (1, None, 0.0, ms(1000)),
        (1, None, 1.0, ms(500)),
        (3, None, 0.5, ms(3000)),
        (40, None, 0.0, ms(60_000)),
        (5, Some(ms(0)), 0.0, ms(0)),
        (0, Some(ms(7000)), 0.5, ms(7250)),
    ] {
        assert_eq!(pause(failure, LONGEST_PAUSE, asked, jitter), expected, "{failure} {asked:?}");
    }
}

#[test]
fn retry_after_in_seconds_or_as_a_date() {
    let now = httpdate::parse_http_date("Sun, 06 Nov 1994 08:49:37 GMT").unwrap();
    let (later, server) = ("Sun, 06 Nov 1994 08:50:07 GMT", "Sun, 06 Nov 1994 08:49:47 GMT");
    for (value, date, expected) in [
        ("7", None, Some(7.0)),
        (" 0.5 ", None, Some(0.5)),
        (later, None, Some(30.0)),
        (later, Some(server), Some(20.0)),
        (later, Some("noon"), Some(30.0)),
        ("Sun, 06 Nov 1994 08:00:00 GMT", None, Some(0.0)),
        ("-3", None, None),
        ("NaN", None, None),
        ("soon", None, None),
    ] {
        let expected = expected.map(Duration::from_secs_f64);
        assert_eq!(retry_after(value, date, now), expected, "{value}");
    }
}

#[test]
fn requests_go_in_order_within_the_limit() {
    let mut story = Story::new(2, 5, 0);
    let [mut first, mut second, mut third] = [(); 3].map(|()| story.request());
    assert!(story.is_held_back(&mut second), "the first request goes first");
    story.start(&mut first);
    story.start(&mut second);
    assert!(story.is_held_back(&mut third), "two are in flight");
    let sent = story.now;
    assert_eq!(story.fail(&mut first, status(500), sent), Next::Retry(Duration::from_millis(500)));
    story.start(&mut third);
    story.state.replied(seconds(1));
    assert!(story.is_held_back(&mut first), "it is not due yet");
    story.now += seconds(1);
    story.start(&mut first);
}

#[test]
fn retry_after_holds_back_every_request() {
    let mut story = Story::new(4, 5, 0);
    let [mut first, mut second] = [(); 2].map(|()| story.request());
    story.start(&mut first);
    let sent = story.now;
    let reason = Transient::Status { status: 503, message: "no".into() };
    story.fail(&mut first, AttemptError::Transient(reason, Some(seconds(7))), sent);
    let until = story.state.turn(&second, story.now).unwrap().unwrap_err();
    assert_eq!(until, Some(sent + seconds(7)));
    story.now += seconds(7);
    assert!(story.is_held_back(&mut second), "the one that failed goes first");
    story.start(&mut first);
    story.start(&mut second);
}

#[test]
fn waiting_while_others_are_served_uses_up_no_retry() {
    for (others, expected) in [(true, 9), (false, 2)] {
        let mut story = Story::new(1, 1, 0);
        let mut attempts = story.request();
        for _ in 0..9 {
            story.now += seconds(100);
            story.start(&mut attempts);
            let sent = story.now;
            if let Next::End(_) = story.fail(&mut attempts, status(429), sent) {
                break;
            }
            if others {
                story.reply(seconds(1));
            }
        }
        assert_eq!(attempts.made, expected, "{others}");
    }
}

/// Eight requests of a slow server time out together; the next ones are fewer and have more time.
#[test]
fn time_outs_shrink_the_load_and_extend_the_deadline() {
    let mut story = Story::new(8, 5, 0);
    let mut requests: Vec<Attempts> = (0..8).map(|_| story.request()).collect();
    for (in_flight, deadline) in [(8, 30), (4, 60), (2, 120), (1, 240), (1, 240)] {
        let sent = story.now;
        for request in &mut requests[..in_flight] {
            assert_eq!(story.start(request), seconds(deadline));
        }
        if let Some(next) = requests.get_mut(in_flight) {
            assert!(story.is_held_back(next), "{in_flight} in flight are enough");
        }
        story.now += seconds(deadline);
        for request in &mut requests[..in_flight] {
            assert!(matches!(story.fail(request, timeout(), sent), Next::Retry(_)));
        }
        story.now += seconds(60);
    }
    story.start(&mut requests[0]);
    story.state.replied(seconds(50));
    story.now += seconds(1);
    assert_eq!(story.start(&mut requests[1]), seconds(150), "three times the latency seen");
    assert_eq!(story.state.load.limit(), 2, "and more at once again");
}

#[test]
fn only_time_outs_and_429_shrink_the_load() {
    for (failure, limit) in [(timeout(), 4), (status(429), 4), (status(500), 8), (unreachable(), 8)]
    {
        let mut story = Story::new(8, 5, 0);
        let mut requests: Vec<Attempts> = (0..8).map(|_| story.request()).collect();
        for request in &mut requests {
            story.start(request);
        }
        let sent = story.now;
        story.now += seconds(1);
        for request in &mut requests {
            story.fail(request, failure.clone(), sent);
        }
        assert_eq!(story.state.load.limit(), limit, "{failure:?}");
    }
}

#[test]
fn a_slow_server_is_called_slow() {
    let mut story = Story::new(1, 1, 600);
    story.reply(seconds(1));
    for _ in 0..2 {
        assert!(matches!(story.until_end(&timeout()), AskError::Failed(_)));
    }
    let AskError::Stopped(why) = story.until_end(&timeout()) else { panic!("three in a row") };
    assert!(
        why.starts_with("the server is too slow") && why.contains("--request-timeout"),
        "{why}"
    );
}

/// The requests of a server that has answered before wait for it, while one tries whether it is back.
#[test]
fn a_server_that_was_there_is_waited_for() {
    for failure in [unreachable(), status(503)] {
        let mut story = Story::new(4, 1, 600);
        story.reply(seconds(1));
        let began = story.elapsed();
        let [mut first, mut second] = [(); 2].map(|()| story.request());
        story.start(&mut first);
        for _ in 0..50 {
            let sent = story.now;
            let next = story.fail(&mut first, failure.clone(), sent);
            let Next::Retry(pause) = next else { panic!("{next:?} after {} s", story.elapsed()) };
            assert!(pause <= LONGEST_OUTAGE_PAUSE);
            story.now += pause;
            story.start(&mut first);
            assert!(story.is_held_back(&mut second), "one is enough to see whether it is back");
        }
        assert!(story.elapsed() - began > 180);
        let told = story.state.waiting_for_server(story.now, &failure).unwrap();
        assert!(
            told.starts_with("no answer from E for 2") && told.ends_with("waiting up to 600 s"),
            "{told}"
        );
        story.state.replied(seconds(1));
        assert_eq!(story.state.waiting_for_server(story.now, &failure), None);
        story.start(&mut second);
        // The next outage is a new one.
        story.state.replied(seconds(1));
        let AskError::Stopped(why) = story.until_end(&failure) else { panic!("{failure:?}") };
        let expected = match failure {
            AttemptError::Transient(Transient::Status { .. }, _) => {
                "the server fails every request (for 60"
            }
            _ => "the server is gone (no answer for 60",
        };
        assert!(why.starts_with(expected), "{why}");
    }
}

#[test]
fn a_request_that_brings_the_server_down_is_given_up() {
    let mut story = Story::new(4, 2, 600);
    story.reply(seconds(1));
    let mut poison = story.request();
    let mut restarts = 0;
    let error = loop {
        story.now += seconds(5);
        story.start(&mut poison);
        let sent = story.now;
        match story.fail(&mut poison, unreachable(), sent) {
            Next::Retry(_) => restarts += 1,
            Next::End(error) => break error,
        }
        // The server starts again and answers another request.
        story.state.in_flight += 1;
        story.state.replied(seconds(1));
    };
    assert!(matches!(error, AskError::Failed(_)), "{error}");
    assert_eq!(restarts, 3);
}

#[test]
fn a_server_that_was_never_there_is_not_waited_for() {
    let mut story = Story::new(4, 5, 600);
    let AskError::Stopped(why) = story.until_end(&unreachable()) else {
        panic!("nothing is there")
    };
    assert!(why.starts_with("the server is gone (no answer in 6 attempts)"), "{why}");
    assert!(story.elapsed() < 20);
}

#[test]
fn without_patience_three_requests_in_a_row_stop_the_client() {
    let mut story = Story::new(4, 1, 0);
    for expected in [false, false, true] {
        let stopped = matches!(story.until_end(&status(503)), AskError::Stopped(_));
        assert_eq!(stopped, expected);
    }
    let next = story.request();
    assert!(story.state.turn(&next, story.now).is_err());
}

/// A server that refuses every request stops the run, and the message says what to do.
#[test]
fn a_server_that_refuses_every_request_stops_the_client() {
    let mut story = Story::new(4, 5, 600);
    for _ in 1..MOST_REFUSED {
        assert!(matches!(story.until_end(&refused(400)), AskError::Failed(_)));
    }
    let AskError::Stopped(why) = story.until_end(&refused(400)) else { panic!("every request") };
    assert!(why.contains("every request so far") && why.contains("--image-budget"), "{why}");

    let mut story = Story::new(4, 5, 600);
    story.reply(seconds(1));
    for _ in 0..20 {
        let error = story.until_end(&refused(400));
        assert!(matches!(error, AskError::Failed(_)), "others were answered");
    }
    let endpoint = "E".to_owned();
    let out_of_reach = RequestError::OutOfReach { endpoint, problem: "no TLS".to_owned() };
    let stopped = Story::new(4, 5, 600).until_end(&AttemptError::Final(out_of_reach));
    assert_eq!(stopped, AskError::Stopped("E cannot be reached: no TLS".to_owned()));
    // These stop it also after a reply, as does what is no chat server.
    let not_chat = RequestError::NotChat { endpoint: "E".into(), what: "a web page".into() };
    for failure in [refused(401), refused(402), refused(403), AttemptError::Final(not_chat)] {
        let mut story = Story::new(4, 5, 600);
        story.reply(seconds(1));
        assert!(matches!(story.until_end(&failure), AskError::Stopped(_)), "{failure:?}");
    }
}

/// How an attempt fails; `None` when it gets its reply.
fn failure() -> impl Strategy<Value = Option<AttemptError>> {
    let failure = prop_oneof![
        3 => prop::sample::select(vec![429, 500, 503]).prop_map(status),
        1 => Just(timeout()),
        1 => Just(unreachable()),
        1 => prop::sample::select(vec![400, 401, 404]).prop_map(refused),
    ];
    prop::option::weighted(0.6, failure)
}

proptest! {
    /// Every request ends exactly once, none waits for ever, and no more are in flight than allowed.
    #[test]
    fn every_request_ends_once(
        (most, retries, requests, patience) in (1..6_u32, 0..3_u32, 1..12_u64, 0..40_u64),
        events in prop::collection::vec((failure(), 0..9_usize), 1..60),
    ) {
        let mut story = Story::new(most, retries, patience);
        let mut waiting: Vec<Attempts> = (0..requests).map(|_| story.request()).collect();
        let mut in_flight: Vec<(Attempts, Instant)> = Vec::new();
        let mut ended = 0;
        let mut events = events.into_iter().cycle();
        while !waiting.is_empty() || !in_flight.is_empty() {
            let (mut earliest, mut started) = (None::<Instant>, false);
            for index in (0..waiting.len()).rev() {
                match story.state.turn(&waiting[index], story.now) {
                    Err(_) => {
                        waiting.swap_remove(index);
                        (ended, started) = (ended + 1, true);
                    }
                    Ok(Ok(())) => {
                        let mut attempts = waiting.swap_remove(index);
                        let deadline = story.state.start(&mut attempts);
                        prop_assert!(deadline <= TIMEOUT * MOST_PATIENCE);
                        in_flight.push((attempts, story.now));
                        started = true;
                    }
                    Ok(Err(until)) => earliest = earliest.into_iter().chain(until).min(),
                }
            }
            prop_assert!(in_flight.len() <= most as usize);
            if started {
                continue;
            }
            if in_flight.is_empty() {
                prop_assert!(earliest.is_some_and(|until| until > story.now), "stuck");
                story.now = earliest.unwrap();
                continue;
            }
            let (failure, which) = events.next().unwrap();
            story.now += seconds(1);
            let (mut attempts, sent) = in_flight.swap_remove(which % in_flight.len());
            let Some(failure) = failure else {
                story.state.replied(story.now - sent);
                ended += 1;
                continue;
            };
            match story.fail(&mut attempts, failure, sent) {
                Next::Retry(_) => waiting.push(attempts),
                Next::End(_) => ended += 1,
            }
        }
        prop_assert_eq!(ended, requests);
    }
}
