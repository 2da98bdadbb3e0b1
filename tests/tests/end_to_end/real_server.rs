//! A language model behind a real server, llama.cpp's, instead of a scripted one. The model is small, text-only and
//! understands nothing of warehouses. The tests check that it receives the requests, that its answers are understood
//! and counted, and that nothing is asked twice.

use std::fs;
use std::path::{Path, PathBuf};

use domain::DemonstrationKind;
use llm::{ChatClient, ChatMessage, ChatRequest, ChatRole, ChatSettings, Endpoint};
use memtransfer_tests::llama::{LlamaServer, MODEL};
use memtransfer_tests::{Bench, records, sorted_log};
use rigs::chat_server::{Reaction, Received, Server, completion};
use serde_json::{Value, json};
use warehouse::{CaseSet, History, Warehouse};

/// Tokens of a request with its answer.
const CONTEXT: u32 = 4096;

/// Small frames are rendered quickly, and this model is shown none.
const FRAME_SIZE: &str = "64";

/// Writes the shipped assets, reduced to two short cases, to `folder`: documents are built from all cases.
pub(crate) fn two_cases(folder: &Path) {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
    fs::create_dir(folder).unwrap();
    for file in ["layout.toml", "catalogue.toml", "models.toml", "published.toml"] {
        fs::copy(shipped.join(file), folder.join(file)).unwrap();
    }
    let mut set = CaseSet::shipped();
    set.cases.retain(|case| ["t01-07", "t02-03"].contains(&&*case.id));
    for (index, case) in set.cases.iter_mut().enumerate() {
        // Only the start poses of these cases remain.
        let of_the_other = [DemonstrationKind::Original, DemonstrationKind::Nearby]
            .map(|kind| History { case: 1 - index, kind });
        (case.irrelevant, case.confusable) = (of_the_other, of_the_other);
    }
    let text = set.to_toml(&Warehouse::shipped().catalogue);
    fs::write(folder.join("cases.toml"), text).unwrap();
}

/// `memtransfer memory build` of the document `kind` by the model behind `base_url`.
fn build<'a>(base_url: &'a str, kind: &'a str) -> Vec<&'a str> {
    let mut args = vec!["memory", "build", "--builder", "model", "--model", MODEL];
    args.extend(["--base-url", base_url, "--max-tokens", "24", "--kind", kind]);
    args.extend(["--demos", "original", "--views", "0"]);
    args.extend(["--assets", "assets", "--frame-size", FRAME_SIZE]);
    args.extend(["--out", "documents", "--quiet"]);
    args
}

/// The file of a document, whose name ends in its address.
pub(crate) fn stored(folder: &Path, name: &str) -> Option<PathBuf> {
    let files = fs::read_dir(folder).ok()?.map(|entry| entry.unwrap().path());
    let is_it = |path: &PathBuf| {
        let file = path.file_name().unwrap().to_string_lossy();
        file.starts_with(&format!("{name}-")) && file.ends_with(".json")
    };
    files.into_iter().find(is_it)
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// A server in front of the one at `base_url` that passes on its answers as whole ones: the model of the tests never ends.
fn with_an_end(base_url: &str) -> Server {
    let endpoint = Endpoint::new(base_url, None).unwrap();
    let client = ChatClient::new(endpoint, ChatSettings::new(MODEL), None);
    let message = |message: &Value| {
        let role = if message["role"] == "system" { ChatRole::System } else { ChatRole::User };
        ChatMessage::text(role, message["content"].as_str().unwrap())
    };
    let answer = move |request: &Received| {
        let body = &request.body;
        let messages = body["messages"].as_array().unwrap().iter().map(message).collect();
        let max_tokens = body["max_tokens"].as_u64().unwrap() as u32;
        let asked = ChatRequest { messages, max_tokens, choices: Vec::new() };
        let reply = client.ask(&asked, 0).unwrap().reply;
        let mut whole = completion(reply.text());
        whole["model"] = json!(reply.model);
        whole["usage"] = json!({
            "prompt_tokens": reply.prompt_tokens,
            "completion_tokens": reply.completion_tokens,
        });
        Reaction::json(200, &whole)
    };
    Server::concurrent(answer).unwrap()
}

#[test]
fn a_document_is_written_by_a_real_model() {
    let bench = Bench::new();
    two_cases(&bench.out("assets"));
    let folder = bench.out("documents");

    // A prompt that is too long for the server gives no document and leaves nothing behind.
    let server = LlamaServer::start(512, 1);
    let ended = bench.run(&build(server.base_url(), "summary")).expect(2);
    for part in ["stage `summary`", "400", "exceeds the available context size"] {
        assert!(ended.stderr.contains(part), "no {part:?} in:\n{}", ended.stderr);
    }
    assert!(stored(&folder, "summary-original").is_none());
    drop(server);

    // The model does not come to an end, and no part of a document is stored.
    let server = LlamaServer::start(CONTEXT, 1);
    let ended = bench.run(&build(server.base_url(), "semantic")).expect(2);
    assert!(ended.stderr.contains("was cut off after 24 tokens"), "{}", ended.stderr);
    assert!(stored(&folder, "semantic-original").is_none());

    let endless = server;
    let server = with_an_end(endless.base_url());
    let base_url = server.base_url();
    bench.run(&build(&base_url, "semantic")).expect(0);
    let path = stored(&folder, "semantic-original").unwrap();
    let document = json(&path);
    assert!(!document["text"].as_str().unwrap().trim().is_empty());
    let account = &document["provenance"]["account"];
    assert_eq!((&account["requests"], &account["model"]), (&3.into(), &MODEL.into()));
    let steps = fs::read_dir(path.with_extension("steps")).unwrap();
    let replies: Vec<Value> =
        steps.map(|step| json(&step.unwrap().path())["reply"].take()).collect();
    assert_eq!(replies.len(), 3);
    // The server counted every answer, and the document records their sum.
    for tokens in ["prompt_tokens", "completion_tokens"] {
        let counts: Vec<u64> =
            replies.iter().map(|reply| reply[tokens].as_u64().unwrap()).collect();
        assert!(counts.iter().all(|&count| count > 0), "{tokens}: {counts:?}");
        assert_eq!(account[tokens], counts.iter().sum::<u64>(), "{account}");
    }

    // A finished document needs no server.
    drop((server, endless));
    bench.run(&build(&base_url, "semantic")).expect(0);
}

#[test]
fn doctor_finds_out_what_a_real_server_can_do() {
    let bench = Bench::new();
    let server = LlamaServer::start(CONTEXT, 2);
    let mut args = vec!["doctor", "--policy", "openai", "--json"];
    args.extend(["--model", MODEL, "--base-url", server.base_url()]);
    // The model sees no images, which is an error for a run that sends some.
    let findings: Value = serde_json::from_str(&bench.run(&args).expect(1).stdout).unwrap();
    let of = |what: &str| {
        let found = findings.as_array().unwrap().iter().find(|finding| finding["what"] == what);
        found.unwrap_or_else(|| panic!("nothing about {what} in {findings:#}"))
    };
    for what in ["reachable", "model", "answers", "reasoning off", "temperature 0"] {
        let finding = of(&format!("endpoint, {what}"));
        assert_eq!(finding["ok"], true, "{finding}");
    }
    let restricted = of("endpoint, restricted answers")["about"].as_str().unwrap().to_owned();
    assert!(restricted.contains("the server restricts answers"), "{restricted}");
    let images = of("endpoint, images");
    assert_eq!(images["ok"], false);
    let about = images["about"].as_str().unwrap();
    assert!(about.contains("not supported") && about.contains("--image-budget 0"), "{about}");

    let report = &of("endpoint")["data"];
    assert_eq!(report["run_sized"], Value::Null);
    assert_eq!(report["reported_model"], MODEL);
}

/// Arguments of a run of one case into the folder `out`, with and without a summary, one step each: the model takes seconds
/// for an answer. No images: it takes none.
fn slice<'a>(base_url: &'a str, out: &'a str) -> Vec<&'a str> {
    let mut args = vec!["run", "--policy", "openai", "--model", MODEL, "--base-url", base_url];
    args.extend(["--image-budget", "0", "--response-cache", "./responses"]);
    args.extend(["--memory", "working,summary", "--starts", "new", "--demos", "original"]);
    args.extend(["--documents", "./documents", "--assets", "assets", "--frame-size", FRAME_SIZE]);
    args.extend(["--cases", "t02-03", "--max-steps", "1", "--lanes", "2", "--out", out]);
    args
}

#[test]
fn a_real_model_decides_in_a_run() {
    let bench = Bench::new();
    two_cases(&bench.out("assets"));
    let mut documents = vec!["memory", "build", "--kind", "summary", "--demos", "original"];
    documents.extend(["--assets", "assets", "--frame-size", FRAME_SIZE, "--out", "documents"]);
    bench.run(&documents).expect(0);

    let server = LlamaServer::start(CONTEXT, 2);
    bench.run(&slice(server.base_url(), "first")).expect(0);
    let episodes = records(&bench.out("first"));
    assert_eq!(episodes.len(), 2);
    for episode in &episodes {
        assert_eq!((&episode["requests"], &episode["images"]), (&1.into(), &0.into()));
        for tokens in ["prompt_tokens", "completion_tokens"] {
            assert!(episode[tokens].as_u64() >= Some(1), "{tokens} of {episode}");
        }
    }
    // The model reads the summary, so its tokens are counted.
    let tokens = |memory: &str, which: &str| -> u64 {
        let of_memory = episodes.iter().filter(|episode| episode["memory"] == memory);
        of_memory.map(|episode| episode[which].as_u64().unwrap()).sum()
    };
    let read = |memory| tokens(memory, "prompt_tokens");
    let document = json(&bench.out("first/documents/summary-original.json"));
    let characters = document["text"].as_str().unwrap().len() as u64;
    assert!(characters > 400, "{document}");
    // English has about four characters a token, and hardly ever six.
    assert!(read("summary") > read("working") + characters / 6);

    // A condition has one case here; the table has tokens of a hundred, in millions.
    bench.run(&["report", "first"]).expect(0);
    let table = bench.out("first/report/tables/conditions.csv");
    let table = fs::read_to_string(table).unwrap();
    for memory in ["working", "summary"] {
        let row = table.lines().find(|row| row.to_lowercase().starts_with(memory)).unwrap();
        let of_memory = tokens(memory, "prompt_tokens") + tokens(memory, "completion_tokens");
        let millions = format!(",{:.2},", of_memory as f64 * 100.0 / 1e6);
        assert!(row.contains(&millions), "{millions} in {row}");
    }

    // Answered requests are read from the cache: the server is gone.
    let base_url = server.base_url().to_owned();
    drop(server);
    bench.run(&slice(&base_url, "second")).expect(0);
    assert_eq!(sorted_log(&bench.out("second")), sorted_log(&bench.out("first")));
    assert!(bench.leftovers().is_empty(), "{:?}", bench.leftovers());
}
