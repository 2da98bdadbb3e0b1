//! Probing servers of several kinds, over real sockets.

use serde_json::{Value, json};

use super::*;
use crate::{ApiKey, ChatSettings, Endpoint};
use rigs::chat_server::{Reaction, Received, Server, completion};

const KEY: &str = "sk-very-secret";

/// Images of the run's largest request.
const IMAGES: u32 = 47;

fn images(request: &Received) -> Vec<&str> {
    let parts = request.body.pointer("/messages/0/content").and_then(Value::as_array);
    let parts = parts.map(Vec::as_slice).unwrap_or_default();
    parts.iter().filter_map(|part| part.pointer("/image_url/url")?.as_str()).collect()
}

fn refused(message: &str) -> Reaction {
    Reaction::json(400, &json!({"error": {"message": message}}))
}

/// A server of a model that sees, and that takes at most `most` images.
fn seeing(request: &Received, most: usize) -> Reaction {
    if request.line.starts_with("GET /v1/models") {
        let list = json!({"data": [{"id": "m", "max_model_len": 8192}]});
        return Reaction::json(200, &list).with("Server: uvicorn");
    }
    if request.line.starts_with("GET") {
        return Reaction::json(404, &json!({"detail": "Not Found"}));
    }
    let images = images(request);
    if images.len() > most {
        return refused(&format!("At most {most} image(s) may be provided in one request."));
    }
    let red = &square([230, 20, 20, 255]).messages[0];
    let red = serde_json::to_value(red).unwrap();
    let mut body = completion(match images.first() {
        Some(image) if Some(*image) == red["content"][0]["image_url"]["url"].as_str() => "Red.",
        Some(_) => "It is blue.",
        None if request.body.get("grammar").is_some() => "meadow",
        None => "42",
    });
    body["usage"]["prompt_tokens"] = json!(20 + 64 * images.len());
    Reaction::json(200, &body)
}

/// A request with `images` images and the text of a run.
fn run_request(images: u32) -> ChatRequest {
    let mut request = square([0; 4]);
    let MessageContent::Parts(parts) = &mut request.messages[0].content else { panic!("parts") };
    let image = parts.remove(0);
    parts.extend(vec![image; images as usize]);
    request
}

fn probe(server: &Server) -> ProbeReport {
    probe_at(&server.base_url())
}

fn probe_at(base_url: &str) -> ProbeReport {
    let endpoint = Endpoint::new(base_url, ApiKey::new(KEY)).unwrap();
    let settings = ChatSettings { max_retries: 0, ..ChatSettings::new("m") };
    let client = ChatClient::new(endpoint, settings, None);
    let report = run(&client, 4, &RunRequest { images: IMAGES, with: &run_request });
    let written = serde_json::to_string(&report).unwrap();
    assert!(!written.contains(KEY), "{written}");
    report
}

/// The findings, without what varies from run to run.
fn story(report: &ProbeReport) -> String {
    let lines = report.findings.iter().map(|ProbeFinding { what, mark, about }| {
        let timed = matches!(*what, "reachable" | "request of the run's size" | "speed");
        format!(
            "{mark:?} {what}: {}\n",
            if timed && *mark == ProbeMark::Ok { "..." } else { about }
        )
    });
    lines.collect::<String>().replace(&report.endpoint, "E")
}

#[test]
fn a_server_with_everything_a_run_needs() {
    let server = Server::start(|request| seeing(request, usize::MAX)).unwrap();
    let report = probe(&server);
    insta::assert_snapshot!(story(&report), @r#"
    Ok reachable: ...
    Ok model: m is in the server's list of 1
    Ok answers: "42" in 5 tokens to 17 + 25
    Ok reasoning off: the answer came without reasoning
    Ok restricted answers: the server restricts answers to the actions
    Ok images: "Red." to a red square, "It is blue." to a blue square
    Ok request of the run's size: ...
    Ok temperature 0: the same question had the same answer twice
    Ok speed: ...
    "#);
    assert_eq!(report.worst(), ProbeMark::Ok);
    let sized = report.run_sized.unwrap();
    assert_eq!((sized.images, sized.prompt_tokens), (IMAGES, Some(20 + 64 * 47)));
    let speed = &report.findings.last().unwrap().about;
    assert!(speed.contains("for 5 tokens") && speed.contains("; 4 at once"), "{speed}");
    assert!(speed.contains("for 20 tokens"), "{speed}");
}

/// A server that refuses the run's largest request is not reported as good.
#[test]
fn the_number_of_images_accepted_is_found() {
    for most in [1, 2, 8, 31, 46] {
        let server = Server::start(move |request| seeing(request, most)).unwrap();
        let report = probe(&server);
        assert_eq!(report.run_sized.as_ref().map(|sized| sized.images), Some(most as u32));
        assert_eq!(report.worst(), ProbeMark::Bad);
        let told = format!(
            "{} images are refused: At most {most} image(s) may be provided in one request.",
            most + 1
        );
        let story = story(&report);
        assert!(
            story.contains(&told) && story.contains(&format!("--image-budget {most}")),
            "{story}"
        );
    }
}

#[test]
fn a_context_that_is_too_short_is_found_with_the_runs_prompt() {
    // Squares are small enough for it; the run's prompt is not.
    let server = Server::start(|request| match request.body.to_string().len() {
        size if size > 1500 => refused("maximum context length is 8192 tokens"),
        _ => seeing(request, usize::MAX),
    })
    .unwrap();
    let report = probe(&server);
    assert_eq!(report.worst(), ProbeMark::Bad);
    assert!(story(&report).contains("Bad request of the run's size: "), "{}", story(&report));
}

#[test]
fn a_model_that_does_not_see() {
    for status in [400, 500] {
        let server = Server::start(move |request| match images(request).len() {
            0 => seeing(request, 0),
            _ => Reaction::json(
                status,
                &json!({"error": {"message": "image input is not supported"}}),
            ),
        })
        .unwrap();
        let report = probe(&server);
        assert_eq!((report.worst(), &report.run_sized), (ProbeMark::Bad, &None));
        let told = "Bad images: the server takes none: image input is not supported. Serve a model that sees";
        assert!(story(&report).contains(told), "{}", story(&report));
    }
}

#[test]
fn a_server_with_peculiarities() {
    let mut asked = 0;
    let server = Server::start(move |request| {
        asked += 1;
        if request.line.starts_with("GET /v1/models") {
            return Reaction::json(200, &json!({"data": [{"id": "n"}, {"id": "o"}]}));
        }
        let mut body = completion(&format!("Answer {asked}."));
        body["choices"][0]["message"]["reasoning_content"] = json!("Hm.");
        Reaction::json(200, &body)
    })
    .unwrap();
    insta::assert_snapshot!(story(&probe(&server)), @r#"
    Ok reachable: ...
    Doubtful model: m is not in the server's list (n, o). If requests fail, pass one of these with --model.
    Ok answers: "Answer 2." in 5 tokens to 17 + 25
    Bad reasoning off: the model reasons although every request turns reasoning off, and has few tokens for its answer: turn reasoning off at the server, or serve a variant that does not reason.
    Ok restricted answers: the server does not restrict answers: the first action in the model's text is taken
    Doubtful images: "Answer 4." to a red square, "Answer 5." to a blue square: the model may be too small, or not see what it is sent.
    Bad request of the run's size: images are accepted, but add no tokens to the prompt: the server may drop them. Check its settings.
    Doubtful temperature 0: the same question had two answers, "Answer 8." and "Answer 9.": a run will not repeat exactly. Ask for several repetitions (--runs), or make the server deterministic.
    Ok speed: ...
    "#);
}

#[test]
fn a_server_that_cannot_be_asked() {
    let turn = Reaction::json(401, &json!({"error": {"message": "wrong key sk-very-secret"}}));
    let server = Server::start(move |_| turn.clone()).unwrap();
    insta::assert_snapshot!(story(&probe(&server)), @r#"
    Ok reachable: ...
    Doubtful model: the server does not show its list: wrong key [key]. Set or check OPENAI_API_KEY.
    Bad answers: the server refuses every request: E refused the request with status 401: wrong key [key]; check OPENAI_API_KEY
    "#);

    let server = Server::turns([]).unwrap();
    let base_url = server.base_url();
    drop(server);
    let report = probe_at(&base_url);
    assert_eq!(report.worst(), ProbeMark::Bad);
    insta::assert_snapshot!(story(&report), @"Bad reachable: no answer from E: there is no connection: Connection refused (os error 111); is the server running? Start the server, or correct --base-url.");
}

#[test]
fn an_answer_that_is_no_list_of_models_is_told_apart() {
    for (answer, expected) in [
        (
            Reaction::json(404, &json!({"detail": "Not Found"})),
            ModelList::Refused(404, "Not Found".into()),
        ),
        (Reaction::json(200, &json!([])), ModelList::Unreadable),
        (
            Reaction::Answer { status: 200, headers: vec![], body: "<html>".into() },
            ModelList::Unreadable,
        ),
    ] {
        let server = Server::start(move |_| answer.clone()).unwrap();
        let endpoint = Endpoint::new(&server.base_url(), None).unwrap();
        let client = HttpClient::new(endpoint, ChatSettings::new("m"));
        assert_eq!(models(&client).unwrap(), (None, expected));
    }
}
