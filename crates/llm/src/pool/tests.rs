//! The pool against a scripted server, over real sockets. Nothing here asserts how long anything takes; what
//! could hang has a watchdog.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicUsize;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::Duration;

use serde_json::json;

use super::super::client::Settings;
use super::super::endpoint::Endpoint;
use super::super::message::{Message, Speaker};
use super::super::reply::Outcome;
use super::super::scripted::{Received, Server, Turn, completion};
use super::super::secret::Secret;
use super::*;

const KEY: &str = "sk-very-secret";

/// Longer than any of these tests should take.
const WATCHDOG: Duration = Duration::from_secs(60);

fn job(text: &str) -> Job {
    let messages = vec![Message::text(Speaker::User, text)];
    Job { question: Question { messages, max_tokens: 30 }, repeat: 0 }
}

fn text(request: &Received) -> &str {
    request.body.pointer("/messages/0/content").and_then(|text| text.as_str()).unwrap_or_default()
}

fn fails(status: u16, message: &str) -> Turn {
    Turn::json(status, &json!({"error": {"message": message}}))
}

/// A pool, and what its questions came to, in the order in which they were done.
struct Bench {
    pool: Pool,
    done: Receiver<(String, Result<Asked, PoolError>)>,
    tell: mpsc::Sender<(String, Result<Asked, PoolError>)>,
}

impl Bench {
    fn new(base_url: &str, max_connections: u32, max_retries: u32, timeout: Duration) -> Self {
        Self::with_cache(base_url, max_connections, max_retries, timeout, None)
    }

    fn with_cache(
        base_url: &str,
        max_connections: u32,
        max_retries: u32,
        timeout: Duration,
        cache: Option<ResponseCache>,
    ) -> Self {
        let endpoint = Endpoint::new(base_url, Secret::new(KEY)).unwrap();
        let client = Client::new(endpoint, Settings { model: "m".into(), timeout, max_retries });
        let settings = PoolSettings { max_connections, ..PoolSettings::default() };
        let (tell, done) = mpsc::channel();
        Self { pool: Pool::new(client, settings, cache), done, tell }
    }

    fn submit(&self, text: &str) {
        let (tell, name) = (self.tell.clone(), text.to_owned());
        self.pool.submit(job(text), move |result| drop(tell.send((name, result))));
    }

    fn next(&self) -> (String, Result<Asked, PoolError>) {
        let (name, result) = self.done.recv_timeout(WATCHDOG).expect("the pool hangs");
        assert!(!format!("{result:?}").contains(KEY), "the key is out");
        (name, result)
    }

    fn answer(&self) -> (String, Asked) {
        let (name, result) = self.next();
        (name, result.unwrap())
    }

    fn error(&self) -> PoolError {
        self.next().1.unwrap_err()
    }
}

#[test]
fn forty_at_once_come_back_in_any_order_each_with_its_own_reply() {
    let together = std::sync::Barrier::new(40);
    let server = Server::concurrent(move |request| {
        // Nobody is answered before all are here.
        together.wait();
        Turn::says(&format!("re: {}", text(request)))
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), 40, 0, WATCHDOG);
    let names: BTreeSet<String> = (0..40).map(|i| format!("lane {i}")).collect();
    names.iter().for_each(|name| bench.submit(name));
    let mut answered = BTreeSet::new();
    for _ in 0..40 {
        let (name, asked) = bench.answer();
        assert_eq!(asked.reply.outcome, Outcome::Text(format!("re: {name}")));
        assert!(asked.sent_ns > 0 && asked.answered_ns >= asked.sent_ns);
        assert_eq!((asked.attempts, asked.from_cache), (1, false));
        answered.insert(name);
    }
    assert_eq!(answered, names);
    assert_eq!(bench.done.try_recv().err(), Some(mpsc::TryRecvError::Empty));
}

#[test]
fn what_passes_is_asked_again_and_nothing_is_lost_or_doubled() {
    for turn in [
        fails(500, "oh"),
        Turn::Close,
        Turn::Half(completion("North.").to_string()),
        Turn::json(200, &json!({"error": {"message": "upstream died"}})),
        Turn::Answer { status: 200, headers: vec![], body: "{\"choices\": [".to_owned() },
    ] {
        let server = Server::turns([turn.clone(), Turn::says("North.")]).unwrap();
        let bench = Bench::new(&server.base_url(), 4, 2, WATCHDOG);
        bench.submit("a");
        let (_, asked) = bench.answer();
        assert_eq!(asked.reply.outcome, Outcome::Text("North.".into()), "{turn:?}");
        assert_eq!(asked.attempts, 2, "{turn:?}");
        assert_eq!(server.received().len(), 2, "{turn:?}");
    }
}

#[test]
fn one_that_hangs_or_trickles_holds_up_nobody_else() {
    let server = Server::concurrent(|request| match text(request) {
        "hang" => Turn::Hang,
        "trickle" => Turn::Trickle(completion("never").to_string().repeat(99)),
        _ => Turn::says("North."),
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), 3, 0, Duration::from_secs(2));
    for name in ["hang", "trickle", "a", "b", "c", "d"] {
        bench.submit(name);
    }
    for _ in 0..4 {
        let (name, _) = bench.answer();
        assert_eq!(name.len(), 1);
    }
    for _ in 0..2 {
        let error = bench.error();
        let PoolError::Failed(ChatError::GaveUp { last: Passing::Timeout(_), .. }) = error else {
            panic!("{error:?}")
        };
    }
}

#[test]
fn too_many_requests_make_them_fewer_and_all_are_answered() {
    // Takes two at once, and says so to the others.
    let (now, refused) = (AtomicUsize::new(0), Arc::new(AtomicUsize::new(0)));
    let counter = Arc::clone(&refused);
    let server = Server::concurrent(move |_| {
        let turn = if now.fetch_add(1, Ordering::SeqCst) < 2 {
            thread::sleep(Duration::from_millis(30));
            Turn::says("North.")
        } else {
            counter.fetch_add(1, Ordering::SeqCst);
            fails(429, "slow down").with("Retry-After: 0")
        };
        now.fetch_sub(1, Ordering::SeqCst);
        turn
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), 16, 9, WATCHDOG);
    (0..40).for_each(|i| bench.submit(&format!("lane {i}")));
    let attempts: u32 = (0..40).map(|_| bench.answer().1.attempts).sum();
    assert_eq!(attempts as usize, 40 + refused.load(Ordering::SeqCst));
    assert!(refused.load(Ordering::SeqCst) > 0);
    assert!(bench.pool.shared.lock().queue.allowed() < 16);
}

#[test]
fn a_retry_after_holds_back_everybody() {
    let arrived = Arc::new(Mutex::new(Vec::new()));
    let log = Arc::clone(&arrived);
    let server = Server::start(move |request| {
        let mut arrived = log.lock().unwrap();
        arrived.push((text(request).to_owned(), Instant::now()));
        match arrived.len() {
            1 => fails(429, "slow down").with("Retry-After: 1"),
            _ => Turn::says("North."),
        }
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), 1, 3, WATCHDOG);
    ["a", "b", "c"].into_iter().for_each(|name| bench.submit(name));
    for _ in 0..3 {
        bench.answer();
    }
    let arrived = arrived.lock().unwrap();
    let (first, second) = (arrived[0].1, arrived[1].1);
    // A lower bound: to wait longer is no fault.
    assert!(second.duration_since(first) >= Duration::from_secs(1), "{arrived:?}");
}

#[test]
fn a_refusal_concerns_its_own_request_once_the_server_has_answered() {
    let message = "At most 8 image(s) may be provided in one request.";
    let server = Server::start(move |request| match text(request) {
        "too many" => fails(400, message),
        _ => Turn::says("North."),
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), 2, 5, WATCHDOG);
    bench.submit("too many");
    let PoolError::Failed(error) = bench.error() else { panic!("one request, not all") };
    assert!(error.to_string().contains(message), "{error}");
    assert_eq!(server.received().len(), 1, "no other 4xx is asked again");
    bench.submit("fine");
    bench.answer();
}

#[test]
fn what_everybody_would_be_told_stops_the_run() {
    for (turn, expected) in [
        (fails(401, "who is sk-very-secret?"), "status 401: who is [key]?; check OPENAI_API_KEY"),
        (fails(404, "no such model"), "check the model's name and the base URL"),
        (fails(429, "quota").with("Retry-After: 86400"), "left alone for 86400 s"),
        (
            Turn::Answer {
                status: 200,
                headers: vec!["Content-Type: text/html".into()],
                body: "<html>".into(),
            },
            "text/html, not JSON",
        ),
    ] {
        let server = Server::start(move |_| turn.clone()).unwrap();
        let bench = Bench::new(&server.base_url(), 2, 5, WATCHDOG);
        bench.submit("a");
        let PoolError::Gone(why) = bench.error() else { panic!("all of them") };
        assert!(why.starts_with("the server refuses every request: "), "{why}");
        assert!(why.contains(expected), "{why}");
        bench.submit("b");
        assert_eq!(bench.error(), PoolError::Gone(why));
        assert_eq!(server.received().len(), 1);
    }
}

#[test]
fn a_server_that_is_not_there_is_gone_after_one_request() {
    let server = Server::turns([]).unwrap();
    let base_url = server.base_url();
    drop(server);
    let bench = Bench::new(&base_url, 4, 1, WATCHDOG);
    bench.submit("a");
    let PoolError::Gone(why) = bench.error() else { panic!("nobody is there") };
    insta::assert_snapshot!(
        why.replace(&base_url, "E"),
        @"the server is gone (attempts in a row without an answer: 2): E/chat/completions gave no reply (attempts: 2); the last time: there is no connection: Connection refused (os error 111); is the server running?; see what `memtransfer doctor --policy openai` says, and start the same again when the server is back"
    );
    bench.submit("b");
    assert_eq!(bench.error(), PoolError::Gone(why));
}

#[test]
fn a_server_that_dies_is_gone_and_what_waits_is_told_so() {
    let server = Server::start(|request| match text(request) {
        "good" => Turn::says("North."),
        _ => fails(503, "out of memory"),
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), 1, 0, WATCHDOG);
    let story = "bad bad good bad bad bad good good";
    story.split(' ').for_each(|name| bench.submit(name));
    let story: Vec<String> = (0..8)
        .map(|_| match bench.next() {
            (_, Ok(_)) => "reply".to_owned(),
            (_, Err(PoolError::Failed(_))) => "failed".to_owned(),
            (_, Err(PoolError::Gone(why))) => why.replace(&server.base_url(), "E"),
        })
        .collect();
    let gone = "the server is gone (attempts in a row without an answer: 3): E/chat/completions gave no reply \
                (attempts: 1); the last time: status 503: out of memory; see what `memtransfer doctor --policy \
                openai` says, and start the same again when the server is back";
    assert_eq!(story, ["failed", "failed", "reply", "failed", "failed", gone, gone, gone]);
    assert_eq!(server.received().len(), 6);
}

#[test]
fn a_pool_that_is_dropped_waits_for_nobody_and_everybody_is_told() {
    let server = Server::concurrent(|_| Turn::Hang).unwrap();
    let Bench { pool, done, tell } = Bench::new(&server.base_url(), 1, 9, Duration::from_secs(2));
    for name in ["in flight", "waiting"] {
        let tell = tell.clone();
        pool.submit(job(name), move |result| drop(tell.send((name.to_owned(), result))));
        while name == "in flight" && server.received().is_empty() {
            thread::sleep(Duration::from_millis(1));
        }
    }
    drop((pool, tell));
    for expected in ["waiting", "in flight"] {
        let (name, result) = done.recv_timeout(WATCHDOG).unwrap();
        assert_eq!(name, expected);
        assert!(matches!(result, Err(PoolError::Gone(why)) if why.contains("was ended")));
    }
    assert_eq!(done.recv_timeout(WATCHDOG).err(), Some(RecvTimeoutError::Disconnected));
}

#[test]
fn a_known_reply_needs_no_connection_and_a_failure_is_never_known() {
    let folder = tempfile::tempdir().unwrap();
    let cache = || Some(ResponseCache::at(folder.path()));
    let server = Server::turns([
        fails(400, "too long"),
        Turn::says("North."),
        Turn::json(200, &json!({"error": {"message": "upstream died"}})),
        Turn::says("South."),
    ])
    .unwrap();
    let base_url = server.base_url();
    let bench = Bench::with_cache(&base_url, 1, 1, WATCHDOG, cache());
    bench.submit("a");
    assert!(matches!(bench.error(), PoolError::Failed(_)));
    for (name, attempts, from_cache) in [("a", 1, false), ("a", 0, true), ("b", 2, false)] {
        bench.submit(name);
        let (_, asked) = bench.answer();
        assert_eq!((asked.attempts, asked.from_cache), (attempts, from_cache), "{name}");
    }
    drop(server);
    // Nobody is there any more, nor is this pool the one that asked.
    let bench = Bench::with_cache(&base_url, 1, 0, WATCHDOG, cache());
    for (name, expected) in [("a", "North."), ("b", "South.")] {
        bench.submit(name);
        let (_, asked) = bench.answer();
        assert_eq!(asked.reply.outcome, Outcome::Text(expected.into()));
        assert_eq!(asked.reply.prompt_tokens, Some(10), "what it cost when it was new");
        assert!(asked.from_cache);
    }
    let again = Job { repeat: 1, ..job("a") };
    let tell = bench.tell.clone();
    bench.pool.submit(again, move |result| drop(tell.send(("again".into(), result))));
    assert!(matches!(bench.error(), PoolError::Gone(_)), "another repetition is another question");
}

#[test]
fn known_replies_come_while_every_connection_hangs() {
    let folder = tempfile::tempdir().unwrap();
    let cache = ResponseCache::at(folder.path());
    let server = Server::concurrent(|request| match text(request) {
        "hang" => Turn::Hang,
        _ => Turn::says("North."),
    })
    .unwrap();
    let bench = Bench::with_cache(&server.base_url(), 2, 0, WATCHDOG, Some(cache));
    bench.submit("a");
    bench.answer();
    ["hang", "hang", "hang"].into_iter().for_each(|name| bench.submit(name));
    bench.submit("a");
    assert!(bench.answer().1.from_cache);
}

#[test]
fn a_cache_that_cannot_be_written_costs_no_reply() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let server = Server::start(|_| Turn::says("North.")).unwrap();
    let bench =
        Bench::with_cache(&server.base_url(), 2, 0, WATCHDOG, Some(ResponseCache::at(file)));
    ["a", "b"].into_iter().for_each(|name| bench.submit(name));
    for _ in 0..2 {
        assert!(!bench.answer().1.from_cache);
    }
}
