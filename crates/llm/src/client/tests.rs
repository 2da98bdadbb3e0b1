//! The client against a scripted server, over real sockets.

use std::sync::Mutex;

use serde_json::json;

use super::super::message::{Message, Speaker};
use super::super::reply::Outcome;
use super::super::scripted::{Server, Turn, completion};
use super::super::secret::Secret;
use super::*;

const KEY: &str = "sk-very-secret";

/// Long enough for any server that means to answer.
const PATIENCE: Duration = Duration::from_secs(60);

fn question() -> Question {
    Question { messages: vec![Message::text(Speaker::User, "Where?")], max_tokens: 30 }
}

/// The outcome of a question to a server that takes `turns`, what it received, and the pauses made.
struct Asked {
    result: Result<Reply, ChatError>,
    received: Vec<super::super::scripted::Received>,
    pauses: Vec<Duration>,
}

impl Asked {
    fn text(&self) -> &str {
        match &self.result {
            Ok(Reply { outcome: Outcome::Text(text), .. }) => text,
            other => panic!("{other:?}"),
        }
    }

    /// The error as people see it, which never holds the key.
    fn error(&self) -> String {
        let error = self.result.as_ref().unwrap_err();
        assert!(!format!("{error:?}").contains(KEY), "the key is out");
        error.to_string()
    }
}

fn client(server: &Server, timeout: Duration) -> (Client, Arc<Mutex<Vec<Duration>>>) {
    let endpoint = Endpoint::new(&server.base_url(), Secret::new(KEY)).unwrap();
    let settings = Settings { model: "m".to_owned(), timeout, max_retries: 2 };
    let pauses = Arc::<Mutex<Vec<Duration>>>::default();
    let log = Arc::clone(&pauses);
    let client =
        Client::sleeping_with(endpoint, settings, move |pause| log.lock().unwrap().push(pause));
    (client, pauses)
}

fn ask_within(timeout: Duration, turns: impl IntoIterator<Item = Turn>) -> Asked {
    let server = Server::turns(turns).unwrap();
    let (client, pauses) = client(&server, timeout);
    let result = client.ask(&question());
    let pauses = pauses.lock().unwrap().clone();
    // Where the server listens differs from test to test.
    let here = server.base_url();
    let result = result.map_err(|error| match error {
        ChatError::Refused { status, message, advice, .. } => {
            ChatError::Refused { endpoint: "E".into(), status, message, advice }
        }
        ChatError::NotChat { what, .. } => {
            ChatError::NotChat { endpoint: "E".into(), what: what.replace(&here, "E") }
        }
        ChatError::GaveUp { attempts, last, .. } => {
            ChatError::GaveUp { endpoint: "E".into(), attempts, last }
        }
        ChatError::Unsaid(_) => error,
    });
    Asked { result, received: server.received(), pauses }
}

fn ask(turns: impl IntoIterator<Item = Turn>) -> Asked {
    ask_within(PATIENCE, turns)
}

fn fails(status: u16, message: &str) -> Turn {
    Turn::json(status, &json!({"error": {"message": message}}))
}

#[test]
fn an_answer() {
    let asked = ask([Turn::says("North.")]);
    let reply = asked.result.as_ref().unwrap();
    assert_eq!(asked.text(), "North.");
    assert_eq!(reply.model.as_deref(), Some("scripted"));
    assert_eq!((reply.prompt_tokens, reply.completion_tokens), (Some(10), Some(5)));
    let [request] = &asked.received[..] else { panic!("one request") };
    assert_eq!(request.line, "POST /v1/chat/completions HTTP/1.1");
    let body = serde_json::to_value(Dialect::default().body("m", &question())).unwrap();
    assert_eq!(request.body, body);
    let authorization = format!("authorization: bearer {KEY}");
    assert!(request.headers.iter().any(|header| header.to_lowercase() == authorization));
}

#[test]
fn what_passes_is_asked_again() {
    let wrong_date = "Retry-After: Sun, 06 Nov 1994 08:49:37 GMT";
    for turn in [
        fails(429, "slow down").with("Retry-After: 0"),
        fails(429, "slow down").with(wrong_date),
        fails(500, "oh"),
        fails(503, "loading the model"),
        Turn::Close,
        Turn::Half(completion("North.").to_string()),
        Turn::json(200, &json!({"error": {"message": "upstream died"}})),
        Turn::Answer { status: 200, headers: vec![], body: "{\"choices\": [".to_owned() },
    ] {
        let asked = ask([turn.clone(), Turn::says("North.")]);
        assert_eq!(asked.text(), "North.", "{turn:?}");
        assert_eq!(asked.pauses.len(), 1, "{turn:?}");
        let [first, second] = &asked.received[..] else { panic!("two requests") };
        assert_eq!(first.body, second.body);
    }
}

#[test]
fn a_server_that_hangs_is_left_at_the_deadline_and_asked_again() {
    let asked = ask_within(Duration::from_secs(1), [Turn::Hang, Turn::says("North.")]);
    assert_eq!(asked.text(), "North.");
    assert_eq!(asked.received.len(), 2);
}

#[test]
fn the_pause_is_the_one_the_server_asks_for() {
    let date = "Date: Sun, 06 Nov 1994 08:49:37 GMT";
    let later = "Retry-After: Sun, 06 Nov 1994 08:50:07 GMT";
    let asked = ask([
        fails(429, "slow down").with("Retry-After: 7"),
        fails(503, "slow down").with(date).with(later),
        Turn::says("North."),
    ]);
    let seconds: Vec<u64> = asked.pauses.iter().map(Duration::as_secs).collect();
    assert_eq!(seconds, [7, 30]);
}

#[test]
fn what_does_not_pass_is_given_up() {
    let asked = ask(vec![fails(500, "oh"); 9]);
    assert_eq!(asked.received.len(), 3);
    insta::assert_snapshot!(asked.error(), @"E gave no reply (attempts: 3); the last time: status 500: oh");

    let asked = ask([fails(429, "quota").with("Retry-After: 86400")]);
    assert_eq!(asked.received.len(), 1);
    insta::assert_snapshot!(asked.error(), @"E gave no reply (attempts: 1); the last time: status 429: quota; it wants to be left alone for 86400 s: start again then");

    let asked = ask_within(Duration::from_millis(300), vec![Turn::Hang; 9]);
    insta::assert_snapshot!(asked.error(), @"E gave no reply (attempts: 3); the last time: no answer within 0.3 s; is the server running, and is --timeout long enough for it?");

    let asked = ask(vec![Turn::Half(completion("North.").to_string()); 9]);
    insta::assert_snapshot!(asked.error(), @"E gave no reply (attempts: 3); the last time: the connection failed: io: Peer disconnected; is the server running?");
}

#[test]
fn nobody_listens() {
    let server = Server::turns([]).unwrap();
    let (client, pauses) = client(&server, PATIENCE);
    drop(server);
    let error = client.ask(&question()).unwrap_err();
    assert!(error.to_string().contains("there is no connection"), "{error}");
    assert_eq!(pauses.lock().unwrap().len(), 2);
}

#[test]
fn a_refusal_is_final_and_says_what_to_do() {
    for (turn, expected) in [
        (
            fails(400, "This model's maximum context length is 8192 tokens"),
            "E refused the request with status 400: This model's maximum context length is 8192 tokens; see \
             whether the server knows the model and takes requests of this length",
        ),
        (
            fails(401, "Incorrect API key provided: sk-very-secret"),
            "E refused the request with status 401: Incorrect API key provided: [key]; check OPENAI_API_KEY",
        ),
        (
            fails(404, "no such model"),
            "E refused the request with status 404: no such model; check the model's name and the base URL, \
             which usually ends in /v1",
        ),
        (
            Turn::Answer {
                status: 200,
                headers: vec!["Content-Type: text/html; charset=utf-8".into()],
                body: "<html>".into(),
            },
            "E is no chat endpoint: it answered with text/html, not JSON; check the base URL, which usually \
             ends in /v1",
        ),
        (
            Turn::Answer {
                status: 308,
                headers: vec!["Location: https://x/v1/".into()],
                body: String::new(),
            },
            "E is no chat endpoint: it answered with a redirection to https://x/v1/; check the base URL, which \
             usually ends in /v1",
        ),
    ] {
        let asked = ask([turn]);
        assert_eq!(asked.error(), expected);
        assert_eq!(asked.received.len(), 1);
    }
}

#[test]
fn a_field_that_the_server_refuses_is_left_out_from_then_on() {
    let server = Server::start(|request| {
        match ["chat_template_kwargs", "thinking"]
            .iter()
            .find(|field| request.body.get(**field).is_some())
        {
            Some(field) => fails(400, &format!("Unknown parameter: '{field}'.")),
            None => Turn::says("North."),
        }
    })
    .unwrap();
    let (client, pauses) = client(&server, PATIENCE);
    for requests in [3, 4] {
        client.ask(&question()).unwrap();
        assert_eq!(server.received().len(), requests);
    }
    assert!(pauses.lock().unwrap().is_empty());
    assert!(server.received()[3].body.get("reasoning_effort").is_some());
}

#[test]
fn threads_share_a_client() {
    let server = Server::start(|request| {
        let text = request.body.pointer("/messages/0/content").and_then(|text| text.as_str());
        Turn::says(text.unwrap_or_default())
    })
    .unwrap();
    let (client, _) = client(&server, PATIENCE);
    std::thread::scope(|scope| {
        for number in 0..4 {
            let client = &client;
            scope.spawn(move || {
                let text = format!("number {number}");
                let message = Message::text(Speaker::User, text.clone());
                let reply =
                    client.ask(&Question { messages: vec![message], max_tokens: 9 }).unwrap();
                assert_eq!(reply.outcome, Outcome::Text(text));
            });
        }
    });
}

#[test]
fn a_client_that_is_printed_keeps_its_key() {
    let server = Server::turns([]).unwrap();
    let (client, _) = client(&server, PATIENCE);
    assert!(!format!("{client:?}").contains(KEY));
}
