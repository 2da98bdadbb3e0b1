//! What is found out about servers of several kinds, over real sockets.

use serde_json::{Value, json};

use super::super::client::Settings;
use super::super::endpoint::Endpoint;
use super::super::scripted::{Received, Server, Turn, completion};
use super::super::secret::Secret;
use super::*;

const KEY: &str = "sk-very-secret";

fn images(request: &Received) -> Vec<&str> {
    let parts = request.body.pointer("/messages/0/content").and_then(Value::as_array);
    let parts = parts.map(Vec::as_slice).unwrap_or_default();
    parts.iter().filter_map(|part| part.pointer("/image_url/url")?.as_str()).collect()
}

fn refused(message: &str) -> Turn {
    Turn::json(400, &json!({"error": {"message": message}}))
}

/// A server of a model that sees, and that takes at most `most` images.
fn seeing(request: &Received, most: usize) -> Turn {
    if request.line.starts_with("GET /v1/models") {
        let list = json!({"data": [{"id": "m", "max_model_len": 8192}]});
        return Turn::json(200, &list).with("Server: uvicorn");
    }
    if request.line.starts_with("GET") {
        return Turn::json(404, &json!({"detail": "Not Found"}));
    }
    let images = images(request);
    if images.len() > most {
        return refused(&format!("At most {most} image(s) may be provided in one request."));
    }
    let red = Colour::Red.picture().unwrap();
    let mut body = completion(match images.first() {
        Some(image) if *image == &*red.url => "Red.",
        Some(_) => "It is blue.",
        None => "42",
    });
    body["usage"]["prompt_tokens"] = json!(20 + 64 * images.len());
    Turn::json(200, &body)
}

fn probe(server: &Server) -> Report {
    let endpoint = Endpoint::new(&server.base_url(), Secret::new(KEY)).unwrap();
    let settings = Settings { model: "m".into(), timeout: TIMEOUT, max_retries: 0 };
    let report = run(&Client::new(endpoint, settings), 4);
    let written = serde_json::to_string(&report).unwrap();
    assert!(!written.contains(KEY), "{written}");
    report
}

/// What was found, without what differs from time to time.
fn story(report: &Report) -> String {
    let lines = report.findings.iter().map(|Finding { what, mark, about }| {
        let timed = matches!(*what, "reachable" | "speed") && *mark == Mark::Ok;
        format!("{mark:?} {what}: {}\n", if timed { "..." } else { about })
    });
    lines.collect::<String>().replace(&report.endpoint, "E")
}

#[test]
fn a_server_that_does_all_a_run_needs() {
    let server = Server::start(|request| seeing(request, usize::MAX)).unwrap();
    let report = probe(&server);
    insta::assert_snapshot!(story(&report), @r#"
    Ok reachable: ...
    Ok model: m is in the server's list of 1
    Ok answers: "42" in 5 tokens to 17 + 25
    Ok reasoning off: the answer came without reasoning
    Ok images: "Red." to a red square, "It is blue." to a blue square
    Ok images per request: 50 at least, which is what a run can need
    Ok temperature 0: the same question had the same answer twice
    Ok speed: ...
    "#);
    assert_eq!((report.worst(), report.images_per_request), (Mark::Ok, Some(50)));
    let speed = report.speed.unwrap();
    assert_eq!((speed.alone_tokens, speed.together, speed.together_tokens), (Some(5), 4, Some(20)));
}

#[test]
fn the_bound_on_images_is_found_whatever_it_is() {
    for most in [1, 2, 8, 31, 49] {
        let server = Server::start(move |request| seeing(request, most)).unwrap();
        let report = probe(&server);
        assert_eq!(report.images_per_request, Some(most as u32));
        assert_eq!(report.worst(), Mark::Doubtful);
        let told = format!(
            "{most}; {} are refused: At most {most} image(s) may be provided in one request.",
            most + 1
        );
        assert!(story(&report).contains(&told), "{}", story(&report));
    }
}

#[test]
fn a_model_that_does_not_see() {
    for status in [400, 500] {
        let server = Server::start(move |request| match images(request).len() {
            0 => seeing(request, 0),
            _ => Turn::json(status, &json!({"error": {"message": "image input is not supported"}})),
        })
        .unwrap();
        let report = probe(&server);
        assert_eq!((report.worst(), report.images_per_request), (Mark::Bad, Some(0)));
        let told = "Bad images: the server takes none: image input is not supported. Serve a model that sees";
        assert!(story(&report).contains(told), "{}", story(&report));
    }
}

#[test]
fn a_server_that_has_peculiarities() {
    let mut asked = 0;
    let server = Server::start(move |request| {
        asked += 1;
        if request.line.starts_with("GET /v1/models") {
            return Turn::json(200, &json!({"data": [{"id": "n"}, {"id": "o"}]}));
        }
        let mut body = completion(&format!("Answer {asked}."));
        body["choices"][0]["message"]["reasoning_content"] = json!("Hm.");
        Turn::json(200, &body)
    })
    .unwrap();
    let report = probe(&server);
    insta::assert_snapshot!(story(&report), @r#"
    Ok reachable: ...
    Doubtful model: m is not in the server's list; it has n, o. Some servers answer all the same; if this one does not, pass one of these with --model.
    Ok answers: "Answer 2." in 5 tokens to 17 + 25
    Bad reasoning off: the model reasons although every request asks it not to, and has few tokens for its answer: turn reasoning off at the server, or serve a variant that does not reason.
    Doubtful images: "Answer 3." to a red square, "Answer 4." to a blue square: the model may be too small, or not see what it is sent.
    Doubtful images per request: 50 are accepted, but the server counts hardly more tokens than for one: it may drop some without a word. Look at its settings before you trust a run.
    Doubtful temperature 0: the same question had two answers, "Answer 6." and "Answer 7.": a run will not repeat exactly. Ask for several repetitions (--runs), or see whether the server can be made deterministic.
    Ok speed: ...
    "#);
}

#[test]
fn what_cannot_be_asked() {
    let turn = Turn::json(401, &json!({"error": {"message": "wrong key sk-very-secret"}}));
    let server = Server::start(move |_| turn.clone()).unwrap();
    insta::assert_snapshot!(story(&probe(&server)), @r#"
    Ok reachable: ...
    Doubtful model: the server does not show its list: wrong key [key]. Set OPENAI_API_KEY, or check it.
    Bad answers: E refused the request with status 401: wrong key [key]; check OPENAI_API_KEY
    "#);

    let server = Server::turns([]).unwrap();
    let endpoint = Endpoint::new(&server.base_url(), None).unwrap();
    drop(server);
    let settings = Settings { model: "m".into(), timeout: TIMEOUT, max_retries: 0 };
    let report = run(&Client::new(endpoint, settings), 4);
    assert_eq!(report.worst(), Mark::Bad);
    insta::assert_snapshot!(story(&report), @"Bad reachable: nobody answers for E: there is no connection: Connection refused (os error 111); is the server running? Start the server, or correct --base-url.");
}
