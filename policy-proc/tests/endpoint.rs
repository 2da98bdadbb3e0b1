//! `policy-proc probe` and `policy-proc cache` as another process sees them, and several processes that share
//! what is kept.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use policy_proc::chat::scripted::{Server, Turn};
use serde_json::{Value, json};

const KEY: &str = "sk-very-secret";

/// `policy-proc ARGUMENTS` without anything from the environment of the test but the key.
fn policy_proc(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_policy-proc"));
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    for variable in ["OPENAI_BASE_URL", "OPENAI_API_BASE", "MEMTRANSFER_CACHE", "XDG_CACHE_HOME"] {
        command.env_remove(variable);
    }
    command.env("OPENAI_API_KEY", KEY).env("RUST_LOG", "trace");
    command
}

/// Its output, with the key in none of it.
fn ended(child: Child) -> Output {
    let output = child.wait_with_output().unwrap();
    let printed = [&output.stdout[..], &output.stderr[..]].concat();
    assert!(!String::from_utf8_lossy(&printed).contains("very-secret"), "the key is out");
    output
}

fn run(arguments: &[&str]) -> Output {
    ended(policy_proc(arguments).spawn().unwrap())
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn value(output: &Output) -> Value {
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Asks `questions` in a process of its own.
fn ask(server: &Server, folder: &Path, questions: &[String]) -> Child {
    let mut command = policy_proc(&["ask", "--model", "m", "--base-url", &server.base_url()]);
    command.arg("--response-cache").arg(folder);
    let mut child = command.spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    for question in questions {
        let message = json!({"role": "user", "content": question});
        writeln!(stdin, "{}", json!({"messages": [message], "max_tokens": 9})).unwrap();
    }
    child
}

fn replies(child: Child) -> Vec<Value> {
    stdout(&ended(child)).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn processes_share_what_is_kept_and_it_can_be_listed_and_removed() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(|request| {
        let text = request.body.pointer("/messages/0/content").unwrap().as_str().unwrap();
        Turn::says(&format!("re: {text}"))
    })
    .unwrap();
    let questions: Vec<String> = (0..20).map(|i| format!("Question {i}?")).collect();
    let children: Vec<_> = (0..3).map(|_| ask(&server, folder.path(), &questions)).collect();
    for child in children {
        let replies = replies(child);
        assert_eq!(replies.len(), 20);
        for (question, reply) in questions.iter().zip(replies) {
            assert_eq!(reply["text"], format!("re: {question}"));
        }
    }
    let asked = server.received().len();
    assert!((20..=60).contains(&asked));
    let known = replies(ask(&server, folder.path(), &questions));
    assert!(known.iter().all(|reply| reply["from_cache"] == true));
    assert_eq!(server.received().len(), asked, "nothing is asked that is known");

    let here = folder.path().to_str().unwrap();
    let listing = value(&run(&["cache", "ls", "--json", "--response-cache", here]));
    assert_eq!((&listing["entries"], &listing["broken"]), (&json!(20), &json!(0)));
    assert_eq!(listing["models"][0]["model"], "m");
    let plain = stdout(&run(&["cache", "ls", "--response-cache", here]));
    assert!(plain.starts_with(&format!("{here}: 20 replies (")), "{plain}");

    let bytes = listing["bytes"].as_u64().unwrap();
    let half = (bytes / 2).to_string();
    let prune = ["cache", "prune", "--json", "--response-cache", here, "--max-bytes", &half];
    let left = value(&run(&prune))["left"]["entries"].as_u64().unwrap();
    assert!(matches!(left, 9..=10), "{left}");
    let prune = ["cache", "prune", "--json", "--response-cache", here, "--older-than", "1d"];
    assert_eq!(value(&run(&prune))["removed"]["entries"], 0);
    let plain = stdout(&run(&["cache", "clear", "--response-cache", here]));
    assert!(plain.starts_with(&format!("removed {left} replies (")), "{plain}");
    assert_eq!(run(&["cache", "prune", "--response-cache", here]).status.code(), Some(2));
}

#[test]
fn the_folder_is_in_the_cache_that_the_environment_names() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = policy_proc(&["cache", "ls"]);
    let output = ended(command.env("MEMTRANSFER_CACHE", folder.path()).spawn().unwrap());
    let expected = folder.path().join("responses");
    assert_eq!(stdout(&output), format!("{}: 0 replies (0 B)\n", expected.display()));
}

#[test]
fn a_probe_ends_with_a_status_and_tells_nobody_the_key() {
    let server = Server::start(|request| match &*request.line {
        "GET /v1/models HTTP/1.1" => Turn::json(200, &json!({"data": [{"id": "m"}]})),
        "GET /version HTTP/1.1" => Turn::json(200, &json!({"version": format!("0.11 {KEY}")})),
        line if line.starts_with("GET") => Turn::json(404, &json!({"detail": "Not Found"})),
        _ => match request.body.pointer("/messages/0/content") {
            Some(Value::String(_)) => Turn::says(&format!("42 {KEY}")),
            _ => Turn::json(400, &json!({"error": {"message": format!("not for {KEY}")}})),
        },
    })
    .unwrap();
    let base_url = server.base_url();
    let arguments = ["probe", "--model", "m", "--base-url", &base_url, "--together", "2"];
    let output = run(&arguments);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let plain = stdout(&output);
    assert!(plain.contains("NOT YET  images: the server takes none: not for [key]. "), "{plain}");
    assert!(plain.contains("ok       temperature 0: "), "{plain}");

    let output = run(&[&arguments[..], &["--json"]].concat());
    assert_eq!(output.status.code(), Some(1));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["images_per_request"], 0);
    assert_eq!(report["fingerprint"]["pages"]["/version/version"], "0.11 [key]");
    assert_eq!(report["speed"]["together_tokens"], 10);
}

#[test]
fn a_probe_without_an_endpoint_says_how_to_name_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = policy_proc(&["probe", "--model", "m"]);
    let output = ended(command.current_dir(folder.path()).spawn().unwrap());
    assert_eq!(output.status.code(), Some(2));
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(printed.contains("pass --base-url or set OPENAI_BASE_URL"), "{printed}");
}
