//! Documents that a run has its own model write: once, before its first episode, within its limits, and labelled by their author
//! wherever figures are shown. The server is scripted.

use std::fs;
use std::path::Path;
use std::process::Child;
use std::sync::mpsc;

use memtransfer_tests::{Bench, Ended, WATCHDOG, eventually, processes_with};
use rigs::chat_server::{Reaction, Received, Server, completion};
use serde_json::{Value, json};

/// Answers have fewer tokens if a decision is asked for.
const LONG_ANSWER: u64 = 1000;

/// What each reply says that it took.
const USAGE: [u64; 2] = [1_000_000, 7];

/// The documents of the runs here.
const DOCUMENTS: [&str; 2] = ["semantic/original", "summary/original"];

fn asks_for_document(body: &Value) -> bool {
    body["max_tokens"].as_u64() > Some(LONG_ANSWER)
}

/// The reply of a model to `request`, on which alone it depends.
fn reply(request: &Received) -> Reaction {
    let text = request.body["messages"].to_string();
    let sum = text.bytes().fold(0_u32, |sum, byte| sum.wrapping_mul(31) + u32::from(byte));
    let mut reply = match asks_for_document(&request.body) {
        true => completion(&format!("# Text {sum}")),
        false => completion("move forward"),
    };
    reply["usage"] = json!({ "prompt_tokens": USAGE[0], "completion_tokens": USAGE[1] });
    Reaction::json(200, &reply)
}

fn model() -> Server {
    Server::start(reply).unwrap()
}

/// The bodies of the requests for documents, in their order.
fn asked_for_documents(server: &Server) -> Vec<Value> {
    let bodies = server.received().into_iter().map(|request| request.body);
    bodies.filter(asks_for_document).collect()
}

/// Arguments of a short run into the folder `out`, whose model sees no images.
fn run<'a>(base_url: &'a str, out: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let mut args = vec!["run", "--policy", "openai", "--model", "m", "--base-url", base_url];
    args.extend(slice(out));
    args.extend(more);
    args
}

/// What a short run consists of.
fn slice(out: &str) -> Vec<&str> {
    let mut args = vec!["--memory", "summary,semantic", "--starts", "new", "--demos", "original"];
    args.extend(["--limit", "1", "--max-steps", "2", "--frame-size", "64", "--image-budget", "0"]);
    args.extend(["--max-retries", "0", "--response-cache", "off", "--out", out]);
    args
}

/// Starts the program with a cache folder of the bench's own.
fn start(bench: &Bench, cache: &str, args: &[&str]) -> Child {
    let mut command = bench.command(args);
    // What a killed one leaves goes with the bench.
    command.env("MEMTRANSFER_CACHE", bench.out(cache)).env("TMPDIR", bench.folder.path());
    command.spawn().unwrap()
}

fn ended(bench: &Bench, cache: &str, args: &[&str]) -> Ended {
    Ended::of(start(bench, cache, args))
}

/// What the manifest of the run in `folder` says about documents.
fn facts(folder: &Path) -> Value {
    let text = fs::read_to_string(folder.join("manifest.json")).unwrap();
    serde_json::from_str::<Value>(&text).unwrap()["documents"].take()
}

#[test]
fn a_model_writes_the_documents_of_its_runs_once() {
    let bench = Bench::new();
    let server = model();
    let base_url = server.base_url();
    let first = run(&base_url, "first", &[]);
    let dry = ended(&bench, "cache", &[&first[..], &["--dry-run"]].concat()).expect(0).stdout;
    assert!(dry.contains("Documents: summary/original, semantic/original to be built."), "{dry}");
    assert!(dry.contains("The model would write first"), "{dry}");
    assert_eq!(server.received().len(), 0);

    let said = ended(&bench, "cache", &first).expect(0).stderr;
    assert_eq!(said.matches("asking m at").count(), 1, "{said}");
    assert!(said.contains("m writes summary/original, semantic/original first: "), "{said}");
    assert!(said.contains("writing document semantic/original (2 of 2)"), "{said}");
    let written = asked_for_documents(&server);
    let all = server.received();
    assert!(written.len() > 3 && all.len() > written.len());
    assert!(all[..written.len()].iter().all(|request| asks_for_document(&request.body)));
    let documents = facts(&bench.out("first"));
    let requests = DOCUMENTS.map(|name| documents[name]["usage"]["requests"].as_u64().unwrap());
    assert_eq!(requests.iter().sum::<u64>(), written.len() as u64);
    for name in DOCUMENTS {
        let of = &documents[name];
        assert_eq!((&of["builder"], &of["model"]), (&"model".into(), &"m".into()), "{of}");
        assert_eq!(of["built"], true, "{of}");
    }
    let score = |name: &str| {
        let shown = ended(&bench, "cache", &["score", name]).expect(0).stdout;
        shown.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let tokens = written.len() as u64 * USAGE.iter().sum::<u64>();
    let shown = score("first");
    let account = |when: &str| {
        let requests = written.len();
        format!(
            "m wrote {} {when}, in {requests} requests with {tokens} tokens",
            DOCUMENTS.join(", ")
        )
    };
    assert!(shown.contains(&account("for this run")) && !shown.contains("Summary ("), "{shown}");

    // Another run uses them, and so does the same one.
    ended(&bench, "cache", &run(&base_url, "second", &[])).expect(0);
    ended(&bench, "cache", &first).expect(0);
    assert_eq!(asked_for_documents(&server).len(), written.len());
    let shown = score("second");
    assert!(shown.contains(&account("before this run")), "{shown}");
    assert!(score("first").contains(&account("for this run")));

    // The script's documents are labelled, and the runs are not called alike.
    let third = run(&base_url, "third", &["--documents", "extractive"]);
    ended(&bench, "cache", &third).expect(0);
    assert_eq!(asked_for_documents(&server).len(), written.len());
    let shown = score("third");
    assert!(shown.contains("Summary (extractive)") && !shown.contains("wrote"), "{shown}");
    ended(&bench, "cache", &["report", "third", "--out", "page"]).expect(0);
    let page = fs::read_to_string(bench.out("page/report.html")).unwrap();
    assert!(page.contains("Semantic (extractive)"));
    let compared = ended(&bench, "cache", &["score", "first", "third"]).expect(0).stdout;
    let compared = compared.split_whitespace().collect::<Vec<_>>().join(" ");
    let differs =
        "author of document summary/original differs: the model m in first, extractive in third.";
    assert!(compared.contains(differs), "{compared}");

    // A policy without a model uses what a model has written before, and says whose it is.
    let mut other = vec!["run", "--policy", "random"];
    other.extend(["--memory", "summary", "--starts", "new", "--demos", "original", "--limit", "1"]);
    other.extend(["--max-steps", "2", "--frame-size", "64", "--documents", "model"]);
    other.extend(["--out", "fourth"]);
    ended(&bench, "cache", &other).expect(0);
    assert!(score("fourth").contains("Summary (by m)"));
    // Another model's are not written in its name.
    let refused = ended(&bench, "cache", &run(&base_url, "fifth", &["--documents", "model:n"]));
    let said = refused.expect(2).stderr;
    assert!(said.contains("memtransfer memory build --builder model --model n --kind"), "{said}");
    assert_eq!(asked_for_documents(&server).len(), written.len());
}

#[test]
fn a_run_that_is_killed_while_its_model_writes_asks_nothing_twice() {
    let bench = Bench::new();
    let whole = model();
    ended(&bench, "whole", &run(&whole.base_url(), "whole-run", &[])).expect(0);
    let questions = asked_for_documents(&whole);

    let (third, arrived) = mpsc::channel();
    let mut count = 0;
    let hanging = Server::start(move |request| {
        count += 1;
        if count < 3 {
            return reply(request);
        }
        third.send(()).unwrap();
        Reaction::Hang
    })
    .unwrap();
    let child = start(&bench, "cache", &run(&hanging.base_url(), "run", &[]));
    arrived.recv_timeout(WATCHDOG).unwrap();
    let builders = || processes_with(bench.folder.path().as_os_str().as_encoded_bytes());
    assert!(!builders().is_empty());
    bench.kill_run(child);
    eventually("the process that builds to end", || builders().is_empty().then_some(()));

    let rest = model();
    ended(&bench, "cache", &run(&rest.base_url(), "run", &[])).expect(0);
    let answered = asked_for_documents(&hanging).into_iter().take(2);
    assert_eq!(answered.chain(asked_for_documents(&rest)).collect::<Vec<_>>(), questions);
    let texts = |of: Value| DOCUMENTS.map(|name| of[name]["sha256"].clone());
    assert_eq!(texts(facts(&bench.out("run"))), texts(facts(&bench.out("whole-run"))));
}

#[test]
fn documents_count_against_the_limits_of_a_run() {
    let bench = Bench::new();
    let server = model();
    let base_url = server.base_url();
    let with = |limit: &'static str| run(&base_url, "run", &["--max-tokens-total", limit]);
    let small = ended(&bench, "cache", &with("10")).expect(1).stderr;
    assert!(small.contains("document summary/original takes about"), "{small}");
    assert_eq!(server.received().len(), 0);

    // The summary takes more than it was thought to take.
    let stopped = ended(&bench, "cache", &with("900000")).expect(1).stderr;
    assert!(stopped.contains("stopped before the first episode: the run has used"), "{stopped}");
    let asked = server.received().len();
    assert!(asked > 0);
    // The same command has not more to spend.
    let again = ended(&bench, "cache", &with("900000")).expect(1).stderr;
    assert!(again.contains("the run has used"), "{again}");
    assert_eq!(server.received().len(), asked);
    let documents = facts(&bench.out("run"));
    assert_eq!(documents["summary/original"]["built"], true, "{documents}");
    ended(&bench, "cache", &with("900000000")).expect(0);
    let documents = facts(&bench.out("run"));
    assert!(DOCUMENTS.iter().all(|name| documents[name]["built"] == true), "{documents}");
}

#[test]
fn a_unit_uses_the_documents_of_its_plan_and_has_none_written() {
    let bench = Bench::new();
    let server = model();
    let base_url = server.base_url();
    let mut plan = vec!["plan", "--policy", "openai", "--model", "m", "--base-url", &base_url];
    plan.extend(slice("plan.json"));
    ended(&bench, "cache", &plan).expect(0);
    let written = asked_for_documents(&server).len();
    assert!(written > 0);
    let mut work = vec!["work", "--plan", "plan.json", "--unit", "0", "--out", "units"];
    work.extend(["--base-url", &base_url]);
    let refused = ended(&bench, "elsewhere", &work).expect(2).stderr;
    assert!(refused.contains("Make the plan with --store"), "{refused}");
    ended(&bench, "cache", &work).expect(0);
    assert_eq!(asked_for_documents(&server).len(), written);
    let documents = facts(&bench.out("units/unit-000000"));
    assert_eq!(documents["summary/original"]["model"], "m", "{documents}");
}
