//! Documents written by a model, with real processes and sockets: a scripted server and the builder.

use std::collections::BTreeMap;
use std::env;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;

use case_book::{
    ActionDeclaration, BookRequest, Demonstration, DemonstrationBook, StateField, WorldDeclaration,
};
use documents::ModelRecipe;
use domain::{ActionCode, DemonstrationKind, DocumentKind, FeedbackCode, ImageFormat, Pose, State};
use llm::{ChatClient, ChatSettings, Endpoint};
use memory_proc::builders::DocumentBuilder;
use memory_proc::builders::model::{ModelBuilder, ask_through};
use memory_proc::builders::views::{DrawViews, DrawnView};
use memtransfer_tests::proxy::{MessagePart, hash_of, parts};
use memtransfer_tests::{Bench, Ended, WATCHDOG, needs, repository};
use png_file::RgbaImage;
use rigs::chat_server::{Reaction, Received, Server};
use serde_json::Value;
use warehouse::case_book::write_books;

use crate::real_server::{stored, two_cases};

/// Set in the test binary when it is started as a building process: the server's URL.
const BASE_URL: &str = "MEMTRANSFER_TEST_BASE_URL";

/// The path of its document.
const DOCUMENT: &str = "MEMTRANSFER_TEST_DOCUMENT";

/// A corridor along which one walks.
fn corridor() -> WorldDeclaration {
    WorldDeclaration {
        name: "corridor".to_owned(),
        rules: "You are in a corridor.".to_owned(),
        actions: vec![ActionDeclaration { letter: 'e', words: "walk east".to_owned() }],
        state: vec![StateField { name: "cell".to_owned(), words: Vec::new(), digits: 0 }],
        state_sentence: "You are in cell {cell}.".to_owned(),
        feedback: vec!["You begin.".to_owned(), "You walked.".to_owned()],
        ..WorldDeclaration::default()
    }
}

/// A demonstration of walking east from cell `first`.
fn demonstration(first: u32) -> Demonstration {
    let cells = (0..9).map(|step| State::new(&[(first + step) as f32]).unwrap());
    Demonstration {
        case: first,
        kind: DemonstrationKind::Original,
        variant: 0,
        instruction: format!("Walk to cell {}.", first + 8),
        states: cells.collect(),
        feedback: (0..9).map(|step| FeedbackCode(u8::from(step > 0))).collect(),
        sub_goals: vec![8],
        actions: vec![ActionCode(0); 8],
        views: (first..first + 9).collect(),
    }
}

/// Draws a view as one pixel.
struct Pixels;

impl DrawViews for Pixels {
    fn draw(&mut self, view: u32) -> anyhow::Result<DrawnView> {
        DrawnView::of_pixels(1, &[view as u8, 0, 0, 255], ImageFormat::Png)
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
    let recipe = ModelRecipe {
        context_chars: 4500,
        max_tokens: 100,
        views: 2,
        image_budget: 16,
        ..ModelRecipe::new("m")
    };
    let kinds = DocumentKind::TEXTS;
    let kind = kinds.into_iter().find(|kind| document.ends_with(kind.word())).unwrap();
    let demonstrations: Vec<_> = (0..30).map(demonstration).collect();
    let demonstrations = Vec::from_iter(&demonstrations);
    let steps = document.with_extension("steps");
    let built = ModelBuilder::new(ask_through(client), Pixels, recipe)
        .build(kind, &corridor(), &demonstrations, &steps, &mut |_, _| {})
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
    let question = request.body.pointer("/messages/1/content").unwrap().to_string();
    let sum = question.bytes().fold(0_u32, |sum, byte| sum.wrapping_mul(31) + u32::from(byte));
    Reaction::says(&format!("# Text {sum}\nof {} lines", question.matches("\\n").count()))
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

/// Arguments of `memtransfer memory build` of documents by the model behind `base_url`.
fn build_arguments<'a>(base_url: &'a str, more: &'a str) -> Vec<&'a str> {
    let mut args = vec!["memory", "build", "--builder", "model", "--model", "m"];
    args.extend(["--base-url", base_url, "--demos", "original", "--frame-size", "64"]);
    args.extend(["--out", "documents", "--quiet"]);
    args.extend(more.split(' '));
    args
}

/// The parts of the messages that a server has received, by request.
fn parts_asked(server: &Server) -> Vec<Vec<MessagePart>> {
    server.received().iter().map(|request| parts(&request.body)).collect()
}

/// The images of a request, each with the line of text before its number; checks the numbers.
fn shown(parts: &[MessagePart]) -> Vec<(String, String)> {
    let mut shown = Vec::new();
    for (index, part) in parts.iter().enumerate() {
        let MessagePart::Image(hash) = part else { continue };
        let MessagePart::Text(_, text) = &parts[index - 1] else { panic!("no text") };
        let mut lines = text.trim_end().lines().rev();
        assert_eq!(lines.next(), Some(&*format!("Image {}:", shown.len() + 1)));
        shown.push((lines.next().unwrap().to_owned(), hash.clone()));
    }
    shown
}

#[test]
fn prompts_show_the_views_of_the_warehouse_in_place() {
    let bench = Bench::new();
    two_cases(&bench.out("assets"));
    let server = Server::start(model).unwrap();
    let base_url = server.base_url();
    let summary = "--kind summary --assets assets --views 3 --image-budget 4";
    bench.run(&build_arguments(&base_url, summary)).expect(0);

    let assets = Some(bench.out("assets"));
    let book = write_books(&BookRequest { assets, ..BookRequest::default() }).unwrap();
    let book: DemonstrationBook = book.demonstrations;
    let asked = parts_asked(&server);
    assert_eq!(asked.len(), 2, "three images of a demonstration, at most four in a prompt");
    for (case, parts) in asked.iter().enumerate() {
        let of = &book.demonstrations[book.cases[case].own[0] as usize];
        let shown = shown(parts);
        assert_eq!(shown.len(), 3);
        // Start and end; what is between them is a sub-goal or before a turn.
        for (state, (line, hash)) in [(of.states.first(), &shown[0]), (of.states.last(), &shown[2])]
        {
            let state = state.unwrap();
            assert!(line.contains(&book.world.sentence(state)), "{line}");
            let pose = Pose::try_from(*state).unwrap().to_string();
            bench.run(&["render", "--pose", &pose, "--size", "64", "--out", "view.png"]).expect(0);
            let rendered = RgbaImage::read(&bench.out("view.png")).unwrap();
            assert_eq!(hash_of(&rendered), *hash, "{pose}");
        }
    }

    // The document says what it took, and what is stored beside it has no pixels.
    let path = stored(&bench.out("documents"), "summary-original").unwrap();
    let document: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    let account = &document["provenance"]["account"];
    assert_eq!((&account["requests"], &account["images"]), (&2.into(), &6.into()));
    let steps = fs::read_dir(path.with_extension("steps")).unwrap();
    for step in steps {
        let text = fs::read_to_string(step.unwrap().path()).unwrap();
        assert!(text.contains("\"view\": \"") && !text.contains("base64"), "{text}");
    }
    let args = ["--frame-size", "64", "--assets", "assets", "--documents", "documents"];
    let listed = bench.run(&[&["memory", "ls"], &args[..]].concat()).expect(0).stdout;
    let row = listed.lines().find(|line| line.starts_with("summary/original")).unwrap();
    assert!(row.contains("model m") && row.contains("current"), "{row}");
    let cells: Vec<&str> = row.split_whitespace().collect();
    assert_eq!(cells[cells.len() - 3..], ["2", "6", "0.00"], "{row}");
    assert!(bench.leftovers().is_empty(), "{:?}", bench.leftovers());
}

/// The cell that is white in each view of the corridor of ten cells, by the view's hash.
fn white_cells() -> BTreeMap<String, usize> {
    let colour = |cell: usize, white: usize| match cell == white {
        true => [255, 255, 255, 255],
        false => [20, 25 * cell as u8, 120, 255],
    };
    let view = |white: usize| {
        let mut image = RgbaImage::filled(64, 64, [0; 4]);
        for (index, pixel) in image.as_bytes_mut().chunks_exact_mut(4).enumerate() {
            // As Python rounds: cell c begins at pixel round(6.4 c).
            let cell =
                (0..10).rev().find(|cell| (index % 64) as f64 >= (6.4 * *cell as f64).round());
            pixel.copy_from_slice(&colour(cell.unwrap(), white));
        }
        hash_of(&image)
    };
    (0..10).map(|white| (view(white), white)).collect()
}

#[test]
fn documents_of_another_world_are_in_its_words_and_views() {
    let bench = Bench::new();
    let server = Server::start(model).unwrap();
    let base_url = server.base_url();
    let script = repository("python/examples/corridor_world.py");
    let world = format!("{} {}", needs::python().display(), script.display());
    let build = |more: &str| {
        let mut command = bench.command(&build_arguments(&base_url, more));
        command.args(["--world-cmd", &world]).env("PYTHONPATH", repository("python"));
        Ended::run(&mut command)
    };
    build("--kind summary,semantic --views 2").expect(0);
    let asked = parts_asked(&server);
    let texts: Vec<String> = asked.iter().map(|parts| format!("{parts:?}")).collect();
    assert_eq!(asked.len(), 1 + 3);
    for text in &texts {
        assert!(text.contains("You walk along a corridor of ten cells"), "{text}");
        assert!(text.contains("walk east, walk west"), "{text}");
        assert!(!text.contains("warehouse"), "{text}");
    }
    let cells = white_cells();
    for parts in &asked[..2] {
        let shown = shown(parts);
        let cells: Vec<usize> = shown.iter().map(|(_, hash)| cells[hash]).collect();
        // Start and end of reach-7, visit-7, reach-8 and visit-8.
        assert_eq!(cells, [2, 7, 2, 6, 2, 8, 2, 7]);
        for ((line, _), cell) in shown.iter().zip(cells) {
            assert!(line.contains(&format!("You are in cell {cell}.")), "{line}");
        }
    }
    // Words alone need no world that draws.
    let before = server.received().len();
    build("--kind summary --views 0").expect(0);
    let asked = parts_asked(&server);
    assert!(asked.len() > before && asked[before..].iter().all(|parts| shown(parts).is_empty()));
    assert!(bench.leftovers().is_empty(), "{:?}", bench.leftovers());
}
