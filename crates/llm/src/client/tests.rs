//! The client against a scripted server, over real sockets. No test asserts a maximum duration; what could hang has a
//! watchdog.

use std::collections::BTreeSet;
use std::sync::Mutex;
use std::sync::atomic::AtomicUsize;
use std::sync::mpsc::{Receiver, Sender, channel};

use serde_json::json;

use super::*;
use crate::error::{RequestError, Transient};
use crate::reply::ReplyContent;
use crate::request::Dialect;
use crate::{ApiKey, EndpointLimit};
use rigs::chat_server::{Reaction, Received, Server, completion};

const KEY: &str = "sk-very-secret";

/// Longer than any of these tests should take.
const WATCHDOG: Duration = Duration::from_secs(600);

fn text(request: &Received) -> &str {
    request.body.pointer("/messages/0/content").and_then(|text| text.as_str()).unwrap_or_default()
}

fn fails(status: u16, message: &str) -> Reaction {
    Reaction::json(status, &json!({"error": {"message": message}}))
}

/// A reply with status 200 that ended for this reason.
fn finished(text: &str, finish_reason: &str) -> Reaction {
    let mut reply = completion(text);
    reply["choices"][0]["finish_reason"] = json!(finish_reason);
    Reaction::json(200, &reply)
}

/// A reply without tokens, with `value` as a field of the object at `place`.
fn inside(place: &str, field: &str, value: serde_json::Value) -> Reaction {
    let mut reply = completion("mov");
    reply["usage"]["completion_tokens"] = json!(0);
    reply.pointer_mut(place).unwrap()[field] = value;
    Reaction::json(200, &reply)
}

fn settings(max_connections: u32, max_retries: u32) -> ChatSettings {
    ChatSettings {
        max_connections,
        max_retries,
        server_patience: Duration::ZERO,
        ..ChatSettings::new("m")
    }
}

/// A client, and the results of its requests in the order in which they ended.
struct Bench {
    client: ChatClient,
    done: Receiver<(String, Result<ChatAnswer, AskError>)>,
    tell: Sender<(String, Result<ChatAnswer, AskError>)>,
}

impl Bench {
    fn new(base_url: &str, settings: ChatSettings) -> Self {
        Self::with_cache(base_url, settings, None)
    }

    fn with_cache(base_url: &str, settings: ChatSettings, cache: Option<ReplyCache>) -> Self {
        let endpoint = Endpoint::new(base_url, ApiKey::new(KEY)).unwrap();
        let (tell, done) = channel();
        Self { client: ChatClient::new(endpoint, settings, cache), done, tell }
    }

    fn submit(&self, text: &str) {
        self.submit_repeat(text, 0);
    }

    fn submit_repeat(&self, text: &str, repeat: u32) {
        let (tell, name) = (self.tell.clone(), text.to_owned());
        let request = ChatRequest::text(text, 30);
        self.client.submit(request, repeat, move |result| drop(tell.send((name, result))));
    }

    fn next(&self) -> (String, Result<ChatAnswer, AskError>) {
        let (name, result) = self.done.recv_timeout(WATCHDOG).expect("the client hangs");
        assert!(!format!("{result:?}").contains(KEY), "the output contains the key");
        (name, result)
    }

    fn answer(&self) -> (String, ChatAnswer) {
        let (name, result) = self.next();
        (name, result.unwrap())
    }

    fn error(&self) -> AskError {
        self.next().1.unwrap_err()
    }
}

#[test]
fn forty_requests_at_once_get_their_own_replies() {
    let together = std::sync::Barrier::new(40);
    let server = Server::concurrent(move |request| {
        // No reply before all forty are here.
        together.wait();
        Reaction::says(&format!("re: {}", text(request)))
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), settings(40, 0));
    let names: BTreeSet<String> = (0..40).map(|i| format!("lane {i}")).collect();
    names.iter().for_each(|name| bench.submit(name));
    let mut answered = BTreeSet::new();
    for _ in 0..40 {
        let (name, answer) = bench.answer();
        assert_eq!(answer.reply.content, ReplyContent::Text(format!("re: {name}")));
        assert!(answer.sent_ns > 0 && answer.answered_ns >= answer.sent_ns);
        assert_eq!((answer.attempts, answer.from_cache), (1, false));
        answered.insert(name);
    }
    assert_eq!(answered, names);
}

#[test]
fn a_request_carries_key_and_body() {
    let server = Server::turns([Reaction::says("North.")]).unwrap();
    let bench = Bench::new(&server.base_url(), settings(1, 0));
    let request = ChatRequest { choices: vec!["go".to_owned()], ..ChatRequest::text("Where?", 30) };
    let reply = bench.client.ask(&request, 0).unwrap().reply;
    assert_eq!((reply.text(), reply.model.as_deref()), ("North.", Some("scripted")));
    assert_eq!((reply.prompt_tokens, reply.completion_tokens), (Some(10), Some(5)));
    let [received] = &server.received()[..] else { panic!("one request") };
    assert_eq!(received.line, "POST /v1/chat/completions HTTP/1.1");
    let body =
        serde_json::to_value(Dialect::default().body(&ChatSettings::new("m"), &request)).unwrap();
    assert_eq!(received.body, body);
    let authorization = format!("authorization: bearer {KEY}");
    assert!(received.headers.iter().any(|header| header.to_lowercase() == authorization));
    assert!(!format!("{:?}", bench.client).contains(KEY));
}

#[test]
fn transient_failures_are_retried() {
    let past = "Retry-After: Sun, 06 Nov 1994 08:49:37 GMT";
    for turn in [
        fails(408, "try again"),
        fails(409, "try again"),
        fails(421, "try again"),
        fails(424, "try again"),
        fails(425, "try again"),
        fails(499, "try again"),
        fails(429, "slow down").with(past),
        fails(500, "oh"),
        Reaction::Close,
        Reaction::Half(completion("North.").to_string()),
        Reaction::json(200, &json!({"error": {"message": "upstream died"}})),
        Reaction::Answer { status: 200, headers: vec![], body: "{\"choices\": [".to_owned() },
        finished("mov", "error"),
        finished("", "abort"),
        inside("/choices/0", "error", json!({"code": 502, "message": "upstream died"})),
        inside("/choices/0", "message", json!(null)),
        inside("/choices/0/message", "content", json!("")),
    ] {
        let server = Server::turns([turn.clone(), Reaction::says("North.")]).unwrap();
        let bench = Bench::new(&server.base_url(), settings(4, 2));
        bench.submit("a");
        let (_, answer) = bench.answer();
        assert_eq!(answer.reply.text(), "North.", "{turn:?}");
        assert_eq!((answer.attempts, server.received().len()), (2, 2), "{turn:?}");
        assert_eq!(server.received()[0].body, server.received()[1].body);
    }
}

/// Servers without authentication get keys that are common words: they change nothing in a reply, and in what is shown of it.
#[test]
fn a_key_changes_nothing_in_a_reply() {
    for key in ["1", "token", "North", "prompt_tokens", "scripted"] {
        let server =
            Server::turns([Reaction::says("North. 1 token"), fails(400, "a token")]).unwrap();
        let endpoint = Endpoint::new(&server.base_url(), ApiKey::new(key)).unwrap();
        let client = ChatClient::new(endpoint, settings(1, 0), None);
        let reply = client.ask(&ChatRequest::text("a", 9), 0).unwrap().reply;
        assert_eq!((reply.prompt_tokens, reply.completion_tokens), (Some(10), Some(5)), "{key}");
        assert_eq!(reply.content, ReplyContent::Text("North. 1 token".to_owned()), "{key}");
        let error = client.ask(&ChatRequest::text("b", 9), 0).unwrap_err().to_string();
        assert!(error.contains("status 400: a token"), "{error}");
    }
}

#[test]
fn requests_that_hang_or_trickle_delay_no_others() {
    let server = Server::concurrent(|request| match text(request) {
        "hang" => Reaction::Hang,
        "trickle" => Reaction::Trickle(completion("never").to_string().repeat(99)),
        _ => Reaction::says("North."),
    })
    .unwrap();
    let timeout = Duration::from_secs(10);
    let bench =
        Bench::new(&server.base_url(), ChatSettings { request_timeout: timeout, ..settings(3, 0) });
    for name in ["hang", "trickle", "a", "b", "c", "d"] {
        bench.submit(name);
    }
    for _ in 0..4 {
        assert_eq!(bench.answer().0.len(), 1);
    }
    for _ in 0..2 {
        let error = bench.error();
        let AskError::Failed(RequestError::GaveUp { last: Transient::Timeout(_), .. }) = error
        else {
            panic!("{error:?}")
        };
        assert!(error.to_string().contains("--request-timeout"), "{error}");
    }
}

/// A server that takes 500 ms per request, one after the other, and is asked by eight at once with a deadline of
/// 1500 ms. It computes all the time, and every request gets its reply.
#[test]
fn a_slow_server_answers_every_request() {
    let server = Server::start(|_| {
        thread::sleep(Duration::from_millis(500));
        Reaction::says("North.")
    })
    .unwrap();
    let timeout = Duration::from_millis(1500);
    let bench =
        Bench::new(&server.base_url(), ChatSettings { request_timeout: timeout, ..settings(8, 5) });
    (0..16).for_each(|i| bench.submit(&format!("lane {i}")));
    for _ in 0..16 {
        bench.answer();
    }
}

#[test]
fn status_429_reduces_requests_in_flight() {
    // Takes two at once and refuses the others.
    let (now, refused) = (AtomicUsize::new(0), Arc::new(AtomicUsize::new(0)));
    let counter = Arc::clone(&refused);
    let server = Server::concurrent(move |_| {
        let turn = if now.fetch_add(1, Ordering::SeqCst) < 2 {
            // Until others have come.
            while counter.load(Ordering::SeqCst) == 0 {
                thread::sleep(Duration::from_millis(1));
            }
            Reaction::says("North.")
        } else {
            counter.fetch_add(1, Ordering::SeqCst);
            fails(429, "slow down").with("Retry-After: 0")
        };
        now.fetch_sub(1, Ordering::SeqCst);
        turn
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), settings(16, 9));
    (0..40).for_each(|i| bench.submit(&format!("lane {i}")));
    let attempts: u32 = (0..40).map(|_| bench.answer().1.attempts).sum();
    assert_eq!(attempts as usize, 40 + refused.load(Ordering::SeqCst));
    assert!(refused.load(Ordering::SeqCst) > 0);
}

#[test]
fn a_retry_after_delays_every_request() {
    let arrived = Arc::new(Mutex::new(Vec::new()));
    let log = Arc::clone(&arrived);
    let server = Server::start(move |_| {
        let mut arrived = log.lock().unwrap();
        arrived.push(Instant::now());
        match arrived.len() {
            1 => fails(429, "slow down").with("Retry-After: 1"),
            _ => Reaction::says("North."),
        }
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), settings(1, 3));
    ["a", "b", "c"].into_iter().for_each(|name| bench.submit(name));
    for _ in 0..3 {
        bench.answer();
    }
    let arrived = arrived.lock().unwrap();
    assert!(arrived[1].duration_since(arrived[0]) >= Duration::from_secs(1), "{arrived:?}");
}

#[test]
fn a_refusal_concerns_one_request_and_is_not_retried() {
    let message = "At most 8 image(s) may be provided in one request";
    let server = Server::start(move |request| match text(request) {
        "too many" => fails(400, message),
        _ => Reaction::says("North."),
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), settings(2, 5));
    bench.submit("too many");
    let AskError::Failed(error) = bench.error() else { panic!("one request, not all") };
    assert!(error.to_string().contains(message), "{error}");
    assert_eq!(server.received().len(), 1);
    bench.submit("fine");
    bench.answer();
}

#[test]
fn errors_that_concern_every_request_stop_the_client() {
    let html = |status, header: &str| Reaction::Answer {
        status,
        headers: vec![header.to_owned()],
        body: "<html><title>Sign in</title></html>".to_owned(),
    };
    for (turn, expected) in [
        (fails(401, "who is sk-very-secret?"), "status 401: who is [key]?; check OPENAI_API_KEY"),
        (fails(404, "no such model"), "check the model's name and the base URL"),
        (fails(429, "quota").with("Retry-After: 86400"), "a pause of 86400 s"),
        (html(200, "Content-Type: text/html; charset=utf-8"), "with a web page: Sign in;"),
        (
            quota(),
            "status 429: You exceeded your current quota; the account of this key has nothing left",
        ),
        (
            Reaction::json(200, &json!({"error": {"code": 402, "message": "no credit"}})),
            "status 402: no credit",
        ),
        (fails(403, "no"), "status 403: no; check OPENAI_API_KEY"),
        (
            fails(500, "Conversation roles must alternate user/assistant"),
            "status 500: Conversation roles must alternate user/assistant; the model's chat template cannot render the conversation: try --system-role user",
        ),
        (
            fails(400, "Only user and assistant roles are supported, got system"),
            "status 400: Only user and assistant roles are supported, got system; the model's chat template cannot render the conversation: try --system-role user",
        ),
        (html(308, "Location: https://x/v1/"), "a redirection to https://x/v1/"),
    ] {
        // Before the first reply and, unless it is a name that may be missing for a while, after it.
        for replies in [0, 1] {
            if replies == 1 && expected.contains("the model's name") {
                continue;
            }
            let (mut asked, turn) = (0, turn.clone());
            let server = Server::start(move |_| {
                asked += 1;
                if asked > replies { turn.clone() } else { Reaction::says("North.") }
            })
            .unwrap();
            let bench = Bench::new(&server.base_url(), settings(2, 5));
            (0..replies).for_each(|number| {
                bench.submit(&number.to_string());
                bench.answer();
            });
            bench.submit("a");
            let AskError::Stopped(why) = bench.error() else { panic!("all of them") };
            assert!(why.starts_with("the server refuses every request: "), "{why}");
            assert!(why.contains(expected), "{why}");
            bench.submit("b");
            assert_eq!(bench.error(), AskError::Stopped(why));
            assert_eq!(server.received().len(), replies + 1);
        }
    }
}

/// OpenAI's answer to an account without a quota.
fn quota() -> Reaction {
    let error = json!({"message": "You exceeded your current quota", "code": "insufficient_quota"});
    Reaction::json(429, &json!({"error": error}))
}

/// Bytes around a reply that servers and proxies add.
#[test]
fn a_reply_is_read_whatever_is_around_it() {
    let whole = completion("North.").to_string();
    let with = |header: &str, body: String| Reaction::Answer {
        status: 200,
        headers: vec![header.to_owned()],
        body,
    };
    let json = "Content-Type: application/json";
    let chunk = json!({"choices": [{"delta": {"content": "North."}, "finish_reason": "stop"}],
        "usage": {"completion_tokens": 5}});
    let mut compressed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    std::io::Write::write_all(&mut compressed, whole.as_bytes()).unwrap();
    let body = compressed.finish().unwrap();
    for turn in [
        Reaction::Bytes { headers: vec![json.to_owned()], body: body.clone() },
        Reaction::Bytes { headers: vec!["Content-Encoding: gzip".to_owned()], body },
        with("Content-Type: text/plain; charset=utf-8", whole.clone()),
        with("Content-Type: text/event-stream", whole.clone()),
        with("X-No-Type: 1", whole.clone()),
        with(json, format!("\u{feff}{whole}")),
        with(json, format!("\n\n  {whole}")),
        with(json, whole.replacen('{', "{\"timing\": NaN, ", 1)),
        with(json, format!("{whole}\n\ndata: [DONE]\n\n")),
        with("Content-Type: text/event-stream", format!("data: {chunk}\n\ndata: [DONE]\n\n")),
    ] {
        let server = Server::turns([turn.clone()]).unwrap();
        let bench = Bench::new(&server.base_url(), settings(1, 0));
        bench.submit("a");
        let (_, answer) = bench.answer();
        assert_eq!(answer.reply.text(), "North.", "{turn:?}");
        assert_eq!(answer.reply.completion_tokens, Some(5), "{turn:?}");
    }
}

#[test]
fn what_cannot_be_read_is_described() {
    for (body, expected) in [
        ("", "it is empty"),
        ("Bad Gateway", "it begins with \"Bad Gateway\""),
        ("data: {\"choices\":[{\"delta\":{}}]}\n\n", "its stream breaks off"),
    ] {
        let turn = Reaction::Answer { status: 200, headers: vec![], body: body.to_owned() };
        let server = Server::start(move |_| turn.clone()).unwrap();
        let bench = Bench::new(&server.base_url(), settings(1, 0));
        bench.submit("a");
        let error = bench.error().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn servers_of_different_models_are_refused() {
    let servers = ["/models/a.gguf", "/other/b.gguf"].map(|model| {
        Server::concurrent(move |_| {
            let mut reply = completion("North.");
            reply["model"] = json!(model);
            Reaction::json(200, &reply)
        })
        .unwrap()
    });
    let [first, second] =
        servers.each_ref().map(|server| Endpoint::new(&server.base_url(), None).unwrap());
    let mut bench = Bench::new(&servers[0].base_url(), settings(4, 0));
    bench.client = ChatClient::balanced(first, vec![second], settings(4, 0), None);
    (0..8).for_each(|number| bench.submit(&number.to_string()));
    let stopped = (0..8).find_map(|_| match bench.next().1 {
        Err(AskError::Stopped(why)) => Some(why),
        _ => None,
    });
    let why = stopped.unwrap();
    assert!(why.contains(" as a.gguf") && why.contains(" as b.gguf"), "{why}");
}

/// Headers of the user go with each request, and what a server repeats of them is masked.
#[test]
fn headers_and_options_are_sent() {
    let server = Server::turns([fails(400, "not for sk-header-secret")]).unwrap();
    let headers = ["X-Secret: sk-header-secret".parse().unwrap()];
    let base_url = format!("{}?api-version=2024-10-21", server.base_url());
    let endpoint = Endpoint::new(&base_url, ApiKey::new(KEY)).unwrap();
    let endpoint = endpoint.with_headers(&headers).unwrap();
    let mut settings = settings(1, 0);
    settings.options.system_role = domain::SystemRole::User;
    settings.options.extra_body.insert("top_k".to_owned(), json!(1));
    let client = ChatClient::new(endpoint, settings, None);
    let error = client.ask(&ChatRequest::text("a", 9), 0).unwrap_err().to_string();
    assert!(error.contains("not for [key]"), "{error}");
    let [received] = &server.received()[..] else { panic!("one request") };
    assert_eq!(received.line, "POST /v1/chat/completions?api-version=2024-10-21 HTTP/1.1");
    let headers = received.headers.join("\n").to_lowercase();
    assert!(
        headers.contains("x-secret: sk-header-secret")
            && headers.contains(&format!("api-key: {KEY}"))
    );
    assert!(!headers.contains("authorization"));
    assert_eq!(received.body["top_k"], 1);
}

/// A context that is too short for every request ends the run after a few of them.
#[test]
fn a_400_to_every_request_stops_the_client_and_names_the_image_budget() {
    let server = Server::start(|_| fails(400, "maximum context length is 8192 tokens")).unwrap();
    let bench = Bench::new(&server.base_url(), settings(1, 5));
    let image = crate::ImageUrl::of_bytes("image/png", b"x");
    let parts = vec![crate::ContentPart::ImageUrl { image_url: image }];
    let content = crate::MessageContent::Parts(parts);
    let message = crate::ChatMessage { role: crate::ChatRole::User, content };
    let request = ChatRequest { messages: vec![message], max_tokens: 30, choices: Vec::new() };
    let errors: Vec<_> = (0..6).map(|_| bench.client.ask(&request, 0).unwrap_err()).collect();
    assert!(matches!(errors[0], AskError::Failed(_)));
    let AskError::Stopped(why) = &errors[5] else { panic!("{errors:?}") };
    assert!(why.contains("the request has 1 image: lower --image-budget"), "{why}");
    assert_eq!(server.received().len(), 5);
}

#[test]
fn a_refused_field_is_left_out_from_then_on() {
    let server = Server::start(|request| {
        let fields = ["chat_template_kwargs", "temperature"];
        match fields.iter().find(|field| request.body.get(**field).is_some()) {
            Some(field) => fails(400, &format!("Unknown parameter: '{field}'.")),
            None => Reaction::says("North."),
        }
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), settings(1, 0));
    for requests in [3, 4] {
        assert_eq!(bench.client.ask(&ChatRequest::text("?", 9), 0).unwrap().attempts, 1);
        assert_eq!(server.received().len(), requests);
    }
    assert!(server.received()[3].body.get("reasoning_effort").is_some());
    assert_eq!(bench.client.refused_fields(), ["chat_template_kwargs", "temperature"]);
}

/// A server that refuses all fields that it does not know, with status 422 and without a message.
#[test]
fn a_strict_server_gets_the_fields_that_it_knows() {
    let accepted = ["model", "messages", "temperature", "max_tokens", "stream"];
    let server = Server::start(move |request| {
        let fields = request.body.as_object().unwrap().keys();
        let others = fields.filter(|field| !accepted.contains(&field.as_str()));
        let detail: Vec<_> = others
            .map(|field| json!({"type": "extra_forbidden", "loc": ["body", field]}))
            .collect();
        match detail.is_empty() {
            true => Reaction::says("North."),
            false => Reaction::json(422, &json!({"detail": detail})),
        }
    })
    .unwrap();
    let bench = Bench::new(&server.base_url(), settings(1, 0));
    let request = ChatRequest { choices: vec!["North.".to_owned()], ..ChatRequest::text("?", 9) };
    assert_eq!(bench.client.ask(&request, 0).unwrap().attempts, 1);
    assert_eq!(server.received().len(), 3, "with all, with response_format, with none");
    let kept = server.received()[2].body.as_object().unwrap().len();
    assert_eq!((kept, bench.client.refused_fields().len()), (accepted.len(), 8));
}

/// A field that the message of another error only mentions stays as it is.
#[test]
fn a_word_in_another_error_changes_no_field() {
    let message = "This model's maximum context length is 4096 tokens; max_completion_tokens was reduced. Thinking tokens \
                   count, as do those of thinking.";
    let server = Server::turns([fails(400, message), Reaction::says("North.")]).unwrap();
    let bench = Bench::new(&server.base_url(), settings(1, 0));
    bench.submit("a");
    assert!(bench.error().to_string().contains("maximum context length"));
    bench.submit("b");
    bench.answer();
    let [first, second] = &server.received()[..] else { panic!("two requests") };
    let fields =
        |body: &serde_json::Value| body.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!(fields(&first.body), fields(&second.body));
}

#[test]
fn a_server_that_is_not_there_stops_the_client() {
    // A port that no other test is given.
    let base_url = "http://127.0.0.1:9/v1";
    let bench = Bench::new(base_url, settings(4, 1));
    bench.submit("a");
    let AskError::Stopped(why) = bench.error() else { panic!("no server") };
    insta::assert_snapshot!(
        why.replace(base_url, "E"),
        @"the server is gone (no answer in 2 attempts): E/chat/completions gave no reply (attempts: 2); the last time: there is no connection: Connection refused (os error 111); is the server running?; check it with `memtransfer doctor --policy openai`, and start the same command again when it is back"
    );
    bench.submit("b");
    assert_eq!(bench.error(), AskError::Stopped(why));
}

/// A model server takes minutes to start again; `--max-retries` covers seconds.
#[test]
fn a_restarting_server_is_waited_for_and_reported() {
    let mut turns = vec![Reaction::says("North.")];
    turns.extend(vec![fails(503, "loading the model"); 3]);
    turns.push(Reaction::says("South."));
    let server = Server::turns(turns).unwrap();
    let patient = ChatSettings { server_patience: WATCHDOG, ..settings(2, 0) };
    let bench = Bench::new(&server.base_url(), patient);
    let told = Arc::new(Mutex::new(Vec::new()));
    let log = Arc::clone(&told);
    bench.client.on_waiting(move |text| log.lock().unwrap().push(text.map(str::to_owned)));
    for expected in ["North.", "South."] {
        bench.submit("a");
        assert_eq!(bench.answer().1.reply.text(), expected);
    }
    let told = told.lock().unwrap();
    let [first, .., last] = &told[..] else { panic!("{told:?}") };
    assert!(
        first.as_deref().unwrap().contains("loading the model); waiting up to 600 s"),
        "{told:?}"
    );
    assert_eq!((told.len(), last), (4, &None));
}

#[test]
fn stopping_ends_waiting_requests_at_once_and_the_others_after_their_attempt() {
    let server = Server::concurrent(|_| Reaction::Hang).unwrap();
    let timeout = Duration::from_secs(2);
    let bench =
        Bench::new(&server.base_url(), ChatSettings { request_timeout: timeout, ..settings(1, 9) });
    bench.submit("in flight");
    while server.received().is_empty() {
        thread::sleep(Duration::from_millis(1));
    }
    bench.submit("waiting");
    bench.client.stop("the run has ended");
    for expected in ["waiting", "in flight"] {
        let (name, result) = bench.next();
        assert_eq!(
            (name.as_str(), result),
            (expected, Err(AskError::Stopped("the run has ended".into())))
        );
    }
}

#[test]
fn stored_replies_need_no_connection_and_failures_are_never_stored() {
    let folder = tempfile::tempdir().unwrap();
    let cache = || Some(ReplyCache::at(folder.path()));
    let server = Server::turns([
        fails(400, "too long"),
        Reaction::says("North."),
        finished("Sou", "abort"),
        Reaction::json(200, &json!({"error": {"message": "upstream died"}})),
        Reaction::says("South."),
    ])
    .unwrap();
    let base_url = server.base_url();
    let bench = Bench::with_cache(&base_url, settings(1, 2), cache());
    bench.submit("a");
    assert!(matches!(bench.error(), AskError::Failed(_)));
    for (name, attempts, from_cache) in [("a", 1, false), ("a", 0, true), ("b", 3, false)] {
        bench.submit(name);
        let (_, answer) = bench.answer();
        assert_eq!((answer.attempts, answer.from_cache), (attempts, from_cache), "{name}");
    }
    drop(server);
    let bench = Bench::with_cache(&base_url, settings(1, 0), cache());
    for (name, expected) in [("a", "North."), ("b", "South.")] {
        bench.submit(name);
        let (_, answer) = bench.answer();
        assert_eq!(answer.reply.text(), expected);
        assert_eq!(answer.reply.prompt_tokens, Some(10), "as counted when it was new");
        assert!(answer.from_cache);
    }
    bench.submit_repeat("a", 1);
    assert!(matches!(bench.error(), AskError::Stopped(_)), "another repetition is another request");
}

#[test]
fn stored_replies_come_while_every_connection_hangs() {
    let folder = tempfile::tempdir().unwrap();
    let cache = ReplyCache::at(folder.path());
    let server = Server::concurrent(|request| match text(request) {
        "hang" => Reaction::Hang,
        _ => Reaction::says("North."),
    })
    .unwrap();
    let bench = Bench::with_cache(&server.base_url(), settings(2, 0), Some(cache));
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
    let server = Server::start(|_| Reaction::says("North.")).unwrap();
    let bench = Bench::with_cache(&server.base_url(), settings(2, 0), Some(ReplyCache::at(file)));
    ["a", "b"].into_iter().for_each(|name| bench.submit(name));
    for _ in 0..2 {
        assert!(!bench.answer().1.from_cache);
    }
}

/// A server that closes every connection while `down` is true.
fn fragile(down: &Arc<AtomicBool>) -> Server {
    let down = Arc::clone(down);
    let answer = move |request: &Received| match down.load(Ordering::SeqCst) {
        true => Reaction::Close,
        false => Reaction::says(text(request)),
    };
    Server::concurrent(answer).unwrap()
}

#[test]
fn servers_share_the_requests_and_a_lost_one_returns() {
    let downs = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
    let servers = downs.each_ref().map(fragile);
    let [first, second] =
        servers.each_ref().map(|server| Endpoint::new(&server.base_url(), None).unwrap());
    let mut bench = Bench::new(&servers[0].base_url(), settings(4, 0));
    bench.client = ChatClient::balanced(first, vec![second], settings(4, 0), None);
    let ask = |count: usize| {
        let received = || servers.each_ref().map(|server| server.received().len());
        let before = received();
        (0..count).for_each(|number| bench.submit(&number.to_string()));
        for _ in 0..count {
            let (name, answer) = bench.answer();
            assert_eq!(answer.reply.text(), name);
        }
        [0, 1].map(|server| received()[server] - before[server])
    };
    assert!(ask(40).iter().all(|count| *count > 0), "both are asked");

    // Without retries and patience of its own, each request is answered by the other server.
    downs[1].store(true, Ordering::SeqCst);
    let [served, tried] = ask(40);
    assert!(served == 40 && tried < 10, "{served} served, {tried} lost");

    downs[1].store(false, Ordering::SeqCst);
    let start = Instant::now();
    while ask(8)[1] < 2 {
        assert!(start.elapsed() < WATCHDOG, "the server that is back is not asked");
        thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_limit_holds_for_all_clients_that_share_its_folder() {
    let (now, most) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
    let (counted, highest) = (Arc::clone(&now), Arc::clone(&most));
    let server = Server::concurrent(move |_| {
        highest.fetch_max(1 + counted.fetch_add(1, Ordering::SeqCst), Ordering::SeqCst);
        // Until as many have come as may.
        while highest.load(Ordering::SeqCst) < 3 {
            thread::sleep(Duration::from_millis(1));
        }
        thread::sleep(Duration::from_millis(10));
        counted.fetch_sub(1, Ordering::SeqCst);
        Reaction::says("North.")
    })
    .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let limit = EndpointLimit { most: 3, folder: folder.path().to_owned() };
    let settings = ChatSettings { endpoint_limit: Some(limit), ..settings(16, 0) };
    let benches = [(); 2].map(|()| Bench::new(&server.base_url(), settings.clone()));
    for bench in &benches {
        (0..30).for_each(|number| bench.submit(&number.to_string()));
    }
    for bench in &benches {
        (0..30).for_each(|_| drop(bench.answer()));
    }
    assert_eq!(most.load(Ordering::SeqCst), 3);
}
