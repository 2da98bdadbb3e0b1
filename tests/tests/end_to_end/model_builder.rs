//! Documents written by a model, with real processes and sockets: a scripted server and the builder.

use std::env;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;

use case_book::Demonstration;
use documents::ModelRecipe;
use domain::{Action, DemonstrationKind, DocumentKind, Feedback, Heading, Pose};
use llm::{ChatClient, ChatSettings, Endpoint};
use memory_proc::builders::DocumentBuilder;
use memory_proc::builders::model::{ModelBuilder, ask_through};
use memtransfer_tests::WATCHDOG;
use rigs::chat_server::{Reaction, Received, Server};

/// Set in the test binary when it is started as a building process: the server's URL.
const BASE_URL: &str = "MEMTRANSFER_TEST_BASE_URL";

/// The path of its document.
const DOCUMENT: &str = "MEMTRANSFER_TEST_DOCUMENT";

/// A demonstration of walking north in column `x`.
fn demonstration(x: u8) -> Demonstration {
    let states = (1..10).map(|y| Pose::new(x, y, Heading::N).into()).collect();
    let feedback = [Feedback::Start].into_iter().chain([Feedback::Moved; 8]);
    Demonstration {
        case: 0,
        kind: DemonstrationKind::Original,
        variant: 0,
        instruction: "Find a blue barrel.".to_owned(),
        states,
        feedback: feedback.map(Into::into).collect(),
        sub_goals: vec![8],
        actions: vec![Action::Forward.into(); 8],
        views: (0..9).collect(),
    }
}

/// Not a test: what this binary does when it is started as a building process.
#[test]
fn building_process() {
    let (Some(base_url), Some(document)) = (env::var_os(BASE_URL), env::var_os(DOCUMENT)) else {
        return;
    };
    let document = Path::new(&document);
    let endpoint = Endpoint::new(base_url.to_str().unwrap(), None).unwrap();
    let settings = ChatSettings {
        request_timeout: WATCHDOG,
        max_retries: 0,
        max_connections: 1,
        ..ChatSettings::new("m")
    };
    let client = ChatClient::new(endpoint, settings, None);
    let recipe = ModelRecipe { model: "m".to_owned(), context_chars: 4500, max_tokens: 100 };
    let kinds = DocumentKind::TEXTS;
    let kind = kinds.into_iter().find(|kind| document.ends_with(kind.word())).unwrap();
    let demonstrations: Vec<_> = (0..30).map(demonstration).collect();
    let demonstrations = Vec::from_iter(&demonstrations);
    let steps = document.with_extension("steps");
    let built = ModelBuilder::new(ask_through(client), recipe)
        .build(kind, &warehouse::declaration(), &demonstrations, &steps, &mut |_, _| {})
        .unwrap();
    let account = serde_json::to_string(&built.account).unwrap();
    fs::write(document, built.text + &account).unwrap();
}

fn start(server: &Server, document: &Path) -> Child {
    Command::new(env::current_exe().unwrap())
        .args(["--exact", "model_builder::building_process"])
        .env(BASE_URL, server.base_url())
        .env(DOCUMENT, document)
        .env_remove("OPENAI_API_KEY")
        .current_dir(document.parent().unwrap())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap()
}

/// Builds in a new process and returns the document.
fn build(server: &Server, document: &Path) -> String {
    assert!(start(server, document).wait().unwrap().success());
    fs::read_to_string(document).unwrap()
}

/// A model whose answer depends only on the request.
fn model(request: &Received) -> Reaction {
    let question = request.body.pointer("/messages/1/content").unwrap().as_str().unwrap();
    let sum = question.bytes().fold(0_u32, |sum, byte| sum.wrapping_mul(31) + u32::from(byte));
    Reaction::says(&format!("# Text {sum}\nof {} lines", question.lines().count()))
}

#[test]
fn a_killed_build_resumes_where_it_stopped() {
    for kind in DocumentKind::TEXTS {
        let folder = tempfile::tempdir().unwrap();
        let whole = Server::start(model).unwrap();
        let expected = build(&whole, &folder.path().join(kind.word()));
        let questions: Vec<_> =
            whole.received().iter().map(|request| request.body.clone()).collect();
        assert!(questions.len() > 3, "{} questions", questions.len());
        assert!(expected.contains("\"prompt_tokens\":"), "{expected}");

        let folder = tempfile::tempdir().unwrap();
        let document = folder.path().join(kind.word());
        let (third, arrived) = mpsc::channel();
        let mut count = 0;
        let hanging = Server::start(move |request| {
            count += 1;
            if count < 3 {
                return model(request);
            }
            third.send(()).unwrap();
            Reaction::Hang
        })
        .unwrap();
        let mut process = start(&hanging, &document);
        arrived.recv_timeout(WATCHDOG).unwrap();
        process.kill().unwrap();
        process.wait().unwrap();
        assert!(!document.exists());

        // Only requests without an answer are sent again.
        let rest = Server::start(model).unwrap();
        assert_eq!(build(&rest, &document), expected);
        let asked = |server: &Server| server.received().into_iter().map(|request| request.body);
        let all: Vec<_> = asked(&hanging).take(2).chain(asked(&rest)).collect();
        assert_eq!(all, questions);

        // A finished document needs no server.
        let nobody = Server::turns([]).unwrap();
        assert_eq!(build(&nobody, &document), expected);
        assert!(nobody.received().is_empty());
    }
}
