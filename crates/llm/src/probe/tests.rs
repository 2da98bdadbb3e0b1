//! Probing servers of several kinds, over real sockets.

use serde_json::{Value, json};

use super::*;
use crate::{ApiKey, ChatSettings, Endpoint};
use rigs::chat_server::{Reaction, Received, Server, completion};

const KEY: &str = "sk-very-secret";

/// Images of the run's largest request.
const IMAGES: u32 = 47;

/// Edge of its views, in pixels.
const FRAME_SIZE: u32 = 128;

fn images(request: &Received) -> Vec<&str> {
    let parts = request.body.pointer("/messages/0/content").and_then(Value::as_array);
    let parts = parts.map(Vec::as_slice).unwrap_or_default();
    parts.iter().filter_map(|part| part.pointer("/image_url/url")?.as_str()).collect()
}

fn refused(message: &str) -> Reaction {
    Reaction::json(400, &json!({"error": {"message": message}}))
}

/// The texts of a request.
fn text(request: &Received) -> String {
    request.body["messages"].to_string()
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
    let colour = |image: &&str| {
        let shows = |edge, upper| **image == *square(edge, upper, RED).url;
        if shows(SQUARE, RED) || shows(FRAME_SIZE, GREY) { "Red" } else { "blue" }
    };
    let text = text(request);
    let colours: Vec<&str> = images.iter().map(colour).collect();
    let answer = match () {
        () if text.contains("with the word meadow only") || text.contains("code word") => {
            "meadow".to_owned()
        }
        () if request.body.get("grammar").is_some() => "meadow".to_owned(),
        () if text.contains("colour") => format!("{}.", colours.join(" and ")),
        () => "42".to_owned(),
    };
    let mut body = completion(&answer);
    body["usage"]["prompt_tokens"] = json!(20 + text.len() / 4 + 64 * images.len());
    Reaction::json(200, &body)
}

/// A request with `images` images and the text of a run.
fn run_request(images: u32) -> ChatRequest {
    let image = square(SQUARE, [0; 4], [0; 4]);
    about_images("What do you do?", &vec![&image; images as usize], PAPER_TOKENS)
}

fn probe(server: &Server) -> ProbeReport {
    probe_at(&server.base_url())
}

fn probe_at(base_url: &str) -> ProbeReport {
    probe_with(base_url, ChatSettings::new("m"))
}

fn probe_with(base_url: &str, settings: ChatSettings) -> ProbeReport {
    let endpoint = Endpoint::new(base_url, ApiKey::new(KEY)).unwrap();
    let settings = ChatSettings { max_retries: 0, ..settings };
    let client = ChatClient::new(endpoint, settings, None);
    let requests = [("full-context", IMAGES, 0), ("summary", 7, 1000)];
    let requests = requests.map(|(memory, images, document_chars)| RunRequest {
        memory: memory.to_owned(),
        images,
        document_chars,
        with: Box::new(move |images| {
            let mut request = run_request(images);
            if let MessageContent::Parts(parts) = &mut request.messages[0].content {
                parts.push(ContentPart::Text { text: "a".repeat(document_chars as usize) });
            }
            request
        }),
    });
    let settings =
        ProbeSettings { together: 4, answer_tokens: PAPER_TOKENS, frame_size: FRAME_SIZE };
    let report = run(&client, settings, &requests);
    let written = serde_json::to_string(&report).unwrap();
    assert!(!written.contains(KEY), "{written}");
    report
}

/// The findings, without what varies from run to run.
fn story(report: &ProbeReport) -> String {
    let lines = report.findings.iter().map(|ProbeFinding { what, mark, about }| {
        let timed = matches!(
            *what,
            "reachable" | "request of the run's size" | "speed" | "tokens of images"
        );
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
    Ok system role: the model follows rules in the role system
    Ok restricted answers: the server restricts answers to the actions (structured_outputs: ignored, grammar: works, response_format: ignored)
    Ok images: "Red." to a red square, "blue." to a blue square
    Ok images in order: "Red and blue." to a red and a blue square, "blue and Red." to a blue and a red one
    Ok images whole: "Red." to a red lower half, "blue." to a blue one
    Ok request of the run's size: ...
    Ok tokens of images: ...
    Ok first line of the prompt: the model knows a word from the first line of the longest prompts
    Ok temperature 0: the same question had the same answer twice
    Ok speed: ...
    "#);
    assert_eq!(report.worst(), ProbeMark::Ok);
    let sized = report.run_sized.unwrap();
    assert_eq!(sized.images, IMAGES);
    assert!(sized.prompt_tokens > Some(64 * 47));
    assert_eq!(report.differences, Some(Vec::new()));
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
        size if size > 6000 => refused("maximum context length is 8192 tokens"),
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
    Bad reasoning off: the model reasons although every request turns reasoning off, and has few tokens for its answer: turn reasoning off at the server, serve a variant that does not reason, or give --reasoning and more --answer-tokens.
    Doubtful system role: "Answer 3." although the rules, in the role system, ask for another word: the model may not see them. Try --system-role user.
    Doubtful restricted answers: the server does not restrict answers, so the action is read from the model's text (structured_outputs: ignored, grammar: ignored, response_format: ignored)
    Doubtful images: "Answer 8." to a red square, "Answer 9." to a blue square: the model may be too small, or not see what it is sent.
    Doubtful images in order: "Answer 10." to a red and a blue square, "Answer 11." to a blue and a red one: the server may drop images or change their order, or the model be too small for two.
    Doubtful images whole: "Answer 12." to a red lower half, "Answer 13." to a blue one: the model may not see the whole image.
    Ok request of the run's size: ...
    Bad tokens of images: images are accepted, but add no tokens to the prompt: the server may drop them. Check its settings.
    Bad first line of the prompt: the prompt of summary memory has 1000 characters of documents, and the server counts 10 tokens: it cuts the prompt. Raise its context.
    Doubtful temperature 0: the same question had two answers, "Answer 19." and "Answer 20.": a run will not repeat exactly. Ask for several repetitions (--runs), or make the server deterministic.
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

    // A port that no other test is given.
    let report = probe_at("http://127.0.0.1:9/v1");
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
        (Reaction::json(200, &json!([{"id": "m"}])), ModelList::Listed(vec!["m".into()])),
        (
            Reaction::Answer { status: 200, headers: vec![], body: "<html>".into() },
            ModelList::Unreadable,
        ),
    ] {
        let server = Server::start(move |_| answer.clone()).unwrap();
        let endpoint = Endpoint::new(&server.base_url(), None).unwrap();
        let client = HttpClient::new(endpoint, ChatSettings::new("m"));
        assert_eq!(models(&client, LIST_TIMEOUT).unwrap(), (None, expected));
    }
}

/// The mark of a finding.
fn mark(report: &ProbeReport, what: &str) -> ProbeMark {
    let finding = report.findings.iter().find(|finding| finding.what == what);
    finding.unwrap_or_else(|| panic!("{what}: {}", story(report))).mark
}

/// Servers that accept everything, and whose models do not get what was sent.
#[test]
fn what_the_model_does_not_get_is_found() {
    let answers = |request: &Received, change: &dyn Fn(&Received, &mut Value)| {
        let reaction = seeing(request, usize::MAX);
        let Reaction::Answer { status: 200, body, .. } = &reaction else { return reaction };
        let mut body: Value = serde_json::from_str(body).unwrap();
        if body.get("choices").is_none() {
            return reaction;
        }
        change(request, &mut body);
        Reaction::json(200, &body)
    };
    type Change = fn(&Received, &mut Value);
    type Marks = &'static [(&'static str, ProbeMark)];
    fn say(body: &mut Value, text: &str) {
        body["choices"][0]["message"]["content"] = json!(text);
    }
    let cases: [(&str, Change, Marks); 10] = [
        (
            "the last image only",
            |request, body| {
                let few = images(request).len().min(1);
                body["usage"]["prompt_tokens"] =
                    json!(20 + text(request).len() / 99_999 + 64 * few);
                if images(request).len() > 1 && text(request).contains("colours") {
                    say(body, "blue");
                }
            },
            &[("images in order", ProbeMark::Doubtful), ("tokens of images", ProbeMark::Bad)],
        ),
        (
            "a cache of texts",
            |request, body| {
                if !images(request).is_empty() && text(request).contains("colour") {
                    say(body, "red");
                }
            },
            &[("images", ProbeMark::Bad), ("images whole", ProbeMark::Bad)],
        ),
        (
            "the upper half only",
            |request, body| {
                if text(request).contains("lower half") {
                    say(body, "red");
                }
            },
            &[("images", ProbeMark::Ok), ("images whole", ProbeMark::Bad)],
        ),
        (
            "a cut beginning",
            |request, body| {
                if text(request).contains("code word") {
                    say(body, "I do not know.");
                }
            },
            &[("first line of the prompt", ProbeMark::Doubtful)],
        ),
        (
            "a cut document",
            |request, body| {
                if text(request).contains("aaaa") {
                    body["usage"]["prompt_tokens"] = json!(50);
                }
            },
            &[("first line of the prompt", ProbeMark::Bad)],
        ),
        (
            "no system message",
            |request, body| {
                if text(request).contains("with the word") {
                    say(body, "42");
                }
            },
            &[("system role", ProbeMark::Doubtful)],
        ),
        (
            "reasoning in tags",
            |_, body| say(body, "I see.\n</think>\n\n42"),
            &[("reasoning off", ProbeMark::Bad)],
        ),
        (
            "reasoning in tokens",
            |_, body| body["usage"]["completion_tokens"] = json!(29),
            &[("reasoning off", ProbeMark::Doubtful)],
        ),
        (
            "nothing within the bound",
            |_, body| {
                body["choices"][0] =
                    json!({"message": {"content": null}, "finish_reason": "length"});
            },
            &[("answers", ProbeMark::Bad), ("reasoning off", ProbeMark::Doubtful)],
        ),
        (
            "only reasoning",
            |_, body| {
                body["choices"][0] = json!({"message": {"content": null, "reasoning": "I think"}, "finish_reason": "length"});
            },
            &[("answers", ProbeMark::Bad), ("reasoning off", ProbeMark::Bad)],
        ),
    ];
    for (name, change, expected) in cases {
        let server = Server::start(move |request| answers(request, &change)).unwrap();
        let report = probe(&server);
        for (what, expected) in expected {
            assert_eq!(mark(&report, what), *expected, "{name}, {what}: {}", story(&report));
        }
        let differences = report.differences.iter().flatten();
        let dropped = differences.filter(|one| one.here == "not all reach the model").count();
        assert_eq!(dropped, usize::from(mark(&report, "tokens of images") == ProbeMark::Bad));
    }
}

#[test]
fn a_list_of_models_that_hangs_ends_no_check() {
    let server = Server::concurrent(|request| match request.line.starts_with("GET") {
        true => Reaction::Hang,
        false => seeing(request, usize::MAX),
    })
    .unwrap();
    let request_timeout = Duration::from_secs(3);
    let report =
        probe_with(&server.base_url(), ChatSettings { request_timeout, ..ChatSettings::new("m") });
    assert_eq!(mark(&report, "reachable"), ProbeMark::Doubtful);
    assert!(report.findings.len() > 1, "{}", story(&report));
}

#[test]
fn each_way_of_restricting_answers_is_tried() {
    for (field, expected) in [
        (
            "response_format",
            "with --extra-body '{\"structured_outputs\": null, \"grammar\": null}' it sends response_format",
        ),
        ("none", "the server does not restrict answers"),
    ] {
        let server = Server::start(move |request| {
            let mut request = request.clone();
            let body = request.body.as_object_mut().into_iter();
            body.for_each(|body| {
                body.remove("grammar");
                if let Some(way) = body.remove(field) {
                    body.insert("grammar".to_owned(), way);
                }
            });
            seeing(&request, usize::MAX)
        })
        .unwrap();
        let report = probe(&server);
        assert_eq!(mark(&report, "restricted answers"), ProbeMark::Doubtful);
        assert!(story(&report).contains(expected), "{}", story(&report));
    }
}

#[test]
fn a_run_that_differs_from_the_paper_is_described() {
    let server = Server::start(|request| match request.body.get("temperature") {
        Some(_) => refused("Unsupported value: 'temperature' does not support 0."),
        None => seeing(request, 12),
    })
    .unwrap();
    let mut settings = ChatSettings::new("m");
    settings.options.reasoning = ReasoningRequest::Low;
    let report = probe_with(&server.base_url(), settings);
    let rows: Vec<String> = report
        .differences
        .iter()
        .flatten()
        .map(|PaperDifference { setting, paper, here }| format!("{setting}: {here}, not {paper}"))
        .collect();
    assert_eq!(
        rows,
        [
            "temperature: the model's own, not 0",
            "reasoning: low, not off",
            "images of a prompt: at most 12, not at most 50"
        ]
    );
    assert_eq!(mark(&report, "temperature 0"), ProbeMark::Doubtful);
}
